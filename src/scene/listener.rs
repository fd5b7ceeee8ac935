//! An observer for tests.
#![allow(clippy::unwrap_used)]

use crate::progress::Observer;
use std::sync::Mutex;

/// Stores the warnings it receives.
#[derive(Default)]
pub(super) struct Listener(Mutex<Vec<String>>);

impl Observer for Listener {
    fn warn(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
}

impl Listener {
    pub(super) fn heard(&self) -> String {
        self.0.lock().unwrap().join("\n")
    }
}

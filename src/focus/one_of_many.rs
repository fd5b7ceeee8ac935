//! The observer of one of many images.

use crate::progress::Observer;

/// An observer that may stop an image, and hears nothing of it: progress is that of all of them.
pub(super) struct OneOfMany<'a>(pub(super) &'a dyn Observer);

impl Observer for OneOfMany<'_> {
    fn should_stop(&self) -> bool {
        self.0.should_stop()
    }
}

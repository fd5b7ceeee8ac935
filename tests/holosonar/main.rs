//! The whole program from outside, in one test binary, by topic.

#![allow(clippy::unwrap_used)]

mod agreement;
mod layout;
mod point;
mod reference;
mod support;

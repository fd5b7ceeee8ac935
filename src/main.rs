#![warn(missing_docs)]
//! The binary.
fn main() {}

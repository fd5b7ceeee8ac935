//! holosonar images 3-D scenes with sound.

pub mod error;
pub mod files;
pub mod progress;
pub mod wave;
// `grid` stands below `wave` and above every stage.
pub mod export;
pub mod grid;

//! holosonar images 3-D scenes with sound.

pub mod error;
pub mod progress;
pub mod wave;
// `grid` stands below `wave` and above every stage.
pub mod grid;
pub mod scene;

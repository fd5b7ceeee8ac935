//! holosonar images 3-D scenes with sound.

pub mod error;
pub mod progress;
pub mod files;
pub mod wave;
pub mod grid;
pub mod scene;
pub mod reflectors;
pub mod acquisition;
pub mod reconstruct;
pub mod depth;
pub mod truth;
pub mod metrics;
pub mod plan;
pub mod export;
pub mod config;
pub mod pipeline;

//! The whole program from outside, in one test binary, by topic.

#![allow(clippy::unwrap_used)]
// What the tests measure is worth reading with --nocapture.
#![allow(clippy::print_stdout)]

mod absurd;
mod agreement;
mod arrays;
mod ascan;
mod backprojection;
mod bare;
mod bare_kinds;
mod binary;
#[cfg(target_os = "linux")]
mod bounces;
mod browser;
mod calibration;
mod choices;
mod coding;
mod command;
mod correlation;
mod designs;
mod escapes;
mod faults;
mod focus;
mod guide;
mod health;
mod import;
mod instrument;
mod interface;
mod layout;
mod levels;
mod linear;
mod measured;
mod memory;
mod meshes;
mod motion;
mod mutation;
mod named;
mod orientation;
mod overwriting;
mod parsers;
mod parts;
mod perspective;
mod physics;
mod plan;
mod point;
mod random;
mod readers;
mod recording;
mod reference;
mod refined;
mod regression;
mod reproduce;
mod scenes;
mod sources;
mod support;
mod system;
mod units;
mod units_by_command;
mod words;
mod zarr;

// `named` takes it from the crate's root, which in the library's unit tests is the library.
use holosonar::progress;

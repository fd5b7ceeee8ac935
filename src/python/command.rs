//! The `holosonar` command, for the script that a wheel installs.

use crate::cli;
use pyo3::prelude::*;
use std::ffi::OsString;

/// Runs the command with these arguments, of which the first is the name of the program; returns the exit status.
#[pyfunction]
pub(super) fn run_command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    // The command handles signals itself, and ends the process when it has to.
    py.detach(|| cli::run_command(&arguments))
}

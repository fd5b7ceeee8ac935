//! The `holosonar` command, for the script that a wheel installs, and what a worker needs to run it for somebody else.

use crate::{checkpoint, cli};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::ffi::OsString;

/// Runs the command with these arguments, of which the first is the name of the program; returns the exit status.
#[pyfunction]
pub(super) fn run_command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    // The command handles signals itself, and ends the process when it has to.
    py.detach(|| cli::run_command(&arguments))
}

/// The secret with which the command seals what it stores, created if there is none.
#[pyfunction]
pub(super) fn users_secret(py: Python<'_>) -> PyResult<Bound<'_, PyBytes>> {
    Ok(PyBytes::new(py, &checkpoint::users_secret()?))
}

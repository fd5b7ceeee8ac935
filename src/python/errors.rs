//! Errors as Python's exceptions: one class for each kind, which are defined in the package's `_errors.py`.

use crate::error::{Error, ErrorKind, is_guarded};
use pyo3::prelude::*;
use std::error::Error as _;
use std::io;

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        Python::attach(|py| exception(py, &error).unwrap_or_else(|failure| failure))
    }
}

/// The exception for an error, with its place and, where there is one, the system's number.
fn exception(py: Python<'_>, error: &Error) -> PyResult<PyErr> {
    let class = match error.kind() {
        ErrorKind::InvalidInput if error.place() == Some("memory") => "MemoryLimitError",
        ErrorKind::InvalidInput => "InputError",
        ErrorKind::NotFound => "NotFoundError",
        ErrorKind::Io => "SystemFailure",
        ErrorKind::OutOfMemory => "OutOfMemoryError",
        ErrorKind::LimitMissed => "LimitMissedError",
        ErrorKind::Interrupted => "Interrupted",
    };
    let exception = py.import("holosonar._errors")?.getattr(class)?.call1((error.to_string(),))?;
    exception.setattr("place", error.place())?;
    let cause = error.source().and_then(|cause| cause.downcast_ref::<io::Error>());
    if let Some(number) = cause.and_then(io::Error::raw_os_error)
        && matches!(error.kind(), ErrorKind::NotFound | ErrorKind::Io)
    {
        exception.setattr("errno", number)?;
    }
    Ok(PyErr::from_value(exception))
}

/// Keeps silent about panics of other crates' readers, which become errors; of all others the usual message is printed.
pub(super) fn silence_guarded_panics() {
    let default = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !is_guarded() {
            default(panic);
        }
    }));
}

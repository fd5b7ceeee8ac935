//! The Python package: the extension module `holosonar._holosonar`, which the Python sources in `python/holosonar` turn into an
//! interface of classes and functions; and the `holosonar` command for Python's scripts.
//!
//! A function here takes plain data, NumPy arrays and a [run file](run_files::PythonRunFile), whose keys hold every option, so that
//! defaults, ranges and messages are those of the command line. Arrays that are contiguous are borrowed, not copied, and
//! results are handed over to NumPy as they are. Every job runs on a thread of its own (module `jobs`), so that the
//! interpreter goes on, progress is reported and Ctrl-C is heard.

// PyO3 passes arguments by value.
#![allow(clippy::needless_pass_by_value)]

mod arrays;
mod command;
mod cubes;
mod depths;
mod designs;
mod errors;
mod images;
mod instruments;
mod jobs;
mod pictures;
mod run_files;
mod volumes;

use pyo3::prelude::*;

#[pymodule]
mod _holosonar {
    #[pymodule_export]
    use super::command::{run_command, users_secret};
    #[pymodule_export]
    use super::cubes::{read_cube, read_reflectors, simulate_points, simulate_scene, write_cube};
    #[pymodule_export]
    use super::depths::{compare, locate_depth, read_depth, truth, write_depth};
    #[pymodule_export]
    use super::designs::{plan, plan_sweep, psf, simulate_sweep};
    #[pymodule_export]
    use super::images::{image_file, image_samples, image_scene};
    #[pymodule_export]
    use super::instruments::{
        advised_pitch, random_array, read_array, rectangular_array, spiral_array, stepped_frequencies,
    };
    #[pymodule_export]
    use super::pictures::{amplitude_picture, depth_picture, error_picture};
    #[pymodule_export]
    use super::run_files::PythonRunFile;
    #[pymodule_export]
    use super::volumes::{read_volume, reconstruct, write_volume};

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::errors::silence_guarded_panics();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

//! The `holosonar` command; all of it is the library's `cli`.

use std::process::ExitCode;

fn main() -> ExitCode {
    holosonar::cli::main()
}

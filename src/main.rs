//! The `holosonar` command, which is implemented in the library's `cli`.

use std::process::ExitCode;

fn main() -> ExitCode {
    holosonar::cli::main()
}

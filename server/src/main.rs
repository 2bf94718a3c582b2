//! The `roundel` command; everything is in the library, so that tests can use it.

use std::process::ExitCode;

fn main() -> ExitCode {
    roundel_server::cli::main()
}

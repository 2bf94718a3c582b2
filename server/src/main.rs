//! The `roundel` command; everything is in the library, so that tests can use it.

use std::process::ExitCode;

/// Snapshots are made of many small pieces, many times a second, on one thread and let go of on another.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    roundel_server::app::cli::main()
}

//! Recordings beside the repository, for tests that are skipped without them.

use std::path::{Path, PathBuf};

/// The folder `../shared/data/NAME` beside the workspace. `None` if it is missing, after printing that.
pub fn shared_data(test: &str, name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(name);
    if folder.exists() {
        return Some(folder);
    }
    println!("skipped: {test} needs ../shared");
    None
}

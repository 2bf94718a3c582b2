//! Runs the bodies of the fuzz targets on the stored inputs: seeds of every format, and inputs that were mishandled once.

use std::{
    fs,
    panic::{self, AssertUnwindSafe},
    path::Path,
};

use crate::fuzz;

fn run_corpus(target: &str, run: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/fuzz/corpus").join(target);
    let mut files: Vec<_> =
        fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(files.len() >= 3, "{} inputs in {}", files.len(), folder.display());
    let mut failed = Vec::new();
    for file in files {
        let bytes = fs::read(&file).unwrap();
        println!("{}", file.display());
        if panic::catch_unwind(AssertUnwindSafe(|| run(&bytes))).is_err() {
            failed.push(file);
        }
    }
    assert!(failed.is_empty(), "the target {target} panics on {failed:#?}");
}

macro_rules! targets {
    ($($target:ident),* $(,)?) => {
        $(
            #[test]
            fn $target() {
                run_corpus(stringify!($target), fuzz::$target::run);
            }
        )*
    };
}

targets! {
    camera_file,
    configuration,
    mjpeg,
    picture,
    push,
    query,
    recording,
    truth,
    websocket,
}

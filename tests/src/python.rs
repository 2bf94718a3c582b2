//! Python with packages from PyPI, for tests that need files which only such packages read or contain.
//!
//! In: a folder for outputs (`target/tmp` of a test). Out: the folder that a script in `tests/python` has filled. It
//! is kept until the script, its arguments or the packages change. Where Python, its `venv` or the network is
//! missing, the test is skipped with a line that names the reason.

use std::{
    ffi::OsStr,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// The scripts and their requirements.
const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/python");

/// A virtual environment with `tests/python/requirements.txt` installed.
pub struct Python {
    program: PathBuf,
    folder: PathBuf,
    packages: String,
}

impl Python {
    /// The environment in `folder`, created if necessary. `None` if that fails, after printing why.
    pub fn new(test: &str, folder: &Path) -> Option<Self> {
        let requirements = Path::new(SCRIPTS).join("requirements.txt");
        let packages = fs::read_to_string(&requirements).expect("tests/python/requirements.txt");
        let environment = folder.join("python");
        let program =
            environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
        let made = cached(&environment, &packages, || {
            run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&environment))?;
            run(Command::new(&program)
                .args(["-m", "pip", "install", "--quiet", "-r"])
                .arg(&requirements))
        });
        match made {
            Ok(()) => Some(Self { program, folder: folder.into(), packages }),
            Err(why) => {
                println!("skipped: {test} needs Python 3 with venv, and PyPI: {why}");
                None
            }
        }
    }

    pub fn program(&self) -> &Path {
        &self.program
    }

    /// The folder NAME that `tests/python/SCRIPT ARGUMENTS… FOLDER` has filled. `None` if the script fails, after
    /// printing why.
    pub fn folder(
        &self,
        test: &str,
        name: &str,
        script: &str,
        arguments: &[&OsStr],
    ) -> Option<PathBuf> {
        let path = Path::new(SCRIPTS).join(script);
        let text = fs::read_to_string(&path).expect("a script in tests/python");
        let key = format!("{}\n{arguments:?}\n{text}", self.packages);
        let folder = self.folder.join(name);
        let made = cached(&folder, &key, || {
            run(Command::new(&self.program).arg(&path).args(arguments).arg(&folder))
        });
        match made {
            Ok(()) => Some(folder),
            Err(why) => {
                println!("skipped: {test} needs {script} to work: {why}");
                None
            }
        }
    }
}

/// Makes `make` fill an empty `folder` unless it was filled for the same `key`. Tests that run at the same time, in
/// one process or several, wait for each other.
fn cached(
    folder: &Path,
    key: &str,
    make: impl FnOnce() -> Result<(), String>,
) -> Result<(), String> {
    let with_folder = |error: io::Error| format!("{}: {error}", folder.display());
    let marker = folder.with_extension("made");
    let lock = File::create(folder.with_extension("lock")).map_err(with_folder)?;
    lock.lock().map_err(with_folder)?;
    if fs::read_to_string(&marker).is_ok_and(|made| made == key) {
        return Ok(());
    }
    let _ = fs::remove_file(&marker);
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(with_folder)?;
    }
    fs::create_dir_all(folder).map_err(with_folder)?;
    make()?;
    fs::write(&marker, key).map_err(with_folder)
}

/// Runs a command to completion. The error is the last line that it wrote.
fn run(command: &mut Command) -> Result<(), String> {
    let Output { status, stderr, .. } =
        command.output().map_err(|error| format!("{:?}: {error}", command.get_program()))?;
    if status.success() {
        return Ok(());
    }
    let text = String::from_utf8_lossy(&stderr);
    Err(text.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("no reason given").into())
}

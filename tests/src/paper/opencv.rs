//! OpenCV's ArUco and SimpleBlobDetector, from PyPI, on pictures rendered here (`tests/compare/paper.py`).

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use tempfile::TempDir;

use crate::{
    optics::Pinhole,
    render::Image,
    rival::{Cells, write_pgm},
};

const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/compare");
/// Markers that are made.
const MARKERS: usize = 32;

/// A detector of OpenCV's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Detector {
    /// ArUco as it is by default.
    Aruco,
    /// With its corners refined.
    Refined,
    /// SimpleBlobDetector.
    Blob,
}

/// Pictures for one detector.
#[derive(Debug, Serialize)]
pub struct Job {
    /// Which.
    pub detector: Detector,
    /// Of markers' sides, metres.
    pub size_m: f64,
    /// fx fy cx cy and the distortion, for positions.
    pub camera: Option<Vec<f64>>,
    /// The least time of so many counts.
    pub repetitions: usize,
    /// Files.
    pub images: Vec<PathBuf>,
}

/// What became of one picture.
#[derive(Debug, Deserialize)]
pub struct Judged {
    /// Time of a search.
    pub ms: f64,
    /// Found.
    pub found: Vec<Found>,
}

/// One marker or blob.
#[derive(Debug, Deserialize)]
pub struct Found {
    /// Its middle in the image.
    pub center_px: [f64; 2],
    /// And before the camera, where that was asked for and can be said.
    pub position_m: Option<[f64; 3]>,
}

/// Python with OpenCV, and a folder for pictures.
pub struct Others {
    python: PathBuf,
    /// Its own, since others may run at the same time.
    folder: TempDir,
    /// Cells of ArUco markers.
    pub markers: Vec<Cells>,
}

impl Others {
    /// Makes the environment where it is not there; the error says what is missing.
    pub fn ready() -> anyhow::Result<Self> {
        let path = said(&mut Command::new(Path::new(SCRIPTS).join("python")))
            .context("Python 3 with venv, and OpenCV from PyPI")?;
        let python = PathBuf::from(path.trim());
        let folder = python.ancestors().nth(3).context("the environment's folder")?;
        let folder = tempfile::tempdir_in(folder).context("a folder for pictures")?;
        let mut others = Self { python, folder, markers: Vec::new() };
        others.markers = serde_json::from_str(&others.run(&["markers", &MARKERS.to_string()])?)?;
        Ok(others)
    }

    /// Writes a picture to be judged.
    pub fn write(&self, name: &str, image: &Image) -> anyhow::Result<PathBuf> {
        let path = self.folder.path().join(format!("{name}.pgm"));
        write_pgm(&path, image).with_context(|| path.display().to_string())?;
        Ok(path)
    }

    /// What becomes of each picture of each job. The pictures are removed: they are large.
    pub fn judge(&self, jobs: &[Job]) -> anyhow::Result<Vec<Vec<Judged>>> {
        let path = self.folder.path().join("jobs.json");
        fs::write(&path, serde_json::to_vec(jobs)?)?;
        let text = self.run(&["judge", &path.display().to_string()])?;
        for image in jobs.iter().flat_map(|job| &job.images) {
            // Jobs may share pictures.
            let _ = fs::remove_file(image);
        }
        Ok(serde_json::from_str(&text)?)
    }

    fn run(&self, arguments: &[&str]) -> anyhow::Result<String> {
        let script = Path::new(SCRIPTS).join("paper.py");
        said(Command::new(&self.python).arg(script).args(arguments))
            .context("tests/compare/paper.py")
    }
}

/// A camera as jobs have it.
pub fn numbers(optics: &Pinhole) -> Vec<f64> {
    let [fx, fy] = optics.focal_px;
    let [cx, cy] = optics.center_px;
    [fx, fy, cx, cy].into_iter().chain(optics.distortion.coefficients().iter().copied()).collect()
}

/// What a command writes; the error is the last line of what it complains of.
fn said(command: &mut Command) -> anyhow::Result<String> {
    let Output { status, stdout, stderr } =
        command.output().with_context(|| format!("{}", command.get_program().display()))?;
    if !status.success() {
        let text = String::from_utf8_lossy(&stderr);
        let last = text.lines().rev().find(|line| !line.trim().is_empty());
        bail!("{}", last.unwrap_or("no reason given"));
    }
    Ok(String::from_utf8(stdout)?)
}

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
    other_markers::{Cells, write_pgm},
    render::Image,
};

const SCRIPTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/compare");
/// Number of generated markers.
const MARKERS: usize = 32;

/// OpenCV's detectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Detector {
    /// ArUco with default parameters.
    Aruco,
    /// ArUco with corner refinement.
    Refined,
    /// SimpleBlobDetector.
    Blob,
}

/// Pictures for one detector.
#[derive(Debug, Serialize)]
pub struct Job {
    pub detector: Detector,
    /// Side of the markers.
    pub size_m: f64,
    /// fx fy cx cy and the distortion, for positions.
    pub camera: Option<Vec<f64>>,
    /// Repetitions, of which the fastest counts.
    pub repetitions: usize,
    pub images: Vec<PathBuf>,
}

/// Result for one picture.
#[derive(Debug, Deserialize)]
pub struct SearchResult {
    /// Time of a search.
    pub ms: f64,
    pub found: Vec<Found>,
}

/// One marker or blob.
#[derive(Debug, Deserialize)]
pub struct Found {
    /// Centre in the image.
    pub center_px: [f64; 2],
    /// Position in the camera frame, if requested and available.
    pub position_m: Option<[f64; 3]>,
}

/// Python with OpenCV, and a folder for pictures.
pub struct OpenCv {
    python: PathBuf,
    /// Separate, since tests run at the same time.
    folder: TempDir,
    /// Cells of ArUco markers.
    pub markers: Vec<Cells>,
}

impl OpenCv {
    /// Creates the environment if necessary. The error names what is missing.
    pub fn ready() -> anyhow::Result<Self> {
        let path = output_of(&mut Command::new(Path::new(SCRIPTS).join("python")))
            .context("Python 3 with venv, and OpenCV from PyPI")?;
        let python = PathBuf::from(path.trim());
        let folder = python.ancestors().nth(3).context("the environment's folder")?;
        let folder = tempfile::tempdir_in(folder).context("a folder for pictures")?;
        let mut others = Self { python, folder, markers: Vec::new() };
        others.markers = serde_json::from_str(&others.run(&["markers", &MARKERS.to_string()])?)?;
        Ok(others)
    }

    pub fn write(&self, name: &str, image: &Image) -> anyhow::Result<PathBuf> {
        let path = self.folder.path().join(format!("{name}.pgm"));
        write_pgm(&path, image).with_context(|| path.display().to_string())?;
        Ok(path)
    }

    /// Results for each picture of each job. The pictures are large and are removed.
    pub fn judge(&self, jobs: &[Job]) -> anyhow::Result<Vec<Vec<SearchResult>>> {
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
        output_of(Command::new(&self.python).arg(script).args(arguments))
            .context("tests/compare/paper.py")
    }
}

/// A camera in the format of jobs.
pub fn numbers(optics: &Pinhole) -> Vec<f64> {
    let [fx, fy] = optics.focal_px;
    let [cx, cy] = optics.center_px;
    [fx, fy, cx, cy].into_iter().chain(optics.distortion.coefficients().iter().copied()).collect()
}

/// Output of a command. The error is the last line of its standard error.
fn output_of(command: &mut Command) -> anyhow::Result<String> {
    let Output { status, stdout, stderr } =
        command.output().with_context(|| format!("{}", command.get_program().display()))?;
    if !status.success() {
        let text = String::from_utf8_lossy(&stderr);
        let last = text.lines().rev().find(|line| !line.trim().is_empty());
        bail!("{}", last.unwrap_or("no reason given"));
    }
    Ok(String::from_utf8(stdout)?)
}

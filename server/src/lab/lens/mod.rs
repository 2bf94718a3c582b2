//! Calibrates a camera's lens while the server runs: the operator moves the printed board in front of the camera, sees
//! which views are missing, and applies the result.
//!
//! | module | content |
//! | --- | --- |
//! | [`board_search`] | finds the board in pictures and collects views; the command line uses it too |
//! | [`chessboard`] | descriptions of chessboards and ChArUco boards |
//! | [`picture_source`] | pictures of a running camera, or of a source opened for the calibration |
//! | `task` | the thread that collects views and solves |
//! | [`report`] | progress and result |
//! | `annotated_picture` | the newest picture with the rings found in it |
//!
//! One calibration runs at a time. A running camera is not interrupted: at most ten of its frames a second are copied, and
//! the thread is busy for at most half of the time. A calibration whose status is not read for a minute is cancelled.

mod annotated_picture;
pub mod board_search;
pub mod chessboard;
#[cfg(feature = "chessboard")]
mod corners;
pub mod picture_source;
pub mod report;
mod task;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use roundel_core::calib::{
    board::Board,
    lens::{DistortionModel, LensCalibration, MIN_VIEWS},
};
use thiserror::Error;

use crate::{
    lab::print::millimetres,
    model::{
        address::{AddressError, SourceAddress},
        hub::Hub,
        redact::redact,
        source_rules::{SourceRuleError, SourceRules},
        stop::StopSignal,
    },
};
pub use annotated_picture::AnnotatedPicture;
use board_search::GOOD_VIEWS;
pub use picture_source::{OpenedSource, PictureSource};
use report::{LensStatus, Stage};

/// Allowed range of [`LensRun::max_views`].
pub const VIEWS: (usize, usize) = (MIN_VIEWS, 100);
pub const DEFAULT_VIEWS: usize = 40;
const IDLE_TIMEOUT: Duration = Duration::from_secs(60);

#[derive(Clone, Debug)]
pub struct LensRun {
    pub picture_source: PictureSource,
    /// Name of the camera in the camera file.
    pub name: String,
    /// The picture source as clients see it.
    pub shown: String,
    pub board: Board,
    /// Maximum number of views to keep, within [`VIEWS`].
    pub max_views: usize,
    /// The distortion model; `None` selects it automatically.
    pub model: Option<DistortionModel>,
}

#[derive(Debug, Error)]
pub enum LensError {
    #[error(transparent)]
    Address(#[from] AddressError),
    #[error(transparent)]
    Rule(#[from] SourceRuleError),
    #[error("the lens of {0} is being calibrated: finish or cancel that calibration first")]
    Busy(String),
    #[error("expected {least} to {most} views, found {0}", least = VIEWS.0, most = VIEWS.1)]
    Views(usize),
    #[error(
        "a `push:` source cannot be opened, since a remote program feeds it: add the camera with any lens file, and \
         calibrate it by its name"
    )]
    Fed,
    #[error("no lens is being calibrated: start one first")]
    NotRecording,
    #[error("there is no calibrated lens: complete a calibration first")]
    NoResult,
    #[error("cannot start the thread of the lens calibration: {0}")]
    Thread(String),
}

/// Result of a calibration.
#[derive(Clone, Debug)]
pub struct LensResult {
    /// The camera of this server; `None` for a source that was opened for the calibration.
    pub camera: Option<String>,
    pub name: String,
    pub lens: Arc<LensCalibration>,
}

impl LensResult {
    /// The `camera_info` YAML.
    pub fn file(&self) -> String {
        report::camera_file(&self.name, &self.lens)
    }
}

/// Starts, follows and ends calibrations of lenses.
pub struct LensCalibrator {
    shared: Arc<Shared>,
    /// Base of relative paths in source addresses.
    folder: PathBuf,
    running: Mutex<Option<Running>>,
}

struct Running {
    stop: StopSignal,
    thread: JoinHandle<()>,
}

/// Shared with the calibration thread.
struct Shared {
    hub: Arc<Hub>,
    state: Mutex<State>,
    /// A calibration is cancelled when no client has read its status for this long.
    idle_timeout: Duration,
}

/// State of the newest calibration.
struct State {
    status: LensStatus,
    /// The newest picture that was searched.
    shown: Option<Arc<AnnotatedPicture>>,
    found: Option<LensResult>,
    last_request: Instant,
    cancelled: bool,
}

impl State {
    fn new(status: LensStatus) -> Self {
        Self { status, shown: None, found: None, last_request: Instant::now(), cancelled: false }
    }
}

impl LensCalibrator {
    /// `folder` is the base of relative paths in sources.
    pub fn new(hub: Arc<Hub>, folder: &Path) -> Self {
        Self::with_idle_timeout(hub, folder, IDLE_TIMEOUT)
    }

    fn with_idle_timeout(hub: Arc<Hub>, folder: &Path, idle_timeout: Duration) -> Self {
        let state = Mutex::new(State::new(LensStatus::default()));
        let shared = Arc::new(Shared { hub, state, idle_timeout });
        Self { shared, folder: folder.to_owned(), running: Mutex::default() }
    }

    /// Parses a source's address; `admit` checks it and returns the rules that bind the source. Also returns the address
    /// without credentials, for display.
    pub fn source(
        &self,
        source: &str,
        size: Option<(usize, usize)>,
        admit: impl Fn(&SourceAddress) -> Result<Option<Arc<SourceRules>>, SourceRuleError>,
    ) -> Result<(PictureSource, String), LensError> {
        match SourceAddress::parse(source, &self.folder)? {
            SourceAddress::Push(_) => Err(LensError::Fed),
            address => {
                let rules = admit(&address)?;
                let source_to_open = OpenedSource { address, rules, size };
                Ok((PictureSource::Source(Box::new(source_to_open)), redact(source)))
            }
        }
    }

    /// Starts a calibration and discards the result of the previous one.
    pub fn start(&self, run: LensRun) -> Result<(), LensError> {
        let mut running = lock(&self.running);
        if running.as_ref().is_some_and(|it| !it.thread.is_finished()) {
            let status = self.shared.lock().status.clone();
            return Err(LensError::Busy(format!("{}{}", status.camera, status.source)));
        }
        if !(VIEWS.0..=VIEWS.1).contains(&run.max_views) {
            return Err(LensError::Views(run.max_views));
        }
        let (camera, source) = match run.picture_source {
            PictureSource::Camera(..) => (run.shown.clone(), String::new()),
            PictureSource::Source(..) => (String::new(), run.shown.clone()),
        };
        let board = format!(
            "{} x {} roundels of {} mm, {} mm from centre to centre",
            run.board.columns(),
            run.board.rows(),
            millimetres(run.board.kind().outer_diameter_m * 1e3),
            millimetres(run.board.pitch_m() * 1e3)
        );
        let (shared, stop) = (self.shared.clone(), StopSignal::default());
        *shared.lock() = State::new(LensStatus {
            stage: Stage::Gathering,
            camera,
            source,
            board,
            enough: GOOD_VIEWS.min(run.max_views),
            least: MIN_VIEWS,
            most: run.max_views,
            ..LensStatus::default()
        });
        let until = stop.clone();
        let builder = std::thread::Builder::new().name("lens".to_owned());
        let spawned = builder.spawn(move || task::run(&shared, run, &until));
        let thread = spawned.map_err(|error| {
            self.shared.lock().status = LensStatus::default();
            LensError::Thread(error.to_string())
        })?;
        *running = Some(Running { stop, thread });
        Ok(())
    }

    /// The progress. A call resets the idle timeout.
    pub fn status(&self) -> LensStatus {
        let mut state = self.shared.lock();
        state.last_request = Instant::now();
        state.status.clone()
    }

    /// The newest searched picture; `None` before the first. A call resets the idle timeout.
    pub fn shown(&self) -> Option<Arc<AnnotatedPicture>> {
        let mut state = self.shared.lock();
        state.last_request = Instant::now();
        state.shown.clone()
    }

    /// Ends the collection of views and solves with those collected so far.
    pub fn finish(&self) -> Result<(), LensError> {
        self.end(false)
    }

    /// Ends the calibration without a result.
    pub fn cancel(&self) -> Result<(), LensError> {
        self.end(true)
    }

    fn end(&self, cancels: bool) -> Result<(), LensError> {
        match &*lock(&self.running) {
            Some(Running { stop, thread }) if !thread.is_finished() => {
                let mut state = self.shared.lock();
                state.cancelled |= cancels;
                state.status.stage = if cancels { Stage::Idle } else { Stage::Solving };
                stop.stop();
                Ok(())
            }
            _ => Err(LensError::NotRecording),
        }
    }

    pub fn found(&self) -> Result<LensResult, LensError> {
        self.shared.lock().found.clone().ok_or(LensError::NoResult)
    }

    /// Records where the camera file of the result was written.
    pub fn applied(&self, kept: &str) {
        self.shared.lock().status.applied = kept.to_owned();
    }

    /// Ends a running calibration and returns its thread.
    pub fn shut_down(&self) -> Option<JoinHandle<()>> {
        let Running { stop, thread } = lock(&self.running).take()?;
        self.shared.lock().cancelled = true;
        stop.stop();
        Some(thread)
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use roundel_core::{marker::CodeLayout, time::Timestamp};

    use super::*;
    use crate::model::hub::Installation;

    fn calibrator(folder: &Path, idle_timeout: Duration) -> LensCalibrator {
        let hub = Arc::new(Hub::new(Installation {
            name: "lab".to_owned(),
            source_id: "lab-0".to_owned(),
            started: Timestamp::default(),
            snapshot_rate_hz: 60.0,
            cameras: Installation::number_cameras([]),
            kinds: Vec::new(),
            object_names: Default::default(),
            body_names: Vec::new(),
        }));
        LensCalibrator::with_idle_timeout(hub, folder, idle_timeout)
    }

    /// A folder with one white picture.
    fn pictures() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let white: Vec<u8> = b"P5\n64 48\n255\n".iter().copied().chain([255; 64 * 48]).collect();
        std::fs::write(folder.path().join("0.pgm"), white).unwrap();
        folder
    }

    fn run(lenses: &LensCalibrator, source: &str) -> LensRun {
        let (picture_source, shown) = lenses.source(source, None, |_| Ok(None)).unwrap();
        let layout = CodeLayout { bits: 9, min_distance: 1 };
        let board = Board::new((7, 5), 0.036, 0.03, layout).unwrap();
        LensRun { picture_source, name: "it".to_owned(), shown, board, max_views: 40, model: None }
    }

    fn ended(lenses: &LensCalibrator) {
        for _ in 0..1000 {
            // Asking for the status would keep the calibration running.
            if lock(&lenses.running).as_ref().is_some_and(|it| it.thread.is_finished()) {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("the calibration does not end");
    }

    #[test]
    fn an_idle_calibration_ends() {
        let folder = pictures();
        let lenses = calibrator(folder.path(), Duration::from_millis(300));
        lenses.start(run(&lenses, "images:*.pgm?fps=50&loop=true")).unwrap();
        ended(&lenses);
        let status = lenses.status();
        assert_eq!(status.stage, Stage::Failed);
        assert!(status.error.contains("no client read the status"), "{}", status.error);
        assert_eq!((status.width, status.height), (64, 48), "the size of the pictures");
        assert_eq!(status.source, "images:*.pgm?fps=50&loop=true");
    }

    #[test]
    fn a_source_of_another_size_than_requested_is_an_error() {
        let folder = pictures();
        let lenses = calibrator(folder.path(), IDLE_TIMEOUT);
        let source = "images:*.pgm?fps=50";
        let (picture_source, _) = lenses.source(source, Some((32, 24)), |_| Ok(None)).unwrap();
        lenses.start(LensRun { picture_source, ..run(&lenses, source) }).unwrap();
        ended(&lenses);
        let error = lenses.status().error;
        assert!(error.contains("requested 32 x 24 pixels, found 64 x 48"), "{error}");
    }

    #[test]
    fn a_source_that_cannot_be_opened_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let lenses = calibrator(folder.path(), IDLE_TIMEOUT);
        lenses.start(run(&lenses, "images:*.png")).unwrap();
        ended(&lenses);
        assert!(lenses.status().error.contains("no file matches"), "{}", lenses.status().error);
        assert!(matches!(lenses.source("push:", None, |_| Ok(None)), Err(LensError::Fed)));
        let error = lenses.source("htp://a/b", None, |_| Ok(None)).unwrap_err().to_string();
        assert!(error.contains("did you mean `http:`?"), "{error}");
        assert!(matches!(lenses.found(), Err(LensError::NoResult)));
    }
}

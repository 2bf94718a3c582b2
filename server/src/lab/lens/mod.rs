//! Finds a camera's lens while the server runs: the operator moves the printed board before the camera, sees what is missing,
//! and takes the result.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`board_search`] | the board in one picture after the other; the command line's too |
//! | `pictures` | from a camera of this server, or a source that is opened for it |
//! | `task` | gathering → solving, on a thread of its own |
//! | [`report`] | how far it is, and what came out |
//! | `annotated_picture` | the newest picture, with what was found in it |
//!
//! One runs at a time. A camera goes on meanwhile: what is looked at are copies of some of its frames, ten a second at most,
//! and the thread looks for half of the time at most. One that nobody asks about for a minute ends.

mod annotated_picture;
pub mod board_search;
pub mod chessboard;
#[cfg(feature = "chessboard")]
mod corners;
mod picture_source;
pub mod report;
mod task;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use roundel_core::{
    calib::{
        board::Board,
        lens::{LEAST_VIEWS, LensCalibration, Model},
    },
    plan::precision::LensDoubt,
};
use thiserror::Error;

use crate::model::{
    address::{AddressError, SourceAddress, without_credentials},
    camera_file,
    hub::Hub,
    stop::StopSignal,
};
pub use annotated_picture::AnnotatedPicture;
pub use picture_source::PictureSource;
use report::{LensStatus, Stage};

/// Fewest and most views that are kept.
pub const VIEWS: (usize, usize) = (LEAST_VIEWS, 100);
/// And so many, if nobody says otherwise.
pub const DEFAULT_VIEWS: usize = 40;
/// One that nobody asks about for so long ends.
const IDLE_TIMEOUT: Duration = Duration::from_secs(60);

/// What is to be done.
#[derive(Clone, Debug)]
pub struct LensRun {
    pub picture_source: PictureSource,
    /// What goes into the file as the camera's name.
    pub name: String,
    /// What stands for the picture_source in what clients are told.
    pub shown: String,
    pub board: Board,
    /// No more views than this, within [`VIEWS`].
    pub most: usize,
    /// The distortion model; `None`: the one for which most speaks.
    pub model: Option<Model>,
}

/// Why something is not done.
#[derive(Debug, Error)]
pub enum LensError {
    /// The source's address is none.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// One at a time: each takes half of a processor.
    #[error("the lens of {0} is being calibrated: finish that one, or cancel it")]
    Busy(String),
    /// Out of bounds.
    #[error("expected {least} to {most} views, found {0}", least = VIEWS.0, most = VIEWS.1)]
    Views(usize),
    #[error(
        "a `push:` source is fed by a program, so there is nothing to be opened: add the camera with any lens file first, and \
         calibrate it by its name"
    )]
    Fed,
    /// No pictures are looked at.
    #[error("no lens is being calibrated: start one first")]
    NotRecording,
    /// The calibration has no result.
    #[error("there is no lens to take: start a calibration, and finish it")]
    NoResult,
    /// The system gives no thread.
    #[error("cannot start the thread of the lens calibration: {0}")]
    Thread(String),
}

/// A lens that was found, and whose it is.
#[derive(Clone, Debug)]
pub struct LensResult {
    /// The camera of this server; `None`: a source of its own.
    pub camera: Option<String>,
    pub name: String,
    pub lens: Arc<LensCalibration>,
}

impl LensResult {
    /// The `camera_info` YAML.
    pub fn file(&self) -> String {
        let Self { name, lens, .. } = self;
        let uncertainty =
            LensDoubt { free: lens.model.free().to_vec(), covariance: lens.covariance.clone() };
        camera_file::write_with_uncertainty(name, &lens.camera, Some(&uncertainty))
    }
}

/// Starts, follows and ends calibrations of lenses.
pub struct LensCalibrator {
    shared: Arc<Shared>,
    /// Relative paths of sources begin here.
    folder: PathBuf,
    running: Mutex<Option<Running>>,
}

struct Running {
    stop: StopSignal,
    thread: JoinHandle<()>,
}

/// What the task's thread needs, too.
struct Shared {
    hub: Arc<Hub>,
    state: Mutex<State>,
    /// One that nobody asks about for so long ends.
    idle_timeout: Duration,
}

/// What is known of the newest calibration.
struct State {
    status: LensStatus,
    /// The newest picture that was looked at.
    shown: Option<Arc<AnnotatedPicture>>,
    found: Option<LensResult>,
    /// When somebody asked last.
    last_request: Instant,
    /// That it is to end without a result.
    cancelled: bool,
}

impl LensCalibrator {
    /// One that has not calibrated anything; relative paths of sources begin in that folder.
    pub fn new(hub: Arc<Hub>, folder: &Path) -> Self {
        let state = State {
            status: LensStatus::default(),
            shown: None,
            found: None,
            last_request: Instant::now(),
            cancelled: false,
        };
        let shared = Arc::new(Shared { hub, state: Mutex::new(state), idle_timeout: IDLE_TIMEOUT });
        Self { shared, folder: folder.to_owned(), running: Mutex::default() }
    }

    /// A source's address as a picture_source, and as it may be shown.
    pub fn source(
        &self,
        source: &str,
        size: Option<(usize, usize)>,
    ) -> Result<(PictureSource, String), LensError> {
        match SourceAddress::parse(source, &self.folder)? {
            SourceAddress::Push(_) => Err(LensError::Fed),
            address => {
                Ok((PictureSource::Source(Box::new(address), size), without_credentials(source)))
            }
        }
    }

    /// Begins one; what the one before has found is gone.
    pub fn start(&self, run: LensRun) -> Result<(), LensError> {
        let mut running = lock(&self.running);
        if running.as_ref().is_some_and(|it| !it.thread.is_finished()) {
            let status = self.shared.lock().status.clone();
            return Err(LensError::Busy(format!("{}{}", status.camera, status.source)));
        }
        if !(VIEWS.0..=VIEWS.1).contains(&run.most) {
            return Err(LensError::Views(run.most));
        }
        let (shared, stop) = (self.shared.clone(), StopSignal::default());
        shared.begin(&run);
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

    /// How far it is; whoever asks keeps it running.
    pub fn status(&self) -> LensStatus {
        let mut state = self.shared.lock();
        state.last_request = Instant::now();
        state.status.clone()
    }

    /// The newest picture that was looked at; `None` before the first. Whoever asks keeps it running.
    pub fn shown(&self) -> Option<Arc<AnnotatedPicture>> {
        let mut state = self.shared.lock();
        state.last_request = Instant::now();
        state.shown.clone()
    }

    /// Looks at no more pictures, and solves with the views that there are.
    pub fn finish(&self) -> Result<(), LensError> {
        self.end(false)
    }

    /// Ends it without a result.
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

    /// Says where the file of what was found is kept.
    pub fn applied(&self, kept: &str) {
        self.shared.lock().status.applied = kept.to_owned();
    }

    /// Ends what runs, and gives its thread to be waited for.
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

    fn begin(&self, run: &LensRun) {
        let (camera, source) = match run.picture_source {
            PictureSource::Camera(..) => (run.shown.clone(), String::new()),
            PictureSource::Source(..) => (String::new(), run.shown.clone()),
        };
        let board = &run.board;
        let board = format!(
            "{} x {} roundels of {} mm, {} mm from centre to centre",
            board.columns(),
            board.rows(),
            crate::lab::print::millimetres(board.kind().outer_diameter_m * 1e3),
            crate::lab::print::millimetres(board.pitch_m() * 1e3)
        );
        *self.lock() = State {
            status: LensStatus::begun(camera, source, board, run.most),
            shown: None,
            found: None,
            last_request: Instant::now(),
            cancelled: false,
        };
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
        let lenses = LensCalibrator::new(hub.clone(), folder);
        let state = Mutex::new(State {
            status: LensStatus::default(),
            shown: None,
            found: None,
            last_request: Instant::now(),
            cancelled: false,
        });
        LensCalibrator { shared: Arc::new(Shared { hub, state, idle_timeout }), ..lenses }
    }

    fn run(lenses: &LensCalibrator, source: &str) -> LensRun {
        let (picture_source, shown) = lenses.source(source, None).unwrap();
        let layout = CodeLayout { bits: 9, min_distance: 1 };
        let board = Board::new((7, 5), 0.036, 0.03, layout).unwrap();
        LensRun { picture_source, name: "it".to_owned(), shown, board, most: 40, model: None }
    }

    fn ended(lenses: &LensCalibrator) {
        for _ in 0..1000 {
            // Not by asking for its status, which would keep it running.
            if lock(&lenses.running).as_ref().is_some_and(|it| it.thread.is_finished()) {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("it does not end");
    }

    #[test]
    fn one_that_nobody_asks_about_ends() {
        let folder = tempfile::tempdir().unwrap();
        let white: Vec<u8> = b"P5\n64 48\n255\n".iter().copied().chain([255; 64 * 48]).collect();
        std::fs::write(folder.path().join("0.pgm"), white).unwrap();
        let lenses = calibrator(folder.path(), Duration::from_millis(300));
        lenses.start(run(&lenses, "images:*.pgm?fps=50&loop=true")).unwrap();
        ended(&lenses);
        let status = lenses.status();
        assert_eq!(status.stage, Stage::Failed);
        assert!(status.error.contains("nobody asked about it"), "{}", status.error);
        assert_eq!((status.width, status.height), (64, 48), "its size was found");
        assert_eq!(status.source, "images:*.pgm?fps=50&loop=true");
    }

    #[test]
    fn a_source_of_another_size_than_was_asked_for_says_which() {
        let folder = tempfile::tempdir().unwrap();
        let white: Vec<u8> = b"P5\n64 48\n255\n".iter().copied().chain([255; 64 * 48]).collect();
        std::fs::write(folder.path().join("0.pgm"), white).unwrap();
        let lenses = calibrator(folder.path(), IDLE_TIMEOUT);
        let source = "images:*.pgm?fps=50";
        let (picture_source, _) = lenses.source(source, Some((32, 24))).unwrap();
        lenses.start(LensRun { picture_source, ..run(&lenses, source) }).unwrap();
        ended(&lenses);
        let error = lenses.status().error;
        assert!(error.contains("asked for pictures of 32 x 24 pixels, found 64 x 48"), "{error}");
    }

    #[test]
    fn a_source_that_cannot_be_looked_at_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let lenses = calibrator(folder.path(), IDLE_TIMEOUT);
        lenses.start(run(&lenses, "images:*.png")).unwrap();
        ended(&lenses);
        assert!(lenses.status().error.contains("no file matches"), "{}", lenses.status().error);
        assert!(matches!(lenses.source("push:", None), Err(LensError::Fed)));
        let error = lenses.source("htp://a/b", None).unwrap_err().to_string();
        assert!(error.contains("did you mean `http:`?"), "{error}");
        assert!(matches!(lenses.found(), Err(LensError::NoResult)));
    }
}

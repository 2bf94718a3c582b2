//! Calibrates the arena while it is being served: records what cameras see, solves, and has the cameras take
//! the result over.
//!
//! | module | what it does |
//! | --- | --- |
//! | `recorder` | what cameras see for a minute, and what is missing meanwhile |
//! | `task` | recording → solving → taking over, on a thread of its own |
//! | `cameras` | cameras that come, change and go |
//! | `apply` | cameras stand where they were found to, now and at the next start |
//! | [`report`] | what came out, and what a person should know, by name |
//! | [`file`] | the versioned file that keeps it |
//!
//! One calibration runs at a time. Cameras go on meanwhile; the solver leaves half of the cores to them. What
//! it finds is taken over by each camera's worker between two frames, lens and place at once, so no track is
//! lost; and written to the calibration file, from which the next start takes it.

mod apply;
mod cameras;
pub mod file;
mod recorder;
pub mod report;
mod task;

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
};

use roundel_core::{
    id::CameraId,
    world::{CameraPlacement, Landmark},
};
use thiserror::Error;
use tokio::sync::watch;

use crate::{
    capture::worker::calibration_update::CalibrationMailbox,
    model::{clock::Clock, hub::Hub, stop::StopSignal},
};
use file::{CalibrationFile, StoredConfig};
pub use recorder::RecordedCamera;
pub use report::CalibrationReport;

/// A recording takes at least and at most so long, seconds.
pub const DURATION_RANGE_S: [f64; 2] = [2.0, 600.0];
/// And so long if nobody says otherwise.
pub const DEFAULT_DURATION_S: f64 = 60.0;
/// Fewer references place no camera.
const MIN_REFERENCES: usize = 3;

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationRequest {
    /// How long to record, within [`DURATION_RANGE_S`].
    pub seconds: f64,
    pub refine_lenses: bool,
    /// Whether cameras take the result over.
    pub apply: ApplyPolicy,
}

impl Default for CalibrationRequest {
    fn default() -> Self {
        Self { seconds: DEFAULT_DURATION_S, refine_lenses: false, apply: ApplyPolicy::IfSound }
    }
}

/// When cameras take a result over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ApplyPolicy {
    /// Unless something grave was found.
    IfSound,
    Always,
    /// When somebody says so ([`Calibrator::apply`]).
    Never,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CalibrationStage {
    /// None was asked for since the start.
    #[default]
    Idle,
    Recording,
    /// The recording is being worked on.
    Solving,
    Done,
    /// There is none, and an error says why.
    Failed,
}

#[derive(Clone, Debug, Default)]
pub struct CalibrationStatus {
    pub stage: CalibrationStage,
    /// How long it records, seconds.
    pub seconds: f64,
    pub recorded_s: f64,
    pub cameras: BTreeMap<CameraId, RecordedCamera>,
    /// Steps of the adjustment so far.
    pub steps: usize,
    /// Why there is no result, or why it could not be kept.
    pub error: String,
    pub report: Option<Arc<CalibrationReport>>,
    /// Version that cameras use since they took it over; 0: they have not.
    pub applied_version: u64,
}

/// Why something is not done.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CalibrationError {
    #[error("a calibration is running already: wait for it, or cancel it")]
    Busy,
    /// Out of bounds.
    #[error("{0}")]
    Seconds(f64),
    #[error(
        "the configuration has {found} reference roundels: expected [[reference]] tables for at least {MIN_REFERENCES} with known places that one camera sees"
    )]
    References { found: usize },
    /// No camera stands.
    #[error(
        "no camera of this installation stands still: cameras that ride on objects are not calibrated"
    )]
    Cameras,
    /// No result that could be taken over.
    #[error("there is no calibration to take over: start one first")]
    NothingToApply,
    #[error("no calibration is running")]
    NotRecording,
    /// The system gives no thread.
    #[error("cannot start the thread of the calibration: {0}")]
    Thread(String),
}

/// One camera, as the calibrator knows it.
#[derive(Clone)]
pub struct CalibratorCamera {
    pub name: String,
    /// What the configuration says; `None` of one that rides.
    pub configured: Option<StoredConfig>,
    pub mailbox: CalibrationMailbox,
}

/// What a calibrator is made of.
pub struct CalibratorParts {
    /// Where observations come from and events go to.
    pub hub: Arc<Hub>,
    pub clock: Clock,
    pub cameras: BTreeMap<CameraId, CalibratorCamera>,
    /// The reference roundels, in the order of the configuration.
    pub landmarks: Vec<Landmark>,
    /// Where results are kept, if anywhere.
    pub path: Option<PathBuf>,
    /// What is in use, if anything.
    pub file: CalibrationFile,
}

/// Starts, follows and ends calibrations.
pub struct Calibrator {
    shared: Arc<Shared>,
    running: Mutex<Option<(StopSignal, JoinHandle<()>)>>,
}

/// What the task's thread needs, too.
struct Shared {
    hub: Arc<Hub>,
    clock: Clock,
    cameras: Mutex<BTreeMap<CameraId, CalibratorCamera>>,
    landmarks: Vec<Landmark>,
    path: Option<PathBuf>,
    file: Mutex<CalibrationFile>,
    status: watch::Sender<CalibrationStatus>,
}

impl Calibrator {
    /// One that has not calibrated anything.
    pub fn new(parts: CalibratorParts) -> Self {
        let CalibratorParts { hub, clock, cameras, landmarks, path, file } = parts;
        let (file, cameras) = (Mutex::new(file), Mutex::new(cameras));
        let status = watch::Sender::default();
        let shared = Shared { hub, clock, cameras, landmarks, path, file, status };
        Self { shared: Arc::new(shared), running: Mutex::default() }
    }

    pub fn start(&self, request: CalibrationRequest) -> Result<(), CalibrationError> {
        let mut running = lock(&self.running);
        if running.as_ref().is_some_and(|(_, thread)| !thread.is_finished()) {
            return Err(CalibrationError::Busy);
        }
        self.shared.check(&request)?;
        let (shared, stop) = (self.shared.clone(), StopSignal::default());
        shared.begin(&request);
        let until = stop.clone();
        let builder = std::thread::Builder::new().name("calibration".to_owned());
        let thread = builder
            .spawn(move || task::run(&shared, request, &until))
            .map_err(|error| CalibrationError::Thread(error.to_string()))?;
        *running = Some((stop, thread));
        Ok(())
    }

    /// Ends the one that runs, without a result.
    pub fn cancel(&self) -> Result<(), CalibrationError> {
        match &*lock(&self.running) {
            Some((stop, thread)) if !thread.is_finished() => {
                stop.stop();
                Ok(())
            }
            _ => Err(CalibrationError::NotRecording),
        }
    }

    /// Has cameras take over what the newest one found.
    pub fn apply(&self) -> Result<(), CalibrationError> {
        let report = self.shared.status.borrow().report.clone();
        let report = report.ok_or(CalibrationError::NothingToApply)?;
        self.shared.apply(&report);
        Ok(())
    }

    /// Has a camera take over a place that was found while it was being served. Does not wait for the disk.
    pub fn apply_pose(&self, camera: CameraId, placement: CameraPlacement) {
        let shared = self.shared.clone();
        let builder = std::thread::Builder::new().name("keep calibration".to_owned());
        if let Err(error) = builder.spawn(move || shared.apply_pose(camera, placement)) {
            tracing::error!(%error, "a camera's new place is lost: the system gives no thread");
        }
    }

    /// The newest status, and a wait for the next ones.
    pub fn status(&self) -> watch::Receiver<CalibrationStatus> {
        self.shared.status.subscribe()
    }

    /// Where a camera's worker is to look.
    pub fn mailbox(&self, id: CameraId) -> CalibrationMailbox {
        let cameras = lock(&self.shared.cameras);
        cameras.get(&id).map(|camera| camera.mailbox.clone()).unwrap_or_default()
    }

    /// The version that is in use; 0: none.
    pub fn version(&self) -> u64 {
        lock(&self.shared.file).version
    }

    /// Ends what runs, and gives its thread to be waited for.
    pub fn shut_down(&self) -> Option<JoinHandle<()>> {
        let (stop, thread) = lock(&self.running).take()?;
        stop.stop();
        Some(thread)
    }
}

impl Shared {
    fn check(&self, request: &CalibrationRequest) -> Result<(), CalibrationError> {
        if !(DURATION_RANGE_S[0]..=DURATION_RANGE_S[1]).contains(&request.seconds) {
            return Err(CalibrationError::Seconds(request.seconds));
        }
        if lock(&self.cameras).values().all(|camera| camera.configured.is_none()) {
            return Err(CalibrationError::Cameras);
        }
        let found = self.landmarks.len();
        if found < MIN_REFERENCES {
            return Err(CalibrationError::References { found });
        }
        Ok(())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

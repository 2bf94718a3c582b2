//! Calibrates the arena while it is served: records observations, solves for poses and lenses, applies the result.
//!
//! | module | content |
//! | --- | --- |
//! | `recorder` | collects observations and reports coverage |
//! | `task` | the calibration thread: record, solve, apply |
//! | `cameras` | adds, changes and removes cameras |
//! | `apply` | applies poses and lenses to the workers, and stores them |
//! | [`report`] | the result, with names |
//! | [`file`] | the calibration file |
//!
//! One calibration runs at a time, and the cameras go on meanwhile: the solver uses half of the cores. Each worker
//! applies its new lens and pose together between two frames, so no track is lost. The calibration file keeps them for
//! the next start.

mod apply;
mod cameras;
pub mod file;
mod recorder;
pub mod report;
mod task;

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::AtomicBool},
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

/// Shortest and longest recording, seconds.
pub const DURATION_RANGE_S: [f64; 2] = [2.0, 600.0];
pub const DEFAULT_DURATION_S: f64 = 60.0;
/// References needed to localize a camera.
const MIN_REFERENCES: usize = 3;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationRequest {
    /// Length of the recording, within [`DURATION_RANGE_S`].
    pub seconds: f64,
    pub refine_lenses: bool,
    pub apply: ApplyPolicy,
}

impl Default for CalibrationRequest {
    fn default() -> Self {
        Self { seconds: DEFAULT_DURATION_S, refine_lenses: false, apply: ApplyPolicy::IfSound }
    }
}

/// When the cameras use the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ApplyPolicy {
    /// Unless a finding is grave.
    IfSound,
    Always,
    /// Only by [`Calibrator::apply`].
    Never,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CalibrationStage {
    /// No calibration since the start.
    #[default]
    Idle,
    Recording,
    Solving,
    Done,
    Failed,
}

impl CalibrationStage {
    fn is_active(self) -> bool {
        matches!(self, Self::Recording | Self::Solving)
    }
}

#[derive(Clone, Debug, Default)]
pub struct CalibrationStatus {
    pub stage: CalibrationStage,
    /// Length of the recording, seconds.
    pub seconds: f64,
    pub recorded_s: f64,
    pub cameras: BTreeMap<CameraId, RecordedCamera>,
    /// Solver steps so far.
    pub steps: usize,
    /// Why there is no result, or why it was not stored.
    pub error: String,
    pub report: Option<Arc<CalibrationReport>>,
    /// Version under which the cameras use the result; 0: they do not.
    pub applied_version: u64,
}

#[derive(Clone, Debug, PartialEq, Error)]
pub enum CalibrationError {
    #[error("a calibration is running already: wait for it, or cancel it")]
    Busy,
    /// Length outside [`DURATION_RANGE_S`].
    #[error("{0}")]
    Seconds(f64),
    #[error(
        "the configuration has {found} reference roundels: expected [[reference]] tables for at least {MIN_REFERENCES} with known places that one camera sees"
    )]
    References { found: usize },
    #[error("this installation has no fixed camera: cameras on moving objects are not calibrated")]
    Cameras,
    #[error("there is no calibration to apply: start one first")]
    NothingToApply,
    #[error("no calibration is running")]
    NotRecording,
    #[error("cannot start the calibration thread: {0}")]
    Thread(String),
}

#[derive(Clone)]
pub struct CalibratorCamera {
    pub name: String,
    /// `None` if it is mounted on an object.
    pub configured: Option<StoredConfig>,
    pub mailbox: CalibrationMailbox,
}

pub struct Calibrator {
    shared: Arc<Shared>,
    running: Mutex<Option<(StopSignal, JoinHandle<()>)>>,
}

/// Shared with the calibration thread.
struct Shared {
    hub: Arc<Hub>,
    clock: Clock,
    cameras: Mutex<BTreeMap<CameraId, CalibratorCamera>>,
    landmarks: Vec<Landmark>,
    path: Option<PathBuf>,
    /// Never locked while files are written.
    file: Mutex<CalibrationFile>,
    is_unsaved: AtomicBool,
    /// Held while the file is written, so that the newest version is written last.
    saving: Mutex<()>,
    status: watch::Sender<CalibrationStatus>,
}

impl Calibrator {
    /// `landmarks`: the reference roundels in the order of the configuration; `file`: the results in use, saved to `path`.
    pub fn new(
        hub: Arc<Hub>,
        clock: Clock,
        cameras: BTreeMap<CameraId, CalibratorCamera>,
        landmarks: Vec<Landmark>,
        path: Option<PathBuf>,
        file: CalibrationFile,
    ) -> Self {
        let (file, cameras) = (Mutex::new(file), Mutex::new(cameras));
        let status = watch::Sender::default();
        let (is_unsaved, saving) = Default::default();
        let shared =
            Shared { hub, clock, cameras, landmarks, path, file, is_unsaved, saving, status };
        Self { shared: Arc::new(shared), running: Mutex::default() }
    }

    pub fn start(&self, request: CalibrationRequest) -> Result<(), CalibrationError> {
        let mut running = lock(&self.running);
        if self.is_active(&running) {
            return Err(CalibrationError::Busy);
        }
        self.shared.check(&request)?;
        let (shared, stop) = (self.shared.clone(), StopSignal::default());
        shared.begin(request.seconds);
        let until = stop.clone();
        let builder = std::thread::Builder::new().name("calibration".to_owned());
        let thread = builder
            .spawn(move || task::run(&shared, request, &until))
            .map_err(|error| CalibrationError::Thread(error.to_string()))?;
        *running = Some((stop, thread));
        Ok(())
    }

    pub fn is_running(&self) -> bool {
        self.is_active(&lock(&self.running))
    }

    /// A thread that has published its result may still be about to end, and one that panicked has published none.
    fn is_active(&self, running: &Option<(StopSignal, JoinHandle<()>)>) -> bool {
        running.as_ref().is_some_and(|(_, thread)| !thread.is_finished())
            && self.shared.status.borrow().stage.is_active()
    }

    pub fn cancel(&self) -> Result<(), CalibrationError> {
        let running = lock(&self.running);
        match &*running {
            Some((stop, _)) if self.is_active(&running) => {
                stop.stop();
                Ok(())
            }
            _ => Err(CalibrationError::NotRecording),
        }
    }

    /// Applies the newest result.
    pub fn apply(&self) -> Result<(), CalibrationError> {
        let report = self.shared.status.borrow().report.clone();
        let report = report.ok_or(CalibrationError::NothingToApply)?;
        self.shared.apply(&report);
        Ok(())
    }

    /// Applies and stores the pose of one camera, without waiting for the disk.
    pub fn apply_pose(&self, camera: CameraId, placement: CameraPlacement) {
        let shared = self.shared.clone();
        let builder = std::thread::Builder::new().name("keep calibration".to_owned());
        if let Err(error) = builder.spawn(move || shared.apply_pose(camera, placement)) {
            tracing::error!(%error, "cannot start the thread that stores a camera's new pose, which is lost");
        }
    }

    pub fn status(&self) -> watch::Receiver<CalibrationStatus> {
        self.shared.status.subscribe()
    }

    pub fn mailbox(&self, id: CameraId) -> CalibrationMailbox {
        let cameras = lock(&self.shared.cameras);
        cameras.get(&id).map(|camera| camera.mailbox.clone()).unwrap_or_default()
    }

    /// Version in use; 0: none.
    pub fn version(&self) -> u64 {
        lock(&self.shared.file).version
    }

    /// Stops a running calibration and returns its thread.
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

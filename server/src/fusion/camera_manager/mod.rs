//! Adds, changes and removes cameras and objects while the server runs, and writes the configuration back.
//!
//! | module | content |
//! | --- | --- |
//! | `worker_threads` | the workers' threads |
//! | `camera_diff` | diff between two versions of a camera, and the actions it requires |
//! | `configuration` | checks and applies a whole configuration |
//! | `apply` | applies changes of cameras to workers, hub, fusion and calibrator |
//! | `object` | adds, changes, removes and names objects |
//! | `lens` | writes lens files and applies them |
//! | [`bodies`] | numbers of the objects' bodies, and their diff for fusion |
//! | [`setup`] | inputs of hub, fusion, worker and calibrator from a camera's configuration |
//! | `error` | errors, with the key that causes them |
//!
//! The text of the configuration is authoritative. A change edits the text, which keeps its comments; then the whole
//! text is parsed and checked as at a start, written to the file, and applied. Cameras that did not change are not
//! affected: each has its own thread, id and port, and ids are never reused.
//!
//! Changes are applied one after the other. Each takes as long as the worker's source needs to stop: milliseconds.
//!
//! Files are read, written and compared only under the lock of changes, on a copy of the configuration. The lock of the
//! state is held for work in memory, so that recording, reading the configuration and shutting down never wait for a
//! disk.

mod apply;
pub mod bodies;
mod camera_diff;
mod configuration;
mod error;
mod lens;
mod object;
pub mod setup;
mod worker_threads;

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError, mpsc},
    time::{Duration, Instant},
};

use roundel_core::id::CameraId;
use roundel_proto::v1::CameraSetup;

use self::{
    apply::WorkerStart, bodies::BodyTable, camera_diff::CameraDiff, error::invalid,
    worker_threads::WorkerThreads,
};
use crate::{
    capture::{
        source::{
            OpenSource, Playback,
            push::{PushEndpoint, PushEndpoints},
        },
        worker::{WorkerCounts, WorkerOutput},
    },
    fusion::calibration::Calibrator,
    model::{
        address::SourceAddress,
        clock::Clock,
        command::FusionCommand,
        config::{CameraConfig, Config, ConfigFile, PoseConfig, edit},
        hub::{EventKind, Hub},
        source_rules::{SourceRuleError, SourceRules},
        stop::StopSignal,
    },
};
pub use bodies::kind_names;
pub use configuration::{ActiveConfig, ApplyPlan};
pub use error::CameraManagerError;

/// A change that lasts longer than this makes the next one fail.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(5);
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Everything a source is created from.
pub struct SourceContext<'a> {
    /// Position of the camera in the configuration.
    pub index: usize,
    pub camera: &'a CameraConfig,
    pub clock: Clock,
    pub playback: Playback,
    /// Ends every wait of the source.
    pub stop: StopSignal,
    /// Queue of a `push:` source.
    pub port: Option<Arc<PushEndpoint>>,
}

pub type SourceFactory = Box<dyn FnMut(SourceContext<'_>) -> Box<dyn OpenSource> + Send>;

pub struct CameraManagerParts {
    pub config: Config,
    pub hub: Arc<Hub>,
    pub clock: Clock,
    pub playback: Playback,
    pub calibrator: Arc<Calibrator>,
    pub ports: Arc<PushEndpoints>,
    /// Output of the workers.
    pub to_fusion: mpsc::SyncSender<WorkerOutput>,
    pub commands: mpsc::Sender<FusionCommand>,
    pub sources: SourceFactory,
}

pub struct CameraManager {
    hub: Arc<Hub>,
    clock: Clock,
    playback: Playback,
    calibrator: Arc<Calibrator>,
    ports: Arc<PushEndpoints>,
    /// Held during a change of the configuration.
    changing: Mutex<()>,
    state: Mutex<State>,
    /// Ends waits for workers that do not stop.
    shutting_down: StopSignal,
}

struct State {
    config: Config,
    /// Id of each configured camera.
    ids: Vec<CameraId>,
    next_id: u32,
    bodies: BodyTable,
    workers: WorkerThreads,
    to_fusion: mpsc::SyncSender<WorkerOutput>,
    commands: mpsc::Sender<FusionCommand>,
    sources: SourceFactory,
    is_shut_down: bool,
}

impl CameraManager {
    /// Starts the workers of all cameras, which calibrator, fusion and hub know already. `calibrated` is the
    /// configuration with the poses and lenses of the calibration file.
    pub fn start(
        parts: CameraManagerParts,
        calibrated: &Config,
    ) -> Result<Self, CameraManagerError> {
        let CameraManagerParts { config, hub, clock, playback, calibrator, ports, .. } = parts;
        let CameraManagerParts { to_fusion, commands, sources, .. } = parts;
        let shutting_down = StopSignal::default();
        let ids: Vec<CameraId> = (0..).map(CameraId).take(config.cameras.len()).collect();
        let state = State {
            next_id: ids.len() as u32,
            bodies: BodyTable::of(&config.objects),
            config,
            ids: ids.clone(),
            workers: WorkerThreads::new(shutting_down.clone()),
            to_fusion,
            commands,
            sources,
            is_shut_down: false,
        };
        let (changing, state) = (Mutex::default(), Mutex::new(state));
        let camera_manager =
            Self { hub, clock, playback, calibrator, ports, changing, state, shutting_down };
        for (index, (id, camera)) in ids.into_iter().zip(&calibrated.cameras).enumerate() {
            let state = &mut *camera_manager.lock();
            camera_manager.register(state, id, camera, calibrated);
            let is_calibrated = matches!(camera.pose, PoseConfig::Calibrated(_));
            let version = if is_calibrated { camera_manager.calibrator.version() } else { 0 };
            let (pose, before) = (setup::pose_source(camera, calibrated), WorkerCounts::default());
            let start = WorkerStart { id, index, camera, pose, version, before };
            camera_manager.start_worker(state, calibrated, start)?;
        }
        Ok(camera_manager)
    }

    /// The camera's configuration without secrets.
    pub fn camera_setup(&self, name: &str) -> Result<CameraSetup, CameraManagerError> {
        Ok(edit::read(&edit::redacted(self.config().file.text())?, name)?)
    }

    /// The current text without secrets, and its version. `None` if that is `known`, or while a change is being made:
    /// does not wait.
    pub fn redacted_text_since(&self, known: &str) -> Option<(String, String)> {
        let config = self.state.try_lock().ok()?.config.clone();
        let version = config.file.version();
        (version != known).then(|| (redacted_text(&config), version))
    }

    /// Checks a source of a request. Returns the rules that bind it; `None` for a source of the configuration file.
    pub fn admit_source(
        &self,
        address: &SourceAddress,
    ) -> Result<Option<Arc<SourceRules>>, SourceRuleError> {
        self.config().admit_source(address)
    }

    /// Adds a camera after the last one. Returns where the configuration is stored.
    pub fn add(&self, camera: &CameraSetup) -> Result<String, CameraManagerError> {
        self.change_with(|| {
            let before = self.editable_config()?;
            let text = edit::add(before.file.text(), camera)?;
            let index = before.cameras.len();
            let camera = parse_cameras(&before, &text, index)?.swap_remove(index);
            setup::pipeline(&camera, &before, Default::default())?;
            let file = replaced(&before.file, text)?;
            let kept = file.kept();
            let started = self.start_added(camera, file);
            if started.is_err() {
                let file = replaced(&self.config().file, before.file.text().to_owned())?;
                self.lock().config.file = file;
            }
            started.map(|()| kept)
        })
    }

    /// Starts a camera that was added to the file, or removes it again.
    fn start_added(
        &self,
        camera: CameraConfig,
        file: ConfigFile,
    ) -> Result<(), CameraManagerError> {
        let state = &mut *self.lock_running()?;
        let index = state.ids.len();
        state.config.file = file;
        state.config.cameras.push(camera);
        let id = state.new_id();
        state.ids.push(id);
        self.start_camera(state, id, index).inspect_err(|_| {
            self.unregister(state, id);
            state.ids.pop();
            state.config.cameras.pop();
        })
    }

    /// Sets these keys of a camera and reads the files that it names again. Returns where the configuration is stored,
    /// and the name of the camera now.
    pub fn change(
        &self,
        name: &str,
        camera: &CameraSetup,
        keys: &[&str],
    ) -> Result<(String, String), CameraManagerError> {
        self.change_with(|| {
            let before = self.editable_config()?;
            let index = find_camera(&before, name)?;
            let text = edit::change(before.file.text(), name, camera, keys)?;
            let text = edit::restored(&text, before.file.text())?;
            let camera = parse_cameras(&before, &text, index)?.swap_remove(index);
            let diff = CameraDiff::of(&before.cameras[index], &camera);
            setup::pipeline(&camera, &before, Default::default())?;
            let file = replaced(&before.file, text)?;
            let (new_name, kept) = (camera.name.clone(), file.kept());
            let state = &mut *self.lock_running()?;
            state.config.file = file;
            state.config.cameras[index] = camera;
            let id = state.ids[index];
            self.apply_diff(state, (id, index), &diff, name)?;
            Ok((new_name, kept))
        })
    }

    /// Removes a camera. Returns where the configuration is stored.
    pub fn remove(&self, name: &str) -> Result<String, CameraManagerError> {
        self.change_with(|| {
            let before = self.editable_config()?;
            let index = find_camera(&before, name)?;
            if before.cameras.len() == 1 {
                return Err(CameraManagerError::LastCamera);
            }
            let text = edit::remove::<CameraSetup>(before.file.text(), name)?;
            // Checks that no other camera or object depends on it.
            parse_cameras(&before, &text, usize::MAX)?;
            let file = replaced(&before.file, text)?;
            let kept = file.kept();
            let state = &mut *self.lock_running()?;
            state.config.file = file;
            self.remove_camera(state, index);
            Ok(kept)
        })
    }

    /// Stops all workers for good and returns their threads.
    pub fn stop_all(&self) -> Vec<std::thread::JoinHandle<WorkerCounts>> {
        self.shutting_down.stop();
        let mut state = self.lock();
        state.is_shut_down = true;
        state.workers.stop_all()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The state, unless the server is shutting down.
    fn lock_running(&self) -> Result<MutexGuard<'_, State>, CameraManagerError> {
        let state = self.lock();
        if state.is_shut_down { Err(CameraManagerError::ShuttingDown) } else { Ok(state) }
    }

    /// A copy of the configuration.
    fn config(&self) -> Config {
        self.lock().config.clone()
    }

    /// A copy of the configuration, unless the server is shutting down.
    fn running_config(&self) -> Result<Config, CameraManagerError> {
        Ok(self.lock_running()?.config.clone())
    }

    /// A copy of the configuration, if cameras may be changed now.
    fn editable_config(&self) -> Result<Config, CameraManagerError> {
        let config = self.running_config()?;
        if self.calibrator.is_running() { Err(CameraManagerError::Calibrating) } else { Ok(config) }
    }

    /// Runs a change of the configuration while no other one runs.
    fn change_with<T>(
        &self,
        change: impl FnOnce() -> Result<T, CameraManagerError>,
    ) -> Result<T, CameraManagerError> {
        let deadline = Instant::now() + CHANGE_TIMEOUT;
        let _changing = loop {
            match self.changing.try_lock() {
                Ok(guard) => break guard,
                Err(TryLockError::Poisoned(poisoned)) => break poisoned.into_inner(),
                Err(TryLockError::WouldBlock) if Instant::now() >= deadline => {
                    return Err(CameraManagerError::Busy);
                }
                Err(TryLockError::WouldBlock) => {
                    if self.shutting_down.wait(POLL_INTERVAL) {
                        return Err(CameraManagerError::ShuttingDown);
                    }
                }
            }
        };
        let outcome = change();
        self.calibrator.save_changes();
        outcome
    }

    fn report(&self, kind: EventKind, camera: CameraId, message: String) {
        tracing::info!("{message}");
        self.hub.publish_camera_event(self.clock.now(), kind, camera, message);
    }
}

/// The text of a configuration without secrets.
pub fn redacted_text(config: &Config) -> String {
    // A text that cannot be parsed may contain passwords.
    edit::redacted(config.file.text()).unwrap_or_default()
}

impl State {
    fn new_id(&mut self) -> CameraId {
        self.next_id += 1;
        CameraId(self.next_id - 1)
    }
}

fn find_camera(config: &Config, name: &str) -> Result<usize, CameraManagerError> {
    let index = config.cameras.iter().position(|camera| camera.name == name);
    index.ok_or_else(|| CameraManagerError::NoCamera(name.to_owned()))
}

/// The cameras of an edited text; errors are attributed to the camera at `index`.
fn parse_cameras(
    before: &Config,
    text: &str,
    index: usize,
) -> Result<Vec<CameraConfig>, CameraManagerError> {
    let config = before
        .parse_request(text)
        .map_err(|problems| invalid::<CameraSetup>(text, index, &problems))?;
    Ok(config.cameras)
}

/// Writes the new text and returns the file with it.
fn replaced(file: &ConfigFile, text: String) -> Result<ConfigFile, CameraManagerError> {
    let mut file = file.clone();
    file.replace(text)?;
    Ok(file)
}

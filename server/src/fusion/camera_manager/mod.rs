//! The cameras and objects of a server that runs: which there are, and that they can be added, changed and removed
//! meanwhile.
//!
//! | module | what it does |
//! | --- | --- |
//! | `workers` | the workers' threads |
//! | `diff` | diff between two versions of a camera, and the actions it requires |
//! | `configuration` | all of them, and what else can change, in one go |
//! | `effect` | what follows from a change that is written |
//! | `object` | the same of objects |
//! | [`bodies`] | which body each object is, and what fusion hears of when they change |
//! | [`setup`] | what the parts of a server are told of a camera |
//! | `error` | why something is not done |
//!
//! The configuration's text is what counts: a change is made in it, comments and all, and the whole is read and checked
//! as at a start. Only then it is written, and only what is written is done. Of the cameras that nobody changed nobody
//! takes notice: each has its own thread, id and port. Ids are never given twice.
//!
//! One change at a time; whoever asks waits for the one before. Each takes as long as its worker's source needs to let
//! go, which is milliseconds.

mod apply;
pub mod bodies;
mod camera_diff;
mod configuration;
mod error;
mod lens;
mod object;
pub mod setup;
mod worker_threads;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};

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
        worker::{WorkerCounts, WorkerOutput, pipeline::Pipeline},
    },
    fusion::calibration::Calibrator,
    model::{
        clock::Clock,
        command::FusionCommand,
        config::{CameraConfig, Config, PoseConfig, edit},
        hub::{EventKind, Hub},
        stop::StopSignal,
    },
};
pub use bodies::kind_names;
pub use configuration::{ActiveConfig, ApplyPlan, fusion_limits};
pub use error::CameraManagerError;

/// What a source has to fit into.
pub struct SourceContext<'a> {
    /// The camera's place in the configuration.
    pub index: usize,
    pub camera: &'a CameraConfig,
    pub clock: Clock,
    /// The time line of recorded and simulated frames.
    pub playback: Playback,
    /// Ends every wait of the source.
    pub stop: StopSignal,
    /// Where the frames of one with a `push:` source arrive.
    pub port: Option<Arc<PushEndpoint>>,
}

pub type SourceFactory = Box<dyn FnMut(SourceContext<'_>) -> Box<dyn OpenSource> + Send>;

pub struct CameraManagerParts {
    pub config: Config,
    /// The newest of everything.
    pub hub: Arc<Hub>,
    pub clock: Clock,
    /// The time line of recorded and simulated frames.
    pub playback: Playback,
    pub calibrator: Arc<Calibrator>,
    pub ports: Arc<PushEndpoints>,
    /// Where workers send what they see.
    pub to_fusion: mpsc::SyncSender<WorkerOutput>,
    pub commands: mpsc::Sender<FusionCommand>,
    pub sources: SourceFactory,
}

/// The cameras of a server that runs.
pub struct CameraManager {
    hub: Arc<Hub>,
    clock: Clock,
    playback: Playback,
    calibrator: Arc<Calibrator>,
    ports: Arc<PushEndpoints>,
    state: Mutex<State>,
}

struct State {
    config: Config,
    /// Of each of its cameras.
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
    /// Starts every camera, of which the calibrator, fusion's task and the hub know already, in the order of the
    /// configuration; where a calibration has found them, `calibrated` says so.
    pub fn start(
        parts: CameraManagerParts,
        calibrated: &Config,
    ) -> Result<Self, CameraManagerError> {
        let CameraManagerParts { config, hub, clock, playback, calibrator, ports, .. } = parts;
        let CameraManagerParts { to_fusion, commands, sources, .. } = parts;
        let ids: Vec<CameraId> = (0..).map(CameraId).take(config.cameras.len()).collect();
        let state = State {
            next_id: ids.len() as u32,
            bodies: BodyTable::of(&config.objects),
            config,
            ids: ids.clone(),
            workers: WorkerThreads::default(),
            to_fusion,
            commands,
            sources,
            is_shut_down: false,
        };
        let state = Mutex::new(state);
        let camera_manager = Self { hub, clock, playback, calibrator, ports, state };
        for (index, (id, camera)) in ids.into_iter().zip(&calibrated.cameras).enumerate() {
            let mut state = camera_manager.lock();
            let pipeline =
                Pipeline::new(setup::pipeline_parts(camera, calibrated, Default::default())?)?;
            camera_manager.register(&state, id, camera, calibrated);
            let is_calibrated = matches!(camera.pose, PoseConfig::Calibrated(_));
            let version = if is_calibrated { camera_manager.calibrator.version() } else { 0 };
            let (pose, before) = (setup::pose_source(camera, calibrated), WorkerCounts::default());
            let start = WorkerStart { id, index, camera, pipeline, pose, version, before };
            camera_manager.start_worker(&mut state, start)?;
        }
        Ok(camera_manager)
    }

    /// A camera as configured, without user and password.
    pub fn camera_setup(&self, name: &str) -> Result<CameraSetup, CameraManagerError> {
        Ok(edit::read(&edit::without_credentials(self.lock().config.file.text())?, name)?)
    }

    /// The configuration's text as it is now, without users and passwords of sources.
    pub fn redacted_text(&self) -> String {
        redacted_text(&self.lock().config)
    }

    /// Adds a camera behind the last one. Says where that is kept.
    pub fn add(&self, camera: &CameraSetup) -> Result<String, CameraManagerError> {
        let mut state = self.lock_editable()?;
        let text = edit::add(state.config.file.text(), camera)?;
        let index = state.ids.len();
        let mut config = state.reparse(&text, index)?;
        config.cameras.splice(..index, state.config.cameras.iter().cloned());
        // That it can be searched for is known before anything is done.
        Pipeline::new(setup::pipeline_parts(&config.cameras[index], &config, Default::default())?)?;
        config.file.replace(text)?;
        let id = CameraId(state.next_id);
        state.next_id += 1;
        let before = std::mem::replace(&mut state.config, config);
        state.ids.push(id);
        if let Err(error) = self.start_camera(&mut state, (id, index)) {
            self.unregister(&state, id);
            state.ids.pop();
            // What is written is what runs.
            let mut file = state.config.file.clone();
            file.replace(before.file.text().to_owned())?;
            state.config = Config { file, ..before };
            return Err(error);
        }
        Ok(state.config.file.kept())
    }

    /// Gives these keys of a camera other values; its other keys are not looked at. Files that it names are read anew.
    /// Says where that is kept, and under which name the camera goes now.
    pub fn change(
        &self,
        name: &str,
        camera: &CameraSetup,
        keys: &[&str],
    ) -> Result<(String, String), CameraManagerError> {
        let mut state = self.lock_editable()?;
        let (index, id) = state.find_camera(name)?;
        let text = edit::change(state.config.file.text(), name, camera, keys)?;
        let mut config = state.reparse(&text, index)?;
        let after = config.cameras[index].clone();
        config.cameras.clone_from(&state.config.cameras);
        let before = std::mem::replace(&mut config.cameras[index], after.clone());
        let diff = CameraDiff::of(&before, &after);
        // That the keys can be searched for is known before anything is done.
        Pipeline::new(setup::pipeline_parts(&after, &config, Default::default())?)?;
        config.file.replace(text)?;
        state.config = config;
        let kept = state.config.file.kept();
        if diff.is_empty() {
            return Ok((after.name, kept));
        }
        self.apply_diff(&mut state, (id, index), &diff)?;
        let message = format!("Camera {} was changed ({}); {kept}.", name, diff.describe());
        self.report(EventKind::CameraChanged(id), message);
        Ok((after.name, kept))
    }

    /// Removes a camera: its thread, its port, and all that is held of it. Says where that is kept.
    pub fn remove(&self, name: &str) -> Result<String, CameraManagerError> {
        let mut state = self.lock_editable()?;
        let (index, id) = state.find_camera(name)?;
        if state.ids.len() == 1 {
            return Err(CameraManagerError::LastCamera);
        }
        let text = edit::remove::<CameraSetup>(state.config.file.text(), name)?;
        // Whom it carried, and who found its place by it, may need it. The others are not read anew.
        let mut config = state.reparse(&text, usize::MAX)?;
        config.cameras.clone_from(&state.config.cameras);
        config.cameras.remove(index);
        config.file.replace(text)?;
        state.config = config;
        state.ids.remove(index);
        state.workers.stop(id);
        let kept = state.config.file.kept();
        self.report(EventKind::CameraRemoved(id), format!("Camera {name} was removed; {kept}."));
        self.unregister(&state, id);
        Ok(kept)
    }

    /// Ends every camera for good, and gives their threads to be waited for.
    pub fn stop_all(&self) -> Vec<std::thread::JoinHandle<WorkerCounts>> {
        let mut state = self.lock();
        state.is_shut_down = true;
        state.workers.stop_all()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The state, if it may be changed now.
    fn lock_editable(&self) -> Result<MutexGuard<'_, State>, CameraManagerError> {
        let state = self.lock();
        if self.calibrator.is_running() {
            return Err(CameraManagerError::Calibrating);
        }
        if state.is_shut_down { Err(CameraManagerError::ShuttingDown) } else { Ok(state) }
    }

    fn report(&self, kind: EventKind, message: String) {
        tracing::info!("{message}");
        self.hub.publish_event(self.clock.now(), kind, message);
    }
}

/// The text of a configuration without users and passwords of sources.
pub fn redacted_text(config: &Config) -> String {
    // A text that cannot be parsed may contain passwords.
    edit::without_credentials(config.file.text()).unwrap_or_default()
}

impl State {
    /// Place and id of a camera.
    fn find_camera(&self, name: &str) -> Result<(usize, CameraId), CameraManagerError> {
        let place = self.config.cameras.iter().position(|camera| camera.name == name);
        let place = place.ok_or_else(|| CameraManagerError::NoCamera(name.to_owned()))?;
        Ok((place, self.ids[place]))
    }

    /// A changed text as a configuration, kept where the one before is; what is wrong is the fault of the camera at
    /// `index`.
    fn reparse(&self, text: &str, index: usize) -> Result<Config, CameraManagerError> {
        let cameras = Config::parse(text, &self.config.folder)
            .map_err(|problems| invalid::<CameraSetup>(text, index, &problems))?
            .cameras;
        Ok(Config { cameras, ..self.config.clone() })
    }
}

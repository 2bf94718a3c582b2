//! Puts a server together, and takes it apart on shutdown: cameras first, then fusion, then clients. [`node`] does
//! so with what only captures and searches.

pub mod node;

use std::{
    io,
    net::SocketAddr,
    sync::{Arc, OnceLock, mpsc::sync_channel},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use roundel_core::{
    id::CameraId,
    marker::{DetectorError, MaskError},
};
use thiserror::Error;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub use crate::fusion::camera_manager::SourceContext;
use crate::fusion::setup::{ObjectError, fusion_machine, installation, landmarks};
use crate::{
    api::{self, AllowedOrigins, ApiLimits, ApiState},
    archive::{
        history::{History, HistoryError},
        record::{Recorder, RecordingOptions},
    },
    capture::{
        source::{
            OpenSource, Playback, SourceOpener, TimesError, fleet::Fleets, push::PushEndpoints,
        },
        source_probe::SourceProbe,
        worker::{WorkerCounts, WorkerOutput},
    },
    fusion::{
        CameraMonitorParts, FusionTask, PublishSchedule, QUEUE_FRAMES,
        calibration::{
            Calibrator, CalibratorParts,
            file::{CalibrationFile, CalibrationFileError},
        },
        camera_manager::{
            self, CameraManager, CameraManagerError, CameraManagerParts, SourceFactory,
        },
    },
    lab::lens::LensCalibrator,
    model::{
        clock::Clock,
        config::Config,
        hub::{EventKind, Hub},
        stop::StopSignal,
    },
};

/// Time that shutdown may take in all.
pub const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(5);
/// Of it, for clients; the rest is for cameras and fusion, which need far less.
const CLIENT_TIMEOUT: Duration = Duration::from_secs(2);

/// Why a server does not start.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The port is taken, or not ours to take.
    #[error("cannot listen on {address}: {source}; {}", remedy(.source))]
    Listen {
        /// What was to be bound.
        address: SocketAddr,
        source: io::Error,
    },
    /// The clock cannot follow a file of times.
    #[error(transparent)]
    Times(#[from] TimesError),
    /// The calibration file cannot be used.
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    /// The kinds of roundel cannot be searched for.
    #[error("kinds of roundel: {0}")]
    Detector(#[from] DetectorError),
    /// The history cannot be kept.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// A camera's mask is none.
    #[error(transparent)]
    Mask(#[from] MaskError),
    /// A camera cannot be begun.
    #[error(transparent)]
    CameraManager(#[from] CameraManagerError),
    /// An object cannot be followed.
    #[error(transparent)]
    Object(#[from] ObjectError),
    /// A node takes its frames from a program.
    #[error(
        "camera \"{camera}\" has `source = \"push:\"`: a node takes frames from cameras, and only a server can be fed"
    )]
    NodeIsFed { camera: String },
    /// There cannot be a server there.
    #[error(transparent)]
    Client(roundel_client::Error),
    /// The system gives no thread.
    #[error("cannot start the thread `{name}`: {source}")]
    Thread { name: String, source: io::Error },
}

fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::AddrInUse => {
            "another program, perhaps another roundel, has this port: stop it, or choose another \
             `listen` (port 0 takes a free one)"
        }
        io::ErrorKind::PermissionDenied => "ports below 1024 need privileges: choose a higher one",
        io::ErrorKind::AddrNotAvailable => "this machine has no such address: correct `listen`",
        _ => "correct `listen`",
    }
}

/// A running server. Dropping it without [`Server::shutdown`] ends its threads too, but does not
/// wait for them.
pub struct Server {
    address: SocketAddr,
    hub: Arc<Hub>,
    clock: Clock,
    playback: Playback,
    calibrator: Arc<Calibrator>,
    lenses: Arc<LensCalibrator>,
    fleets: Arc<Fleets>,
    camera_manager: Option<Arc<CameraManager>>,
    recorder: Option<Arc<Recorder>>,
    history: Option<Arc<History>>,
    stop_fusion: StopSignal,
    cancel_clients: CancellationToken,
    fusion: Option<JoinHandle<()>>,
    api: Option<tokio::task::JoinHandle<()>>,
}

impl Server {
    /// Binds the port and starts cameras, fusion and APIs. To be called within a tokio runtime.
    ///
    /// A camera whose source cannot be opened is no error: it is shown as failed and tried again.
    pub async fn start(config: Config) -> Result<Self, ServeError> {
        let fleets = Arc::<Fleets>::default();
        let shared = fleets.clone();
        let source = move |setting: SourceContext<'_>| -> Box<dyn OpenSource> {
            let SourceContext { camera, clock, playback, stop, port, .. } = setting;
            let size = (camera.calibration.width(), camera.calibration.height());
            let opener = SourceOpener::new(camera.address.clone(), size, clock, playback, stop);
            Box::new(
                opener.with_push_endpoint(port.unwrap_or_default()).with_fleets(shared.clone()),
            )
        };
        Self::start_with_fleets(config, fleets, source).await
    }

    /// The same with frames of the caller's own: `source` is asked each time that a camera's worker begins. Its
    /// sources give frames of the size of the camera's calibration, with capture times on the
    /// setting's clock, and end their waits on its stop signal.
    pub async fn start_with_sources(
        config: Config,
        source: impl FnMut(SourceContext<'_>) -> Box<dyn OpenSource> + Send + 'static,
    ) -> Result<Self, ServeError> {
        Self::start_with_fleets(config, Arc::default(), source).await
    }

    async fn start_with_fleets(
        config: Config,
        fleets: Arc<Fleets>,
        source: impl FnMut(SourceContext<'_>) -> Box<dyn OpenSource> + Send + 'static,
    ) -> Result<Self, ServeError> {
        let address = config.server.listen;
        let listening = |source| ServeError::Listen { address, source };
        let listener = TcpListener::bind(address).await.map_err(listening)?;
        let address = listener.local_addr().map_err(listening)?;
        let (clock, playback) = Playback::begin(config.cameras.iter().map(|c| &c.address))?;
        let hub = Arc::new(Hub::new(installation(&config, clock.now())));
        let mut calibrated = config.clone();
        let file = load_calibration(&mut calibrated, &hub, clock)?;
        let calibrator = Arc::new(Calibrator::new(CalibratorParts {
            hub: hub.clone(),
            clock,
            cameras: (0..)
                .map(CameraId)
                .zip(config.cameras.iter().map(camera_manager::setup::calibrator_camera))
                .collect(),
            landmarks: landmarks(&config),
            path: config.server.calibration.clone(),
            file,
        }));
        let lenses = Arc::new(LensCalibrator::new(hub.clone(), &config.folder));
        let mut server = Self {
            address,
            hub,
            clock,
            playback,
            calibrator,
            lenses,
            fleets,
            camera_manager: None,
            recorder: None,
            history: None,
            stop_fusion: StopSignal::default(),
            cancel_clients: CancellationToken::new(),
            fusion: None,
            api: None,
        };
        if let Some(settings) = config.history.clone() {
            server.history = Some(Arc::new(History::start(settings, server.hub.clone())?));
        }
        let ports = Arc::new(PushEndpoints::default());
        // Before anything happens, so that nothing is missing in what is recorded from the begin.
        let camera_manager = server.start_recorder(&config);
        server.start_threads(&config, &calibrated, (ports.clone(), Box::new(source)))?;
        server.camera_manager.iter().for_each(|it| drop(camera_manager.set(it.clone())));
        server.start_api(listener, &config, ports);
        Ok(server)
    }

    /// Where it listens; the port is a real one even if 0 was asked for.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// The newest of everything.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// The time line of its recorded and simulated sources.
    pub fn playback(&self) -> Playback {
        self.playback
    }

    pub fn fleets(&self) -> &Arc<Fleets> {
        &self.fleets
    }

    pub fn calibrator(&self) -> &Arc<Calibrator> {
        &self.calibrator
    }

    pub fn recorder(&self) -> Option<&Arc<Recorder>> {
        self.recorder.as_ref()
    }

    /// The cameras that there are, and how they become others.
    pub fn camera_manager(&self) -> Option<&Arc<CameraManager>> {
        self.camera_manager.as_ref()
    }

    fn start_threads(
        &mut self,
        config: &Config,
        calibrated: &Config,
        (ports, sources): (Arc<PushEndpoints>, SourceFactory),
    ) -> Result<(), ServeError> {
        // Full: observations are dropped and counted, see `worker`.
        let (to_fusion, from_workers) = sync_channel::<WorkerOutput>(QUEUE_FRAMES);
        let machine = fusion_machine(config)?;
        let mut task = FusionTask::new(machine, self.hub.clone(), self.clock, from_workers);
        if config.server.monitors_cameras {
            let (landmarks, calibrator) = (landmarks(config), self.calibrator.clone());
            task = task.with_camera_monitor(CameraMonitorParts { landmarks, calibrator });
        } else {
            tracing::warn!(
                "cameras are not watched (`watch = false` in [server]): one that is bumped goes on to be used"
            );
        }
        let (task, commands) = task.with_commands();
        let period = Duration::from_secs_f64(1.0 / config.server.snapshot_rate_hz);
        let schedule = PublishSchedule::new(period, config.server.publishes_per_frame);
        let stop = self.stop_fusion.clone();
        self.fusion = Some(spawn("fusion".to_owned(), move || task.run(schedule, &stop))?);
        let parts = CameraManagerParts {
            config: config.clone(),
            hub: self.hub.clone(),
            clock: self.clock,
            playback: self.playback,
            calibrator: self.calibrator.clone(),
            ports,
            to_fusion,
            commands,
            sources,
        };
        self.camera_manager = Some(Arc::new(CameraManager::start(parts, calibrated)?));
        Ok(())
    }

    /// One that cannot begin is told, and no reason not to serve. It reads the camera manager once there is one, which
    /// then says the configuration.
    fn start_recorder(&mut self, config: &Config) -> Arc<OnceLock<Arc<CameraManager>>> {
        let camera_manager = Arc::<OnceLock<Arc<CameraManager>>>::default();
        let (known, first) = (camera_manager.clone(), camera_manager::redacted_text(config));
        let text = move || known.get().map_or_else(|| first.clone(), |it| it.redacted_text());
        let (hub, settings) = (self.hub.clone(), config.recording.clone());
        let recorder = Recorder::new(hub, self.clock, settings, Box::new(text));
        if config.recording.starts
            && let Err(error) = recorder.start(&RecordingOptions::default())
        {
            let message = format!("Nothing is recorded: {error}.");
            tracing::error!("{message}");
            self.hub.publish_event(self.clock.now(), EventKind::RecordingFailed, message);
        }
        self.recorder = Some(Arc::new(recorder));
        camera_manager
    }

    fn start_api(&mut self, listener: TcpListener, config: &Config, ports: Arc<PushEndpoints>) {
        let (kinds, folder) = (config.kinds.clone(), config.folder.clone());
        let source_probe = || Arc::new(SourceProbe::new(kinds, folder, self.clock, self.playback));
        let state = ApiState {
            calibrator: self.calibrator.clone(),
            lenses: self.lenses.clone(),
            kinds: config.kinds.clone(),
            fleets: self.fleets.clone(),
            ports,
            late_window_ms: config.fusion.late_window_s * 1e3,
            source_probe: config.server.setup.then(source_probe),
            camera_manager: self.camera_manager.clone().filter(|_| config.server.setup),
            allowed_origins: AllowedOrigins::new(config.server.allow_origins.clone()),
            recorder: self.recorder.clone(),
            history: self.history.clone(),
            cancel: self.cancel_clients.clone(),
            limits: ApiLimits {
                max_clients: config.limits.max_clients,
                grace: CLIENT_TIMEOUT,
                ..ApiLimits::default()
            },
            ..ApiState::new(self.hub.clone(), self.clock)
        };
        self.api = Some(tokio::spawn(api::serve(listener, state)));
    }

    fn stop_cameras(&self) -> Vec<JoinHandle<WorkerCounts>> {
        self.camera_manager
            .as_ref()
            .map(|camera_manager| camera_manager.stop_all())
            .unwrap_or_default()
    }

    /// Ends cameras, then fusion, then clients; at most [`SHUTDOWN_TIMEOUT`] long. What does not end in time is
    /// left behind with a warning.
    pub async fn shutdown(mut self) {
        let deadline = Instant::now() + (SHUTDOWN_TIMEOUT - CLIENT_TIMEOUT);
        let cameras = self.stop_cameras();
        for calibration in
            [self.calibrator.shut_down(), self.lenses.shut_down()].into_iter().flatten()
        {
            join(calibration, deadline).await;
        }
        for camera in cameras {
            join(camera, deadline).await;
        }
        self.stop_fusion.stop();
        if let Some(fusion) = self.fusion.take() {
            join(fusion, deadline).await;
        }
        if let Some(history) = self.history.as_ref().and_then(|it| it.shut_down()) {
            join(history, deadline).await;
        }
        if let Some(recorder) = self.recorder.clone() {
            // What cameras and fusion said last is in it; its file gets its end.
            let _ = tokio::task::spawn_blocking(move || recorder.stop()).await;
        }
        self.cancel_clients.cancel();
        if let Some(api) = self.api.take()
            && let Err(error) = api.await
        {
            tracing::error!(%error, "the APIs ended badly");
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop_cameras();
        self.calibrator.shut_down();
        self.lenses.shut_down();
        self.stop_fusion.stop();
        self.cancel_clients.cancel();
    }
}

/// Reads what is kept, and has the cameras stand where it says.
fn load_calibration(
    config: &mut Config,
    hub: &Hub,
    clock: Clock,
) -> Result<CalibrationFile, CalibrationFileError> {
    let Some(path) = config.server.calibration.clone() else {
        return Ok(CalibrationFile::default());
    };
    let Some(mut file) = CalibrationFile::load(&path)? else {
        return Ok(CalibrationFile::default());
    };
    for why in file.merge_into(config) {
        tracing::warn!("{why}");
        hub.publish_event(clock.now(), EventKind::CalibrationApplied, why);
    }
    let (version, cameras) = (file.version, file.cameras.len());
    tracing::info!(version, cameras, file = %path.display(), "calibration of the arena");
    Ok(file)
}

fn spawn<T: Send + 'static>(
    name: String,
    run: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, ServeError> {
    let builder = thread::Builder::new().name(name.clone());
    builder.spawn(run).map_err(|source| ServeError::Thread { name, source })
}

/// Waits for a thread without holding up the runtime.
async fn join<T>(thread: JoinHandle<T>, deadline: Instant) {
    const POLL_INTERVAL: Duration = Duration::from_millis(5);
    while !thread.is_finished() {
        if Instant::now() >= deadline {
            let name = thread.thread().name().unwrap_or_default();
            tracing::warn!(thread = name, "did not end within the grace time");
            return;
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
    if thread.join().is_err() {
        tracing::error!("a thread ended with a panic");
    }
}

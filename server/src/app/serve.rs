//! Builds a server from its configuration and shuts it down: cameras first, then fusion, then clients. [`node`] is the
//! counterpart that only captures and searches.

mod error;
mod essential;
pub mod node;
mod shutdown;

use std::{
    net::SocketAddr,
    sync::{Arc, Mutex, OnceLock, PoisonError, mpsc::sync_channel},
    thread::{self, JoinHandle},
    time::Duration,
};

use roundel_core::id::CameraId;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub use crate::fusion::camera_manager::SourceContext;
use crate::{
    api::{
        self, AllowedOrigins, ApiLimits, ApiState,
        access::AccessControl,
        tls::{CertificateSummary, Tls, TlsError},
    },
    archive::{
        history::History,
        record::{Recorder, standing},
    },
    capture::{
        source::{OpenSource, Playback, SourceOpener, fleet::Fleets, push::PushEndpoints},
        source_probe::SourceProbe,
        worker::WorkerOutput,
    },
    fusion::{
        FusionTask, PublishSchedule, QUEUE_FRAMES,
        calibration::{
            Calibrator,
            file::{CalibrationFile, CalibrationFileError},
        },
        camera_manager::{self, CameraManager, CameraManagerParts},
        setup::{fusion_machine, landmarks},
    },
    lab::lens::LensCalibrator,
    model::{
        access::AccessConfig,
        clock::Clock,
        config::Config,
        hub::{EventKind, Hub},
        stop::StopSignal,
    },
};
pub use error::ServeError;
use essential::Essential;
use shutdown::CLIENT_TIMEOUT;
pub use shutdown::SHUTDOWN_TIMEOUT;

/// A running server. Dropping it without [`Server::shutdown`] ends its threads too, but does not wait for them.
pub struct Server {
    address: SocketAddr,
    certificate: Option<CertificateSummary>,
    hub: Arc<Hub>,
    clock: Clock,
    playback: Playback,
    calibrator: Arc<Calibrator>,
    lenses: Arc<LensCalibrator>,
    fleets: Arc<Fleets>,
    camera_manager: Arc<CameraManager>,
    recorder: Arc<Recorder>,
    stop_recording: StopSignal,
    history: Option<Arc<History>>,
    stop_fusion: StopSignal,
    cancel_clients: CancellationToken,
    /// Cancelled when an essential thread has ended.
    failed: CancellationToken,
    /// `None` after the shutdown, like `api`.
    fusion: Option<JoinHandle<()>>,
    api: Option<tokio::task::JoinHandle<()>>,
    is_shut_down: bool,
}

impl Server {
    /// Binds the port and starts cameras, fusion and APIs, in the current tokio runtime.
    ///
    /// A source that cannot be opened is no error: its camera is marked failed and retried.
    pub async fn start(config: Config) -> Result<Self, ServeError> {
        let fleets = Arc::<Fleets>::default();
        let shared = fleets.clone();
        let source = move |mut context: SourceContext<'_>| -> Box<dyn OpenSource> {
            let endpoint = context.port.take().unwrap_or_default();
            let opener = source_opener(context).with_push_endpoint(endpoint);
            Box::new(opener.with_fleets(shared.clone()))
        };
        Self::start_with_fleets(config, fleets, source).await
    }

    /// Like [`Server::start`], with sources of the caller. `source` is called each time a camera's worker starts; its
    /// sources yield frames of the calibration's size with capture times on the context's clock, and end their waits
    /// on its stop signal.
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
        check_exposure(config.server.listen, config.server.tls.is_some(), &config.access)?;
        let tls = load_tls(&config)?;
        let certificate = tls.certificate();
        let (listener, address) = listen(config.server.listen).await?;
        let (clock, playback) = Playback::begin(config.cameras.iter().map(|c| &c.address))?;
        let hub = Arc::new(Hub::new(camera_manager::setup::installation(&config, clock.now())));
        let mut calibrated = config.clone();
        let file = load_calibration(&mut calibrated, &hub, clock)?;
        let cameras = config.cameras.iter().map(camera_manager::setup::calibrator_camera);
        let calibrator = Arc::new(Calibrator::new(
            hub.clone(),
            clock,
            (0..).map(CameraId).zip(cameras).collect(),
            landmarks(&config),
            config.server.calibration.clone(),
            file,
        ));
        let lenses = Arc::new(LensCalibrator::new(hub.clone(), &config.folder));
        let start_history = |settings| Arc::new(History::start(settings, hub.clone(), clock));
        let history = config.history.clone().map(start_history);
        // Started before fusion and cameras, so that a recording misses nothing.
        let (recorder, recorded_manager) = new_recorder(&config, &hub, clock);
        let stop_recording = StopSignal::default();
        if config.recording.starts {
            standing::start(recorder.clone(), stop_recording.clone());
        }

        // Workers drop and count observations when this queue is full.
        let (to_fusion, from_workers) = sync_channel::<WorkerOutput>(QUEUE_FRAMES);
        let machine = fusion_machine(&config)?;
        let mut task = FusionTask::new(machine, hub.clone(), clock, from_workers);
        if config.server.monitors_cameras {
            task = task.with_camera_monitor(&landmarks(&config), calibrator.clone());
        } else {
            tracing::warn!(
                "cameras are not monitored (`watch = false` in [server]): a bumped camera stays in use"
            );
        }
        let (task, commands) = task.with_commands();
        let period = Duration::from_secs_f64(1.0 / config.server.snapshot_rate_hz);
        let schedule = PublishSchedule::new(period, config.server.publishes_per_frame);
        let (stop_fusion, failed) = (StopSignal::default(), CancellationToken::new());
        let stop = stop_fusion.clone();
        let essential = Essential::new("fusion", &failed, move || stop.is_stopped());
        let (stop, ending_hub) = (stop_fusion.clone(), hub.clone());
        let fusion = spawn("fusion".to_owned(), move || {
            let _essential = essential;
            let _end = FusionEnd(ending_hub);
            task.run(schedule, &stop);
        })?;

        let ports = Arc::new(PushEndpoints::default());
        let parts = CameraManagerParts {
            config: config.clone(),
            hub: hub.clone(),
            clock,
            playback,
            calibrator: calibrator.clone(),
            ports: ports.clone(),
            to_fusion,
            commands,
            sources: Box::new(source),
        };
        let camera_manager = CameraManager::start(parts, &calibrated);
        let camera_manager = Arc::new(camera_manager.inspect_err(|_| stop_fusion.stop())?);
        let _ = recorded_manager.set(camera_manager.clone());

        let (kinds, folder) = (config.kinds.clone(), config.folder.clone());
        let source_probe = || Arc::new(SourceProbe::new(kinds, folder, clock, playback));
        let cancel_clients = CancellationToken::new();
        let origins = AllowedOrigins(config.server.allow_origins.clone());
        let setup = config.server.setup;
        let access = AccessControl::new(&config.access, origins, address, setup);
        let needs_tls = config.server.tls.is_some() && !config.access.insecure;
        let access = Arc::new(if needs_tls { access.with_tls_only() } else { access });
        let state = ApiState {
            calibrator: calibrator.clone(),
            lenses: lenses.clone(),
            kinds: config.kinds.clone(),
            fleets: fleets.clone(),
            ports,
            late_window_ms: config.fusion.late_window_s * 1e3,
            source_probe: config.server.setup.then(source_probe),
            camera_manager: config.server.setup.then(|| camera_manager.clone()),
            access,
            recorder: Some(recorder.clone()),
            history: history.clone(),
            cancel: cancel_clients.clone(),
            limits: ApiLimits {
                max_clients: config.limits.max_clients,
                max_connections_per_peer: config.limits.max_connections_per_peer,
                grace: CLIENT_TIMEOUT,
                ..ApiLimits::default()
            },
            tls,
            ..ApiState::new(hub.clone(), clock)
        };
        let cancel = cancel_clients.clone();
        let essential = Essential::new("the API", &failed, move || cancel.is_cancelled());
        let api = async move {
            let _essential = essential;
            api::serve(listener, state).await;
        };
        Ok(Self {
            address,
            certificate,
            hub,
            clock,
            playback,
            calibrator,
            lenses,
            fleets,
            camera_manager,
            recorder,
            stop_recording,
            history,
            stop_fusion,
            cancel_clients,
            failed,
            fusion: Some(fusion),
            api: Some(tokio::spawn(api)),
            is_shut_down: false,
        })
    }

    /// The address it listens on, with the actual port where 0 was configured.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// The TLS certificate at start; `None` without `[server] tls`.
    pub fn certificate(&self) -> Option<&CertificateSummary> {
        self.certificate.as_ref()
    }

    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// The time line of recorded and simulated sources.
    pub fn playback(&self) -> Playback {
        self.playback
    }

    pub fn fleets(&self) -> &Arc<Fleets> {
        &self.fleets
    }

    pub fn calibrator(&self) -> &Arc<Calibrator> {
        &self.calibrator
    }

    pub fn recorder(&self) -> &Arc<Recorder> {
        &self.recorder
    }

    /// Waits until an essential thread or task has failed. Then nothing is localized or served any more.
    pub async fn failed(&self) {
        self.failed.cancelled().await;
    }
}

/// Refuses to serve other computers without encryption and credentials, unless configured.
pub fn check_exposure(
    address: SocketAddr,
    has_tls: bool,
    access: &AccessConfig,
) -> Result<(), ServeError> {
    let is_protected = has_tls && !access.entries.is_empty();
    if address.ip().is_loopback() || is_protected || access.insecure {
        return Ok(());
    }
    Err(ServeError::Exposed { address })
}

fn load_tls(config: &Config) -> Result<Tls, TlsError> {
    let Some(files) = &config.server.tls else { return Ok(Tls::default()) };
    let tls = Tls::load(files, config.server.listen.ip())?;
    if let Some(CertificateSummary { fingerprint, expires }) = tls.certificate() {
        tracing::info!(fingerprint, expires, "TLS certificate");
    }
    Ok(tls)
}

/// Tells the hub when the fusion thread ends, also by a panic.
struct FusionEnd(Arc<Hub>);

impl Drop for FusionEnd {
    fn drop(&mut self) {
        self.0.set_fusion_ended();
    }
}

/// Binds a port; returns also the actual address.
pub(super) async fn listen(address: SocketAddr) -> Result<(TcpListener, SocketAddr), ServeError> {
    let failed = |source| ServeError::Listen { address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    Ok((listener, bound))
}

fn source_opener(context: SourceContext<'_>) -> SourceOpener {
    let SourceContext { camera, clock, playback, stop, .. } = context;
    let size = (camera.calibration.width(), camera.calibration.height());
    SourceOpener::new(camera.address.clone(), size, clock, playback, stop)
        .with_rules(camera.source_rules.clone())
}

/// Creates the recorder. It gets the current configuration from the returned camera manager once that is set.
fn new_recorder(
    config: &Config,
    hub: &Arc<Hub>,
    clock: Clock,
) -> (Arc<Recorder>, Arc<OnceLock<Arc<CameraManager>>>) {
    let camera_manager = Arc::<OnceLock<Arc<CameraManager>>>::default();
    let known = camera_manager.clone();
    let newest = Mutex::new((camera_manager::redacted_text(config), config.file.version()));
    let text = move || {
        let mut newest = newest.lock().unwrap_or_else(PoisonError::into_inner);
        // Does not wait for a change that is being made; the text follows after it.
        if let Some(changed) = known.get().and_then(|it| it.redacted_text_since(&newest.1)) {
            *newest = changed;
        }
        newest.0.clone()
    };
    let recorder = Recorder::new(hub.clone(), clock, config.recording.clone(), Box::new(text));
    (Arc::new(recorder), camera_manager)
}

/// Reads the calibration file, if there is one, and applies it to the configuration.
fn load_calibration(
    config: &mut Config,
    hub: &Hub,
    clock: Clock,
) -> Result<CalibrationFile, CalibrationFileError> {
    let Some(path) = config.server.calibration.clone() else { return Ok(Default::default()) };
    let Some(mut file) = CalibrationFile::load(&path)? else { return Ok(Default::default()) };
    for why in file.merge_into(config) {
        tracing::warn!("{why}");
        hub.publish_event(clock.now(), EventKind::CalibrationApplied, why);
    }
    let (version, cameras) = (file.version, file.cameras.len());
    tracing::info!(version, cameras, file = %path.display(), "calibration of the arena");
    Ok(file)
}

pub(super) fn spawn<T: Send + 'static>(
    name: String,
    run: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, ServeError> {
    let builder = thread::Builder::new().name(name.clone());
    builder.spawn(run).map_err(|source| ServeError::Thread { name, source })
}

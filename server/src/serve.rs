//! Puts a server together, and takes it apart on shutdown: cameras first, then fusion, then clients. [`node`] does
//! so with what only captures and searches.

pub mod node;
mod setup;

use std::{
    io,
    net::SocketAddr,
    sync::{Arc, mpsc::sync_channel},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use roundel_core::{
    marker::{DetectorError, MaskError},
    world::BodyError,
};
use thiserror::Error;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use crate::{
    api,
    calibration::{
        Calibrated, Calibrator, CalibratorParts,
        file::{CalibrationFile, CalibrationFileError, Configured},
    },
    clock::Clock,
    config::{CameraConfig, CameraPose, Config},
    fusion::{FusionTask, QUEUE_FRAMES, Standing},
    hub::{Happening, Hub},
    source::{OpenSource, Playback, SourceAddress, SourceOpener, TimesError, push::Port},
    stop::Stop,
    trial::Trier,
    worker::{self, Sighted, Worker, WorkerParts, adoption::Inbox, pipeline::Pipeline},
};
use setup::{camera_id, configured, fusion, installation, landmarks, pipeline, place, standing};

/// Time that shutdown may take in all.
pub const GRACE: Duration = Duration::from_secs(5);
/// Of it, for clients; the rest is for cameras and fusion, which need far less.
const CLIENT_GRACE: Duration = Duration::from_secs(2);

/// Why a server does not start.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The port is taken, or not ours to take.
    #[error("cannot listen on {address}: {source}; {}", remedy(.source))]
    Listen {
        /// What was to be bound.
        address: SocketAddr,
        /// What the system says.
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
    /// A camera's mask is none.
    #[error(transparent)]
    Mask(#[from] MaskError),
    /// An object cannot be followed.
    #[error("object \"{name}\": {source}")]
    Object {
        /// Its name.
        name: String,
        /// Why not.
        source: BodyError,
    },
    /// A node takes its frames from a program.
    #[error(
        "camera \"{camera}\" has `source = \"push:\"`: a node takes frames from cameras, and only a server can be fed"
    )]
    NodeIsFed {
        /// Which camera.
        camera: String,
    },
    /// There cannot be a server there.
    #[error(transparent)]
    Client(roundel_client::Error),
    /// The system gives no thread.
    #[error("cannot start the thread `{name}`: {source}")]
    Thread {
        /// Which thread.
        name: String,
        /// What the system says.
        source: io::Error,
    },
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

/// What a source has to fit into.
pub struct CameraSetting<'a> {
    /// The camera's place in the configuration.
    pub index: usize,
    /// Its configuration.
    pub camera: &'a CameraConfig,
    /// The server's clock.
    pub clock: Clock,
    /// The time line of recorded and simulated frames.
    pub playback: Playback,
    /// Ends every wait of the source.
    pub stop: Stop,
    /// Where the frames of one with a `push:` source arrive.
    pub port: Option<Arc<Port>>,
}

/// A running server. Dropping it without [`Server::shutdown`] ends its threads too, but does not
/// wait for them.
pub struct Server {
    address: SocketAddr,
    hub: Arc<Hub>,
    clock: Clock,
    playback: Playback,
    calibrator: Arc<Calibrator>,
    stop_cameras: Stop,
    stop_fusion: Stop,
    cancel_clients: CancellationToken,
    cameras: Vec<JoinHandle<()>>,
    fusion: Option<JoinHandle<()>>,
    api: Option<tokio::task::JoinHandle<()>>,
}

impl Server {
    /// Binds the port and starts cameras, fusion and APIs. To be called within a tokio runtime.
    ///
    /// A camera whose source cannot be opened is no error: it is shown as failed and tried again.
    pub async fn start(config: Config) -> Result<Self, ServeError> {
        Self::start_with_sources(config, |setting| {
            let CameraSetting { camera, clock, playback, stop, port, .. } = setting;
            let size = (camera.calibration.width(), camera.calibration.height());
            let opener = SourceOpener::new(camera.address.clone(), size, clock, playback, stop);
            Box::new(opener.with_port(port.unwrap_or_default()))
        })
        .await
    }

    /// The same with frames of the caller's own: `source` is asked once for each camera. Its
    /// sources give frames of the size of the camera's calibration, with capture times on the
    /// setting's clock, and end their waits on its stop signal.
    pub async fn start_with_sources(
        mut config: Config,
        mut source: impl FnMut(CameraSetting<'_>) -> Box<dyn OpenSource>,
    ) -> Result<Self, ServeError> {
        let address = config.server.listen;
        let listening = |source| ServeError::Listen { address, source };
        let listener = TcpListener::bind(address).await.map_err(listening)?;
        let address = listener.local_addr().map_err(listening)?;
        let (clock, playback) = Playback::begin(config.cameras.iter().map(|c| &c.address))?;
        let hub = Arc::new(Hub::new(installation(&config, clock.now())));
        let calibrated = config.cameras.iter().map(calibrated).collect();
        let file = kept_calibration(&mut config, &hub, clock)?;
        let calibrator = Arc::new(Calibrator::new(CalibratorParts {
            hub: hub.clone(),
            clock,
            cameras: calibrated,
            landmarks: landmarks(&config),
            path: config.server.calibration.clone(),
            file,
        }));
        let mut server = Self {
            address,
            hub: hub.clone(),
            clock,
            playback,
            calibrator: calibrator.clone(),
            stop_cameras: Stop::default(),
            stop_fusion: Stop::default(),
            cancel_clients: CancellationToken::new(),
            cameras: Vec::new(),
            fusion: None,
            api: None,
        };
        let ports: Vec<Option<Arc<Port>>> = config.cameras.iter().map(port).collect();
        server.start_threads(&config, &ports, &mut source)?;
        let trier = config.server.setup.then(|| {
            Arc::new(Trier::new(config.kinds.clone(), config.folder.clone(), clock, playback))
        });
        let limits = api::Limits {
            max_clients: config.limits.max_clients,
            grace: CLIENT_GRACE,
            ..api::Limits::default()
        };
        let cancel = server.cancel_clients.clone();
        server.api = Some(tokio::spawn(api::serve(
            listener,
            api::Served {
                hub,
                clock,
                calibrator,
                ports,
                late_window_ms: config.fusion.late_window_s * 1e3,
                trier,
            },
            limits,
            cancel,
        )));
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

    /// The server's clock.
    pub fn clock(&self) -> Clock {
        self.clock
    }

    /// The time line of its recorded and simulated sources.
    pub fn playback(&self) -> Playback {
        self.playback
    }

    /// What calibrates its arena.
    pub fn calibrator(&self) -> &Arc<Calibrator> {
        &self.calibrator
    }

    fn start_threads(
        &mut self,
        config: &Config,
        ports: &[Option<Arc<Port>>],
        source: &mut dyn FnMut(CameraSetting<'_>) -> Box<dyn OpenSource>,
    ) -> Result<(), ServeError> {
        // Full: observations are dropped and counted, see `worker`.
        let (to_fusion, from_workers) = sync_channel::<Sighted>(QUEUE_FRAMES);
        let mut task = FusionTask::new(fusion(config)?, self.hub.clone(), self.clock, from_workers);
        if config.server.watches {
            task = task.watching(Standing {
                cameras: standing(config),
                configured: configured(config),
                landmarks: landmarks(config),
                calibrator: self.calibrator.clone(),
            });
        } else {
            tracing::warn!(
                "cameras are not watched (`watch = false` in [server]): one that is bumped goes on to be used"
            );
        }
        let period = Duration::from_secs_f64(1.0 / config.server.snapshot_rate_hz);
        let stop = self.stop_fusion.clone();
        self.fusion = Some(spawn("fusion".to_owned(), move || task.run(period, &stop))?);
        for (index, camera) in config.cameras.iter().enumerate() {
            let worker = Worker::new(WorkerParts {
                id: camera_id(index),
                name: camera.name.clone(),
                opener: source(CameraSetting {
                    index,
                    camera,
                    clock: self.clock,
                    playback: self.playback,
                    stop: self.stop_cameras.clone(),
                    port: ports.get(index).cloned().flatten(),
                }),
                pipeline: Pipeline::new(pipeline(camera, config)?)?,
                place: place(camera, config),
                calibration_version: version_of(camera, &self.calibrator),
                inbox: self.calibrator.inbox(camera_id(index)),
                hub: self.hub.clone(),
                fusion: to_fusion.clone(),
                clock: self.clock,
                promised_hz: camera.rate_hz,
            });
            let stop = self.stop_cameras.clone();
            let name = format!("camera {}", camera.name);
            self.cameras.push(spawn(name, move || worker::run(worker, &stop))?);
        }
        Ok(())
    }

    /// Ends cameras, then fusion, then clients; at most [`GRACE`] long. What does not end in time is
    /// left behind with a warning.
    pub async fn shutdown(mut self) {
        let deadline = Instant::now() + (GRACE - CLIENT_GRACE);
        self.stop_cameras.stop();
        if let Some(calibration) = self.calibrator.shut_down() {
            join(calibration, deadline).await;
        }
        for camera in std::mem::take(&mut self.cameras) {
            join(camera, deadline).await;
        }
        self.stop_fusion.stop();
        if let Some(fusion) = self.fusion.take() {
            join(fusion, deadline).await;
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
        self.stop_cameras.stop();
        self.calibrator.shut_down();
        self.stop_fusion.stop();
        self.cancel_clients.cancel();
    }
}

/// Where remote programs feed a camera.
fn port(camera: &CameraConfig) -> Option<Arc<Port>> {
    matches!(camera.address, SourceAddress::Push(_)).then(Arc::default)
}

/// What the calibrator is told of a camera, before a kept calibration is merged.
fn calibrated(camera: &CameraConfig) -> Calibrated {
    let rides = matches!(camera.pose, CameraPose::Rides(_));
    Calibrated {
        name: camera.name.clone(),
        configured: (!rides).then(|| Configured::of(camera)),
        inbox: Inbox::default(),
    }
}

/// Reads what is kept, and has the cameras stand where it says.
fn kept_calibration(
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
        hub.publish_event(clock.now(), Happening::CalibrationApplied, why);
    }
    let (version, cameras) = (file.version, file.cameras.len());
    tracing::info!(version, cameras, file = %path.display(), "calibration of the arena");
    Ok(file)
}

/// Of the calibration that a camera starts with.
fn version_of(camera: &CameraConfig, calibrator: &Calibrator) -> u64 {
    if matches!(camera.pose, CameraPose::Calibrated(_)) { calibrator.version() } else { 0 }
}

fn spawn(name: String, run: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, ServeError> {
    let builder = thread::Builder::new().name(name.clone());
    builder.spawn(run).map_err(|source| ServeError::Thread { name, source })
}

/// Waits for a thread without holding up the runtime.
async fn join(thread: JoinHandle<()>, deadline: Instant) {
    const LOOK_EVERY: Duration = Duration::from_millis(5);
    while !thread.is_finished() {
        if Instant::now() >= deadline {
            let name = thread.thread().name().unwrap_or_default();
            tracing::warn!(thread = name, "did not end within the grace time");
            return;
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
    if thread.join().is_err() {
        tracing::error!("a thread ended with a panic");
    }
}

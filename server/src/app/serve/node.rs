//! A node: cameras that are captured and searched here, and fused by a server elsewhere.
//!
//! Each camera has its worker, as in a server; what it sees goes through [`roundel_client::Pusher`] into the camera of
//! the same name of the server, whose source there is `push:`. While the server is away cameras go on being searched;
//! what the server could still use is kept, the rest is dropped and counted.
//!
//! The server's word on lenses counts: what its configuration or a calibration of the arena says of a camera's lens is
//! taken over between two frames. Where cameras stand does not matter here.

mod picture;

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use roundel_client::{Client, PushOptions, PushStatus, Pusher};
use roundel_core::id::CameraId;
use roundel_proto::v1;
use tokio::task::JoinSet;

use super::{SHUTDOWN_TIMEOUT, ServeError, join, spawn};
use crate::{
    capture::{
        push_messages::{calibration_camera, pushed_observations},
        source::{OpenSource, Playback, SourceOpener},
        worker::{
            self, PoseSource, Worker, WorkerCounts, WorkerOutput, WorkerParts,
            calibration_update::{CalibrationMailbox, CalibrationUpdate},
            pipeline::Pipeline,
        },
    },
    fusion::{QUEUE_FRAMES, camera_manager::setup::pipeline_parts, setup::installation},
    model::{
        address::SourceAddress,
        clock::Clock,
        config::Config,
        hub::{CameraStatus, Hub},
        stop::StopSignal,
    },
};

/// How often it is looked whether a camera has failed.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// What was seen last may still be sent for so long at the end.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(2);

/// What a source of a node has to fit into.
pub struct NodeSourceContext<'a> {
    /// The camera's pose in the configuration.
    pub index: usize,
    pub config: &'a Config,
    pub clock: Clock,
    /// The time line of recorded and simulated frames.
    pub playback: Playback,
    /// Ends every wait of the source.
    pub stop: StopSignal,
}

pub struct Node {
    hub: Arc<Hub>,
    pushers: Arc<Vec<Pusher>>,
    stop: StopSignal,
    cameras: Vec<JoinHandle<WorkerCounts>>,
    forwarder: JoinHandle<()>,
    listeners: JoinSet<()>,
}

/// What became of a camera's frames.
#[derive(Clone, Debug)]
pub struct NodeReport {
    pub camera: String,
    pub frames: u64,
    pub pushed: PushStatus,
}

impl Node {
    /// Starts cameras; the server may come later. To be called within a tokio runtime.
    pub fn start(config: &Config, server: &Client) -> Result<Self, ServeError> {
        Self::start_with_sources(config, server, |setting| {
            let camera = &setting.config.cameras[setting.index];
            let size = (camera.calibration.width(), camera.calibration.height());
            let NodeSourceContext { clock, playback, stop, .. } = setting;
            Box::new(SourceOpener::new(camera.address.clone(), size, clock, playback, stop))
        })
    }

    /// The same with frames of the caller's own, as [`super::Server::start_with_sources`].
    pub fn start_with_sources(
        config: &Config,
        server: &Client,
        mut source: impl FnMut(NodeSourceContext<'_>) -> Box<dyn OpenSource>,
    ) -> Result<Self, ServeError> {
        let fed = config.cameras.iter().find(|it| matches!(it.address, SourceAddress::Push(_)));
        if let Some(camera) = fed {
            return Err(ServeError::NodeIsFed { camera: camera.name.clone() });
        }
        let (clock, playback) = Playback::begin(config.cameras.iter().map(|c| &c.address))?;
        let hub = Arc::new(Hub::new(installation(config, clock.now())));
        let stop = StopSignal::default();
        let (to_server, from_workers) = sync_channel::<WorkerOutput>(QUEUE_FRAMES);
        let (mut pushers, mut cameras, mut listeners) = (Vec::new(), Vec::new(), JoinSet::new());
        let faults = Arc::new(CameraFaults(Mutex::new(vec![None; config.cameras.len()])));
        for (index, camera) in config.cameras.iter().enumerate() {
            let options = PushOptions::new(&camera.name)
                .sender(format!("node {}", config.name))
                .clock(move || clock.now().as_ns());
            let pusher = server.push(options).map_err(ServeError::Client)?;
            let mailbox = CalibrationMailbox::default();
            let listener = ServerListener {
                name: camera.name.clone(),
                index,
                size: (camera.calibration.width(), camera.calibration.height()),
                mailbox: mailbox.clone(),
                faults: faults.clone(),
            };
            listeners.spawn(listener.clone().follow(pusher.calibration()));
            listeners.spawn(listener.tell(pusher.statuses()));
            pushers.push(pusher);
            let setting = NodeSourceContext { index, config, clock, playback, stop: stop.clone() };
            let (id, before) = (CameraId(index as u32), WorkerCounts::default());
            let worker = Worker::new(WorkerParts {
                id,
                name: camera.name.clone(),
                opener: source(setting),
                pipeline: Pipeline::new(pipeline_parts(camera, config, before.detection)?)?,
                // The server finds it; nothing is placed here.
                pose: PoseSource::Mounted,
                calibration_version: 0,
                mailbox,
                hub: hub.clone(),
                fusion: to_server.clone(),
                clock,
                promised_hz: camera.rate_hz,
                before,
            });
            let stop = stop.clone();
            let name = format!("camera {}", camera.name);
            cameras.push(spawn(name, move || worker::run(worker, &stop))?);
        }
        let pushers = Arc::new(pushers);
        for index in 0..pushers.len() {
            listeners.spawn(picture::answer_requests(hub.clone(), pushers.clone(), index));
        }
        let reported = vec![String::new(); pushers.len()];
        let forwarder = Forwarder {
            hub: hub.clone(),
            pushers: pushers.clone(),
            faults,
            from_workers,
            reported,
        };
        let forwarder = spawn("forwarder".to_owned(), move || forwarder.run())?;
        Ok(Self { hub, pushers, stop, cameras, forwarder, listeners })
    }

    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    /// What became of each camera's frames so far.
    pub fn reports(&self) -> Vec<NodeReport> {
        let cameras = Self::searched_frames(&self.hub).into_iter().zip(self.pushers.iter());
        let report = |((camera, frames), pusher): ((String, u64), &Pusher)| NodeReport {
            camera,
            frames,
            pushed: pusher.status(),
        };
        cameras.map(report).collect()
    }

    /// Every camera's name, and how many of its frames were searched.
    fn searched_frames(hub: &Hub) -> Vec<(String, u64)> {
        let (installation, states) = (hub.installation(), hub.cameras());
        let name = |id: CameraId| installation.camera_name(id).to_owned();
        states.iter().map(|(id, state)| (name(*id), state.frames)).collect()
    }

    /// Ends cameras, sends what they saw last, and says what became of everything.
    pub async fn shutdown(mut self) -> Vec<NodeReport> {
        self.stop.stop();
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        for camera in self.cameras.drain(..) {
            join(camera, deadline).await;
        }
        // It ends when the last camera has.
        join(self.forwarder, deadline).await;
        self.listeners.shutdown().await;
        let mut reports = Vec::new();
        let Some(pushers) = Arc::into_inner(self.pushers) else { return reports };
        for (pusher, (camera, frames)) in pushers.into_iter().zip(Self::searched_frames(&self.hub))
        {
            let pushed = pusher.finish(FLUSH_TIMEOUT).await;
            reports.push(NodeReport { camera, frames, pushed });
        }
        reports
    }
}

/// Why what a camera sees is not sent, by camera.
struct CameraFaults(Mutex<Vec<Option<String>>>);

impl CameraFaults {
    fn set(&self, index: usize, fault: Option<String>) {
        let mut faults = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(slot) = faults.get_mut(index) {
            *slot = fault;
        }
    }

    fn of(&self, index: usize) -> Option<String> {
        let faults = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        faults.get(index).cloned().flatten()
    }
}

/// Hands what workers saw to the pushers, and tells them of failures.
struct Forwarder {
    hub: Arc<Hub>,
    pushers: Arc<Vec<Pusher>>,
    faults: Arc<CameraFaults>,
    from_workers: Receiver<WorkerOutput>,
    /// What the pushers were told last, by camera; what they are given to send takes it back.
    reported: Vec<String>,
}

impl Forwarder {
    /// Until the last worker has ended.
    fn run(mut self) {
        let mut look = Instant::now();
        loop {
            match self.from_workers.recv_timeout(POLL_INTERVAL) {
                Ok(output) => self.forward(&output),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if look.elapsed() >= POLL_INTERVAL {
                look = Instant::now();
                self.report_faults();
            }
        }
    }

    fn forward(&mut self, output: &WorkerOutput) {
        let seen = &output.observations;
        let index = seen.camera.0 as usize;
        let (Some(pusher), Some(state)) = (self.pushers.get(index), self.hub.camera(seen.camera))
        else {
            return;
        };
        if self.faults.of(index).is_none() {
            pusher.observations(pushed_observations(&self.hub.installation(), seen, &state));
            self.reported[index].clear();
        }
    }

    fn report_faults(&mut self) {
        // What a camera saw before it failed is told before: it is in the queue by the time that this is known.
        let states = self.hub.cameras();
        while let Ok(output) = self.from_workers.try_recv() {
            self.forward(&output);
        }
        for (index, state) in states.into_values().enumerate() {
            let fault = match (self.faults.of(index), state.status) {
                (Some(fault), _) => fault,
                (None, CameraStatus::Failed) => state.error,
                (None, CameraStatus::Finished) => "its source has no more frames".to_owned(),
                (None, CameraStatus::Starting | CameraStatus::Running) => continue,
            };
            if self.reported[index] != fault {
                self.pushers[index].trouble(&fault);
                self.reported[index] = fault;
            }
        }
    }
}

/// Follows what the server says of one camera.
#[derive(Clone)]
struct ServerListener {
    name: String,
    index: usize,
    /// Of the source's pictures.
    size: (usize, usize),
    mailbox: CalibrationMailbox,
    faults: Arc<CameraFaults>,
}

type Calibrations = tokio::sync::watch::Receiver<Option<v1::PushedCalibration>>;

impl ServerListener {
    async fn follow(self, mut calibrations: Calibrations) {
        while calibrations.changed().await.is_ok() {
            let Some(calibration) = calibrations.borrow_and_update().clone() else { continue };
            let fault = self.take_over(&calibration).err();
            if let Some(fault) = &fault {
                tracing::warn!(camera = self.name, "{fault}");
            }
            self.faults.set(self.index, fault);
        }
    }

    fn take_over(&self, calibration: &v1::PushedCalibration) -> Result<(), String> {
        let size = (calibration.width as usize, calibration.height as usize);
        if size != self.size {
            return Err(format!(
                "the server's calibration of this camera is for {} x {} pixels, the node's pictures have {} x {}: \
                 give both the same camera file",
                size.0, size.1, self.size.0, self.size.1
            ));
        }
        let Some(lens) = calibration_camera(calibration) else {
            return Err(
                "the server's calibration of this camera is none that this node knows: both should be of one \
                 version"
                    .to_owned(),
            );
        };
        // Where it stands, nobody asks here.
        self.mailbox.put(CalibrationUpdate {
            lens,
            pose: PoseSource::Unchanged,
            version: calibration.version,
        });
        tracing::info!(
            camera = self.name,
            version = calibration.version,
            "lens taken over from the server"
        );
        Ok(())
    }

    /// Says when the connection comes and goes.
    async fn tell(self, mut statuses: tokio::sync::watch::Receiver<PushStatus>) {
        let (camera, mut was) = (&self.name, (false, String::new()));
        while statuses.changed().await.is_ok() {
            let status = statuses.borrow_and_update().clone();
            let now = (status.connected, status.error.clone());
            if now == was {
                continue;
            }
            match status.connected {
                true => tracing::info!(
                    camera,
                    dropped = status.dropped,
                    "the server takes what it sees"
                ),
                false => tracing::warn!(camera, "{}", status.error),
            }
            was = now;
        }
    }
}

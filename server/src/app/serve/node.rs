//! A node: captures and searches frames on this computer, for a server on another one that fuses the observations.
//!
//! Each camera has a worker, as in a server. A [`roundel_client::Pusher`] sends its observations to the server's camera
//! of the same name, whose source is `push:`. While the server is away, frames are still searched; observations that are
//! recent enough are kept, older ones are dropped and counted.
//!
//! The server decides on lenses: a lens from its configuration or from an arena calibration replaces the node's between
//! two frames. Poses do not matter to a node.

mod picture;

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use roundel_client::{Client, PushOptions, PushStatus, Pusher};
use roundel_core::id::CameraId;
use roundel_proto::v1;
use tokio::{sync::watch, task::JoinSet};

use super::{
    ServeError, SourceContext,
    shutdown::{join, on_thread},
    source_opener, spawn,
};
use crate::{
    capture::{
        push_messages::{calibration_camera, pushed_observations},
        source::{OpenSource, Playback},
        worker::{
            self, PoseSource, Worker, WorkerCounts, WorkerOutput, WorkerParts,
            calibration_update::{CalibrationMailbox, CalibrationUpdate},
            pipeline::Pipeline,
        },
    },
    fusion::{
        QUEUE_FRAMES,
        camera_manager::setup::{installation, pipeline_parts},
    },
    model::{
        address::SourceAddress,
        config::Config,
        hub::{CameraStatus, Hub},
        stop::StopSignal,
    },
};

/// Time between checks for failed cameras.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Time limit for ending the cameras at shutdown.
const CAMERA_TIMEOUT: Duration = Duration::from_millis(2500);
/// Time limit for sending the last observations then.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(2);

pub struct Node {
    hub: Arc<Hub>,
    pushers: Arc<Vec<Pusher>>,
    stop: StopSignal,
    cameras: Vec<JoinHandle<WorkerCounts>>,
    forwarder: JoinHandle<()>,
    listeners: JoinSet<()>,
}

/// Counts of one camera's frames.
#[derive(Clone, Debug)]
pub struct NodeReport {
    pub camera: String,
    /// Frames that were searched.
    pub frames: u64,
    pub pushed: PushStatus,
}

impl Node {
    /// Starts the cameras, in the current tokio runtime. The server need not be reachable yet.
    pub fn start(config: &Config, server: &Client) -> Result<Self, ServeError> {
        Self::start_with_sources(config, server, |context| Box::new(source_opener(context)))
    }

    /// Like [`Node::start`], with sources of the caller, as in [`super::Server::start_with_sources`].
    pub fn start_with_sources(
        config: &Config,
        server: &Client,
        mut source: impl FnMut(SourceContext<'_>) -> Box<dyn OpenSource>,
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
            let calibrations = CalibrationListener {
                name: camera.name.clone(),
                index,
                size: (camera.calibration.width(), camera.calibration.height()),
                mailbox: mailbox.clone(),
                faults: faults.clone(),
            };
            listeners.spawn(calibrations.run(pusher.calibration()));
            listeners.spawn(log_connection(camera.name.clone(), pusher.statuses()));
            pushers.push(pusher);
            let (stop, port) = (stop.clone(), None);
            let context =
                SourceContext { index, camera, clock, playback, stop: stop.clone(), port };
            let (id, before) = (CameraId(index as u32), WorkerCounts::default());
            let worker = Worker::new(WorkerParts {
                id,
                name: camera.name.clone(),
                opener: source(context),
                pipeline: Pipeline::new(pipeline_parts(camera, config, before.detection)?)?,
                // The server knows or searches for the pose.
                pose: PoseSource::Mounted,
                calibration_version: 0,
                mailbox,
                hub: hub.clone(),
                fusion: to_server.clone(),
                clock,
                promised_hz: camera.rate_hz,
                min_error_px: 0.0,
                time_budget: config.time_budget,
                before,
            });
            let name = format!("camera {}", camera.name);
            cameras.push(spawn(name, move || worker::run(worker, &stop))?);
        }
        let pushers = Arc::new(pushers);
        for index in 0..pushers.len() {
            listeners.spawn(picture::answer_requests(hub.clone(), pushers.clone(), index));
        }
        let forwarder = Forwarder {
            hub: hub.clone(),
            pushers: pushers.clone(),
            faults,
            from_workers,
            reported: vec![String::new(); pushers.len()],
        };
        let forwarder = spawn("forwarder".to_owned(), move || forwarder.run())?;
        Ok(Self { hub, pushers, stop, cameras, forwarder, listeners })
    }

    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    /// The counts of all cameras so far.
    pub fn reports(&self) -> Vec<NodeReport> {
        let statuses = self.pushers.iter().map(Pusher::status).collect();
        reports(&self.hub, statuses)
    }

    /// Ends cameras, sends their last observations, and returns the final counts.
    pub async fn shutdown(mut self) -> Vec<NodeReport> {
        self.stop.stop();
        let deadline = Instant::now() + CAMERA_TIMEOUT;
        on_thread(move || {
            self.cameras.into_iter().for_each(|camera| join(camera, deadline));
            // Ends when the last camera has.
            join(self.forwarder, deadline);
        })
        .await;
        self.listeners.shutdown().await;
        let mut statuses = Vec::new();
        for pusher in Arc::into_inner(self.pushers).unwrap_or_default() {
            statuses.push(pusher.finish(FLUSH_TIMEOUT).await);
        }
        reports(&self.hub, statuses)
    }
}

fn reports(hub: &Hub, statuses: Vec<PushStatus>) -> Vec<NodeReport> {
    let (installation, states) = (hub.installation(), hub.cameras());
    let cameras = states.iter().map(|(id, state)| (installation.camera_name(*id), state.frames));
    cameras
        .zip(statuses)
        .map(|((camera, frames), pushed)| NodeReport { camera: camera.to_owned(), frames, pushed })
        .collect()
}

/// Why a camera's observations are not sent, by camera.
struct CameraFaults(Mutex<Vec<Option<String>>>);

impl CameraFaults {
    fn lock(&self) -> MutexGuard<'_, Vec<Option<String>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Passes the workers' observations and failures to the pushers.
struct Forwarder {
    hub: Arc<Hub>,
    pushers: Arc<Vec<Pusher>>,
    faults: Arc<CameraFaults>,
    from_workers: Receiver<WorkerOutput>,
    /// The fault reported last, by camera; cleared by the next observations.
    reported: Vec<String>,
}

impl Forwarder {
    /// Runs until the last worker has ended.
    fn run(mut self) {
        let mut checked = Instant::now();
        loop {
            match self.from_workers.recv_timeout(POLL_INTERVAL) {
                Ok(output) => self.forward(&output),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if checked.elapsed() >= POLL_INTERVAL {
                checked = Instant::now();
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
        if self.faults.lock()[index].is_none() {
            pusher.observations(pushed_observations(&self.hub.installation(), seen, &state));
            self.reported[index].clear();
        }
    }

    fn report_faults(&mut self) {
        // Observations from before a failure are in the queue by now, and must be sent first.
        let states = self.hub.cameras();
        while let Ok(output) = self.from_workers.try_recv() {
            self.forward(&output);
        }
        for (index, state) in states.into_values().enumerate() {
            let fault = match (self.faults.lock()[index].clone(), state.status) {
                (Some(fault), _) => fault,
                (None, CameraStatus::Failed) => state.error,
                (None, CameraStatus::Finished) => "its source has ended".to_owned(),
                (None, CameraStatus::Starting | CameraStatus::Running) => continue,
            };
            if self.reported[index] != fault {
                self.pushers[index].trouble(&fault);
                self.reported[index] = fault;
            }
        }
    }
}

/// Applies one camera's calibrations from the server.
struct CalibrationListener {
    name: String,
    index: usize,
    /// Size of the source's pictures.
    size: (usize, usize),
    mailbox: CalibrationMailbox,
    faults: Arc<CameraFaults>,
}

impl CalibrationListener {
    async fn run(self, mut calibrations: watch::Receiver<Option<v1::PushedCalibration>>) {
        while calibrations.changed().await.is_ok() {
            let Some(calibration) = calibrations.borrow_and_update().clone() else { continue };
            let fault = self.apply(&calibration).err();
            if let Some(fault) = &fault {
                tracing::warn!(camera = self.name, "{fault}");
            }
            self.faults.lock()[self.index] = fault;
        }
    }

    fn apply(&self, calibration: &v1::PushedCalibration) -> Result<(), String> {
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
                "this node does not support the server's calibration of this camera: run the same version on both"
                    .to_owned(),
            );
        };
        // The pose does not matter to a node.
        let version = calibration.version;
        self.mailbox.put(CalibrationUpdate { lens, pose: PoseSource::Unchanged, version });
        tracing::info!(camera = self.name, version, "using the server's lens");
        Ok(())
    }
}

async fn log_connection(camera: String, mut statuses: watch::Receiver<PushStatus>) {
    let mut was = (false, String::new());
    while statuses.changed().await.is_ok() {
        let PushStatus { connected, error, dropped, .. } = statuses.borrow_and_update().clone();
        if was == (connected, error.clone()) {
            continue;
        }
        if connected {
            tracing::info!(camera, dropped, "connected to the server");
        } else {
            tracing::warn!(camera, "{error}");
        }
        was = (connected, error);
    }
}

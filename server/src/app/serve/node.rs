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

use super::{GRACE, ServeError, join, spawn};
use crate::{
    capture::{
        push_messages::{pushed_observations, told_camera},
        source::{OpenSource, Playback, SourceOpener},
        worker::{
            self, Place, Sighted, Totals, Worker, WorkerParts,
            adoption::{Adoption, Inbox},
            pipeline::Pipeline,
        },
    },
    fusion::{QUEUE_FRAMES, roster::setup::pipeline, setup::installation},
    model::{
        address::SourceAddress,
        clock::Clock,
        config::Config,
        hub::{CameraStatus, Hub},
        stop::Stop,
    },
};

/// How often it is looked whether a camera has failed.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// What was seen last may still be sent for so long at the end.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// What a source of a node has to fit into.
pub struct NodeSetting<'a> {
    /// The camera's place in the configuration.
    pub index: usize,
    /// The configuration.
    pub config: &'a Config,
    /// The node's clock.
    pub clock: Clock,
    /// The time line of recorded and simulated frames.
    pub playback: Playback,
    /// Ends every wait of the source.
    pub stop: Stop,
}

/// A running node.
pub struct Node {
    hub: Arc<Hub>,
    pushers: Arc<Vec<Pusher>>,
    stop: Stop,
    cameras: Vec<JoinHandle<Totals>>,
    forwarder: JoinHandle<()>,
    listeners: JoinSet<()>,
}

/// What became of a camera's frames.
#[derive(Clone, Debug)]
pub struct NodeReport {
    /// Its name.
    pub camera: String,
    /// Frames that were searched.
    pub frames: u64,
    /// What became of them.
    pub pushed: PushStatus,
}

impl Node {
    /// Starts cameras; the server may come later. To be called within a tokio runtime.
    pub fn start(config: &Config, server: &Client) -> Result<Self, ServeError> {
        Self::start_with_sources(config, server, |setting| {
            let camera = &setting.config.cameras[setting.index];
            let size = (camera.calibration.width(), camera.calibration.height());
            let NodeSetting { clock, playback, stop, .. } = setting;
            Box::new(SourceOpener::new(camera.address.clone(), size, clock, playback, stop))
        })
    }

    /// The same with frames of the caller's own, as [`super::Server::start_with_sources`].
    pub fn start_with_sources(
        config: &Config,
        server: &Client,
        mut source: impl FnMut(NodeSetting<'_>) -> Box<dyn OpenSource>,
    ) -> Result<Self, ServeError> {
        let fed = config.cameras.iter().find(|it| matches!(it.address, SourceAddress::Push(_)));
        if let Some(camera) = fed {
            return Err(ServeError::NodeIsFed { camera: camera.name.clone() });
        }
        let (clock, playback) = Playback::begin(config.cameras.iter().map(|c| &c.address))?;
        let hub = Arc::new(Hub::new(installation(config, clock.now())));
        let stop = Stop::default();
        let (to_server, from_workers) = sync_channel::<Sighted>(QUEUE_FRAMES);
        let (mut pushers, mut cameras, mut listeners) = (Vec::new(), Vec::new(), JoinSet::new());
        let troubles = Arc::new(Troubles(Mutex::new(vec![None; config.cameras.len()])));
        for (index, camera) in config.cameras.iter().enumerate() {
            let options = PushOptions::new(&camera.name)
                .sender(format!("node {}", config.name))
                .clock(move || clock.now().as_ns());
            let pusher = server.push(options).map_err(ServeError::Client)?;
            let inbox = Inbox::default();
            let listener = Listener {
                name: camera.name.clone(),
                index,
                size: (camera.calibration.width(), camera.calibration.height()),
                inbox: inbox.clone(),
                troubles: troubles.clone(),
            };
            listeners.spawn(listener.clone().follow(pusher.calibration()));
            listeners.spawn(listener.tell(pusher.statuses()));
            pushers.push(pusher);
            let setting = NodeSetting { index, config, clock, playback, stop: stop.clone() };
            let (id, before) = (CameraId(index as u32), Totals::default());
            let worker = Worker::new(WorkerParts {
                id,
                name: camera.name.clone(),
                opener: source(setting),
                pipeline: Pipeline::new(pipeline(camera, config, before.detection)?)?,
                // The server finds it; nothing is placed here.
                place: Place::Rides,
                calibration_version: 0,
                inbox,
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
            listeners.spawn(picture::show(hub.clone(), pushers.clone(), index));
        }
        let told = vec![String::new(); pushers.len()];
        let forwarder =
            Forwarder { hub: hub.clone(), pushers: pushers.clone(), troubles, from_workers, told };
        let forwarder = spawn("forwarder".to_owned(), move || forwarder.run())?;
        Ok(Self { hub, pushers, stop, cameras, forwarder, listeners })
    }

    /// How its cameras do.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    /// What became of each camera's frames so far.
    pub fn reports(&self) -> Vec<NodeReport> {
        let cameras = Self::searched(&self.hub).into_iter().zip(self.pushers.iter());
        let report = |((camera, frames), pusher): ((String, u64), &Pusher)| NodeReport {
            camera,
            frames,
            pushed: pusher.status(),
        };
        cameras.map(report).collect()
    }

    /// Every camera's name, and how many of its frames were searched.
    fn searched(hub: &Hub) -> Vec<(String, u64)> {
        let (installation, states) = (hub.installation(), hub.cameras());
        let name = |id: CameraId| installation.camera_name(id).to_owned();
        states.iter().map(|(id, state)| (name(*id), state.frames)).collect()
    }

    /// Ends cameras, sends what they saw last, and says what became of everything.
    pub async fn shutdown(mut self) -> Vec<NodeReport> {
        self.stop.stop();
        let deadline = Instant::now() + GRACE;
        for camera in self.cameras.drain(..) {
            join(camera, deadline).await;
        }
        // It ends when the last camera has.
        join(self.forwarder, deadline).await;
        self.listeners.shutdown().await;
        let mut reports = Vec::new();
        let Some(pushers) = Arc::into_inner(self.pushers) else { return reports };
        for (pusher, (camera, frames)) in pushers.into_iter().zip(Self::searched(&self.hub)) {
            let pushed = pusher.finish(LAST_WORDS).await;
            reports.push(NodeReport { camera, frames, pushed });
        }
        reports
    }
}

/// Why what a camera sees is not sent, by camera.
struct Troubles(Mutex<Vec<Option<String>>>);

impl Troubles {
    fn set(&self, index: usize, trouble: Option<String>) {
        let mut troubles = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(slot) = troubles.get_mut(index) {
            *slot = trouble;
        }
    }

    fn of(&self, index: usize) -> Option<String> {
        let troubles = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        troubles.get(index).cloned().flatten()
    }
}

/// Hands what workers saw to the pushers, and tells them of failures.
struct Forwarder {
    hub: Arc<Hub>,
    pushers: Arc<Vec<Pusher>>,
    troubles: Arc<Troubles>,
    from_workers: Receiver<Sighted>,
    /// What the pushers were told last, by camera; what they are given to send takes it back.
    told: Vec<String>,
}

impl Forwarder {
    /// Until the last worker has ended.
    fn run(mut self) {
        let mut look = Instant::now();
        loop {
            match self.from_workers.recv_timeout(LOOK_EVERY) {
                Ok(sighted) => self.forward(&sighted),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if look.elapsed() >= LOOK_EVERY {
                look = Instant::now();
                self.tell_troubles();
            }
        }
    }

    fn forward(&mut self, sighted: &Sighted) {
        let seen = &sighted.observations;
        let index = seen.camera.0 as usize;
        let (Some(pusher), Some(state)) = (self.pushers.get(index), self.hub.camera(seen.camera))
        else {
            return;
        };
        if self.troubles.of(index).is_none() {
            pusher.observations(pushed_observations(&self.hub.installation(), seen, &state));
            self.told[index].clear();
        }
    }

    fn tell_troubles(&mut self) {
        // What a camera saw before it failed is told before: it is in the queue by the time that this is known.
        let states = self.hub.cameras();
        while let Ok(sighted) = self.from_workers.try_recv() {
            self.forward(&sighted);
        }
        for (index, state) in states.into_values().enumerate() {
            let trouble = match (self.troubles.of(index), state.status) {
                (Some(trouble), _) => trouble,
                (None, CameraStatus::Failed) => state.error,
                (None, CameraStatus::Finished) => "its source has no more frames".to_owned(),
                (None, CameraStatus::Starting | CameraStatus::Running) => continue,
            };
            if self.told[index] != trouble {
                self.pushers[index].trouble(&trouble);
                self.told[index] = trouble;
            }
        }
    }
}

/// Follows what the server says of one camera.
#[derive(Clone)]
struct Listener {
    name: String,
    index: usize,
    /// Of the source's pictures.
    size: (usize, usize),
    inbox: Inbox,
    troubles: Arc<Troubles>,
}

type Calibrations = tokio::sync::watch::Receiver<Option<v1::PushedCalibration>>;

impl Listener {
    /// Takes lenses over.
    async fn follow(self, mut calibrations: Calibrations) {
        while calibrations.changed().await.is_ok() {
            let Some(told) = calibrations.borrow_and_update().clone() else { continue };
            let trouble = self.take_over(&told).err();
            if let Some(trouble) = &trouble {
                tracing::warn!(camera = self.name, "{trouble}");
            }
            self.troubles.set(self.index, trouble);
        }
    }

    fn take_over(&self, told: &v1::PushedCalibration) -> Result<(), String> {
        let size = (told.width as usize, told.height as usize);
        if size != self.size {
            return Err(format!(
                "the server's calibration of this camera is for {} x {} pixels, the node's pictures have {} x {}: \
                 give both the same camera file",
                size.0, size.1, self.size.0, self.size.1
            ));
        }
        let Some(lens) = told_camera(told) else {
            return Err(
                "the server's calibration of this camera is none that this node knows: both should be of one \
                 version"
                    .to_owned(),
            );
        };
        // Where it stands, nobody asks here.
        self.inbox.put(Adoption { lens, place: Place::Kept, version: told.version });
        tracing::info!(
            camera = self.name,
            version = told.version,
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

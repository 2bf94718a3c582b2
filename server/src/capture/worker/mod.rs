//! One camera's worker: newest frame → detections → observations, on a thread of its own.
//!
//! | module | what it does |
//! | --- | --- |
//! | `supervisor` | runs the worker again after a failure, with backoff |
//! | `helpers` | threads that fit a part of a frame's rings |
//! | [`pipeline`] | pixels → detections with poses and times |
//! | `remote` | what was seen elsewhere, and only passes through |
//! | `place`, `placing` | where the camera stands, and what finds that where it is unknown |
//! | [`adoption`] | a new lens and place, taken over between two frames |
//! | `pace` | whether the camera gives as many frames as was promised |
//! | [`meter`] | rates and medians over the newest frames |
//!
//! Nothing here waits for anybody but the source: the hub's publishing never blocks, and what
//! fusion has no room for is dropped and counted.

pub mod adoption;
mod helpers;
pub mod meter;
mod pace;
pub mod pipeline;
mod place;
mod placing;
mod remote;
mod supervisor;

use std::{
    sync::{
        Arc,
        mpsc::{SyncSender, TrySendError},
    },
    time::Instant,
};

use roundel_core::{
    id::CameraId,
    time::Timestamp,
    world::{CameraPlacement, FrameObservations},
};

pub use place::Place;
pub use supervisor::run;

use crate::{
    capture::source::{Arrival, LentFrame, OpenSource, SourceError},
    model::{
        clock::Clock,
        hub::{CameraPlace, CameraStatus, DetectionCounts, Happening, Hub, Picture, PoseStatus},
        tap::RawFrame,
    },
};
use adoption::{Adoption, Inbox};
use meter::{Median, Rate};
use pace::{Pace, Told};
use pipeline::{Pipeline, Seen};
use placing::{Placing, Progress};

/// What workers hand to fusion.
#[derive(Clone, Debug)]
pub struct Sighted {
    /// What was seen in one frame.
    pub observations: Arc<FrameObservations>,
    /// The camera's place from this frame on, where it is new.
    pub placement: Option<CameraPlacement>,
}

/// What a worker has counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Totals {
    /// Frames processed, which their numbers go on from.
    pub frames: u64,
    /// Frames that gave way to newer ones.
    pub dropped: u64,
    /// Frames that arrived broken.
    pub broken: u64,
    /// What became of rings and candidates.
    pub detection: DetectionCounts,
}

/// What a worker is made of.
pub struct WorkerParts {
    /// Which camera.
    pub id: CameraId,
    /// Its name, for messages.
    pub name: String,
    /// Where its frames come from.
    pub opener: Box<dyn OpenSource>,
    /// What is done with them.
    pub pipeline: Pipeline,
    /// Where it stands.
    pub place: Place,
    /// Of the calibration that `place` and the pipeline's lens are of; 0: of the configuration.
    pub calibration_version: u64,
    /// Where news of both arrive.
    pub inbox: Inbox,
    /// Where the results go.
    pub hub: Arc<Hub>,
    /// To fusion; when it is full, the observations are dropped and counted.
    pub fusion: SyncSender<Sighted>,
    /// The server's clock.
    pub clock: Clock,
    /// Frames a second that the camera is to give, as a person has said; `None`: as its driver says.
    pub promised_hz: Option<f64>,
    /// What the camera's worker before this one has counted.
    pub before: Totals,
}

/// One camera's worker.
pub struct Worker {
    parts: WorkerParts,
    placing: Option<Placing>,
    /// Found and not yet taken by fusion.
    placement: Option<CameraPlacement>,
    frames: u64,
    dropped: u64,
    rate: Rate,
    pace: Pace,
    detect_ms: Median,
    find_ms: Median,
    locate_ms: Median,
    blur_px: Median,
    noise: Median,
    decode_ms: Median,
    broken: u64,
    /// Since when frames arrive.
    running_since: Option<Instant>,
    /// Whether any have arrived before.
    has_run: bool,
}

/// Why a worker stopped taking frames.
#[derive(Clone, Debug, PartialEq, Eq)]
enum End {
    Stopped,
    Finished,
    Failed(String),
}

impl Worker {
    /// A worker that has not begun.
    pub fn new(parts: WorkerParts) -> Self {
        let placing = parts.place.search();
        let (place, camera) = (parts.place.shown(), parts.pipeline.camera().clone());
        parts.hub.update_camera(parts.id, |state| {
            place.into_iter().for_each(|place| state.place = place);
            state.camera = Some(camera);
            state.calibration_version = parts.calibration_version;
            // Of one before it that is nobody's news any more.
            state.status = CameraStatus::Starting;
            state.error.clear();
            state.rate_reason.clear();
            (state.rate_hz, state.promised_hz, state.detections) = (0.0, 0.0, 0);
        });
        let Totals { frames, dropped, broken, .. } = parts.before;
        Self {
            parts,
            placing,
            placement: None,
            frames,
            dropped,
            rate: Rate::default(),
            pace: Pace::default(),
            detect_ms: Median::default(),
            find_ms: Median::default(),
            locate_ms: Median::default(),
            blur_px: Median::default(),
            noise: Median::default(),
            decode_ms: Median::default(),
            broken,
            running_since: None,
            has_run: false,
        }
    }

    fn totals(&self) -> Totals {
        let Self { frames, dropped, broken, .. } = *self;
        Totals { frames, dropped, broken, detection: *self.parts.pipeline.counts() }
    }

    /// Opens the source and works until it ends.
    fn play(&mut self) -> End {
        self.running_since = None;
        self.rate = Rate::default();
        self.parts.pipeline.reset();
        let mut source = match self.parts.opener.open() {
            Ok(source) => source,
            Err(error) => return end(error),
        };
        self.pace.restart(None);
        let mut is_first = true;
        loop {
            match source.next() {
                Ok(Arrival::Frame(lent)) => self.take(&lent),
                Ok(Arrival::Seen(sighting)) => self.take_seen(*sighting),
                Err(error) => return end(error),
            }
            if std::mem::take(&mut is_first) {
                self.hold_to_promise(source.promised_hz());
            }
        }
    }

    /// Who set the camera up knows best.
    fn hold_to_promise(&mut self, of_source_hz: Option<f64>) {
        let promised_hz = self.parts.promised_hz.or(of_source_hz);
        self.pace.restart(promised_hz);
        self.parts.hub.update_camera(self.parts.id, |state| {
            state.promised_hz = promised_hz.unwrap_or(0.0);
        });
    }

    /// Counts what no frame has told of, since no frame may come any more.
    fn count_skipped(&mut self) {
        let skipped = self.parts.opener.take_skipped();
        if skipped > 0 {
            self.dropped += skipped;
            self.parts.hub.update_camera(self.parts.id, |state| state.dropped += skipped);
        }
    }

    fn take(&mut self, lent: &LentFrame<'_>) {
        let info = &lent.info;
        let received = self.parts.clock.now();
        if let Some(adoption) = self.parts.inbox.take() {
            self.adopt(adoption);
        }
        self.frames += 1;
        self.dropped += info.skipped;
        self.broken += info.broken;
        self.decode_ms.add(info.decoding.as_secs_f64() * 1e3);
        let begun = Instant::now();
        let by = Seen {
            camera: self.parts.id,
            calibration_version: self.parts.calibration_version,
            frame: self.frames,
            capture_time: info.capture_time,
            received_time: received,
        };
        let observations = Arc::new(self.parts.pipeline.process(&lent.frame, &by));
        if self.running_since.is_none() {
            self.running_since = Some(begun);
            self.report_running((lent.frame.width(), lent.frame.height()), received);
        }
        self.find_place(&observations, received);
        self.hand_to_fusion(observations.clone());
        // Nobody waits for what follows.
        self.parts.pipeline.seek(&lent.frame);
        self.detect_ms.add(begun.elapsed().as_secs_f64() * 1e3);
        let times = self.parts.pipeline.times();
        self.find_ms.add(times.find_ms);
        self.locate_ms.add(times.locate_ms);
        if let Some(quality) = self.parts.pipeline.image_quality() {
            self.blur_px.add(quality.blur_px);
            self.noise.add(quality.noise);
        }
        self.rate.add(received);
        self.judge_pace(received, 1 + info.skipped + info.broken);
        self.publish(lent, observations);
    }

    /// From this frame on. Fusion hears of the place with what is seen in it.
    fn adopt(&mut self, Adoption { lens, place, version }: Adoption) {
        match &place {
            Place::Kept => {}
            Place::Standing(_, placement) => {
                (self.placing, self.placement) = (None, Some(**placement));
            }
            Place::Unknown { .. } | Place::Rides => {
                (self.placing, self.placement) = (place.search(), None);
            }
        }
        self.parts.calibration_version = version;
        self.parts.pipeline.set_camera(&lens);
        self.parts.hub.update_camera(self.parts.id, |state| {
            place.shown().into_iter().for_each(|place| state.place = place);
            state.camera = Some(lens);
            state.calibration_version = version;
        });
    }

    fn report_running(&mut self, (width, height): (usize, usize), now: Timestamp) {
        let (id, name) = (self.parts.id, &self.parts.name);
        tracing::info!(camera = name, width, height, "frames arrive");
        // Nobody opens one that is fed: what counts is that it has come back.
        let came_back = self.has_run && self.parts.opener.is_fed();
        self.has_run = true;
        self.parts.hub.update_camera(id, |state| {
            state.status = CameraStatus::Running;
            state.error.clear();
            (state.width, state.height) = (width, height);
            state.restarts += u64::from(came_back);
        });
        let happening = Happening::Camera(id, CameraStatus::Running);
        self.parts.hub.publish_event(now, happening, format!("Camera {name} is running."));
    }

    /// So many frames have come; tells where that is another number than was promised.
    fn judge_pace(&mut self, now: Timestamp, frames: u64) {
        let Some(told) = self.pace.add(now, frames) else { return };
        let (id, name) = (self.parts.id, &self.parts.name);
        let (happening, reason, message) = match told {
            Told::Off { found_hz, promised_hz } => {
                let reason = pace::sentence(found_hz, promised_hz);
                let message = format!("Camera {name} {reason}.");
                tracing::warn!("{message}");
                (Happening::RateOff(id), reason, message)
            }
            Told::Agrees => {
                let message = format!("Camera {name} gives as many frames as was promised again.");
                tracing::info!("{message}");
                (Happening::RateAgrees(id), String::new(), message)
            }
        };
        self.parts.hub.update_camera(id, |state| state.rate_reason = reason);
        self.parts.hub.publish_event(now, happening, message);
    }

    fn find_place(&mut self, observations: &FrameObservations, now: Timestamp) {
        let Some(placing) = &mut self.placing else { return };
        let (id, name, hub) = (self.parts.id, &self.parts.name, &self.parts.hub);
        match placing.observe(observations) {
            Progress::Waiting => {}
            Progress::Failed(reason) => {
                hub.update_camera(id, |state| state.place = CameraPlace::searching(reason));
            }
            Progress::Found { placement, references, rms_m } => {
                self.placing = None;
                self.placement = Some(*placement);
                let place = CameraPlace::standing(PoseStatus::Found, *placement);
                hub.update_camera(id, |state| state.place = place);
                let millimetres = rms_m * 1e3;
                let message = format!(
                    "Camera {name} found its place from {references} references, which fit to \
                     {millimetres:.1} mm."
                );
                tracing::info!(camera = name, "{message}");
                hub.publish_event(now, Happening::Placed(id), message);
            }
        }
    }

    fn hand_to_fusion(&mut self, observations: Arc<FrameObservations>) {
        let sighted = Sighted { observations, placement: self.placement };
        match self.parts.fusion.try_send(sighted) {
            Ok(()) => self.placement = None,
            // Fusion gone means shutdown, which the source's next wait notices.
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => self.dropped += 1,
        }
    }

    fn publish(&mut self, lent: &LentFrame<'_>, observations: Arc<FrameObservations>) {
        let (id, hub) = (self.parts.id, &self.parts.hub);
        let (width, height) = (lent.frame.width(), lent.frame.height());
        let copied = || (0..height).flat_map(|v| lent.frame.row(v)).copied().collect();
        if hub.tap().wants_frame(observations.frame) {
            let FrameObservations { frame: number, capture_time, received_time, .. } =
                *observations;
            let (pixels, size) = (copied(), (width, height));
            let camera = id;
            hub.tap().offer_frame(RawFrame {
                camera,
                number,
                capture_time,
                received_time,
                size,
                pixels,
            });
        }
        if hub.take_picture_request(id) {
            let pixels = copied();
            let picture = Picture::new((width, height), pixels, observations.clone());
            hub.publish_picture(id, picture);
        }
        hub.update_camera(id, |state| {
            state.frames = self.frames;
            state.dropped = self.dropped;
            state.broken = self.broken;
            state.capture_clock = Some(lent.info.clock);
            state.decode_ms = self.decode_ms.value();
            state.rate_hz = self.rate.hz();
            state.detections = observations.detections.len();
            state.detect_ms = self.detect_ms.value();
            state.find_ms = self.find_ms.value();
            state.locate_ms = self.locate_ms.value();
            (state.blur_px, state.noise) = (self.blur_px.value(), self.noise.value());
            state.counts = *self.parts.pipeline.counts();
        });
        hub.publish_observations(observations);
    }
}

fn end(error: SourceError) -> End {
    match error {
        SourceError::Stopped => End::Stopped,
        SourceError::Finished => End::Finished,
        SourceError::Failed(message) => End::Failed(message),
        error @ SourceError::Size { .. } => End::Failed(error.to_string()),
    }
}

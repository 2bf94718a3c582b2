//! The fusion thread: the one owner of all tracks. Takes what workers saw, drives the pure machine
//! of `core::world`, and publishes snapshots at steady ticks, or sooner where there is news.

mod order;
mod rhythm;
mod riding;
mod watching;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    time::Instant,
};

use roundel_core::{
    id::{BodyId, CameraId, KindId, ObjectId},
    marker::Code,
    time::Timestamp,
    world::{Event, EventKind, Fusion, Snapshot, WrongHeight},
};

use crate::{
    clock::Clock,
    hub::{Happening, Hub, Installation},
    record::tap::{Change, Item, Told},
    stop::Stop,
    worker::{Sighted, meter::Median},
};
pub use order::{FusionLimits, Known, ObjectOrder, Order, Stand, Timekeeping};
pub use rhythm::Rhythm;
use riding::Riding;
use watching::Watching;
pub use watching::WatchingParts;

/// Frames from all cameras that may wait for fusion; full: the newest is dropped and counted.
pub const QUEUE_FRAMES: usize = 256;

/// Drives fusion until the signal comes.
pub struct FusionTask {
    fusion: Fusion,
    hub: Arc<Hub>,
    clock: Clock,
    received: Receiver<Sighted>,
    orders: Receiver<Order>,
    /// Those of which frames are used.
    cameras: BTreeSet<CameraId>,
    latency_ms: BTreeMap<CameraId, Median>,
    /// What the newest snapshot says of each object, for messages about it.
    known: BTreeMap<ObjectId, Subject>,
    riding: Riding,
    watching: Option<Watching>,
}

/// Kind, body and code of an object.
type Subject = (Option<KindId>, Option<BodyId>, Option<Code>);

impl FusionTask {
    /// A task with a fusion machine that knows objects and landmarks. What it is to know of the installation's cameras
    /// comes by [`FusionTask::taking_orders`], unless it was told already.
    pub fn new(fusion: Fusion, hub: Arc<Hub>, clock: Clock, received: Receiver<Sighted>) -> Self {
        let cameras = hub.installation().cameras.keys().copied().collect();
        Self {
            fusion,
            hub,
            clock,
            received,
            // Nobody sends any.
            orders: channel().1,
            cameras,
            latency_ms: BTreeMap::new(),
            known: BTreeMap::new(),
            riding: Riding::default(),
            watching: None,
        }
    }

    /// The same, which notices cameras that no longer stand where they did.
    pub fn watching(self, parts: WatchingParts) -> Self {
        Self { watching: Some(Watching::new(parts)), ..self }
    }

    /// The same, which hears of cameras that come, change and go.
    pub fn taking_orders(self) -> (Self, Sender<Order>) {
        let (sender, orders) = channel();
        (Self { orders, ..self }, sender)
    }

    /// Publishes snapshots in this rhythm until the signal comes, and a last one then.
    pub fn run(mut self, mut rhythm: Rhythm, stop: &Stop) {
        while !stop.is_stopped() {
            self.take(&rhythm, stop);
            let begun = Instant::now();
            self.publish(self.clock.at(rhythm.pose_time(begun)), None);
            rhythm.publish(begun, Instant::now());
        }
        while let Ok(sighted) = self.received.try_recv() {
            self.observe(&sighted);
        }
        self.obey();
        self.publish(self.clock.now(), None);
    }

    /// Takes frames until a snapshot is due; what waits already belongs to that as well.
    fn take(&mut self, rhythm: &Rhythm, stop: &Stop) {
        let mut has_news = false;
        loop {
            self.obey();
            let now = Instant::now();
            if now >= rhythm.tick() {
                return;
            }
            let rest = rhythm.due(has_news).saturating_duration_since(now);
            match self.received.recv_timeout(rest) {
                Ok(sighted) => {
                    self.observe(&sighted);
                    has_news = true;
                }
                Err(RecvTimeoutError::Timeout) => return,
                // All cameras have finished; tracks still grow old and are lost.
                Err(RecvTimeoutError::Disconnected) => {
                    stop.wait(rest);
                    return;
                }
            }
        }
    }

    /// Takes in what was seen in a frame.
    pub fn observe(&mut self, sighted: &Sighted) {
        let camera = sighted.observations.camera;
        // What it was told of came before the frame that was taken with it.
        self.obey();
        if !self.cameras.contains(&camera) {
            return;
        }
        if let Some(placement) = sighted.placement {
            self.be_told(Told { camera, change: Change::Placed(Box::new(placement)) });
        }
        let (hub, taken) = (&self.hub, self.clock.now());
        hub.tap().offer(|| Item::Observed(sighted.observations.clone(), taken));
        let steps = self.fusion.counts().clock_steps;
        self.fusion.observe(&sighted.observations);
        if self.fusion.counts().clock_steps > steps {
            self.tell_clock_set(camera, sighted.observations.received_time);
        }
        if let Some(watching) = &mut self.watching {
            watching.observe(&sighted.observations, &self.fusion);
        }
        let latency_s = taken.seconds_since(sighted.observations.capture_time);
        let median = self.latency_ms.entry(camera).or_default();
        median.add(latency_s * 1e3);
        let latency_ms = median.value();
        let clock = self.fusion.clock(camera);
        self.hub.update_camera(camera, |state| {
            state.latency_ms = latency_ms;
            state.clock = clock;
        });
    }

    fn tell_clock_set(&self, camera: CameraId, time: Timestamp) {
        let installation = self.hub.installation();
        let name = installation.camera_name(camera);
        let message = format!(
            "The clock of camera {name} was set, or counts from another epoch: its times are brought to \
             the server's, and what is left of the difference is found from what it sees."
        );
        tracing::warn!(camera = name, "{message}");
        self.hub.publish_event(time, Happening::ClockSet(camera), message);
    }

    /// Publishes a snapshot of an instant, fused then, or now.
    pub fn publish(&mut self, pose_time: Timestamp, fused_time: Option<Timestamp>) {
        let snapshot = self.fusion.snapshot(pose_time);
        let gives_frames = |camera| self.latency_ms.contains_key(&camera);
        self.riding.publish(&mut self.fusion, &self.hub, pose_time, gives_frames);
        self.hub.set_fusion_counts(self.fusion.counts());
        self.remember(&snapshot);
        self.hub.publish_snapshot(snapshot, fused_time.unwrap_or_else(|| self.clock.now()));
        // After the snapshot, as whoever fuses a recording anew does it.
        if let Some(watching) = &mut self.watching {
            watching.advance(self.clock.now(), &mut self.fusion, &self.hub);
        } else {
            // Nobody judges who is held back.
            self.fusion.drain_held_back().for_each(drop);
        }
        let events: Vec<Event> = self.fusion.drain_events().collect();
        for wrong in self.fusion.drain_wrong_heights() {
            let message = height_sentence(&self.hub.installation(), &wrong);
            tracing::warn!("{message}");
            self.hub.publish_event(pose_time, Happening::WrongHeight, message);
        }
        for event in events {
            let message = self.sentence(&event);
            let happening = Happening::Object(event.object, event.kind);
            self.hub.publish_event(event.time, happening, message);
        }
    }

    fn remember(&mut self, snapshot: &Snapshot) {
        self.known.clear();
        let each = snapshot.objects.iter();
        self.known.extend(each.map(|object| (object.id, (object.kind, object.body, object.code))));
    }

    fn sentence(&self, event: &Event) -> String {
        let (kind, body, code) = self.known.get(&event.object).copied().unwrap_or_default();
        let installation = self.hub.installation();
        let name = match (installation.object_name(kind, body), code) {
            ("", None) => format!("Object {}", event.object),
            ("", Some(code)) => format!("Object {} (code {})", event.object, code.number),
            (name, _) => format!("Object {} ({name})", event.object),
        };
        match event.kind {
            EventKind::Appeared => format!("{name} has appeared."),
            EventKind::Predicted => {
                format!("{name} is not seen by any camera; its pose is predicted.")
            }
            EventKind::Recovered => format!("{name} is seen again."),
            EventKind::Lost => format!("{name} is lost."),
        }
    }
}

fn height_sentence(installation: &Installation, wrong: &WrongHeight) -> String {
    let what = match wrong.body {
        Some(_) => format!("\"{}\"", installation.object_name(wrong.kind, wrong.body)),
        None => format!("Roundels \"{}\"", installation.kind_name(wrong.kind)),
    };
    let cameras: Vec<&str> = wrong.cameras.iter().map(|&id| installation.camera_name(id)).collect();
    format!(
        "{what}: seen at a height of {:.2} m by {}, and `height_m` says {:.2}. Correct it, or the diameters \
         or the cameras' poses; until then places are wrong, and objects may appear that are not there.",
        wrong.seen_m,
        cameras.join(", "),
        wrong.said_m
    )
}

#[cfg(test)]
mod tests {
    use std::{sync::mpsc::sync_channel, time::Duration};

    use nalgebra::Vector3;
    use roundel_core::{
        camera::PixelPoint,
        ellipse::Ellipse,
        id::TrackNumber,
        marker::Ring,
        pose::{Detection, RoundelPose},
        rigid::{Covariance6, Rigid},
        world::{CameraPlacement, FrameObservations, FusionParams, MotionClass},
    };

    use super::*;
    use crate::hub::{CameraInfo, EVENTS_KEPT};

    fn hub(clock: &Clock) -> Arc<Hub> {
        Arc::new(Hub::new(Installation {
            name: "lab".into(),
            source_id: "s".into(),
            started: clock.now(),
            snapshot_rate_hz: 100.0,
            cameras: Installation::numbered([CameraInfo {
                name: "north".into(),
                ..CameraInfo::default()
            }]),
            kinds: vec!["robot".into()],
            object_names: BTreeMap::from([(KindId(0), "robot one".into())]),
            body_names: vec!["carrier".into()],
        }))
    }

    fn sighted(frame: u64, capture_time: Timestamp) -> Sighted {
        let rim = Ellipse {
            center: PixelPoint { u: 320.0, v: 240.0 },
            semi_major_px: 20.0,
            semi_minor_px: 20.0,
            angle_rad: 0.0,
        };
        let pose = RoundelPose {
            position_m: Vector3::new(0.0, 0.0, 3.0),
            normal: -Vector3::z(),
            normal_likelihood: 1.0,
            other_normal: -Vector3::z(),
            yaw_rad: None,
            yaw_symmetry: 1,
            covariance: Covariance6::identity() * 1e-4,
        };
        let detection = Detection {
            track: TrackNumber(1),
            ring: Ring { kind: Some(KindId(0)), ..Ring::of_rims(rim, rim) },
            capture_time,
            pose: Some(pose),
        };
        let observations = FrameObservations {
            camera: CameraId(0),
            frame,
            capture_time,
            received_time: capture_time,
            calibration_version: 1,
            detections: vec![detection],
        };
        Sighted { observations: Arc::new(observations), placement: None }
    }

    #[test]
    fn what_was_sent_before_the_end_is_fused_and_told() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let (sender, receiver) = sync_channel(QUEUE_FRAMES);
        let placement = CameraPlacement {
            world_from_camera: Rigid::translation(1.0, 0.0, 0.0),
            covariance: Covariance6::zeros(),
        };
        for frame in 1..=10 {
            // The camera's place comes with its first frame, as from a worker that has found it.
            let placement = (frame == 1).then_some(placement);
            let seen = sighted(frame, clock.now().plus_seconds((frame as f64 - 10.0) * 0.01));
            sender.send(Sighted { placement, ..seen }).unwrap();
        }
        drop(sender);
        let task =
            FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
        let stop = Stop::default();
        stop.stop();
        task.run(Rhythm::new(Duration::from_millis(10), false), &stop);

        let newest = hub.snapshots().borrow().clone();
        assert_eq!(newest.sequence, 1, "the last one");
        let object = &newest.snapshot.objects[0];
        assert!((object.position_m - Vector3::new(1.0, 0.0, 3.0)).norm() < 0.01, "{object:?}");
        let (events, _) = hub.events(10);
        let messages: Vec<&str> = events.iter().map(|event| event.message.as_str()).collect();
        assert_eq!(messages, [format!("Object {} (robot one) has appeared.", object.id)]);
        assert!(hub.cameras()[&CameraId(0)].latency_ms >= 0.0);
    }

    #[test]
    fn a_clock_that_was_set_is_told() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let (sender, receiver) = sync_channel(QUEUE_FRAMES);
        for frame in 1..=30 {
            let received_time = clock.now().plus_seconds(frame as f64 * 0.03);
            let set_s = if frame > 10 { 3600.0 } else { 0.0 };
            let mut seen = sighted(frame, received_time.plus_seconds(set_s));
            Arc::get_mut(&mut seen.observations).unwrap().received_time = received_time;
            sender.send(seen).unwrap();
        }
        drop(sender);
        let task =
            FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
        let stop = Stop::default();
        stop.stop();
        task.run(Rhythm::new(Duration::from_millis(10), false), &stop);
        let (events, _) = hub.events(10);
        let told: Vec<_> = events.iter().map(|event| event.happening).collect();
        assert_eq!(told, [Happening::ClockSet(CameraId(0))]);
        assert!(events[0].message.contains("camera north was set"), "{}", events[0].message);
        assert!(hub.cameras()[&CameraId(0)].clock.is_some());
    }

    #[test]
    fn a_height_that_cameras_contradict_is_told() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let (sender, receiver) = sync_channel(QUEUE_FRAMES);
        for frame in 1..=200 {
            sender.send(sighted(frame, clock.now().plus_seconds(frame as f64 * 0.11))).unwrap();
        }
        drop(sender);
        let mut fusion = Fusion::new(FusionParams::default());
        let world_from_camera = Rigid::identity();
        let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
        fusion.set_camera(CameraId(0), Some(placement));
        fusion.set_motion(KindId(0), MotionClass::Ground { height_m: Some(2.5) });
        let task = FusionTask::new(fusion, hub.clone(), clock, receiver);
        let stop = Stop::default();
        stop.stop();
        task.run(Rhythm::new(Duration::from_millis(10), false), &stop);
        let (events, _) = hub.events(EVENTS_KEPT);
        let told: Vec<&str> = events
            .iter()
            .filter(|event| event.happening == Happening::WrongHeight)
            .map(|event| event.message.as_str())
            .collect();
        let expected =
            "Roundels \"robot\": seen at a height of 3.00 m by north, and `height_m` says 2.50.";
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].starts_with(expected), "{told:?}");
        // Of an object that is known by several roundels, by its name.
        let wrong = WrongHeight {
            kind: Some(KindId(0)),
            body: Some(BodyId(0)),
            said_m: 0.0,
            seen_m: 0.2,
            cameras: vec![CameraId(0)],
        };
        let sentence = height_sentence(&hub.installation(), &wrong);
        assert!(sentence.starts_with("\"carrier\": seen at a height of 0.20 m"), "{sentence}");
    }

    #[test]
    fn who_has_no_name_is_told_by_its_code() {
        let clock = Clock::anchored_now();
        let hub = Arc::new(Hub::new(Installation {
            object_names: BTreeMap::new(),
            ..Installation::clone(&hub(&clock).installation())
        }));
        let (_, receiver) = sync_channel(1);
        let fusion = Fusion::new(FusionParams::default());
        let mut task = FusionTask::new(fusion, hub, clock, receiver);
        let (object, time) = (ObjectId(3), clock.now());
        let event = Event { time, object, kind: EventKind::Lost };
        assert_eq!(task.sentence(&event), "Object 3 is lost.");
        let code = Code { bits: 8, number: 12 };
        task.known.insert(object, (Some(KindId(0)), None, Some(code)));
        assert_eq!(task.sentence(&event), "Object 3 (code 12) is lost.");
        task.known.insert(object, (Some(KindId(0)), Some(BodyId(0)), Some(code)));
        assert_eq!(task.sentence(&event), "Object 3 (carrier) is lost.");
    }

    #[test]
    fn a_prompt_one_tells_of_a_frame_long_before_the_tick() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let (sender, receiver) = sync_channel(QUEUE_FRAMES);
        let task =
            FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
        let stop = Stop::default();
        let running = std::thread::spawn({
            let stop = stop.clone();
            move || task.run(Rhythm::new(Duration::from_secs(3600), true), &stop)
        });
        for frame in 1..=3 {
            let sequence = hub.snapshots().borrow().sequence;
            sender.send(sighted(frame, clock.now())).unwrap();
            while hub.snapshots().borrow().sequence == sequence {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        stop.stop();
        // Ends the wait for the tick.
        drop(sender);
        running.join().unwrap();
    }

    #[test]
    fn ticks_go_on_when_no_camera_is_left() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let (_, receiver) = sync_channel(1);
        let task =
            FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
        let stop = Stop::default();
        let ticking = std::thread::spawn({
            let stop = stop.clone();
            move || task.run(Rhythm::new(Duration::from_millis(2), false), &stop)
        });
        while hub.snapshots().borrow().sequence < 3 {
            std::thread::sleep(Duration::from_millis(1));
        }
        stop.stop();
        ticking.join().unwrap();
    }
}

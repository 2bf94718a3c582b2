//! Feeds recorded messages to the hub: as recorded, fused again, or detected and fused again.
//!
//! When fusing again, the engine passes every input of fusion (observations, camera updates, times of snapshots) in the
//! recorded order and with the recorded times to the code that fuses live. The result is therefore reproducible bit by bit.
//! With the recorded settings it equals the live result, except for the influence of observations before the recording.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, mpsc::sync_channel},
};

use prost::Message;
use roundel_core::{
    id::{BodyId, CameraId},
    time::Timestamp,
    world::{self, FrameObservations},
};
use roundel_proto::v1;

use super::{
    ReplayError, ReplayFrom,
    reader::{FusionUpdate, Reader},
};
use crate::{
    archive::{
        record::{
            file_reader::{Channel, RecordedMessage},
            schema::{CompressedImage, Topic},
        },
        replay::from_recording,
    },
    capture::{
        image_file::{self, GreyImage},
        worker::{
            WorkerOutput,
            pipeline::{FrameHeader, Pipeline},
        },
    },
    fusion::{
        FusionTask,
        camera_manager::{self, bodies::BodyTable},
        setup::{fusion_machine, fusion_params},
    },
    model::{
        clock::Clock,
        command::{AppliedConfig, FusionSettings},
        config::{Config, Lenses, ObjectConfig},
        convert,
        hub::{EventKind, Hub, Picture},
    },
};

/// Observations of a camera that are cached until their picture arrives.
const OBSERVATION_CACHE_LEN: usize = 64;

/// Settings for fusing again.
pub struct EngineSettings {
    /// At the start of the recording.
    pub config: Config,
    pub lenses: Lenses,
    /// Whether the configuration is the recorded one and changes as recorded.
    pub is_recorded: bool,
}

/// The only field of a recorded snapshot that is needed when fusing again.
#[derive(Clone, PartialEq, Message)]
struct PoseTime {
    /// As in `roundel.v1.Snapshot`.
    #[prost(int64, tag = "3")]
    pose_time_ns: i64,
}

pub struct Engine {
    hub: Arc<Hub>,
    clock: Clock,
    from: ReplayFrom,
    settings: Option<EngineSettings>,
    ids: BTreeMap<String, CameraId>,
    task: Option<FusionTask>,
    /// Current objects, as fusion has them.
    objects: Vec<ObjectConfig>,
    bodies: BodyTable,
    pipelines: BTreeMap<CameraId, Pipeline>,
    recent: BTreeMap<CameraId, VecDeque<Arc<FrameObservations>>>,
    invalid_messages: u64,
}

impl Engine {
    /// `ids` are the cameras' ids in the recording.
    pub fn new(
        hub: Arc<Hub>,
        clock: Clock,
        from: ReplayFrom,
        settings: Option<EngineSettings>,
        ids: BTreeMap<String, CameraId>,
    ) -> Self {
        Self {
            hub,
            clock,
            from,
            settings,
            ids,
            task: None,
            objects: Vec::new(),
            bodies: BodyTable::default(),
            pipelines: BTreeMap::new(),
            recent: BTreeMap::new(),
            invalid_messages: 0,
        }
    }

    /// Whether it fuses again.
    pub fn fuses(&self) -> bool {
        self.task.is_some()
    }

    /// The configuration at the start; `None` when snapshots are played.
    pub(super) fn config(&self) -> Option<&Config> {
        self.settings.as_ref().map(|settings| &settings.config)
    }

    /// Makes fusion publish a snapshot of this time.
    pub(super) fn publish_at(&mut self, pose_time: Timestamp, now: Timestamp) {
        if let Some(task) = &mut self.task {
            task.publish(pose_time, Some(now));
        }
    }

    /// The current objects with their body ids.
    pub(super) fn objects(&self) -> impl Iterator<Item = (&ObjectConfig, Option<BodyId>)> {
        self.objects.iter().zip(self.bodies.numbers.iter().copied())
    }

    /// Number of messages skipped as invalid.
    pub fn invalid_messages(&self) -> u64 {
        self.invalid_messages
    }

    /// Restarts at the time `until`, after applying the updates that fusion received before it.
    pub fn restart(
        &mut self,
        updates: &[(Timestamp, FusionUpdate)],
        until: Timestamp,
    ) -> Result<(), ReplayError> {
        self.hub.clear_objects();
        self.pipelines.clear();
        self.recent.clear();
        if self.from == ReplayFrom::Snapshots {
            return Ok(());
        }
        let Some(EngineSettings { config, .. }) = &self.settings else { return Ok(()) };
        // The engine calls the task directly.
        let (_, unused) = sync_channel(0);
        let machine = fusion_machine(config)?;
        self.task = Some(FusionTask::new(machine, self.hub.clone(), self.clock, unused));
        self.objects.clone_from(&config.objects);
        self.bodies = BodyTable::of(&self.objects);
        self.name_objects();
        for (_, update) in updates.iter().take_while(|(time, _)| *time < until) {
            match update {
                FusionUpdate::Camera(message) => self.update_camera(message),
                FusionUpdate::Settings(message) => {
                    self.invalid_messages += u64::from(self.apply_configuration(message).is_none())
                }
            }
        }
        Ok(())
    }

    pub fn process(&mut self, raw: &RecordedMessage, reader: &mut Reader) {
        let done = match &raw.channel {
            Channel::Topic(Topic::Snapshots) => self.process_snapshot(raw),
            Channel::Topic(Topic::Observations) => self.process_observations(raw, reader),
            Channel::Topic(Topic::Events) => self.process_event(raw),
            Channel::Topic(Topic::Calibration) => {
                read::<v1::FusedCamera>(raw).map(|message| self.update_camera(&message))
            }
            Channel::Topic(Topic::Health) => self.process_camera_health(raw),
            Channel::Topic(Topic::Configuration) => read::<v1::RecordedConfiguration>(raw)
                .and_then(|message| self.apply_configuration(&message)),
            Channel::Foreign(_) => Some(()),
            Channel::Frame(camera) => self.process_frame(camera, raw),
        };
        self.invalid_messages += u64::from(done.is_none());
    }

    fn id(&mut self, name: &str) -> CameraId {
        if let Some(id) = self.ids.get(name) {
            return *id;
        }
        // Cameras of a recording that names the largest number share it.
        let next = self.ids.values().map(|id| id.0.saturating_add(1)).max().unwrap_or(0);
        self.ids.insert(name.to_owned(), CameraId(next));
        CameraId(next)
    }

    fn update_camera(&mut self, message: &v1::FusedCamera) {
        if !message.camera.is_empty() {
            self.ids.insert(message.camera.clone(), CameraId(message.number));
        }
        let mut message = message.clone();
        // Changes before the recording may have led to other body ids.
        let names = &self.bodies.names;
        if let Some(body) = names.iter().position(|name| *name == message.carrier)
            && message.carrier_body > 0
        {
            message.carrier_body = body as u32 + 1;
        }
        // A damaged recording may name a body that no configuration has.
        if message.carrier_body as usize > self.bodies.names.len() {
            message.carrier_body = 0;
        }
        if let (Some(task), Some(update)) = (&mut self.task, convert::read_fused_camera(&message)) {
            task.apply_camera_update(update);
        }
    }

    /// Applies a configuration that fusion applied when it was recorded.
    fn apply_configuration(&mut self, message: &v1::RecordedConfiguration) -> Option<()> {
        let (Some(task), Some(settings)) = (&mut self.task, &self.settings) else {
            return Some(());
        };
        if !message.fused || !settings.is_recorded {
            return Some(());
        }
        let config = Config::parse_recorded(&message.text, &settings.lenses).ok()?;
        let renamed = (!message.renamed_to.is_empty())
            .then_some((message.renamed_from.as_str(), message.renamed_to.as_str()));
        let update = self.bodies.update((&self.objects, &config.objects), renamed, &config.motions);
        let owned = |(before, after): (&str, &str)| (before.to_owned(), after.to_owned());
        let params = Some(fusion_params(&config));
        self.objects = config.objects;
        let applied = AppliedConfig { text: message.text.clone(), renamed: renamed.map(owned) };
        task.apply_settings(FusionSettings { params, objects: update, config: applied });
        self.name_objects();
        Some(())
    }

    fn name_objects(&self) {
        let kind_names = camera_manager::kind_names(&self.objects);
        self.hub.set_object_names(kind_names, self.bodies.names.clone());
    }

    fn process_snapshot(&mut self, raw: &RecordedMessage) -> Option<()> {
        match &mut self.task {
            Some(task) => {
                let PoseTime { pose_time_ns } = read(raw)?;
                task.publish(Timestamp::from_ns(pose_time_ns), Some(raw.log_time));
            }
            None => {
                let message = read::<v1::Snapshot>(raw)?;
                let snapshot = from_recording::read_snapshot(&self.hub, &message);
                self.hub.publish_snapshot(snapshot, Timestamp::from_ns(message.fused_time_ns));
            }
        }
        Some(())
    }

    fn process_observations(&mut self, raw: &RecordedMessage, reader: &mut Reader) -> Option<()> {
        let message = read::<v1::FrameObservations>(raw)?;
        let (name, number) = (message.camera.clone(), message.frame);
        let id = self.id(&name);
        let recorded = from_recording::read_observations(&self.hub, id, message).ok()?;
        let observations = if self.from == ReplayFrom::Frames {
            // Without a recorded frame there are no observations.
            let Some(frame) = reader.frame(&name, number as u32) else { return Some(()) };
            Arc::new(self.search(&name, &recorded, &frame)?)
        } else {
            Arc::new(recorded)
        };
        if let Some(task) = &mut self.task {
            task.observe(&WorkerOutput { observations: observations.clone(), placement: None });
        }
        let recent = self.recent.entry(id).or_default();
        recent.push_back(observations.clone());
        if recent.len() > OBSERVATION_CACHE_LEN {
            recent.pop_front();
        }
        self.hub.update_camera(id, |state| {
            (state.frames, state.detections) = (number, observations.detections.len());
        });
        self.hub.publish_observations(observations);
        Some(())
    }

    /// Searches a frame as a worker does, with the current settings.
    fn search(
        &mut self,
        name: &str,
        recorded: &FrameObservations,
        frame: &RecordedMessage,
    ) -> Option<FrameObservations> {
        let id = recorded.camera;
        let image = decoded(frame)?;
        if !self.pipelines.contains_key(&id) {
            let config = &self.settings.as_ref()?.config;
            let camera = config.cameras.iter().find(|camera| camera.name == name)?;
            let parts =
                camera_manager::setup::pipeline_parts(camera, config, Default::default()).ok()?;
            self.pipelines.insert(id, Pipeline::new(parts).ok()?);
        }
        let pipeline = self.pipelines.get_mut(&id)?;
        let header = FrameHeader {
            camera: id,
            calibration_version: recorded.calibration_version,
            frame: recorded.frame,
            capture_time: recorded.capture_time,
            received_time: recorded.received_time,
        };
        let view = image.frame().ok()?;
        let observations = pipeline.process(&view, &header);
        pipeline.seek(&view);
        if self.hub.take_picture_request(id) {
            self.publish_picture(id, image, Arc::new(observations.clone()));
        }
        Some(observations)
    }

    /// Publishes the frame if a client has requested a picture.
    fn process_frame(&mut self, camera: &str, raw: &RecordedMessage) -> Option<()> {
        let id = self.id(camera);
        if !self.hub.take_picture_request(id) {
            return Some(());
        }
        let image = decoded(raw)?;
        let mut recent = self.recent.get(&id).into_iter().flatten();
        let observations = recent.find(|recent| recent.frame as u32 == raw.sequence).cloned();
        let none = || {
            Arc::new(world::FrameObservations {
                camera: id,
                frame: u64::from(raw.sequence),
                capture_time: raw.publish_time,
                received_time: raw.log_time,
                calibration_version: 0,
                detections: Vec::new(),
            })
        };
        self.publish_picture(id, image, observations.unwrap_or_else(none));
        Some(())
    }

    fn publish_picture(&self, id: CameraId, image: GreyImage, of: Arc<FrameObservations>) {
        let picture = Picture::new((image.width, image.height), image.pixels, of);
        self.hub.publish_picture(id, picture);
    }

    fn process_event(&mut self, raw: &RecordedMessage) -> Option<()> {
        let message = read::<v1::Event>(raw)?;
        let is_published = match message.kind() {
            // A kind that this version does not know.
            EventKind::Unspecified => false,
            // Fusion publishes these itself.
            EventKind::ObjectAppeared
            | EventKind::ObjectPredicted
            | EventKind::ObjectRecovered
            | EventKind::ObjectLost
            | EventKind::CameraClockSet
            | EventKind::HeightContradicted
            | EventKind::PrintSizeContradicted => self.task.is_none(),
            _ => true,
        };
        if is_published {
            self.hub.publish(message);
        }
        Some(())
    }

    fn process_camera_health(&mut self, raw: &RecordedMessage) -> Option<()> {
        let list = read::<v1::ListCamerasResponse>(raw)?;
        for camera in &list.cameras {
            let (id, info) = (self.id(&camera.name), from_recording::read_camera_info(camera));
            let installation = self.hub.installation();
            let known = installation.cameras.get(&id);
            if !known.is_some_and(|it| it.name == info.name && it.source == info.source) {
                self.hub.set_camera(id, info);
            }
            self.hub.update_camera(id, |state| from_recording::read_camera_state(state, camera));
        }
        for (id, camera) in &self.hub.installation().cameras {
            if list.cameras.iter().all(|it| it.name != camera.name) {
                self.hub.remove_camera(*id);
            }
        }
        Some(())
    }
}

fn read<M: Message + Default>(raw: &RecordedMessage) -> Option<M> {
    M::decode(raw.data.as_slice()).ok()
}

fn decoded(raw: &RecordedMessage) -> Option<GreyImage> {
    let image = read::<CompressedImage>(raw)?;
    image_file::decode(&image.data, "recorded frame".as_ref()).ok()
}

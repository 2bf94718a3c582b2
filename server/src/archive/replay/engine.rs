//! Has happen what a recording says: as it was, fused anew, or searched and fused anew.
//!
//! Fused anew, everything that fusion was given (observations, what it was told of cameras, the instants of snapshots)
//! comes in the recorded order with the recorded times, to the same code that fuses live. So the same file gives the
//! same bits, and with the same settings those that were given live, but for what fusion knew before the recording.

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
        image_file,
        worker::{
            WorkerOutput,
            pipeline::{FrameHeader, Pipeline},
        },
    },
    fusion::{
        FusionTask,
        camera_manager::{self, bodies::BodyTable},
        setup::fusion_machine,
    },
    model::{
        clock::Clock,
        command::{AppliedConfig, FusionSettings},
        config::{Config, Lenses, ObjectConfig},
        convert,
        hub::{EventKind, Hub, Picture},
    },
};

/// Frames of a camera whose observations are remembered until their picture comes.
const OBSERVATION_CACHE_LEN: usize = 64;

/// What is needed for everything but snapshots as they are.
pub struct EngineSettings {
    /// As it begins.
    pub config: Config,
    pub lenses: Lenses,
    /// Whether it is the recorded one, and changes as that did.
    pub is_recorded: bool,
}

/// Objects as fusion knows them at a moment.
struct FusedObjects {
    objects: Vec<ObjectConfig>,
    bodies: BodyTable,
}

/// What of a recorded snapshot counts where all is fused anew; its objects are not even read.
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
    objects: FusedObjects,
    pipelines: BTreeMap<CameraId, Pipeline>,
    recent: BTreeMap<CameraId, VecDeque<Arc<FrameObservations>>>,
    /// Messages that say what cannot be.
    invalid_messages: u64,
}

impl Engine {
    /// An empty one. `ids` are the numbers that the recording gives cameras.
    pub fn new(
        hub: Arc<Hub>,
        clock: Clock,
        from: ReplayFrom,
        (settings, ids): (Option<EngineSettings>, BTreeMap<String, CameraId>),
    ) -> Self {
        Self {
            hub,
            clock,
            from,
            settings,
            ids,
            task: None,
            objects: FusedObjects { objects: Vec::new(), bodies: BodyTable::default() },
            pipelines: BTreeMap::new(),
            recent: BTreeMap::new(),
            invalid_messages: 0,
        }
    }

    pub fn fuses(&self) -> bool {
        self.task.is_some()
    }

    /// As it begins; `None` where snapshots are played.
    pub(super) fn config(&self) -> Option<&Config> {
        self.settings.as_ref().map(|settings| &settings.config)
    }

    /// Has fusion, if anything is fused, publish where everything was then.
    pub(super) fn publish_at(&mut self, pose_time: Timestamp, now: Timestamp) {
        if let Some(task) = &mut self.task {
            task.publish(pose_time, Some(now));
        }
    }

    /// The objects of now, and the number of each as a body.
    pub(super) fn objects(&self) -> impl Iterator<Item = (&ObjectConfig, Option<BodyId>)> {
        let FusedObjects { objects, bodies } = &self.objects;
        objects.iter().zip(bodies.numbers.iter().copied())
    }

    /// Messages so far that said what cannot be, and were left out.
    pub fn invalid_messages(&self) -> u64 {
        self.invalid_messages
    }

    /// Begins anew at an instant, until which fusion was told all this.
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
        // Nobody sends anything: it is called.
        let (_, nothing) = sync_channel(0);
        let machine = fusion_machine(config)?;
        let task = FusionTask::new(machine, self.hub.clone(), self.clock, nothing);
        self.task = Some(task);
        let objects = config.objects.clone();
        self.objects = FusedObjects { bodies: BodyTable::of(&objects), objects };
        self.name_objects();
        for (_, told) in updates.iter().take_while(|(time, _)| *time < until) {
            match told {
                FusionUpdate::Camera(message) => self.update_camera(message),
                FusionUpdate::Settings(message) => {
                    self.invalid_messages += u64::from(self.apply_configuration(message).is_none())
                }
            }
        }
        Ok(())
    }

    pub fn process(&mut self, raw: &RecordedMessage, reader: &mut Reader) {
        let is_sound = match &raw.channel {
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
        self.invalid_messages += u64::from(is_sound.is_none());
    }

    fn id(&mut self, name: &str) -> CameraId {
        if let Some(id) = self.ids.get(name) {
            return *id;
        }
        let next = self.ids.values().map(|id| id.0 + 1).max().unwrap_or(0);
        self.ids.insert(name.to_owned(), CameraId(next));
        CameraId(next)
    }

    fn update_camera(&mut self, message: &v1::FusedCamera) {
        if !message.camera.is_empty() {
            self.ids.insert(message.camera.clone(), CameraId(message.number));
        }
        let mut message = message.clone();
        // Live, numbers may have been given otherwise: by changes of before the recording.
        let names = &self.objects.bodies.names;
        if let Some(body) = names.iter().position(|name| *name == message.carrier)
            && message.carrier_body > 0
        {
            message.carrier_body = body as u32 + 1;
        }
        if let (Some(task), Some(told)) = (&mut self.task, convert::read_fused_camera(&message)) {
            task.apply_camera_update(told);
        }
    }

    /// Goes by another configuration from now on, where fusion did.
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
        let FusedObjects { objects, bodies } = &mut self.objects;
        let order = bodies.update((objects, &config.objects), renamed, &config.motions);
        let owned = |(before, after): (&str, &str)| (before.to_owned(), after.to_owned());
        let limits = Some(camera_manager::fusion_limits(&config));
        *objects = config.objects;
        let written = AppliedConfig { text: message.text.clone(), renamed: renamed.map(owned) };
        task.apply_settings(FusionSettings { limits, objects: order, config: written });
        self.name_objects();
        Some(())
    }

    fn name_objects(&self) {
        let FusedObjects { objects, bodies } = &self.objects;
        self.hub.set_object_names(camera_manager::kind_names(objects), bodies.names.clone());
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
            // What was not kept is not seen.
            let Some(frame) = reader.frame(&name, number as u32) else { return Some(()) };
            Arc::new(self.search(&name, &recorded, &frame)?)
        } else {
            Arc::new(recorded)
        };
        if let Some(task) = &mut self.task {
            task.observe(&WorkerOutput { observations: observations.clone(), placement: None });
        }
        let seen = self.recent.entry(id).or_default();
        seen.push_back(observations.clone());
        if seen.len() > OBSERVATION_CACHE_LEN {
            seen.pop_front();
        }
        self.hub.update_camera(id, |state| {
            (state.frames, state.detections) = (number, observations.detections.len());
        });
        self.hub.publish_observations(observations);
        Some(())
    }

    /// Searches a frame as it was searched live, with the settings of now.
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
        let by = FrameHeader {
            camera: id,
            calibration_version: recorded.calibration_version,
            frame: recorded.frame,
            capture_time: recorded.capture_time,
            received_time: recorded.received_time,
        };
        let view = image.frame().ok()?;
        let observations = pipeline.process(&view, &by);
        pipeline.seek(&view);
        if self.hub.take_picture_request(id) {
            let observations = Arc::new(observations.clone());
            self.hub.publish_picture(id, picture(image, observations));
        }
        Some(observations)
    }

    /// Shown when somebody asks for it.
    fn process_frame(&mut self, camera: &str, raw: &RecordedMessage) -> Option<()> {
        let id = self.id(camera);
        if !self.hub.take_picture_request(id) {
            return Some(());
        }
        let image = decoded(raw)?;
        let seen = self.recent.get(&id).and_then(|seen| {
            seen.iter().find(|observations| observations.frame as u32 == raw.sequence)
        });
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
        let observations = seen.cloned().unwrap_or_else(none);
        self.hub.publish_picture(id, picture(image, observations));
        Some(())
    }

    fn process_event(&mut self, raw: &RecordedMessage) -> Option<()> {
        let message = read::<v1::Event>(raw)?;
        // Of a kind that this version does not know.
        let Some(kind) = from_recording::read_event_kind(&self.hub, &message) else {
            return Some(());
        };
        // Fusion says its own.
        let is_fusions = matches!(
            kind,
            EventKind::ObjectStageChanged(..)
                | EventKind::CameraClockSet(_)
                | EventKind::HeightContradicted
        );
        if self.task.is_none() || !is_fusions {
            let time = Timestamp::from_ns(message.time_ns);
            self.hub.publish_event(time, kind, message.message);
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

fn picture(image: image_file::GreyImage, observations: Arc<FrameObservations>) -> Picture {
    Picture::new((image.width, image.height), image.pixels, observations)
}

fn decoded(raw: &RecordedMessage) -> Option<image_file::GreyImage> {
    let image = read::<CompressedImage>(raw)?;
    image_file::decode(&image.data, "recorded frame".as_ref()).ok()
}

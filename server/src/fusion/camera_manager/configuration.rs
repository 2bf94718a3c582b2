//! The configuration as a whole: read, checked, and put in the place of the one in force, as far as a server that runs
//! can do that.

use roundel_core::id::CameraId;
use roundel_proto::v1::CameraSetup;

use super::{
    CameraManager, CameraManagerError, State, apply::WorkerStart, camera_diff::CameraDiff, setup,
};
use crate::{
    capture::worker::{WorkerCounts, pipeline::Pipeline},
    model::{
        address::without_credentials,
        command::FusionLimits,
        config::{
            CameraConfig, Config, PoseConfig, Problem,
            edit::{self, EditError},
        },
        hub::EventKind,
    },
};

pub struct ActiveConfig {
    /// As it is written, without users and passwords.
    pub text: String,
    pub config: Config,
}

/// What applying a text would do.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ApplyPlan {
    pub changes: Vec<String>,
    /// What differs and cannot.
    pub needs_restart: Vec<String>,
}

/// A text that is to be in force, and what of it is new.
struct TargetConfig {
    text: String,
    config: Config,
    /// Of each of its cameras, where it is now and what differs; `None`: it is new.
    cameras: Vec<Option<(CameraId, CameraDiff)>>,
    limits: Option<FusionLimits>,
    plan: ApplyPlan,
}

impl CameraManager {
    pub fn configuration(&self) -> Result<ActiveConfig, CameraManagerError> {
        let config = self.lock().config.clone();
        let text = edit::without_credentials(config.file.text())?;
        Ok(ActiveConfig { text, config })
    }

    /// Tells the text in force from others.
    pub fn version(&self) -> String {
        self.lock().config.file.version()
    }

    /// What applying a text would do, or what is wrong with it.
    pub fn check(&self, text: &str) -> Result<ApplyPlan, Vec<Problem>> {
        let state = self.lock();
        state.plan_apply(text).map(|target| target.plan)
    }

    /// Puts a text in the place of the one in force, if that has this version (empty: any). Says what has changed, and
    /// where that is kept.
    pub fn apply(
        &self,
        text: &str,
        version: &str,
    ) -> Result<(Vec<String>, String), CameraManagerError> {
        let mut state = self.lock_running()?;
        if !version.is_empty() && version != state.config.file.version() {
            return Err(CameraManagerError::Stale);
        }
        let target = state.plan_apply(text).map_err(CameraManagerError::Problems)?;
        if !target.plan.needs_restart.is_empty() {
            return Err(CameraManagerError::NeedsRestart(target.plan.needs_restart));
        }
        if self.calibrator.is_running() && target.changes_cameras(&state) {
            return Err(CameraManagerError::Calibrating);
        }
        // That all can be searched for is known before anything is done.
        for camera in &target.config.cameras {
            Pipeline::new(setup::pipeline_parts(camera, &target.config, Default::default())?)?;
        }
        state.config.file.replace(target.text.clone())?;
        let changes = target.plan.changes.clone();
        self.activate(&mut state, target)?;
        Ok((changes, state.config.file.kept()))
    }

    fn activate(&self, state: &mut State, target: TargetConfig) -> Result<(), CameraManagerError> {
        let TargetConfig { config, cameras, limits, .. } = target;
        let kept = state.config.file.kept();
        let stays = |id: &CameraId| cameras.iter().flatten().any(|(known, _)| known == id);
        for (id, camera) in state.ids.clone().into_iter().zip(state.config.cameras.clone()) {
            if !stays(&id) {
                state.workers.stop(id);
                let message = format!("Camera {} was removed; {kept}.", camera.name);
                self.report(EventKind::CameraRemoved(id), message);
                self.unregister(state, id);
            }
        }
        let remains: Vec<bool> = state.ids.iter().map(stays).collect();
        let mut each = remains.iter();
        state.ids.retain(|_| each.next() == Some(&true));
        let mut each = remains.iter();
        state.config.cameras.retain(|_| each.next() == Some(&true));
        if state.config.objects != config.objects || limits.is_some() {
            self.replace_and_report_objects(state, config.objects, limits);
        }
        let before = std::mem::replace(&mut state.config.cameras, config.cameras);
        state.config.mode = config.mode;
        state.config.fusion = config.fusion;
        state.config.limits = config.limits;
        let names: Vec<String> = before.into_iter().map(|camera| camera.name).collect();
        let known = std::mem::take(&mut state.ids);
        for camera in &cameras {
            state.ids.push(camera.as_ref().map_or_else(
                || {
                    state.next_id += 1;
                    CameraId(state.next_id - 1)
                },
                |(id, _)| *id,
            ));
        }
        for (index, camera) in cameras.into_iter().enumerate() {
            let id = state.ids[index];
            match camera {
                None => self.start_camera(state, (id, index))?,
                Some((_, diff)) if !diff.is_empty() => {
                    self.apply_diff(state, (id, index), &diff)?;
                    let place = known.iter().position(|known| *known == id);
                    let name = place.map_or("", |place| &names[place]);
                    let words = diff.describe();
                    let message = format!("Camera {name} was changed ({words}); {kept}.");
                    self.report(EventKind::CameraChanged(id), message);
                }
                Some(_) => {}
            }
        }
        Ok(())
    }

    /// Begins with a camera that the configuration has and nobody knows of yet.
    pub(super) fn start_camera(
        &self,
        state: &mut State,
        (id, index): (CameraId, usize),
    ) -> Result<(), CameraManagerError> {
        let config = state.config.clone();
        let camera = &config.cameras[index];
        let pipeline = Pipeline::new(setup::pipeline_parts(camera, &config, Default::default())?)?;
        self.hub.set_camera(id, setup::camera_info(camera, &config));
        self.calibrator.set(id, setup::calibrator_camera(camera));
        self.register(state, id, camera, &config);
        let (pose, before) = (setup::pose_source(camera, &config), WorkerCounts::default());
        self.start_worker(
            state,
            WorkerStart { id, index, camera, pipeline, pose, version: 0, before },
        )?;
        let kept = config.file.kept();
        self.report(
            EventKind::CameraAdded(id),
            format!("Camera {} was added; {kept}.", camera.name),
        );
        Ok(())
    }
}

impl TargetConfig {
    fn changes_cameras(&self, state: &State) -> bool {
        let is_new = |camera: &Option<(CameraId, CameraDiff)>| {
            camera.as_ref().is_none_or(|(_, diff)| !diff.is_empty())
        };
        self.cameras.len() != state.ids.len() || self.cameras.iter().any(is_new)
    }
}

impl State {
    /// A text, read as at a start, and held against what is in force.
    fn plan_apply(&self, text: &str) -> Result<TargetConfig, Vec<Problem>> {
        let text = self.with_credentials(text).unwrap_or_else(|_| text.to_owned());
        let mut config = Config::parse(&text, &self.config.folder)?;
        // What was made more exact than its text, as a demonstration's, is held by its text.
        let mut before = Config::parse(self.config.file.text(), &self.config.folder)
            .unwrap_or_else(|_| self.config.clone());
        for config in [&mut config, &mut before] {
            config.set_file(self.config.file.clone());
        }
        let mut plan =
            ApplyPlan { changes: Vec::new(), needs_restart: needs_restart(&before, &config) };
        let max_roundels = |config: &Config| config.limits.max_roundels_per_camera;
        let mut cameras = Vec::new();
        for camera in &config.cameras {
            let known =
                self.config.cameras.iter().zip(&self.ids).find(|(old, _)| old.name == camera.name);
            let Some((old, id)) = known else {
                plan.changes.push(format!("camera \"{}\" is new", camera.name));
                cameras.push(None);
                continue;
            };
            let old = self.with_carrier_index_of(old, &config);
            let max_roundels = max_roundels(&config) != max_roundels(&self.config);
            let mut diff = CameraDiff::of(&old, camera);
            if max_roundels {
                diff.add_max_roundels();
            }
            if !diff.is_empty() {
                plan.changes.push(format!("camera \"{}\": {}", camera.name, diff.describe()));
            }
            cameras.push(Some((*id, diff)));
        }
        let has = |name: &str| config.cameras.iter().any(|camera| camera.name == name);
        let gone = self.config.cameras.iter().filter(|camera| !has(&camera.name));
        plan.changes.extend(gone.map(|camera| format!("camera \"{}\" is gone", camera.name)));
        plan.changes.extend(object_changes(&self.config, &config));
        let limits =
            (fusion_limits(&self.config) != fusion_limits(&config)).then(|| fusion_limits(&config));
        plan.changes.extend(limits.map(|_| "[fusion] or [limits] max_objects".to_owned()));
        if self.config.mode != config.mode {
            plan.changes.push("[detection] mode".to_owned());
        }
        Ok(TargetConfig { text, config, cameras, limits, plan })
    }

    /// A camera as it is now, but that it names what it rides on by its place in another configuration.
    fn with_carrier_index_of(&self, camera: &CameraConfig, config: &Config) -> CameraConfig {
        let mut camera = camera.clone();
        if let PoseConfig::Mounted(ride) = &mut camera.pose {
            let name = &self.config.objects[ride.object].name;
            let place = config.objects.iter().position(|object| object.name == *name);
            ride.object = place.unwrap_or(usize::MAX);
        }
        camera
    }

    /// A text with the users and passwords of those sources that are written as in the one in force, but for them.
    fn with_credentials(&self, text: &str) -> Result<String, EditError> {
        let mut text = text.to_owned();
        for known in edit::read_all::<CameraSetup>(self.config.file.text())? {
            let bare = without_credentials(&known.source);
            let is_meant = |now: CameraSetup| now.source == bare && known.source != bare;
            if edit::read::<CameraSetup>(&text, &known.name).is_ok_and(is_meant) {
                text = edit::change(&text, &known.name, &known, &["source"])?;
            }
        }
        Ok(text)
    }
}

/// Tables and keys that differ and are read at a start only.
fn needs_restart(before: &Config, after: &Config) -> Vec<String> {
    let (old, new) = (&before.server, &after.server);
    let all: [(bool, &str); 15] = [
        (before.name != after.name, "name"),
        (old.listen != new.listen, "[server] listen"),
        (old.snapshot_rate_hz != new.snapshot_rate_hz, "[server] snapshot_rate_hz"),
        (old.publishes_per_frame != new.publishes_per_frame, "[server] prompt"),
        (old.calibration != new.calibration, "[server] calibration"),
        (old.monitors_cameras != new.monitors_cameras, "[server] watch"),
        (old.setup != new.setup, "[server] setup"),
        (old.allow_origins != new.allow_origins, "[server] allow_origins"),
        (before.kinds != after.kinds || before.motions != after.motions, "[[roundel]]"),
        (before.references != after.references, "[[reference]]"),
        (before.fusion.late_window_s != after.fusion.late_window_s, "[fusion] late_window_ms"),
        (before.limits.max_clients != after.limits.max_clients, "[limits] max_clients"),
        (before.recording != after.recording, "[recording]"),
        (before.history != after.history, "[history]"),
        (before.node != after.node, "[node]"),
    ];
    all.iter().filter(|(differs, _)| *differs).map(|(_, what)| (*what).to_owned()).collect()
}

/// What a configuration lets objects do.
pub fn fusion_limits(config: &Config) -> FusionLimits {
    FusionLimits {
        acceleration_m_s2: config.fusion.acceleration_m_s2,
        predicted_after_s: config.fusion.predicted_after_s,
        lost_after_s: config.fusion.lost_after_s,
        max_objects: config.limits.max_objects,
    }
}

fn object_changes(before: &Config, after: &Config) -> Vec<String> {
    let mut changes = Vec::new();
    for object in &after.objects {
        match before.objects.iter().find(|old| old.name == object.name) {
            None => changes.push(format!("object \"{}\" is new", object.name)),
            Some(old) if old != object => changes.push(format!("object \"{}\"", object.name)),
            Some(_) => {}
        }
    }
    let has = |name: &str| after.objects.iter().any(|object| object.name == name);
    let gone = before.objects.iter().filter(|object| !has(&object.name));
    changes.extend(gone.map(|object| format!("object \"{}\" is gone", object.name)));
    changes
}

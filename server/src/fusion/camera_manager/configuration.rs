//! Checks and applies a whole configuration, as far as a running server can.

use roundel_core::{id::CameraId, world::FusionParams};

use super::{
    CameraManager, CameraManagerError, State, camera_diff::CameraDiff, object::object_changes,
    replaced, setup,
};
use crate::{
    fusion::setup::fusion_params,
    model::{
        config::{CameraConfig, Config, PoseConfig, Problem, edit},
        hub::EventKind,
    },
};

pub struct ActiveConfig {
    /// As written, without secrets.
    pub text: String,
    pub config: Config,
}

/// What applying a configuration would change.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ApplyPlan {
    pub changes: Vec<String>,
    /// Differences that need a restart.
    pub needs_restart: Vec<String>,
}

/// A checked configuration, and its differences from the current one.
struct TargetConfig {
    text: String,
    config: Config,
    /// Id and diff of each camera; `None`: new.
    cameras: Vec<Option<(CameraId, CameraDiff)>>,
    /// `None`: unchanged.
    params: Option<FusionParams>,
    plan: ApplyPlan,
}

/// The configuration in use, with the id of each camera.
struct CurrentConfig {
    config: Config,
    ids: Vec<CameraId>,
}

impl CameraManager {
    pub fn configuration(&self) -> Result<ActiveConfig, CameraManagerError> {
        let config = self.config();
        let text = edit::redacted(config.file.text())?;
        Ok(ActiveConfig { text, config })
    }

    /// Identifies the current text.
    pub fn version(&self) -> String {
        self.lock().config.file.version()
    }

    pub fn check(&self, text: &str) -> Result<ApplyPlan, Vec<Problem>> {
        let current = CurrentConfig::of(&self.lock());
        current.plan_apply(text).map(|target| target.plan)
    }

    /// Applies a text if the current version is `version`, or that is empty. Returns the changes, and where the
    /// configuration is stored.
    pub fn apply(
        &self,
        text: &str,
        version: &str,
    ) -> Result<(Vec<String>, String), CameraManagerError> {
        self.change_with(|| {
            let current = CurrentConfig::of(&*self.lock_running()?);
            if !version.is_empty() && version != current.config.file.version() {
                return Err(CameraManagerError::Stale);
            }
            let target = current.plan_apply(text).map_err(CameraManagerError::Problems)?;
            if !target.plan.needs_restart.is_empty() {
                return Err(CameraManagerError::NeedsRestart(target.plan.needs_restart));
            }
            if self.calibrator.is_running() && target.changes_cameras(&current) {
                return Err(CameraManagerError::Calibrating);
            }
            for camera in &target.config.cameras {
                setup::pipeline(camera, &target.config, Default::default())?;
            }
            let file = replaced(&current.config.file, target.text.clone())?;
            let (changes, kept) = (target.plan.changes.clone(), file.kept());
            let state = &mut *self.lock_running()?;
            state.config.file = file;
            self.activate(state, target)?;
            Ok((changes, kept))
        })
    }

    fn activate(&self, state: &mut State, target: TargetConfig) -> Result<(), CameraManagerError> {
        let TargetConfig { config, cameras, params, .. } = target;
        let stays = |id: &CameraId| cameras.iter().flatten().any(|(known, _)| known == id);
        let mut index = 0;
        while let Some(id) = state.ids.get(index) {
            if stays(id) {
                index += 1;
            } else {
                self.remove_camera(state, index);
            }
        }
        if state.config.objects != config.objects || params.is_some() {
            self.replace_and_report_objects(state, config.objects, params);
        }
        state.config.cameras = config.cameras;
        state.config.mode = config.mode;
        state.config.fusion = config.fusion;
        state.config.limits = config.limits;
        state.ids.clear();
        for camera in &cameras {
            let id = camera.as_ref().map_or_else(|| state.new_id(), |(id, _)| *id);
            state.ids.push(id);
        }
        for (index, camera) in cameras.iter().enumerate() {
            let id = state.ids[index];
            match camera {
                None => self.start_camera(state, id, index)?,
                Some((_, diff)) => {
                    // Cameras are matched by name, so the name is the same.
                    let name = state.config.cameras[index].name.clone();
                    self.apply_diff(state, (id, index), diff, &name)?;
                }
            }
        }
        Ok(())
    }
}

impl TargetConfig {
    fn changes_cameras(&self, current: &CurrentConfig) -> bool {
        let is_new = |camera: &Option<(CameraId, CameraDiff)>| {
            camera.as_ref().is_none_or(|(_, diff)| !diff.is_empty())
        };
        self.cameras.len() != current.ids.len() || self.cameras.iter().any(is_new)
    }
}

impl CurrentConfig {
    fn of(state: &State) -> Self {
        Self { config: state.config.clone(), ids: state.ids.clone() }
    }

    /// Parses a text as at a start, and compares it with the current configuration.
    fn plan_apply(&self, text: &str) -> Result<TargetConfig, Vec<Problem>> {
        let known = self.config.file.text();
        let text = edit::restored(text, known).unwrap_or_else(|_| text.to_owned());
        let mut config = self.config.parse_request(&text)?;
        // The configuration of a demonstration is more exact than its text: compare the texts.
        let mut before = self
            .config
            .parse_request(self.config.file.text())
            .unwrap_or_else(|_| self.config.clone());
        for config in [&mut config, &mut before] {
            config.set_file(self.config.file.clone());
        }
        let mut changes = Vec::new();
        let max_roundels = |config: &Config| config.limits.max_roundels_per_camera;
        let mut cameras = Vec::new();
        for camera in &config.cameras {
            let known =
                self.config.cameras.iter().zip(&self.ids).find(|(old, _)| old.name == camera.name);
            let Some((old, id)) = known else {
                changes.push(format!("camera \"{}\" is new", camera.name));
                cameras.push(None);
                continue;
            };
            let old = self.with_carrier_index_of(old, &config);
            let mut diff = CameraDiff::of(&old, camera);
            if max_roundels(&config) != max_roundels(&self.config) {
                diff.add_max_roundels();
            }
            if !diff.is_empty() {
                changes.push(format!("camera \"{}\": {}", camera.name, diff.describe()));
            }
            cameras.push(Some((*id, diff)));
        }
        let has = |name: &str| config.cameras.iter().any(|camera| camera.name == name);
        let gone = self.config.cameras.iter().filter(|camera| !has(&camera.name));
        changes.extend(gone.map(|camera| format!("camera \"{}\" is gone", camera.name)));
        for (name, kind) in object_changes(&self.config.objects, &config.objects) {
            changes.push(match kind {
                EventKind::ObjectAdded => format!("object \"{name}\" is new"),
                EventKind::ObjectRemoved => format!("object \"{name}\" is gone"),
                _ => format!("object \"{name}\""),
            });
        }
        let old = fusion_params(&self.config);
        // The others need a restart.
        let params = FusionParams {
            late_window_ns: old.late_window_ns,
            held_back_ns: old.held_back_ns,
            ..fusion_params(&config)
        };
        let params = (params != old).then_some(params);
        changes.extend(params.map(|_| "[fusion] or [limits] max_objects".to_owned()));
        if self.config.mode != config.mode {
            changes.push("[detection] mode".to_owned());
        }
        let plan = ApplyPlan { changes, needs_restart: needs_restart(&before, &config) };
        Ok(TargetConfig { text, config, cameras, params, plan })
    }

    /// The camera with the index that its object has in another configuration.
    fn with_carrier_index_of(&self, camera: &CameraConfig, config: &Config) -> CameraConfig {
        let mut camera = camera.clone();
        if let PoseConfig::Mounted(ride) = &mut camera.pose {
            let name = &self.config.objects[ride.object].name;
            let place = config.objects.iter().position(|object| object.name == *name);
            ride.object = place.unwrap_or(usize::MAX);
        }
        camera
    }
}

/// Differences that only a restart applies.
fn needs_restart(before: &Config, after: &Config) -> Vec<String> {
    let (old, new) = (&before.server, &after.server);
    let all: [(bool, &str); 21] = [
        (before.name != after.name, "name"),
        (old.listen != new.listen, "[server] listen"),
        (old.snapshot_rate_hz != new.snapshot_rate_hz, "[server] snapshot_rate_hz"),
        (old.publishes_per_frame != new.publishes_per_frame, "[server] prompt"),
        (old.calibration != new.calibration, "[server] calibration"),
        (old.monitors_cameras != new.monitors_cameras, "[server] watch"),
        (old.setup != new.setup, "[server] setup"),
        (old.allow_origins != new.allow_origins, "[server] allow_origins"),
        (
            before.access != after.access,
            "[[access]], or allow_hosts, trusted_proxies, insecure in [server]",
        ),
        (old.tls != new.tls, "[server] tls"),
        (old.source_rules.folders != new.source_rules.folders, "[server] source_folders"),
        (old.source_rules.networks != new.source_rules.networks, "[server] source_networks"),
        (
            before.kinds != after.kinds
                || before.motions != after.motions
                || before.tolerances != after.tolerances,
            "[[roundel]]",
        ),
        (before.references != after.references, "[[reference]]"),
        (before.time_budget != after.time_budget, "[detection] time_budget"),
        (before.fusion.late_window_s != after.fusion.late_window_s, "[fusion] late_window_ms"),
        (before.limits.max_clients != after.limits.max_clients, "[limits] max_clients"),
        (
            before.limits.max_connections_per_peer != after.limits.max_connections_per_peer,
            "[limits] max_connections_per_peer",
        ),
        (before.recording != after.recording, "[recording]"),
        (before.history != after.history, "[history]"),
        (before.node != after.node, "[node]"),
    ];
    all.iter().filter(|(differs, _)| *differs).map(|(_, what)| (*what).to_owned()).collect()
}

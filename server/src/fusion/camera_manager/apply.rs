//! Applies changes of cameras to workers, ports, the hub, fusion and the calibrator.

use roundel_core::id::CameraId;

use super::{
    CameraManager, CameraManagerError, SourceContext, State, camera_diff::CameraDiff, setup,
};
use crate::{
    capture::worker::{
        PoseSource, Worker, WorkerCounts, WorkerParts, calibration_update::CalibrationUpdate,
    },
    model::{
        address::SourceAddress,
        command::{CameraChange, CameraModel, CameraUpdate, FusionCommand},
        config::{CameraConfig, Config, Effect},
        hub::{EventKind, PoseStatus},
        stop::StopSignal,
    },
};

pub(super) struct WorkerStart<'a> {
    pub(super) id: CameraId,
    pub(super) index: usize,
    pub(super) camera: &'a CameraConfig,
    pub(super) pose: PoseSource,
    /// Version of the calibration in use.
    pub(super) version: u64,
    /// Counts of the worker before.
    pub(super) before: WorkerCounts,
}

impl CameraManager {
    /// Adds a camera to fusion and opens its port.
    pub(super) fn register(
        &self,
        state: &State,
        id: CameraId,
        camera: &CameraConfig,
        config: &Config,
    ) {
        let pose = setup::camera_pose(camera, config, &state.bodies.numbers);
        let clock = Some(setup::clock_model(camera));
        state.set_model(id, CameraModel { pose: Some(pose), clock, trust: Some(camera.trust) });
        if matches!(camera.address, SourceAddress::Push(_)) {
            self.ports.open(id, config.limits.max_roundels_per_camera);
        }
    }

    pub(super) fn start_worker(
        &self,
        state: &mut State,
        config: &Config,
        start: WorkerStart<'_>,
    ) -> Result<(), CameraManagerError> {
        let WorkerStart { id, index, camera, pose, version, before } = start;
        let pipeline = setup::pipeline(camera, config, before.detection)?;
        let stop = StopSignal::default();
        let opener = (state.sources)(SourceContext {
            index,
            camera,
            clock: self.clock,
            playback: self.playback,
            stop: stop.clone(),
            port: self.ports.get(id),
        });
        let worker = Worker::new(WorkerParts {
            id,
            name: camera.name.clone(),
            opener,
            pipeline,
            pose,
            calibration_version: version,
            mailbox: self.calibrator.mailbox(id),
            hub: self.hub.clone(),
            fusion: state.to_fusion.clone(),
            clock: self.clock,
            promised_hz: camera.rate_hz,
            min_error_px: setup::min_error_px(camera),
            time_budget: config.time_budget,
            before,
        });
        state.workers.spawn(id, &camera.name, worker, stop).map_err(|source| {
            CameraManagerError::Thread { name: format!("camera {}", camera.name), source }
        })
    }

    /// Starts a camera that was added to the configuration.
    pub(super) fn start_camera(
        &self,
        state: &mut State,
        id: CameraId,
        index: usize,
    ) -> Result<(), CameraManagerError> {
        let config = state.config.clone();
        let camera = &config.cameras[index];
        self.hub.set_camera(id, setup::camera_info(camera, &config));
        self.calibrator.set(id, setup::calibrator_camera(camera));
        self.register(state, id, camera, &config);
        let (pose, before) = (setup::pose_source(camera, &config), WorkerCounts::default());
        let start = WorkerStart { id, index, camera, pose, version: 0, before };
        self.start_worker(state, &config, start)?;
        let message = format!("Camera {} was added; {}.", camera.name, config.file.kept());
        self.report(EventKind::CameraAdded, id, message);
        Ok(())
    }

    /// Applies and reports a change that is in the configuration already; `name` is the camera's name before.
    pub(super) fn apply_diff(
        &self,
        state: &mut State,
        (id, index): (CameraId, usize),
        diff: &CameraDiff,
        name: &str,
    ) -> Result<(), CameraManagerError> {
        if diff.is_empty() {
            return Ok(());
        }
        let config = state.config.clone();
        let camera = &config.cameras[index];
        // Stops first, so that no frame of the old source reaches the new model.
        let before = diff.requires_restart().then(|| state.workers.stop(id).unwrap_or_default());
        self.hub.set_camera(id, setup::camera_info(camera, &config));
        let is_invalidated = diff.invalidates_calibration();
        if is_invalidated {
            self.calibrator.set(id, setup::calibrator_camera(camera));
        } else if diff.has(Effect::Rename) {
            self.calibrator.rename(id, &camera.name);
        }
        let pose =
            is_invalidated.then(|| setup::camera_pose(camera, &config, &state.bodies.numbers));
        let clock = diff.resets_clock().then(|| setup::clock_model(camera));
        state.set_model(id, CameraModel { pose, clock, trust: Some(camera.trust) });
        let is_pushed = matches!(camera.address, SourceAddress::Push(_));
        if is_pushed {
            self.ports.open(id, config.limits.max_roundels_per_camera);
        } else {
            self.ports.close(id);
        }
        let pose = setup::pose_source(camera, &config);
        self.hub.update_camera(id, |shown| {
            if !is_pushed {
                shown.link = None;
            }
            if diff.has(Effect::Source) {
                shown.capture_clock = None;
            }
            if is_invalidated {
                shown.health = None;
                if let Some(pose) = pose.initial_state() {
                    shown.pose = pose;
                }
                shown.camera = Some(camera.calibration.clone());
                shown.calibration_version = 0;
            }
        });
        if let Some(before) = before {
            // The new worker continues the counts; calibrated pose and lens stay if they are still valid.
            let shown = self.hub.camera(id).unwrap_or_default();
            let is_kept = !is_invalidated && shown.pose.status != PoseStatus::Searching;
            let pose = if is_kept { PoseSource::Unchanged } else { pose };
            let mut camera = camera.clone();
            if let Some(lens) = shown.camera.filter(|_| !is_invalidated) {
                camera.calibration = lens;
            }
            let (version, camera) = (shown.calibration_version, &camera);
            let start = WorkerStart { id, index, camera, pose, version, before };
            self.start_worker(state, &config, start)?;
        } else if is_invalidated {
            let lens = camera.calibration.clone();
            self.calibrator.mailbox(id).put(CalibrationUpdate { lens, pose, version: 0 });
        }
        let (words, kept) = (diff.describe(), config.file.kept());
        let message = format!("Camera {name} was changed ({words}); {kept}.");
        self.report(EventKind::CameraChanged, id, message);
        Ok(())
    }

    /// Removes a camera that is not in the file any more.
    pub(super) fn remove_camera(&self, state: &mut State, index: usize) {
        let (id, camera) = (state.ids.remove(index), state.config.cameras.remove(index));
        state.workers.stop(id);
        let message = format!("Camera {} was removed; {}.", camera.name, state.config.file.kept());
        self.report(EventKind::CameraRemoved, id, message);
        self.unregister(state, id);
    }

    pub(super) fn unregister(&self, state: &State, id: CameraId) {
        self.ports.close(id);
        state.update_camera(id, CameraChange::Removed);
        self.calibrator.remove(id);
        self.hub.remove_camera(id);
    }
}

impl State {
    pub(super) fn set_model(&self, id: CameraId, model: CameraModel) {
        self.update_camera(id, CameraChange::Set(Box::new(model)));
    }

    fn update_camera(&self, camera: CameraId, change: CameraChange) {
        // Fails only during shutdown.
        let _ = self.commands.send(FusionCommand::UpdateCamera(CameraUpdate { camera, change }));
    }
}

//! Applies changes of cameras to workers, ports, the hub, fusion and the calibrator.

use roundel_core::id::CameraId;

use super::{
    CameraManager, CameraManagerError, SourceContext, State, camera_diff::CameraDiff, setup,
};
use crate::{
    capture::worker::{
        PoseSource, Worker, WorkerCounts, WorkerParts, calibration_update::CalibrationUpdate,
        pipeline::Pipeline,
    },
    model::{
        address::SourceAddress,
        command::{CameraModel, FusionCommand},
        config::{CameraConfig, Config, Effect},
        hub::PoseStatus,
        stop::StopSignal,
    },
};

/// What a worker begins with.
pub(super) struct WorkerStart<'a> {
    pub(super) id: CameraId,
    pub(super) index: usize,
    pub(super) camera: &'a CameraConfig,
    pub(super) pipeline: Pipeline,
    pub(super) pose: PoseSource,
    pub(super) version: u64,
    pub(super) before: WorkerCounts,
}

impl CameraManager {
    /// Tells fusion of a camera, and opens its port.
    pub(super) fn register(
        &self,
        state: &State,
        id: CameraId,
        camera: &CameraConfig,
        config: &Config,
    ) {
        let pose = Some(setup::camera_pose(camera, config, &state.bodies.numbers));
        state.send_model(id, CameraModel { pose, clock: Some(setup::clock_model(camera)) });
        if matches!(camera.address, SourceAddress::Push(_)) {
            self.ports.open(id);
        }
    }

    pub(super) fn start_worker(
        &self,
        state: &mut State,
        begin: WorkerStart<'_>,
    ) -> Result<(), CameraManagerError> {
        let WorkerStart { id, index, camera, pipeline, pose, version, before } = begin;
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
            before,
        });
        state.workers.spawn(id, &camera.name, worker, stop).map_err(|source| {
            CameraManagerError::Thread { name: format!("camera {}", camera.name), source }
        })
    }

    /// Does what follows from a change that is written.
    pub(super) fn apply_diff(
        &self,
        state: &mut State,
        (id, index): (CameraId, usize),
        diff: &CameraDiff,
    ) -> Result<(), CameraManagerError> {
        let config = state.config.clone();
        let camera = &config.cameras[index];
        // Nothing of the old source comes after fusion has heard of the new one.
        let before = diff.requires_restart().then(|| state.workers.stop(id).unwrap_or_default());
        self.hub.set_camera(id, setup::camera_info(camera, &config));
        if diff.invalidates_calibration() {
            self.calibrator.set(id, setup::calibrator_camera(camera));
        } else if diff.has(Effect::Rename) {
            self.calibrator.rename(id, &camera.name);
        }
        let pose = diff
            .invalidates_calibration()
            .then(|| setup::camera_pose(camera, &config, &state.bodies.numbers));
        let clock = diff.resets_clock().then(|| setup::clock_model(camera));
        state.send_model(id, CameraModel { pose, clock });
        let is_pushed = matches!(camera.address, SourceAddress::Push(_));
        if is_pushed {
            self.ports.open(id);
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
            if diff.invalidates_calibration() {
                shown.health = None;
                pose.initial_state().into_iter().for_each(|pose| shown.pose = pose);
                shown.camera = Some(camera.calibration.clone());
                shown.calibration_version = 0;
            }
        });
        if let Some(before) = before {
            return self.restart_worker(state, (id, index), &config, (diff, before));
        }
        if diff.invalidates_calibration() {
            let lens = camera.calibration.clone();
            self.calibrator.mailbox(id).put(CalibrationUpdate { lens, pose, version: 0 });
        }
        Ok(())
    }

    /// A worker in the pose of the one before: it goes on to count, and a pose and a lens that were found out and
    /// still hold are kept.
    fn restart_worker(
        &self,
        state: &mut State,
        (id, index): (CameraId, usize),
        config: &Config,
        (diff, before): (&CameraDiff, WorkerCounts),
    ) -> Result<(), CameraManagerError> {
        let mut camera = config.cameras[index].clone();
        let shown = self.hub.camera(id).unwrap_or_default();
        let is_kept = !diff.invalidates_calibration() && shown.pose.status != PoseStatus::Searching;
        let pose =
            if is_kept { PoseSource::Unchanged } else { setup::pose_source(&camera, config) };
        let lens = shown.camera.filter(|_| !diff.invalidates_calibration());
        camera.calibration = lens.unwrap_or(camera.calibration);
        let pipeline = Pipeline::new(setup::pipeline_parts(&camera, config, before.detection)?)?;
        let (version, camera) = (shown.calibration_version, &camera);
        self.start_worker(state, WorkerStart { id, index, camera, pipeline, pose, version, before })
    }

    /// Nothing knows of a camera any more.
    pub(super) fn unregister(&self, state: &State, id: CameraId) {
        self.ports.close(id);
        // Fusion is gone only when the server goes down.
        let _ = state.commands.send(FusionCommand::RemoveCamera(id));
        self.calibrator.remove(id);
        self.hub.remove_camera(id);
    }
}

impl State {
    fn send_model(&self, id: CameraId, known: CameraModel) {
        // Fusion is gone only when the server goes down.
        let _ = self.commands.send(FusionCommand::SetCamera(id, Box::new(known)));
    }
}

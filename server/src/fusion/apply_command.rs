//! Cameras and objects that come, change and go while fusion runs.
//!
//! Orders are few and none may be lost, so they have a queue of their own, which is never full. They are obeyed before
//! the next frame is taken: a camera is known before its first frame, and of one that was removed no frame is used.

use roundel_core::{id::CameraId, world::FusionParams};

use super::FusionTask;
use crate::model::{
    command::{
        CameraChange, CameraModel, CameraPose, CameraUpdate, ClockModel, FusionCommand,
        FusionSettings, ObjectUpdate,
    },
    tap::RecordedItem,
};

impl FusionTask {
    /// Obeys what was ordered by now.
    pub(super) fn process_commands(&mut self) {
        while let Ok(order) = self.commands.try_recv() {
            match order {
                FusionCommand::SetCamera(camera, known) => {
                    self.apply_camera_update(CameraUpdate {
                        camera,
                        change: CameraChange::Set(known),
                    });
                }
                FusionCommand::RemoveCamera(camera) => {
                    self.apply_camera_update(CameraUpdate { camera, change: CameraChange::Removed })
                }
                FusionCommand::SetParams(settings) => self.apply_settings(*settings),
            }
        }
    }

    /// Takes what there is to know of a camera; a recording hears of it.
    pub fn apply_camera_update(&mut self, told: CameraUpdate) {
        let CameraUpdate { camera, change } = told.clone();
        self.hub.tap().update_camera(told);
        match change {
            CameraChange::Set(known) => self.set_camera(camera, *known),
            CameraChange::Removed => self.remove_camera(camera),
            CameraChange::Localized(placement) => {
                self.fusion.set_camera(camera, Some(*placement));
                self.camera_monitor
                    .iter_mut()
                    .for_each(|camera_monitor| camera_monitor.place(camera, *placement));
            }
            CameraChange::HoldBackExempt(is_exempt) => self.fusion.spare(camera, is_exempt),
            CameraChange::Quarantined => self.fusion.quarantine(camera),
        }
    }

    /// Goes by other settings; a recording hears of it.
    pub fn apply_settings(&mut self, settings: FusionSettings) {
        let FusionSettings { limits, objects, config } = settings;
        self.hub.tap().offer(|| RecordedItem::Settings(config));
        self.update_objects(&objects);
        if let Some(limits) = limits {
            let ns = |seconds: f64| (seconds * 1e9).round() as i64;
            self.fusion.set_params(FusionParams {
                acceleration_m_s2: limits.acceleration_m_s2,
                predicted_after_ns: ns(limits.predicted_after_s),
                lost_after_ns: ns(limits.lost_after_s),
                max_objects: limits.max_objects,
                ..self.fusion.params()
            });
        }
    }

    fn update_objects(&mut self, objects: &ObjectUpdate) {
        for &(kind, offset_m, motion) in &objects.kinds {
            self.fusion.set_offset(kind, offset_m);
            self.fusion.change_motion(kind, motion);
        }
        if let Err(error) = self.fusion.set_bodies(&objects.bodies) {
            // The configuration has been checked for that.
            tracing::error!(%error, "the objects that were changed are not followed as such");
        }
    }

    fn set_camera(&mut self, camera: CameraId, known: CameraModel) {
        self.cameras.insert(camera);
        if let Some(clock) = known.clock {
            self.fusion.forget_source(camera);
            if let ClockModel::Estimated(prior) = clock {
                self.fusion.set_clock(camera, prior);
            }
        }
        let camera_monitor = self.camera_monitor.as_mut();
        match known.pose {
            None => {}
            Some(CameraPose::Fixed { placement, is_configured }) => {
                self.mounted_cameras.remove(camera);
                self.fusion.set_mount(camera, None);
                self.fusion.set_camera(camera, Some(placement));
                camera_monitor.into_iter().for_each(|it| it.set(camera, placement, is_configured));
            }
            Some(CameraPose::Unknown) => {
                self.mounted_cameras.remove(camera);
                self.fusion.set_mount(camera, None);
                self.fusion.set_camera(camera, None);
                camera_monitor.into_iter().for_each(|it| it.remove(camera));
            }
            Some(CameraPose::Mounted(mount, ride)) => {
                self.mounted_cameras.set(camera, ride);
                self.fusion.set_camera(camera, None);
                self.fusion.set_mount(camera, mount);
                camera_monitor.into_iter().for_each(|it| it.remove(camera));
            }
        }
    }

    fn remove_camera(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
        self.latency_ms.remove(&camera);
        self.mounted_cameras.remove(camera);
        self.camera_monitor.iter_mut().for_each(|it| it.remove(camera));
        self.fusion.remove_camera(camera);
    }
}

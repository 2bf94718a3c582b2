//! Adds, changes and removes cameras and objects while fusion runs.
//!
//! Commands are rare and must not be lost, so they have an unbounded queue. They are applied before the next frame:
//! a camera is known before its first frame, and no frame of a removed camera is used.

use roundel_core::id::CameraId;

use super::FusionTask;
use crate::model::{
    command::{
        CameraChange, CameraModel, CameraPose, CameraUpdate, ClockModel, FusionCommand,
        FusionSettings,
    },
    tap::RecordedItem,
};

impl FusionTask {
    pub(super) fn process_commands(&mut self) {
        while let Ok(command) = self.commands.try_recv() {
            match command {
                FusionCommand::UpdateCamera(update) => self.apply_camera_update(update),
                FusionCommand::SetParams(settings) => self.apply_settings(*settings),
            }
        }
    }

    /// Applies and records a change of a camera.
    pub fn apply_camera_update(&mut self, update: CameraUpdate) {
        let CameraUpdate { camera, change } = update.clone();
        self.hub.tap().update_camera(update);
        match change {
            CameraChange::Set(model) => self.set_camera(camera, *model),
            CameraChange::Removed => {
                self.cameras.remove(&camera);
                self.latency_ms.remove(&camera);
                self.mounted_cameras.remove(camera);
                self.fusion.remove_camera(camera);
                if let Some(camera_monitor) = &mut self.camera_monitor {
                    camera_monitor.forget(camera);
                }
            }
            CameraChange::Localized(placement) => {
                self.fusion.set_camera(camera, Some(*placement));
                if let Some(camera_monitor) = &mut self.camera_monitor {
                    camera_monitor.set(camera, *placement, false);
                }
            }
            CameraChange::HoldBackExempt(is_exempt) => {
                self.fusion.set_hold_back_exempt(camera, is_exempt);
            }
            CameraChange::Quarantined => self.fusion.quarantine(camera),
        }
    }

    /// Applies and records other settings.
    pub fn apply_settings(&mut self, settings: FusionSettings) {
        let FusionSettings { params, objects, config } = settings;
        self.hub.tap().offer(|| RecordedItem::Settings(config));
        for (kind, offset_m, motion) in objects.kinds {
            self.fusion.set_offset(kind, offset_m);
            self.fusion.change_motion(kind, motion);
        }
        if let Err(error) = self.fusion.set_bodies(&objects.bodies) {
            // The configuration was checked for this.
            tracing::error!(%error, "the changed objects are not tracked");
        }
        if let Some(params) = params {
            self.fusion.set_params(params);
        }
    }

    fn set_camera(&mut self, camera: CameraId, model: CameraModel) {
        self.cameras.insert(camera);
        if let Some(clock) = model.clock {
            self.fusion.forget_source(camera);
            if let ClockModel::Estimated(prior) = clock {
                self.fusion.set_clock(camera, prior);
            }
        }
        if let Some(trust) = model.trust {
            self.fusion.set_trust(camera, trust);
            if let Some(camera_monitor) = &mut self.camera_monitor {
                camera_monitor.set_trust(camera, trust);
            }
        }
        let Some(pose) = model.pose else { return };
        self.mounted_cameras.remove(camera);
        let (placement, mount) = match &pose {
            CameraPose::Fixed { placement, .. } => (Some(*placement), None),
            CameraPose::Unknown => (None, None),
            CameraPose::Mounted(mount, _) => (None, *mount),
        };
        self.fusion.set_mount(camera, mount);
        self.fusion.set_camera(camera, placement);
        if let Some(camera_monitor) = &mut self.camera_monitor {
            match pose {
                CameraPose::Fixed { placement, is_configured } => {
                    camera_monitor.set(camera, placement, is_configured);
                }
                CameraPose::Unknown | CameraPose::Mounted(..) => camera_monitor.remove(camera),
            }
        }
        if let CameraPose::Mounted(_, info) = pose {
            self.mounted_cameras.set(camera, info);
        }
    }
}

//! Cameras and objects that come, change and go while fusion runs.
//!
//! Orders are few and none may be lost, so they have a queue of their own, which is never full. They are obeyed before
//! the next frame is taken: a camera is known before its first frame, and of one that was removed no frame is used.

use roundel_core::{id::CameraId, world::FusionParams};

use super::FusionTask;
use crate::model::{
    command::{Change, Known, ObjectOrder, Order, Settings, Stand, Timekeeping, Told},
    tap::Item,
};

impl FusionTask {
    /// Obeys what was ordered by now.
    pub(super) fn obey(&mut self) {
        while let Ok(order) = self.orders.try_recv() {
            match order {
                Order::Set(camera, known) => {
                    self.be_told(Told { camera, change: Change::Set(known) });
                }
                Order::Remove(camera) => self.be_told(Told { camera, change: Change::Removed }),
                Order::Settings(settings) => self.be_set(*settings),
            }
        }
    }

    /// Takes what there is to know of a camera; a recording hears of it.
    pub fn be_told(&mut self, told: Told) {
        let Told { camera, change } = told.clone();
        self.hub.tap().tell(told);
        match change {
            Change::Set(known) => self.set(camera, *known),
            Change::Removed => self.remove(camera),
            Change::Placed(placement) => {
                self.fusion.set_camera(camera, Some(*placement));
                self.watching.iter_mut().for_each(|watching| watching.place(camera, *placement));
            }
            Change::Spared(is_spared) => self.fusion.spare(camera, is_spared),
            Change::Quarantined => self.fusion.quarantine(camera),
        }
    }

    /// Goes by other settings; a recording hears of it.
    pub fn be_set(&mut self, settings: Settings) {
        let Settings { limits, order, written } = settings;
        self.hub.tap().offer(|| Item::Settings(written));
        self.follow(&order);
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

    fn follow(&mut self, order: &ObjectOrder) {
        for &(kind, offset_m, motion) in &order.kinds {
            self.fusion.set_offset(kind, offset_m);
            self.fusion.change_motion(kind, motion);
        }
        if let Err(error) = self.fusion.set_bodies(&order.bodies) {
            // The configuration has been checked for that.
            tracing::error!(%error, "the objects that were changed are not followed as such");
        }
    }

    fn set(&mut self, camera: CameraId, known: Known) {
        self.cameras.insert(camera);
        if let Some(clock) = known.clock {
            self.fusion.forget_source(camera);
            if let Timekeeping::Estimated(prior) = clock {
                self.fusion.set_clock(camera, prior);
            }
        }
        let watching = self.watching.as_mut();
        match known.place {
            None => {}
            Some(Stand::At { placement, is_written }) => {
                self.riding.remove(camera);
                self.fusion.set_mount(camera, None);
                self.fusion.set_camera(camera, Some(placement));
                watching.into_iter().for_each(|it| it.set(camera, placement, is_written));
            }
            Some(Stand::Unknown) => {
                self.riding.remove(camera);
                self.fusion.set_mount(camera, None);
                self.fusion.set_camera(camera, None);
                watching.into_iter().for_each(|it| it.remove(camera));
            }
            Some(Stand::On(mount, ride)) => {
                self.riding.set(camera, ride);
                self.fusion.set_camera(camera, None);
                self.fusion.set_mount(camera, mount);
                watching.into_iter().for_each(|it| it.remove(camera));
            }
        }
    }

    fn remove(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
        self.latency_ms.remove(&camera);
        self.riding.remove(camera);
        self.watching.iter_mut().for_each(|it| it.remove(camera));
        self.fusion.remove_camera(camera);
    }
}

//! Cameras that come, change and go while fusion runs.
//!
//! Orders are few and none may be lost, so they have a queue of their own, which is never full. They are obeyed before
//! the next frame is taken: a camera is known before its first frame, and of one that was removed no frame is used.

use roundel_core::{
    id::CameraId,
    world::{CameraMount, CameraPlacement, ClockPrior},
};

use super::FusionTask;
use crate::hub::RideInfo;

/// What is to become of a camera.
#[derive(Clone, Debug)]
pub enum Order {
    /// It is there, and this is what is known of it.
    Set(CameraId, Box<Known>),
    /// It is there no more.
    Remove(CameraId),
}

/// What is known of a camera.
#[derive(Clone, Debug)]
pub struct Known {
    /// Where it stands or what it rides on; `None`: as before.
    pub place: Option<Stand>,
    /// How it keeps time; `None`: as before.
    pub clock: Option<Timekeeping>,
}

/// Where a camera stands or what it rides on.
#[derive(Clone, Debug)]
pub enum Stand {
    /// There.
    At {
        /// Where.
        placement: CameraPlacement,
        /// Whether a person has written it, who may not have measured well.
        is_written: bool,
    },
    /// Its worker will tell.
    Unknown,
    /// On an object; without a mount, on one that is not followed.
    On(Option<CameraMount>, RideInfo),
}

/// How a camera keeps time, of which nothing was learned yet.
#[derive(Clone, Copy, Debug)]
pub enum Timekeeping {
    /// Its stamps are right.
    Exact,
    /// They may be off.
    Estimated(ClockPrior),
}

impl FusionTask {
    /// Obeys what was ordered by now.
    pub(super) fn obey(&mut self) {
        while let Ok(order) = self.orders.try_recv() {
            match order {
                Order::Set(camera, known) => self.set(camera, *known),
                Order::Remove(camera) => self.remove(camera),
            }
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

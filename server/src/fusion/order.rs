//! Cameras and objects that come, change and go while fusion runs.
//!
//! Orders are few and none may be lost, so they have a queue of their own, which is never full. They are obeyed before
//! the next frame is taken: a camera is known before its first frame, and of one that was removed no frame is used.

use nalgebra::Vector3;
use roundel_core::{
    id::{BodyId, CameraId, KindId},
    world::{Body, CameraMount, CameraPlacement, ClockPrior, FusionParams, MotionClass},
};

use super::FusionTask;
use crate::{
    hub::RideInfo,
    record::tap::{Change, Item, Told},
};

/// What is to become of a camera, or of objects.
#[derive(Clone, Debug)]
pub enum Order {
    /// It is there, and this is what is known of it.
    Set(CameraId, Box<Known>),
    /// It is there no more.
    Remove(CameraId),
    /// Objects are known by something else than before, or may do something else.
    Settings(Box<Settings>),
}

/// What is another in the settings than before.
#[derive(Clone, Debug)]
pub struct Settings {
    /// How long objects are predicted and remembered, and how many there may be; `None`: as before.
    pub limits: Option<FusionLimits>,
    /// What objects are known by.
    pub order: ObjectOrder,
    /// The configuration that says so.
    pub written: WrittenSettings,
}

/// A configuration that fusion goes by from some moment on.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WrittenSettings {
    /// Its text, without passwords.
    pub text: String,
    /// The object that has another name than in the one before, and that name.
    pub renamed: Option<(String, String)>,
}

/// What fusion lets objects do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionLimits {
    /// Rms acceleration that objects are capable of, m/s²; of tracks that begin from now on.
    pub acceleration_m_s2: f64,
    /// Not seen for so long: predicted, seconds.
    pub predicted_after_s: f64,
    /// Not seen for so long: lost, seconds.
    pub lost_after_s: f64,
    /// Followed at most.
    pub max_objects: usize,
}

/// What is another in objects than before.
#[derive(Clone, Debug, Default)]
pub struct ObjectOrder {
    /// What bodies carry; nothing of one that was removed.
    pub bodies: Vec<(BodyId, Body)>,
    /// Of what is known by a whole kind: the followed point in the roundel's frame, metres, and how it moves.
    pub kinds: Vec<(KindId, Vector3<f64>, MotionClass)>,
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

//! Commands to the fusion thread.

use nalgebra::Vector3;
use roundel_core::{
    id::{BodyId, CameraId, KindId},
    world::{Body, CameraMount, CameraPlacement, ClockPrior, MotionClass},
};

use super::camera::MountInfo;

/// What is to become of a camera, or of objects.
#[derive(Clone, Debug)]
pub enum FusionCommand {
    /// It is there, and this is what is known of it.
    SetCamera(CameraId, Box<CameraModel>),
    /// It is there no more.
    RemoveCamera(CameraId),
    /// Objects are known by something else than before, or may do something else.
    SetParams(Box<FusionSettings>),
}

/// What is another in the settings than before.
#[derive(Clone, Debug)]
pub struct FusionSettings {
    /// How long objects are predicted and remembered, and how many there may be; `None`: as before.
    pub limits: Option<FusionLimits>,
    pub objects: ObjectUpdate,
    pub config: AppliedConfig,
}

/// A configuration that fusion goes by from some moment on.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AppliedConfig {
    /// Its text, without passwords.
    pub text: String,
    /// The object that has another name than in the one before, and that name.
    pub renamed: Option<(String, String)>,
}

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
pub struct ObjectUpdate {
    /// What bodies carry; nothing of one that was removed.
    pub bodies: Vec<(BodyId, Body)>,
    /// Of what is known by a whole kind: the followed point in the roundel's frame, metres, and how it moves.
    pub kinds: Vec<(KindId, Vector3<f64>, MotionClass)>,
}

/// What is known of a camera.
#[derive(Clone, Debug)]
pub struct CameraModel {
    /// Where it stands or what it rides on; `None`: as before.
    pub pose: Option<CameraPose>,
    /// How it keeps time; `None`: as before.
    pub clock: Option<ClockModel>,
}

/// Where a camera stands or what it rides on.
#[derive(Clone, Debug)]
pub enum CameraPose {
    Fixed {
        placement: CameraPlacement,
        /// Whether a person has written it, who may not have measured well.
        is_configured: bool,
    },
    Unknown,
    /// On an object; without a mount, on one that is not followed.
    Mounted(Option<CameraMount>, MountInfo),
}

/// How a camera keeps time, of which nothing was learned yet.
#[derive(Clone, Copy, Debug)]
pub enum ClockModel {
    Exact,
    /// They may be off.
    Estimated(ClockPrior),
}

/// What fusion is told of a camera.
#[derive(Clone, Debug)]
pub struct CameraUpdate {
    pub camera: CameraId,
    pub change: CameraChange,
}

/// What fusion can be told of a camera.
#[derive(Clone, Debug)]
pub enum CameraChange {
    /// It is there, and so much is known of it.
    Set(Box<CameraModel>),
    /// Its worker has found it there.
    Localized(Box<CameraPlacement>),
    /// Whether it is not held back when it disagrees with others.
    HoldBackExempt(bool),
    Quarantined,
    /// It is there no more.
    Removed,
}

//! Commands to the fusion thread, and the camera updates that recordings keep.

use nalgebra::Vector3;
use roundel_core::{
    id::{BodyId, CameraId, KindId},
    world::{Body, CameraMount, CameraPlacement, ClockPrior, FusionParams, MotionClass},
};

use super::camera::MountInfo;

/// Changes cameras, objects or parameters while fusion runs.
#[derive(Clone, Debug)]
pub enum FusionCommand {
    /// [`CameraChange::Set`] adds unknown cameras.
    UpdateCamera(CameraUpdate),
    SetParams(Box<FusionSettings>),
}

/// Parameters and objects of one configuration.
#[derive(Clone, Debug)]
pub struct FusionSettings {
    /// `None`: unchanged.
    pub params: Option<FusionParams>,
    pub objects: ObjectUpdate,
    pub config: AppliedConfig,
}

/// The configuration that fusion applied, for recordings.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AppliedConfig {
    /// TOML without passwords.
    pub text: String,
    /// Old and new name of the object that the change renamed.
    pub renamed: Option<(String, String)>,
}

/// Difference between two versions of the configured objects.
#[derive(Clone, Debug, Default)]
pub struct ObjectUpdate {
    /// Bodies that changed; an empty body was removed.
    pub bodies: Vec<(BodyId, Body)>,
    /// Objects identified by their kind: followed point in the roundel's frame, metres, and motion class.
    pub kinds: Vec<(KindId, Vector3<f64>, MotionClass)>,
}

/// Pose, clock and rank of a camera as configured or calibrated.
#[derive(Clone, Debug, Default)]
pub struct CameraModel {
    /// `None`: unchanged.
    pub pose: Option<CameraPose>,
    /// `None`: unchanged.
    pub clock: Option<ClockModel>,
    /// `None`: unchanged.
    pub trust: Option<u8>,
}

#[derive(Clone, Debug)]
pub enum CameraPose {
    Fixed {
        placement: CameraPlacement,
        /// From the configuration, and therefore possibly measured by hand.
        is_configured: bool,
    },
    Unknown,
    /// On a moving object; no mount if that object is not tracked.
    Mounted(Option<CameraMount>, MountInfo),
}

/// Prior of a camera's clock, before fusion has estimated it.
#[derive(Clone, Copy, Debug)]
pub enum ClockModel {
    Exact,
    Estimated(ClockPrior),
}

/// One change of a camera as fusion applied it.
#[derive(Clone, Debug)]
pub struct CameraUpdate {
    pub camera: CameraId,
    pub change: CameraChange,
}

#[derive(Clone, Debug)]
pub enum CameraChange {
    Set(Box<CameraModel>),
    /// The worker estimated the pose from references.
    Localized(Box<CameraPlacement>),
    /// Whether detections are used although they disagree with other cameras.
    HoldBackExempt(bool),
    Quarantined,
    Removed,
}

//! All objects in the world frame, from all cameras: the fusion machine.
//!
//! [`Fusion`] takes what cameras saw, each observation with its own time and covariance, in any
//! order, and gives snapshots and events. It is a pure state machine: it reads no clock, and the
//! same calls give the same bits. What is where: `timeline` judges frames by their times, `gap` counts those
//! that never came,
//! `observation` carries detections into the world, `association` says which object each one is
//! of, [`crate::track`] estimates, `life` tells new from trusted from lost, `merge` joins two
//! tracks of one object, `vote` counts the codes that it was seen with, `identity` gives an object that returns its
//! id again, `snapshot` shows the result at an instant. `body` knows the objects that carry several
//! roundels, and `assembly` makes one measurement of these. Cameras that move are placed by what carries them (`rider`), and place it by landmarks
//! that they see (`landmark`, `localize`). `floor` tells when what drives is not as high as was said; `guard` holds
//! cameras back that suddenly disagree with all others; `trust` keeps less trusted cameras from moving what others see.

mod association;
mod body;
mod camera_outlier;
mod camera_pose;
mod clock;
mod counts;
mod fusion;
mod height_check;
mod identity;
mod lifecycle;
mod measurement;
mod mobile_camera;
mod params;
mod snapshot;

pub use body::{Body, BodyError, Mount};
pub use camera_outlier::{HeldBack, HeldStep};
pub use camera_pose::CameraPlacement;
pub use clock::{ClockEstimate, ClockPrior};
pub use counts::FusionCounts;
pub use fusion::{Compared, Fusion};
pub use height_check::WrongHeight;
pub use measurement::seen_in_world;
pub use mobile_camera::{CameraMount, Carrier, Landmark, TURN_SIGMA_RAD, Unplaced};
pub use params::{FusionParams, MotionClass};

pub mod reference;

use nalgebra::{UnitQuaternion, Vector3};

use roundel_vision::{
    id::{BodyId, CameraId, KindId, ObjectId},
    marker::Code,
    pose::Detection,
    rigid::Covariance6,
    time::Timestamp,
};

/// One camera's detections of one frame: what a worker hands to fusion.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameObservations {
    /// Which camera.
    pub camera: CameraId,
    /// Frames that the worker took from its source so far, from 1.
    pub frame: u64,
    /// Middle of the exposure at the middle row.
    pub capture_time: Timestamp,
    /// When the worker had the frame.
    pub received_time: Timestamp,
    /// Version of the calibration that the poses were computed with.
    pub calibration_version: u64,
    /// What was found, each roundel once.
    pub detections: Vec<Detection>,
}

/// A track's life stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LifeStage {
    /// Seen too seldom yet to be trusted.
    Tentative,
    /// Observed now.
    Tracked,
    /// Not observed now; the motion model's pose.
    Predicted,
    /// Given up.
    Lost,
}

/// One object's estimate at a snapshot's pose time.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectState {
    /// Given at first sight.
    pub id: ObjectId,
    /// Its kind of roundel; of a body that of its first one.
    pub kind: Option<KindId>,
    /// Which body, if its roundels are those of one: then position and orientation are its origin's and axes'.
    pub body: Option<BodyId>,
    /// The code that it was seen with most of late; `None` before one was read.
    pub code: Option<Code>,
    /// Where in its life.
    pub stage: LifeStage,
    /// Tracked point, world frame, metres.
    pub position_m: Vector3<f64>,
    /// world_from_object.
    pub orientation: UnitQuaternion<f64>,
    /// False while the rotation about the normal is not observed.
    pub yaw_observed: bool,
    /// In how many evenly spaced yaws it looks the same while that is observed: 2 with an elliptical disc,
    /// of which the one first taken up is kept, else 1.
    pub yaw_symmetry: u32,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// By which the velocity goes on to change for some tenths of a second, world frame, m/s².
    pub acceleration_m_s2: Vector3<f64>,
    /// World frame, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Over (position, rotation), world frame, left perturbation.
    pub covariance: Covariance6,
    /// Over (position, velocity), world frame; its first block is that of `covariance`.
    pub motion_covariance: Covariance6,
    /// Over (rotation, angular velocity), world frame; its first block is the last of `covariance`.
    pub rotation_covariance: Covariance6,
    /// By which both grow when the state is predicted.
    pub process_noise: ProcessNoise,
    /// Cameras that contributed within the last 200 ms, ascending.
    pub cameras: Vec<CameraId>,
    /// Highest rank ([`Fusion::set_trust`]) of the cameras that see it, or were the last to see it.
    pub trust: u8,
    /// Capture time of the newest observation used.
    pub newest_observation: Timestamp,
    /// Newest innovation's Mahalanobis distance squared over its degrees of freedom.
    pub residual: f64,
    /// First sight's capture time.
    pub first_observation: Timestamp,
    /// Detections used since then.
    pub observations: u64,
}

/// What an object may do that constant velocity does not foresee: spectral densities of white
/// acceleration and white angular acceleration along the axes of the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProcessNoise {
    /// m²/s³.
    pub acceleration_density_m2_s3: Vector3<f64>,
    /// rad²/s³.
    pub angular_density_rad2_s3: Vector3<f64>,
}

/// Every track at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// What every state is predicted to.
    pub pose_time: Timestamp,
    /// Newest observation used; `None` before the first.
    pub capture_time: Option<Timestamp>,
    /// By id.
    pub objects: Vec<ObjectState>,
}

/// Something that happened to a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// A tentative track has become trusted.
    Appeared,
    /// No camera sees it any more.
    Predicted,
    /// Seen again after it was predicted.
    Recovered,
    /// Given up.
    Lost,
}

/// A change in a track's life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// When, on the observations' time.
    pub time: Timestamp,
    /// Whose.
    pub object: ObjectId,
    /// What.
    pub kind: EventKind,
}

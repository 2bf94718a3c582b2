//! Fusion of all cameras' detections into tracks in the world frame.
//!
//! [`Fusion`] takes the observations of all cameras, each with its own time and covariance, in any order, and returns
//! snapshots and events. It is a pure state machine: it reads no clock, and the same calls give the same bits.
//!
//! A frame passes these stages, in this order:
//!
//! | module | stage |
//! | --- | --- |
//! | `clock` | corrects stamps, judges frames by their times, counts missing frames, estimates clock offsets |
//! | `mobile_camera` | pose of a camera that moves with an object, and of the object from landmarks that the camera detects |
//! | `print_size` | estimates how large the prints of a kind are |
//! | `measurement` | transforms detections into the world frame |
//! | `body` | joins the detections of an object with several roundels into one measurement |
//! | `association` | assigns measurements to tracks |
//! | `camera_outlier` | rejects frames of a camera that suddenly disagrees with all others |
//! | `height_check` | reports a configured height that the cameras contradict |
//! | [`crate::track`] | filters one object |
//! | `lifecycle` | confirms, loses and merges tracks; keeps ids; ranks cameras by trust |
//! | `snapshot` | predicts all tracks to one time |
//!
//! `identity` holds what identifies an object, `fusion` the state machine that calls these stages. [`mod@reference`]
//! computes the pose of a camera from roundels at known positions.

mod association;
mod body;
mod camera_outlier;
mod clock;
mod counts;
mod fusion;
mod height_check;
mod identity;
mod lifecycle;
mod measurement;
mod mobile_camera;
mod params;
mod print_size;
mod snapshot;

pub use body::{Body, BodyError, Mount};
pub use camera_outlier::{HeldBack, HeldStep};
pub use clock::{ClockEstimate, ClockPrior};
pub use counts::FusionCounts;
pub use fusion::{Fusion, LeaveOneOut};
pub use height_check::WrongHeight;
pub use measurement::{CameraPlacement, PrintSize, seen_in_world};
pub use mobile_camera::{CameraMount, Carrier, Landmark, TURN_SIGMA_RAD, Unplaced};
pub use params::{FusionParams, MotionClass};
pub use print_size::{KindPrintSize, PrintSizeState};

pub mod reference;

use nalgebra::{UnitQuaternion, Vector3};

use roundel_vision::{
    id::{BodyId, CameraId, KindId, ObjectId},
    marker::Code,
    pose::Detection,
    rigid::Covariance6,
    time::Timestamp,
};

/// One camera's detections of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameObservations {
    /// Camera that took the frame.
    pub camera: CameraId,
    /// Number of frames that the worker has taken from its source, from 1.
    pub frame: u64,
    /// Middle of the exposure at the middle row.
    pub capture_time: Timestamp,
    /// Time at which the worker received the frame.
    pub received_time: Timestamp,
    /// Version of the calibration that the poses were computed with.
    pub calibration_version: u64,
    /// Detected roundels, each once.
    pub detections: Vec<Detection>,
}

/// Life stage of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LifeStage {
    /// Too few detections to be confirmed.
    Tentative,
    /// Observed at present.
    Tracked,
    /// Not observed at present; the pose is predicted.
    Predicted,
    /// Ended.
    Lost,
}

/// State of one object at a snapshot's pose time.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectState {
    /// Assigned with the first detection.
    pub id: ObjectId,
    /// Kind of its roundel; of its first roundel for a body.
    pub kind: Option<KindId>,
    /// The body, for an object with configured roundels. Position and orientation are then those of its origin
    /// and axes.
    pub body: Option<BodyId>,
    /// Code of most recent readings; `None` before the first reading.
    pub code: Option<Code>,
    /// Life stage.
    pub stage: LifeStage,
    /// Tracked point, world frame, metres.
    pub position_m: Vector3<f64>,
    /// world_from_object.
    pub orientation: UnitQuaternion<f64>,
    /// False while the rotation about the normal is not observed.
    pub yaw_observed: bool,
    /// Number of evenly spaced yaws that look the same, while the yaw is observed: 2 for an elliptical disc,
    /// whose first adopted yaw is kept, else 1.
    pub yaw_symmetry: u32,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Change of the velocity over the next tenths of a second, world frame, m/s².
    pub acceleration_m_s2: Vector3<f64>,
    /// World frame, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Over (position, rotation), world frame, left perturbation.
    pub covariance: Covariance6,
    /// Over (position, velocity), world frame; its first block is that of `covariance`.
    pub motion_covariance: Covariance6,
    /// Over (rotation, angular velocity), world frame; its first block is the last of `covariance`.
    pub rotation_covariance: Covariance6,
    /// Process noise by which the covariances grow in predictions.
    pub process_noise: ProcessNoise,
    /// Cameras that contributed within the last 200 ms, ascending.
    pub cameras: Vec<CameraId>,
    /// Highest rank ([`Fusion::set_trust`]) of the cameras that observe it, or observed it last.
    pub trust: u8,
    /// Capture time of the newest observation used.
    pub newest_observation: Timestamp,
    /// Squared Mahalanobis length of the newest innovation over its degrees of freedom.
    pub residual: f64,
    /// Capture time of the first detection.
    pub first_observation: Timestamp,
    /// Number of detections used.
    pub observations: u64,
}

/// Spectral densities of white acceleration and white angular acceleration along the axes of the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProcessNoise {
    /// m²/s³.
    pub acceleration_density_m2_s3: Vector3<f64>,
    /// rad²/s³.
    pub angular_density_rad2_s3: Vector3<f64>,
}

/// All tracks at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Time of every state.
    pub pose_time: Timestamp,
    /// Newest observation used; `None` before the first.
    pub capture_time: Option<Timestamp>,
    /// In ascending order of id.
    pub objects: Vec<ObjectState>,
}

/// Kind of an [`Event`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// A tentative track was confirmed.
    Appeared,
    /// No camera observes it any more.
    Predicted,
    /// Observed again after it was predicted.
    Recovered,
    /// Ended.
    Lost,
}

/// Change of a track's life stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// Time of the change, on the time scale of observations.
    pub time: Timestamp,
    /// The object.
    pub object: ObjectId,
    /// The change.
    pub kind: EventKind,
}

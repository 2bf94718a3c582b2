//! Cameras that ride on tracked objects: where such a camera is when it exposes, and how far off.
//!
//! With the carrier's pose (R, p) at the exposure's own time, from its track's rewind history, and the
//! mount (Rₘ, tₘ), the camera is at p + R tₘ, turned by R Rₘ. The carrier's error (δp, δθ) moves it by
//! J = [I -[R tₘ]×; 0 I], and the mount's error is turned along.
//!
//! A carrier's error is neither the same from frame to frame nor fresh in each:
//!
//! - what its cameras' systematic errors have made of it, S = Σ C_c C_cᵀ (the correlations that its filter
//!   carries, [`crate::track::Kernel`]), lasts as long as those do: it counts as systematic, and so does
//!   all of the mount's error;
//! - the rest, N = P - S, lasts as long as the filter remembers: T = √(tr N / tr D), with the rate's
//!   covariance D (in a steady filter of a value and its rate D = ω² P and T = 1/ω). Frames dt < T apart
//!   see nearly the same one. It counts as fresh, but T / dt times as large: from noise of density r such
//!   a filter has P = √2 r ω and an error whose power is r at rest and 1.5 r at most, which white noise of
//!   the variance P T / dt = √2 r / dt just covers. More would be no safer: who sees noise that is not
//!   there believes that objects move less than they do.
//!
//! `core/tests/fusion/rider.rs` and the scenario `drone` hold the result against the truth.
//!
//! What carries a camera is never located by a camera that rides, only by cameras that stand and by its
//! own sight of landmarks (`localize`). So errors go from cameras that stand to carriers to what
//! these see and never back, and no two estimates can make each other sure. The price: a drone that only
//! another drone sees carries no camera of use.
//!
//! Limits: that all objects which one carrier's camera sees err together is not told, only by how much
//! each errs; nor that they share a standing camera's error with the carrier. What stamps frames late on
//! board is not estimated: a doubtful clock widens the camera's place by what the carrier moves meanwhile.

use nalgebra::Matrix3;

use crate::track::{Estimate, FilterState, MotionModel};
use crate::world::{
    LifeStage,
    camera_pose::{ExposurePose, with_lever_arm},
    identity::Subject,
    lifecycle::Track,
};
use roundel_vision::{
    id::{BodyId, KindId},
    marker::Code,
    rigid::{Covariance6, Rigid, rotate_covariance},
    time::Timestamp,
};

/// No camera takes frames more often, seconds.
const MIN_PERIOD_S: f64 = 1e-3;

/// The object that carries a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// By the roundel on it. Without a code it has no yaw that a camera could be placed by.
    Roundel {
        /// Its kind.
        kind: KindId,
        /// Its code.
        code: Code,
    },
    /// By the roundels that [`super::Fusion::add_body`] was told of.
    Body(BodyId),
}

/// A camera fixed to an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraMount {
    /// What it is fixed to.
    pub carrier: Carrier,
    /// The camera in the frame of the carrier: of its roundel, or of the body.
    pub object_from_camera: Rigid,
    /// Over (position, rotation), that frame, left perturbation; zero when exact.
    pub covariance: Covariance6,
    /// Whether what it sees of landmarks says where the carrier is ([`super::Landmark`]).
    pub localizes: bool,
}

/// Why a camera has no place now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unplaced {
    /// Nobody has said where it stands.
    Unknown,
    /// What carries it is not followed, or is there twice.
    CarrierUnseen,
    /// How its carrier is turned about its normal is not observed, or only up to half a turn.
    CarrierWithoutYaw,
    /// Its carrier may be turned by so much that nothing could be said.
    CarrierUncertain,
}

/// A carrier at the time of a frame.
#[derive(Clone, Copy, Debug)]
pub(in crate::world) struct CarrierState {
    pub(super) estimate: FilterState,
    pub(super) model: MotionModel,
    pub(super) mount: CameraMount,
    /// To the camera's frame before, seconds.
    pub(super) period_s: Option<f64>,
    /// What its clock may be off by, seconds.
    pub(super) clock_s: f64,
}

impl Carrier {
    /// Whether what is seen as this is it.
    pub(super) fn is(&self, subject: &Subject, code: Option<Code>) -> bool {
        match *self {
            Self::Roundel { kind, code: own } => {
                subject.body.is_none() && subject.kind == Some(kind) && code == Some(own)
            }
            Self::Body(body) => subject.body == Some(body),
        }
    }
}

/// The one track of a carrier; none if there are two.
pub(in crate::world) fn find_carrier_track(carrier: &Carrier, tracks: &[Track]) -> Option<usize> {
    let is_carrier = |track: &Track| {
        let is_followed = matches!(track.stage, LifeStage::Tracked | LifeStage::Predicted);
        is_followed && carrier.is(&track.subject, track.codes.settled())
    };
    let mut found = (0..tracks.len()).filter(|&index| is_carrier(&tracks[index]));
    let first = found.next();
    first.filter(|_| found.next().is_none())
}

impl CarrierState {
    /// The camera at the exposure of one of the frame's rows.
    pub(in crate::world) fn pose_at(&self, time: Timestamp) -> ExposurePose {
        let mut estimate = self.estimate;
        estimate.predict(time, &self.model);
        let Estimate { motion, attitude, .. } = estimate.estimate(time, &self.model);
        let mount = &self.mount;
        let arm_m = attitude.orientation * mount.object_from_camera.translation.vector;
        let world_from_camera = Rigid::from_parts(
            (motion.position_m + arm_m).into(),
            attitude.orientation * mount.object_from_camera.rotation,
        );
        let turning = attitude.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let turn = attitude.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let mut parts = [Covariance6::zeros(); 2];
        let systematic =
            [estimate.motion.systematic_covariance(), estimate.attitude.systematic_covariance()];
        let rates = [motion.velocity_m_s, attitude.angular_velocity_rad_s];
        let totals = [(motion.spread.value, motion.spread.rate), (turn, turning)];
        for (block, ((value, rate), systematic)) in totals.into_iter().zip(systematic).enumerate() {
            let rest = value - systematic;
            let fresh = rest * self.inflation(&rest, &rate);
            let clock = rates[block] * self.clock_s;
            let systematic = systematic + clock * clock.transpose();
            for (part, covariance) in parts.iter_mut().zip([systematic, fresh]) {
                part.fixed_view_mut::<3, 3>(3 * block, 3 * block).copy_from(&covariance);
            }
        }
        let [systematic, fresh] = parts.map(|part| with_lever_arm(&part, &arm_m));
        let mounted = rotate_covariance(&attitude.orientation, &mount.covariance);
        ExposurePose { world_from_camera, systematic: systematic + mounted, fresh }
    }

    /// The camera at the frame's time, with all of its error.
    pub(in crate::world) fn mean_pose(&self) -> (Rigid, Covariance6) {
        let alone = Self { period_s: None, ..*self };
        let camera_pose = alone.pose_at(self.estimate.time);
        (camera_pose.world_from_camera, camera_pose.systematic + camera_pose.fresh)
    }

    /// Deviations of the carrier's velocity, m/s, and angular velocity, rad/s, along each axis.
    pub(in crate::world) fn rate_deviations(&self) -> (f64, f64) {
        let motion = self.estimate.motion.estimate(0.0, &self.model).spread.rate;
        let turning = self.estimate.attitude.estimate(0.0, &self.model).covariance;
        let turning = turning.fixed_view::<3, 3>(3, 3).trace();
        ((motion.trace() / 3.0).max(0.0).sqrt(), (turning / 3.0).max(0.0).sqrt())
    }

    /// T / dt, at least 1; 1 while nobody knows dt.
    fn inflation(&self, rest: &Matrix3<f64>, rate: &Matrix3<f64>) -> f64 {
        let memory_s = (rest.trace().max(0.0) / rate.trace().max(f64::MIN_POSITIVE)).sqrt();
        self.period_s.map_or(1.0, |period_s| (memory_s / period_s.max(MIN_PERIOD_S)).max(1.0))
    }
}

//! Pose of a camera that is fixed to a tracked object, with its error.
//!
//! With the carrier's pose (R, p) at the time of exposure, from its track's rewind history, and the mount (Rₘ, tₘ), the
//! camera is at p + R tₘ with orientation R Rₘ. The carrier's error (δp, δθ) moves it by J = [I -[R tₘ]×; 0 I], and the
//! mount's error is rotated along.
//!
//! A carrier's error is neither the same in all frames nor independent between them:
//!
//! - The part by its cameras' systematic errors, S = Σ C_c C_cᵀ (the correlations that its filter carries,
//!   [`crate::track::Kalman`]), lasts as long as those. It counts as systematic, and so does all of the mount's error.
//! - The rest, N = P - S, lasts as long as the filter's memory: T = √(tr N / tr D), with the rate's covariance D (in
//!   the steady state D = ω² P and T = 1/ω). Frames dt < T apart have nearly the same error. It counts as fresh, but T
//!   / dt times as large: a filter of noise density r has P = √2 r ω and an error whose power is r at rest and 1.5 r at
//!   most, which white noise of variance P T / dt = √2 r / dt just covers. A larger factor would not be safer:
//!   overstated noise makes objects appear to move less than they do.
//!
//! `core/tests/fusion/mobile_camera.rs` and the scenario `drone` compare the result with the truth.
//!
//! A carrier is never measured by a mobile camera, only by stationary cameras and by its own detections of landmarks
//! (`localize`). Errors pass from stationary cameras to carriers to the objects that these detect and never back, so no
//! two estimates reinforce each other. The price: a drone that only another drone observes carries no usable camera.
//!
//! Limits: the common error of all objects that one carrier's camera detects is not reported, only the error of each;
//! neither is the error that they share with the carrier through a stationary camera. A late clock on board is not
//! estimated: an uncertain clock widens the camera's pose by the carrier's motion.

use nalgebra::Matrix3;

use crate::track::{Estimate, FilterState, MotionModel};
use crate::world::{
    LifeStage,
    identity::Subject,
    lifecycle::Track,
    measurement::{ExposurePose, with_lever_arm},
};
use roundel_vision::{
    id::{BodyId, KindId},
    marker::Code,
    rigid::{Covariance6, Rigid, rotate_covariance},
    time::Timestamp,
};

/// Smallest interval between frames, seconds.
const MIN_PERIOD_S: f64 = 1e-3;

/// The object that carries a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// An object with one coded roundel. Without a code it would have no yaw.
    Roundel {
        /// Kind of the roundel.
        kind: KindId,
        /// Code of the roundel.
        code: Code,
    },
    /// A body added by [`super::super::Fusion::add_body`].
    Body(BodyId),
}

/// Mount of a camera on an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraMount {
    /// The object.
    pub carrier: Carrier,
    /// Camera in the frame of the carrier: of its roundel, or of the body.
    pub object_from_camera: Rigid,
    /// Over (position, rotation), carrier frame, left perturbation; zero when exact.
    pub covariance: Covariance6,
    /// Whether detections of landmarks ([`super::super::Landmark`]) measure the carrier.
    pub localizes: bool,
}

/// Reason why a camera has no pose at present.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unplaced {
    /// No pose was set.
    Unknown,
    /// The carrier is not tracked, or has two tracks.
    CarrierUnseen,
    /// The carrier's yaw is not observed, or only up to half a turn.
    CarrierWithoutYaw,
    /// The carrier's orientation is too uncertain.
    CarrierUncertain,
}

/// State of a carrier at the time of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CarrierState {
    pub(super) state: FilterState,
    pub(super) model: MotionModel,
    pub(super) mount: CameraMount,
    /// Interval from the camera's frame before, seconds.
    pub(super) period_s: Option<f64>,
    /// Standard deviation of the camera's clock, seconds.
    pub(super) clock_s: f64,
}

impl Carrier {
    /// Whether a subject with this code is the carrier.
    pub(super) fn is(&self, subject: &Subject, code: Option<Code>) -> bool {
        match *self {
            Self::Roundel { kind, code: own } => {
                subject.body.is_none() && subject.kind == Some(kind) && code == Some(own)
            }
            Self::Body(body) => subject.body == Some(body),
        }
    }
}

/// The track of a carrier; `None` if there are two.
pub(crate) fn find_carrier_track(carrier: &Carrier, tracks: &[Track]) -> Option<usize> {
    let is_carrier = |track: &Track| {
        let is_followed = matches!(track.stage, LifeStage::Tracked | LifeStage::Predicted);
        is_followed && carrier.is(&track.subject, track.codes.settled())
    };
    let mut found = (0..tracks.len()).filter(|&index| is_carrier(&tracks[index]));
    let first = found.next();
    first.filter(|_| found.next().is_none())
}

impl CarrierState {
    /// Camera pose at the exposure of a row.
    pub(crate) fn pose_at(&self, time: Timestamp) -> ExposurePose {
        let mut state = self.state;
        state.predict(time, &self.model);
        let Estimate { motion, attitude, .. } = state.estimate(time, &self.model);
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
            [state.motion.systematic_covariance(), state.attitude.systematic_covariance()];
        let rates = [motion.velocity_m_s, attitude.angular_velocity_rad_s];
        let totals = [(motion.covariance.value, motion.covariance.rate), (turn, turning)];
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

    /// Camera pose at the frame's time, with the covariance of its whole error.
    pub(crate) fn mean_pose(&self) -> (Rigid, Covariance6) {
        let alone = Self { period_s: None, ..*self };
        let camera_pose = alone.pose_at(self.state.time);
        (camera_pose.world_from_camera, camera_pose.systematic + camera_pose.fresh)
    }

    /// Standard deviations of the carrier's velocity, m/s, and angular velocity, rad/s, per axis.
    pub(crate) fn rate_deviations(&self) -> (f64, f64) {
        let motion = self.state.motion.estimate(0.0, &self.model).covariance.rate;
        let turning = self.state.attitude.estimate(0.0, &self.model).covariance;
        let turning = turning.fixed_view::<3, 3>(3, 3).trace();
        ((motion.trace() / 3.0).max(0.0).sqrt(), (turning / 3.0).max(0.0).sqrt())
    }

    /// T / dt, at least 1; 1 while dt is unknown.
    fn inflation(&self, rest: &Matrix3<f64>, rate: &Matrix3<f64>) -> f64 {
        let memory_s = (rest.trace().max(0.0) / rate.trace().max(f64::MIN_POSITIVE)).sqrt();
        self.period_s.map_or(1.0, |period_s| (memory_s / period_s.max(MIN_PERIOD_S)).max(1.0))
    }
}

//! A camera that detects coded roundels at short range, and statistics of objects against the truth.

use std::f64::consts::PI;

use nalgebra::{Matrix3, UnitQuaternion, Vector3, Vector6};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    rigid::{
        Covariance6, Rigid, UNKNOWN_ANGLE_VARIANCE_RAD2, mahalanobis_squared, orientation_of_normal,
    },
    time::Timestamp,
    world::{
        CameraMount, CameraPlacement, Carrier, FrameObservations, Fusion, FusionParams, LifeStage,
        ObjectState,
    },
};

pub const KIND: KindId = KindId(0);
/// χ² of 3 degrees of freedom at 95 %.
const CHI3: f64 = 7.815;
/// The camera on board, and the positions of the stationary ones.
pub const ONBOARD: CameraId = CameraId(9);
pub const STATIONARY: [[f64; 2]; 4] = [[-2.5, -2.0], [2.5, -2.0], [-2.5, 2.0], [2.5, 2.0]];
pub const DRONE: u16 = 1;

pub fn code(number: u16) -> Code {
    Code { bits: 8, number }
}

pub fn carrier(number: u16) -> Carrier {
    Carrier::Roundel { kind: KIND, code: code(number) }
}

/// Looks down, with the image's right along the x axis of the carrier, `depth_m` below its roundel.
pub fn downwards(depth_m: f64) -> Rigid {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Rigid::from_parts(Vector3::new(0.05, 0.0, -depth_m).into(), turn)
}

/// Detections of roundels with errors that are fresh in each frame, as stated.
pub struct RoundelCamera {
    random: ChaCha8Rng,
    noise_px: f64,
    tilt_rad: f64,
}

impl RoundelCamera {
    pub fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed), noise_px: 0.1, tilt_rad: 0.02 }
    }

    fn draw(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| StandardNormal.sample(&mut self.random))
    }

    /// `code`: `None` if it is not read; then there is no yaw either.
    pub fn detect(
        &mut self,
        camera_from_roundel: &Rigid,
        time: Timestamp,
        number: u64,
        code: Option<Code>,
    ) -> Detection {
        let place_m = camera_from_roundel.translation.vector;
        let distance_m = place_m.norm();
        let line_of_sight = place_m / distance_m;
        let across_m = self.noise_px * distance_m / 600.0;
        let along_m = across_m * distance_m / 0.16;
        let along = line_of_sight * line_of_sight.transpose();
        let root = (Matrix3::identity() - along) * across_m + along * along_m;
        let position_m = place_m + root * self.draw();
        let slip = self.draw() * self.tilt_rad;
        let turn = UnitQuaternion::from_scaled_axis(slip) * camera_from_roundel.rotation;
        let (x, z) = (turn * Vector3::x(), turn * Vector3::z());
        let level = orientation_of_normal(&z).inverse() * x;
        let mut covariance = Covariance6::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&(root * root.transpose()));
        let tilt = Matrix3::from_diagonal_element(self.tilt_rad * self.tilt_rad);
        let about =
            z * z.transpose() * if code.is_some() { 0.0 } else { UNKNOWN_ANGLE_VARIANCE_RAD2 };
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&(tilt + about));
        let center = PixelPoint { u: 320.0, v: 240.0 };
        let rim = Ellipse { center, semi_major_px: 20.0, semi_minor_px: 20.0, angle_rad: 0.0 };
        let ring = Ring {
            kind: Some(KIND),
            code: code.map(|code| CodeReading::certain(code, center)),
            ..Ring::of_rims(rim, rim)
        };
        let pose = RoundelPose {
            position_m,
            normal: z,
            normal_likelihood: 0.8,
            other_normal: (line_of_sight * (2.0 * line_of_sight.dot(&z)) - z).normalize(),
            yaw_rad: code.map(|_| level.y.atan2(level.x)),
            yaw_symmetry: 1,
            covariance,
        };
        Detection { track: TrackNumber(number), ring, capture_time: time, pose: Some(pose) }
    }
}

pub fn frame(
    camera: CameraId,
    number: u64,
    time: Timestamp,
    detections: Vec<Detection>,
) -> FrameObservations {
    FrameObservations {
        camera,
        frame: number,
        capture_time: time,
        received_time: time.plus_seconds(0.02),
        calibration_version: 1,
        detections,
    }
}

/// A machine for errors as [`Eye`] makes them.
pub fn fusion() -> Fusion {
    let mut fusion = Fusion::new(FusionParams { systematic_share: 0.0, ..FusionParams::default() });
    for (index, standing) in STATIONARY.iter().enumerate() {
        let world_from_camera = stationary_camera(*standing);
        let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
        fusion.set_camera(CameraId(index as u32), Some(placement));
    }
    fusion
}

pub fn stationary_camera([x, y]: [f64; 2]) -> Rigid {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Rigid::from_parts(Vector3::new(x, y, 5.0).into(), turn)
}

pub fn mount() -> CameraMount {
    CameraMount {
        carrier: carrier(DRONE),
        object_from_camera: downwards(0.1),
        covariance: Covariance6::zeros(),
        localizes: false,
    }
}

pub fn own(objects: &[ObjectState], number: u16) -> Option<&ObjectState> {
    objects
        .iter()
        .find(|object| object.code == Some(code(number)) && object.stage == LifeStage::Tracked)
}

pub fn error(object: &ObjectState, truth: &Rigid) -> Vector6<f64> {
    let off = object.position_m - truth.translation.vector;
    let turn = (object.orientation * truth.rotation.inverse()).scaled_axis();
    Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z)
}

/// Shares of positions, velocities and rotations within 95 %, and the rms position error.
#[derive(Default)]
pub struct ErrorStatistics {
    count: usize,
    inside: [usize; 3],
    square_m2: f64,
}

impl ErrorStatistics {
    pub fn add(&mut self, object: &ObjectState, truth: impl Fn(f64) -> Rigid, t: f64) {
        let error = error(object, &truth(t));
        let ahead_m = truth(t + 1e-4).translation.vector - truth(t - 1e-4).translation.vector;
        let speed = object.velocity_m_s - ahead_m / 2e-4;
        let (moved, turned) =
            (error.fixed_rows::<3>(0).into_owned(), error.fixed_rows::<3>(3).into_owned());
        let block = |whole: &Covariance6| whole.fixed_view::<3, 3>(3, 3).into_owned();
        let place: Matrix3<f64> = object.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let squares = [
            mahalanobis_squared(&moved, &place),
            mahalanobis_squared(&speed, &block(&object.motion_covariance)),
            mahalanobis_squared(&turned, &block(&object.covariance)),
        ];
        for (inside, square) in self.inside.iter_mut().zip(squares) {
            *inside += usize::from(square.unwrap() < CHI3);
        }
        self.count += 1;
        self.square_m2 += moved.norm_squared();
    }

    pub fn shares(&self) -> [f64; 3] {
        self.inside.map(|inside| inside as f64 / self.count as f64)
    }

    pub fn rms_mm(&self) -> f64 {
        (self.square_m2 / self.count as f64).sqrt() * 1e3
    }
}

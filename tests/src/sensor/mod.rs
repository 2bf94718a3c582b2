//! Simulated observations without pixels: the detections that a camera worker would pass to fusion, with errors drawn
//! from exactly the stated covariances.
//!
//! Each robot is projected at its true pose when its own image row is exposed, through this crate's optics. A robot
//! that is outside the image, turned away, hidden or dropped is not detected. With the line of sight s, the distance
//! d and the focal length f, a noise of σ pixels is
//!
//! σ d / f across s,  d σ / (D f / d) along it (D the roundel's diameter),
//!
//! so small in bearing and large in depth. The rotation has an error of `tilt_rad` about each axis across the normal
//! and of `yaw_rad` about it. Each error is √q b + √(1 - q) w, with w new in every frame and b an Ornstein-Uhlenbeck
//! process of the camera and robot, so a share q of the variance persists for about `systematic_time_s`. The first
//! normal is right as often as its stated likelihood; the second is its mirror image about the line of sight. The
//! unit tests verify all of this.
//!
//! Moving cameras have the pose of their robot when the row is exposed.
//!
//! Times: a frame's capture time is the reading of the camera's clock ([`super::arena::SiteClock`]), its arrival time
//! is the server's.

mod rims;
mod stream;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    rigid::{Covariance6, UNKNOWN_ANGLE_VARIANCE_RAD2},
    time::Timestamp,
    world::FrameObservations,
};

use crate::{
    arena::{Arena, Kind, Path, Site},
    random::Random,
};
pub use stream::Stream;

/// Cosine of the steepest angle at which a roundel is detected.
const MIN_COSINE: f64 = 0.15;
/// A tracker assigns a new number to a roundel that it has not seen for this long.
const TRACK_TIMEOUT_S: f64 = 0.25;
/// Range of the likelihood of the first normal.
const LIKELIHOOD: (f64, f64) = (0.55, 0.95);

/// Error model of cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensing {
    /// Standard deviation of a roundel's centre and of its diameter in the image.
    pub noise_px: f64,
    /// Standard deviation of the normal, about each axis across it.
    pub tilt_rad: f64,
    /// Standard deviation of the rotation about the normal, where the code is read.
    pub yaw_rad: f64,
    /// Share of the variances that persists from frame to frame.
    pub systematic_share: f64,
    /// Correlation time of that share.
    pub systematic_time_s: f64,
    /// Whether the persistent error of a still roundel before a fixed camera never changes, as with rendered frames.
    pub bias_persists_while_still: bool,
    /// Share of roundels that are missed in a frame.
    pub dropout: f64,
    /// False detections per frame, up to 1.
    pub clutter: f64,
    /// Share of codes that cannot be read.
    pub unread: f64,
    /// Share of codes that are misread.
    pub misread: f64,
    /// Minimum and maximum time from exposure to arrival, seconds.
    pub latency_s: (f64, f64),
    /// Whether rings have the rims of a roundel at the observed pose; otherwise only a place in the image.
    pub shows_rims: bool,
}

impl Sensing {
    pub const DEFAULT: Self = Self {
        noise_px: 0.1,
        tilt_rad: 0.03,
        yaw_rad: 0.01,
        systematic_share: 0.5,
        systematic_time_s: 1.0,
        bias_persists_while_still: false,
        dropout: 0.02,
        clutter: 0.0,
        unread: 0.02,
        misread: 1e-4,
        latency_s: (0.015, 0.025),
        shows_rims: false,
    };
}

impl Default for Sensing {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// State of one camera for one robot.
#[derive(Clone, Copy, Debug, Default)]
struct ErrorState {
    number: u64,
    seen_s: Option<f64>,
    /// Persistent errors of position and rotation, unit variance.
    bias: [Vector3<f64>; 2],
    /// Time and place of the last update of the errors.
    bias_at: Option<(f64, Vector3<f64>)>,
}

/// A robot's pose when its row is exposed.
struct Exposed {
    camera_from_roundel: Isometry3<f64>,
    pixel: Vector2<f64>,
    row_s: f64,
}

/// One camera of an arena.
#[derive(Clone, Debug)]
pub struct Sensor<'a> {
    arena: &'a Arena,
    index: usize,
    sensing: Sensing,
    random: Random,
    states: Vec<ErrorState>,
    numbers: u64,
}

impl<'a> Sensor<'a> {
    /// The `index`-th camera. Its errors are seeded by the arena.
    pub fn new(arena: &'a Arena, index: usize, sensing: Sensing) -> Self {
        Self {
            arena,
            index,
            sensing,
            random: Random::new(arena.seed, (index as u64 + 1) << 20),
            states: vec![ErrorState::default(); arena.robots.len() + arena.landmarks.len()],
            numbers: 0,
        }
    }

    fn site(&self) -> &'a Site {
        &self.arena.sites[self.index]
    }

    /// The `frame`-th frame, from 0. Frames must be requested in order.
    pub fn frame(&mut self, frame: usize) -> FrameObservations {
        let site = self.site();
        let capture_ns = self.arena.capture_time_ns(site, frame);
        let stated = Timestamp::from_ns(self.arena.stated_time_ns(site, capture_ns));
        let t = (capture_ns - self.arena.start_ns) as f64 * 1e-9;
        let roundels = 0..self.states.len();
        let mut detections: Vec<_> =
            roundels.filter_map(|roundel| self.detect(roundel, t, stated)).collect();
        if self.chance(self.sensing.clutter) {
            detections.extend(self.false_detection(stated));
        }
        let (min_s, max_s) = self.sensing.latency_s;
        let latency_s = self.random.uniform(min_s, max_s);
        FrameObservations {
            camera: CameraId(self.index as u32),
            frame: frame as u64 + 1,
            capture_time: stated,
            received_time: Timestamp::from_ns(capture_ns).plus_seconds(latency_s),
            calibration_version: 1,
            detections,
        }
    }

    fn detect(&mut self, robot: usize, t: f64, stated: Timestamp) -> Option<Detection> {
        let bias = self.persistent_errors(robot, t);
        let (arena, site) = (self.arena, self.site());
        let (kind, code, exposed) = if let Some(carrier) = arena.robots.get(robot) {
            let is_aside = carrier.is_hidden_from_fixed_cameras && site.mount.is_none();
            if carrier.is_hidden(t) || is_aside || self.chance(self.sensing.dropout) {
                return None;
            }
            let kind = arena.kinds.iter().position(|kind| kind.name == carrier.kind)?;
            (kind, carrier.code, expose(arena, site, |t| carrier.path.pose(t), t)?)
        } else {
            let landmark = &arena.landmarks[robot - arena.robots.len()];
            if self.chance(self.sensing.dropout) {
                return None;
            }
            (landmark.kind, Some(landmark.code), expose(arena, site, |_| landmark.pose, t)?)
        };
        let kinds = &arena.kinds;
        let reading = self.read(kinds[kind].code_bits.zip(code));
        let number = self.number(robot, t);
        let pose = self.perturb(&kinds[kind], &exposed, &bias, reading.is_some());
        let rims = if self.sensing.shows_rims {
            let turn = exposed.camera_from_roundel.rotation;
            let seen = Isometry3::from_parts(pose.position_m.into(), turn);
            let kind = &kinds[kind];
            [kind.outer_diameter_m, kind.inner_diameter_m]
                .map(|diameter_m| rims::imaged(&site.optics, &seen, diameter_m))
        } else {
            [None; 2]
        };
        let mut detection = detection(number, kind, &exposed, stated, pose, reading);
        if let [Some(outer), Some(inner)] = rims {
            detection.ring = Ring {
                kind: detection.ring.kind,
                code: detection.ring.code,
                ..Ring::of_rims(outer, inner)
            };
        }
        Some(detection)
    }

    /// A false detection: upright, somewhere in the image and at most 2 m above the floor.
    fn false_detection(&mut self, stated: Timestamp) -> Option<Detection> {
        let (site, kind) = (self.site(), &self.arena.kinds[0]);
        let mut within = |size: usize| self.random.uniform(0.0, size as f64 - 1.0);
        let pixel = Vector2::new(within(site.optics.width), within(site.optics.height));
        let ray = site.world_from_camera.rotation * site.optics.ray(&pixel)?;
        let eye = site.world_from_camera.translation.vector;
        let along = (self.random.uniform(0.0, 2.0) - eye.z) / ray.z;
        let still = Path::still(eye + ray * along);
        let exposed = expose(self.arena, site, |t| still.pose(t), 0.0)?;
        let new = [self.gaussian(), self.gaussian()];
        let pose = self.perturb(kind, &exposed, &new, false);
        self.numbers += 1;
        let number = TrackNumber(self.numbers);
        (along > 0.0).then(|| detection(number, 0, &exposed, stated, pose, None))
    }

    /// The tracker's number for a robot that is detected now.
    fn number(&mut self, robot: usize, t: f64) -> TrackNumber {
        let state = &mut self.states[robot];
        if state.seen_s.is_none_or(|seen_s| t - seen_s > TRACK_TIMEOUT_S) {
            self.numbers += 1;
            state.number = self.numbers;
        }
        state.seen_s = Some(t);
        TrackNumber(state.number)
    }

    /// The persistent errors at time `t`.
    fn persistent_errors(&mut self, robot: usize, t: f64) -> [Vector3<f64>; 2] {
        let new = [self.gaussian(), self.gaussian()];
        let place_m = match self.arena.robots.get(robot) {
            Some(carrier) => carrier.path.pose(t).translation.vector,
            None => Vector3::zeros(),
        };
        let keeps = self.sensing.bias_persists_while_still && self.site().mount.is_none();
        let state = &mut self.states[robot];
        state.bias = match state.bias_at {
            None => new,
            Some((_, before_m)) if keeps && before_m == place_m => state.bias,
            Some((before_s, _)) => {
                let kept = (-(t - before_s) / self.sensing.systematic_time_s).exp();
                let added = (1.0 - kept * kept).sqrt();
                [0, 1].map(|which| state.bias[which] * kept + new[which] * added)
            }
        };
        state.bias_at = Some((t, place_m));
        state.bias
    }

    /// The reading of a code of this many bits.
    fn read(&mut self, code: Option<(u8, u16)>) -> Option<Code> {
        let (bits, number) = code?;
        if self.chance(self.sensing.unread) {
            return None;
        }
        let wrong = self.chance(self.sensing.misread);
        Some(Code { bits, number: if wrong { number % 8 + 1 } else { number } })
    }

    /// The pose with an error drawn from its stated covariance.
    fn perturb(
        &mut self,
        kind: &Kind,
        exposed: &Exposed,
        bias: &[Vector3<f64>; 2],
        with_yaw: bool,
    ) -> RoundelPose {
        let Sensing { noise_px, tilt_rad, yaw_rad, systematic_share, .. } = self.sensing;
        let persistent = systematic_share.sqrt();
        let mixed = [0, 1].map(|which| {
            bias[which] * persistent + self.gaussian() * (1.0 - systematic_share).sqrt()
        });
        let (true_place, turn) =
            (exposed.camera_from_roundel.translation.vector, exposed.camera_from_roundel.rotation);
        let distance_m = true_place.norm();
        let focal_px = self.site().optics.focal_px[0];
        let across_m = noise_px * distance_m / focal_px;
        let along_m = across_m * distance_m / kind.outer_diameter_m;
        let spread = Vector3::new(across_m, across_m, along_m);
        let root = frame_along(&true_place) * Matrix3::from_diagonal(&spread);
        let position_m = true_place + root * mixed[0];
        let normal = turn * Vector3::z();
        let about = normal * normal.transpose();
        let slip = (Matrix3::identity() - about) * mixed[1] * tilt_rad + about * mixed[1] * yaw_rad;
        let seen = UnitQuaternion::from_scaled_axis(slip) * turn;
        let likelihood = self.random.uniform(LIKELIHOOD.0, LIKELIHOOD.1);
        let is_right = self.chance(likelihood);
        let mirrored = mirror(&seen, &position_m);
        let (first, other) = if is_right { (seen, mirrored) } else { (mirrored, seen) };
        let (normal, other_normal) = (first * Vector3::z(), other * Vector3::z());
        let about = normal * normal.transpose();
        let about_variance = if with_yaw { yaw_rad * yaw_rad } else { UNKNOWN_ANGLE_VARIANCE_RAD2 };
        let rotation =
            (Matrix3::identity() - about) * (tilt_rad * tilt_rad) + about * about_variance;
        let mut covariance = Covariance6::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&(root * root.transpose()));
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        RoundelPose {
            position_m,
            normal,
            normal_likelihood: likelihood,
            other_normal,
            yaw_rad: with_yaw.then(|| heading_rad(&first)),
            yaw_symmetry: 1,
            covariance,
        }
    }

    fn chance(&mut self, share: f64) -> bool {
        self.random.uniform(0.0, 1.0) < share
    }

    fn gaussian(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| f64::from(self.random.normal()))
    }
}

/// Pose of a roundel when its row is exposed; `None` if it is outside the image, turned away or too steep.
fn expose(
    arena: &Arena,
    site: &Site,
    pose: impl Fn(f64) -> Isometry3<f64>,
    t: f64,
) -> Option<Exposed> {
    let seen = |t: f64| arena.camera_pose(site, t).inverse() * pose(t);
    let middle = (site.optics.height as f64 - 1.0) / 2.0;
    let mut row_s = 0.0;
    // Each iteration contracts the error of the row's time by image speed × line time, below 1/50.
    for _ in 0..3 {
        let place = Point3::from(seen(t + row_s).translation.vector);
        row_s = (site.optics.project(&place)?.y - middle) * site.imaging.line_time_s;
    }
    let camera_from_roundel = seen(t + row_s);
    let place = camera_from_roundel.translation.vector;
    let pixel = site.optics.project(&Point3::from(place))?;
    let inside = (0.0..site.optics.width as f64).contains(&pixel.x)
        && (0.0..site.optics.height as f64).contains(&pixel.y);
    let normal = camera_from_roundel.rotation * Vector3::z();
    let faces = normal.dot(&place) < -MIN_COSINE * place.norm();
    (inside && faces).then_some(Exposed { camera_from_roundel, pixel, row_s })
}

fn detection(
    number: TrackNumber,
    kind: usize,
    exposed: &Exposed,
    stated: Timestamp,
    pose: RoundelPose,
    code: Option<Code>,
) -> Detection {
    let center = PixelPoint { u: exposed.pixel.x, v: exposed.pixel.y };
    let rim = |semi_px| Ellipse {
        center,
        semi_major_px: semi_px,
        semi_minor_px: semi_px,
        angle_rad: 0.0,
    };
    let ring = Ring {
        kind: Some(KindId(kind as u16)),
        code: code.map(|code| CodeReading::certain(code, center)),
        ..Ring::of_rims(rim(15.0), rim(6.0))
    };
    let capture_time = stated.plus_seconds(exposed.row_s);
    Detection { track: number, ring, capture_time, pose: Some(pose) }
}

/// Two axes across a direction, and the direction.
fn frame_along(direction: &Vector3<f64>) -> Matrix3<f64> {
    let z = direction.normalize();
    let helper = if z.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let x = helper.cross(&z).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

/// The orientation with the same image under weak perspective: its normal is rotated by half a turn about the line of
/// sight, and its x points the same way in the image.
fn mirror(seen: &UnitQuaternion<f64>, position_m: &Vector3<f64>) -> UnitQuaternion<f64> {
    let sight = position_m.normalize();
    let (x, z) = (seen * Vector3::x(), seen * Vector3::z());
    let x = x - sight * (2.0 * sight.dot(&x));
    let z = sight * (2.0 * sight.dot(&z)) - z;
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

/// Rotation about the normal, relative to the smallest rotation that moves +z to the normal.
fn heading_rad(seen: &UnitQuaternion<f64>) -> f64 {
    let upright = UnitQuaternion::rotation_between(&Vector3::z(), &(seen * Vector3::z()));
    let x = upright.unwrap_or_default().inverse() * (seen * Vector3::x());
    x.y.atan2(x.x)
}

#[cfg(test)]
mod tests;

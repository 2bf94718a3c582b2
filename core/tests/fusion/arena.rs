//! A seeded world for fusion: objects on smooth paths, cameras whose errors have exactly the stated covariance, and
//! frames that arrive late and out of order. No pixels.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::Ring,
    pose::{Detection, RoundelPose},
    rigid::{Covariance6, Rigid, UNKNOWN_ANGLE_VARIANCE_RAD2},
    time::Timestamp,
    world::{CameraPlacement, FrameObservations},
};

/// Start of virtual time.
pub const START: Timestamp = Timestamp::from_ns(1_800_000_000_000_000_000);

/// Parameters of a world.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    pub seed: u64,
    pub objects: usize,
    /// Every how many objects one stands still; 0: none.
    pub still: usize,
    pub cameras: usize,
    pub rate_hz: f64,
    /// Spreads the cameras' exposures over the period.
    pub unsynchronized: bool,
    /// Latency is this plus or minus `jitter_s`, uniform.
    pub latency_s: f64,
    pub jitter_s: f64,
    pub dropout: f64,
    /// Probability of a false detection per frame.
    pub clutter: f64,
    /// Share of the error's variance that is systematic, and its correlation time.
    pub systematic_share: f64,
    pub systematic_time_s: f64,
    pub max_acceleration_m_s2: f64,
    /// Random accelerations (bounded by a spring) instead of sines.
    pub random: bool,
    pub noise_px: f64,
    /// Until then all objects stand at the start of their paths.
    pub start_s: f64,
    /// Neighbours move to and fro and pass each other at 0.25 m.
    pub passing: bool,
    /// No object flies.
    pub ground: bool,
}

impl Default for Setting {
    fn default() -> Self {
        Self {
            seed: 1,
            objects: 24,
            still: 0,
            cameras: 4,
            rate_hz: 30.0,
            unsynchronized: true,
            latency_s: 0.020,
            jitter_s: 0.005,
            dropout: 0.02,
            clutter: 0.0,
            systematic_share: 0.5,
            systematic_time_s: 1.0,
            max_acceleration_m_s2: 2.0,
            random: false,
            noise_px: 0.1,
            start_s: 0.0,
            passing: false,
            ground: false,
        }
    }
}

/// True state of one object.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    pub position_m: Vector3<f64>,
    pub velocity_m_s: Vector3<f64>,
    pub normal: Vector3<f64>,
}

/// Sines along the axes, or a random path.
#[derive(Clone, Debug)]
struct Path {
    center_m: Vector3<f64>,
    waves: Vec<(Vector3<f64>, f64, f64)>,
    /// Instead of waves: position, velocity and acceleration every [`GRID_S`], from the start.
    grid: Vec<[Vector3<f64>; 3]>,
    tilting: bool,
    start_s: f64,
}

/// Time step of a random path.
const GRID_S: f64 = 0.005;
/// Length of a random path.
const GRID_END_S: f64 = 70.0;

/// Acceleration with a correlation time of 0.4 s, a spring and a damper that keep the object in place; at most
/// `max`.
fn random_grid(rng: &mut ChaCha8Rng, axes: &Vector3<f64>, max: f64) -> Vec<[Vector3<f64>; 3]> {
    let (mut position, mut velocity, mut push) =
        (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
    let kept: f64 = (-GRID_S / 0.4f64).exp();
    let steps = (GRID_END_S / GRID_S) as usize;
    (0..steps)
        .map(|_| {
            push = push * kept
                + gaussian3(rng).component_mul(axes) * (max * 0.45 * (1.0 - kept * kept).sqrt());
            let mut acceleration: Vector3<f64> = push - position * 6.0 - velocity * 2.0;
            if acceleration.norm() > max {
                acceleration *= max / acceleration.norm();
            }
            let knot = [position, velocity, acceleration];
            position += velocity * GRID_S + acceleration * (GRID_S * GRID_S / 2.0);
            velocity += acceleration * GRID_S;
            knot
        })
        .collect()
}

impl Path {
    fn at(&self, t: f64) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        if !self.grid.is_empty() {
            let index = ((t / GRID_S) as usize).min(self.grid.len() - 1);
            let [position, velocity, acceleration] = self.grid[index];
            let dt = t - index as f64 * GRID_S;
            return (
                self.center_m + position + velocity * dt + acceleration * (dt * dt / 2.0),
                velocity + acceleration * dt,
                acceleration,
            );
        }
        let (mut position, mut velocity, mut acceleration) =
            (self.center_m, Vector3::zeros(), Vector3::zeros());
        for (amplitude, omega, phase) in &self.waves {
            let (sine, cosine) = (omega * t + phase).sin_cos();
            position += amplitude * sine;
            velocity += amplitude * (omega * cosine);
            acceleration -= amplitude * (omega * omega * sine);
        }
        (position, velocity, acceleration)
    }

    fn truth(&self, t: f64) -> Truth {
        let (position_m, mut velocity_m_s, mut acceleration) = self.at((t - self.start_s).max(0.0));
        if t < self.start_s {
            velocity_m_s = Vector3::zeros();
            acceleration = Vector3::zeros();
        }
        // A flying robot leans into its acceleration.
        let lean = if self.tilting { acceleration } else { Vector3::zeros() };
        Truth { position_m, velocity_m_s, normal: (Vector3::new(0., 0., 9.81) + lean).normalize() }
    }
}

pub struct Arena {
    pub setting: Setting,
    paths: Vec<Path>,
    pub placements: Vec<CameraPlacement>,
}

fn uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    let unit: f64 = StandardUniform.sample(rng);
    low + (high - low) * unit
}

pub fn gaussian3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}

impl Arena {
    pub fn new(setting: Setting) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(setting.seed);
        let columns = (setting.objects as f64).sqrt().ceil() as usize;
        let cell = (5.6 / columns as f64, 4.4 / columns as f64);
        let paths = (0..setting.objects)
            .map(|index| {
                let flying = index % 3 == 2 && !setting.ground;
                let still = setting.still > 0 && index % setting.still == 0;
                let center_m = Vector3::new(
                    -2.8 + cell.0 * ((index % columns) as f64 + 0.5),
                    -2.2 + cell.1 * ((index / columns) as f64 + 0.5),
                    if flying { 1.2 } else { 0.3 },
                );
                let center_m = if setting.passing {
                    let (pair, columns) = (index / 2, 4);
                    Vector3::new(
                        -2.1 + 1.4 * (pair % columns) as f64,
                        -1.5 + 1.2 * (pair / columns) as f64 + 0.25 * (index % 2) as f64,
                        0.3,
                    )
                } else {
                    center_m
                };
                let (mut waves, mut grid) = (Vec::new(), Vec::new());
                let max_acceleration_m_s2 = setting.max_acceleration_m_s2;
                if setting.random && !still {
                    let axes = Vector3::new(1.0, 1.0, if flying { 0.6 } else { 0.0 });
                    grid = random_grid(&mut rng, &axes, max_acceleration_m_s2);
                } else if setting.passing {
                    // To and fro on neighbouring lines, each pair in opposite phase.
                    let amplitude = 0.45;
                    let phase = if index % 2 == 0 { 0.0 } else { PI };
                    waves.push((
                        Vector3::x() * amplitude,
                        (max_acceleration_m_s2 * 0.8 / amplitude).sqrt(),
                        phase,
                    ));
                } else if !still {
                    for (axis, share) in
                        [(Vector3::x(), 0.6), (Vector3::y(), 0.6), (Vector3::z(), 0.3)]
                    {
                        if axis.z > 0.0 && !flying {
                            continue;
                        }
                        let amplitude = uniform(&mut rng, 0.3, 0.45) * cell.1;
                        let omega = (max_acceleration_m_s2 * share * uniform(&mut rng, 0.5, 1.0)
                            / amplitude)
                            .sqrt();
                        waves.push((axis * amplitude, omega, uniform(&mut rng, 0.0, TAU)));
                    }
                }
                // A lean that jumps with a random acceleration would not be realistic.
                Path {
                    center_m,
                    waves,
                    tilting: flying && !setting.passing && grid.is_empty(),
                    grid,
                    start_s: setting.start_s,
                }
            })
            .collect();
        let placements = (0..setting.cameras).map(placement);
        Self { setting, paths, placements: placements.collect() }
    }

    pub fn truth(&self, object: usize, time: Timestamp) -> Truth {
        self.paths[object].truth(time.seconds_since(START))
    }

    /// All frames of `seconds` in order of arrival.
    pub fn frames(&self, seconds: f64) -> Vec<FrameObservations> {
        let setting = &self.setting;
        let mut sent = Vec::new();
        for camera in 0..setting.cameras {
            let seed = setting.seed * 1000 + camera as u64;
            let mut sensor = Sensor {
                rng: ChaCha8Rng::seed_from_u64(seed),
                bias: vec![None; setting.objects],
                last_s: 0.0,
            };
            let period = 1.0 / setting.rate_hz;
            let phase = if setting.unsynchronized {
                period * (camera as f64 + uniform(&mut sensor.rng, 0.0, 1.0))
                    / setting.cameras as f64
            } else {
                0.0
            };
            for number in 0..(seconds * setting.rate_hz) as u64 {
                let t = phase + number as f64 * period;
                sent.push(self.frame(camera, number + 1, t, &mut sensor));
            }
        }
        sent.sort_by_key(|frame: &FrameObservations| (frame.received_time, frame.camera));
        sent
    }

    fn frame(&self, camera: usize, number: u64, t: f64, sensor: &mut Sensor) -> FrameObservations {
        let setting = &self.setting;
        let time = START.plus_seconds(t);
        let kept = (-(t - sensor.last_s) / setting.systematic_time_s).exp();
        sensor.last_s = t;
        let mut detections = Vec::new();
        for object in 0..self.paths.len() {
            let fresh = [gaussian3(&mut sensor.rng), gaussian3(&mut sensor.rng)];
            let bias = match sensor.bias[object] {
                None => fresh,
                Some(old) => {
                    let old: [Vector3<f64>; 2] = old;
                    [0, 1].map(|i| old[i] * kept + fresh[i] * (1.0 - kept * kept).sqrt())
                }
            };
            sensor.bias[object] = Some(bias);
            let state = self.paths[object].truth(t);
            let dropped = uniform(&mut sensor.rng, 0.0, 1.0) < setting.dropout;
            let pose = self.detect(camera, &state, &bias, &mut sensor.rng);
            if let (Some(pose), false) = (pose, dropped) {
                detections.push(detection(object as u64 + 1, time, Some(pose)));
            }
        }
        if uniform(&mut sensor.rng, 0.0, 1.0) < setting.clutter {
            let place = Truth {
                position_m: Vector3::new(
                    uniform(&mut sensor.rng, -3.5, 3.5),
                    uniform(&mut sensor.rng, -2.8, 2.8),
                    uniform(&mut sensor.rng, 0.0, 2.0),
                ),
                velocity_m_s: Vector3::zeros(),
                normal: Vector3::z(),
            };
            let none = [Vector3::zeros(); 2];
            if let Some(pose) = self.detect(camera, &place, &none, &mut sensor.rng) {
                detections.push(detection(1_000_000 + number, time, Some(pose)));
            }
        }
        let latency = setting.latency_s + setting.jitter_s * uniform(&mut sensor.rng, -1.0, 1.0);
        FrameObservations {
            camera: CameraId(camera as u32),
            frame: number,
            capture_time: time,
            received_time: time.plus_seconds(latency),
            calibration_version: 1,
            detections,
        }
    }

    /// A pose with an error drawn from its stated covariance; `None` outside the image.
    pub fn detect(
        &self,
        camera: usize,
        truth: &Truth,
        bias: &[Vector3<f64>; 2],
        rng: &mut ChaCha8Rng,
    ) -> Option<RoundelPose> {
        const FOCAL_PX: f64 = 1100.0;
        const DIAMETER_M: f64 = 0.16;
        let share = self.setting.systematic_share;
        let fresh = [gaussian3(rng), gaussian3(rng)];
        let likelihood: f64 = uniform(rng, 0.55, 0.95);
        let is_right_normal = uniform(rng, 0.0, 1.0) < likelihood;
        let camera_from_world = self.placements[camera].world_from_camera.inverse();
        let center = (camera_from_world * Point3::from(truth.position_m)).coords;
        let normal = camera_from_world.rotation * truth.normal;
        let inside = (center.x / center.z * FOCAL_PX).abs() < 960.0
            && (center.y / center.z * FOCAL_PX).abs() < 540.0;
        if center.z < 0.5 || !inside || normal.dot(&center) > -0.15 * center.norm() {
            return None;
        }
        let distance = center.norm();
        let across = self.setting.noise_px * distance / FOCAL_PX;
        let along = distance * self.setting.noise_px / (DIAMETER_M * FOCAL_PX / distance);
        let tilt: f64 = 0.05;
        let line_of_sight = center / distance;
        let axes = basis(&line_of_sight);
        let root = axes * Matrix3::from_diagonal(&Vector3::new(across, across, along));
        let mixed = |i: usize| bias[i] * share.sqrt() + fresh[i] * (1.0 - share).sqrt();
        let tangent = {
            let along = normal * normal.transpose();
            Matrix3::identity() - along
        };
        let turn = UnitQuaternion::from_scaled_axis(tangent * mixed(1) * tilt);
        let right = turn * normal;
        let mirrored =
            |n: &Vector3<f64>| (line_of_sight * (2.0 * line_of_sight.dot(n)) - n).normalize();
        let other = mirrored(&right);
        let first = if is_right_normal { right } else { other };
        let mut covariance = Covariance6::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&(root * root.transpose()));
        let about = first * first.transpose();
        let rotation =
            (Matrix3::identity() - about) * (tilt * tilt) + about * UNKNOWN_ANGLE_VARIANCE_RAD2;
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        Some(RoundelPose {
            position_m: center + root * mixed(0),
            normal: first,
            normal_likelihood: likelihood,
            other_normal: if is_right_normal { other } else { right },
            yaw_rad: None,
            yaw_symmetry: 1,
            covariance,
        })
    }
}

struct Sensor {
    rng: ChaCha8Rng,
    bias: Vec<Option<[Vector3<f64>; 2]>>,
    last_s: f64,
}

fn basis(z: &Vector3<f64>) -> Matrix3<f64> {
    let helper = if z.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let x = helper.cross(z).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), *z])
}

/// R4's four camera poses; further cameras stand beside them.
fn placement(index: usize) -> CameraPlacement {
    let side = |bit: usize| if index & bit == 0 { -1.0 } else { 1.0 };
    let shift = (index / 4) as f64 * 0.6;
    let position_m = Vector3::new(side(1) * (2.5 - shift), side(2) * (2.0 - shift), 5.0);
    let target = Vector3::new(side(1) * 1.25, side(2), 0.0);
    let forward = (target - position_m).normalize();
    let is_right_normal = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&is_right_normal);
    let rotation =
        UnitQuaternion::from_matrix(&Matrix3::from_columns(&[is_right_normal, down, forward]));
    let world_from_camera: Rigid = Isometry3::from_parts(Translation3::from(position_m), rotation);
    CameraPlacement { world_from_camera, covariance: Covariance6::zeros() }
}

/// A detection of kind 0.
pub fn detection(number: u64, time: Timestamp, pose: Option<RoundelPose>) -> Detection {
    let rim = |semi_px: f64| Ellipse {
        center: PixelPoint { u: 0.0, v: 0.0 },
        semi_major_px: semi_px,
        semi_minor_px: semi_px,
        angle_rad: PI / 4.0,
    };
    let ring = Ring { kind: Some(KindId(0)), ..Ring::of_rims(rim(15.0), rim(6.0)) };
    Detection { track: TrackNumber(number), ring, capture_time: time, pose }
}

//! A seeded world: robots on their ways, cameras above them, and the truth about both.

use std::collections::BTreeMap;

use nalgebra::{Point3, Rotation3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use roundel_vision::{
    camera::{Camera, Intrinsics},
    id::KindId,
    marker::{Code, Pattern},
    rigid::Rigid,
};

use super::{
    course::{Course, Drive, Walls},
    layout,
    params::{ScenarioError, ScenarioParams},
    path::Path,
    rig::{SimCamera, look_at},
};

/// A simulated installation. Pure: what it says depends on parameters, time and what its robots were told alone, so
/// any instant can be asked for in any order, from any thread.
#[derive(Clone, Debug)]
pub struct Scenario {
    params: ScenarioParams,
    cameras: Vec<SimCamera>,
    paths: Vec<Path>,
    /// Robots that are driven, by index.
    courses: BTreeMap<usize, Course>,
    booms: Vec<Boom>,
    /// By robot.
    codes: Vec<Option<PrintedCode>>,
}

/// What the teeth of a robot's roundel say, and as which word they are printed.
#[derive(Clone, Copy, Debug)]
struct PrintedCode {
    code: Code,
    word: u16,
}

/// The truth about one robot at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotTruth {
    /// Its place in the scenario, from 0.
    pub index: usize,
    /// Kind of its roundel, a place in [`ScenarioParams::kinds`].
    pub kind: KindId,
    /// What its teeth say; `None` for a plain roundel.
    pub code: Option<Code>,
    /// Pose of its roundel: origin at the rings' centre, z out of the print.
    pub world_from_roundel: Rigid,
    /// Of the roundel's centre, world frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Of the roundel's centre, world frame, m/s².
    pub acceleration_m_s2: Vector3<f64>,
    /// World frame, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Flies.
    pub flying: bool,
    /// Has never moved by then.
    pub still: bool,
}

/// A beam that swings about a vertical axis above the robots.
#[derive(Clone, Debug)]
struct Boom {
    pivot_m: Vector3<f64>,
    length_m: f64,
    middle_rad: f64,
    swing_rad: f64,
    rate_rad_s: f64,
}

/// A beam at one instant: a flat bar that faces up.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoomPose {
    /// Middle of the bar, x along it.
    pub world_from_boom: Rigid,
    /// Half its length and half its width, metres.
    pub half_m: [f64; 2],
}

/// Half a boom's width, metres.
const BOOM_HALF_WIDTH_M: f64 = 0.045;

impl Scenario {
    /// A scenario of these parameters. Fails on numbers out of range, on more robots than have
    /// room, and on cameras that see too little of the arena.
    pub fn new(params: ScenarioParams) -> Result<Self, ScenarioError> {
        params.validate()?;
        // Each matter draws from a stream of its own: one more robot does not move the cameras.
        let stream = |number: u64| {
            let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
            rng.set_stream(number);
            rng
        };
        let cameras = cameras(&params, &mut stream(1))?;
        let paths = layout::lay_out(&params, &cameras, &mut stream(2))?;
        let booms = booms(&params, &mut stream(3));
        let codes = codes(&params)?;
        Ok(Self { params, cameras, paths, courses: BTreeMap::new(), booms, codes })
    }

    /// The demo's installation, [`ScenarioParams::r4_lite`].
    pub fn r4_lite(seed: u64) -> Self {
        Self::new(ScenarioParams::r4_lite(seed)).expect("the preset has room for its robots")
    }

    /// The reference installation, [`ScenarioParams::r4`].
    pub fn r4(seed: u64) -> Self {
        Self::new(ScenarioParams::r4(seed)).expect("the preset has room for its robots")
    }

    /// What it follows from.
    pub fn params(&self) -> &ScenarioParams {
        &self.params
    }

    /// Its cameras.
    pub fn cameras(&self) -> &[SimCamera] {
        &self.cameras
    }

    /// Every robot, by index, `time_s` seconds after the scenario's start (any finite time).
    pub fn truth(&self, time_s: f64) -> Vec<RobotTruth> {
        (0..self.paths.len()).map(|index| self.robot(index, time_s)).collect()
    }

    /// One robot, as in [`Scenario::truth`]. Panics if there is no such robot.
    pub fn robot(&self, index: usize, time_s: f64) -> RobotTruth {
        let path = &self.paths[index];
        let course = self.courses.get(&index);
        let motion =
            course.map_or_else(|| path.motion(time_s), |course| course.motion(path, time_s));
        let attitude = match course {
            Some(course) => course.attitude(path, time_s, &motion),
            None => path.attitude(time_s, &motion),
        };
        RobotTruth {
            index,
            kind: KindId((index % self.params.kinds.len()) as u16),
            code: self.codes[index].map(|printed| printed.code),
            world_from_roundel: Rigid::from_parts(
                Translation3::from(motion.position_m),
                attitude.orientation,
            ),
            velocity_m_s: motion.velocity_m_s,
            acceleration_m_s2: motion.acceleration_m_s2,
            angular_velocity_rad_s: attitude.angular_velocity_rad_s,
            flying: path.is_flying(),
            still: path.is_still() && course.is_none_or(|course| !course.has_begun(time_s)),
        }
    }

    /// Tells a robot how to move; what it was told before ends where that begins. Its way until then stays as it was,
    /// so nobody who has asked for an instant before is contradicted. When the span ends, it stops. One that drives
    /// keeps its height and turns no more. Panics if there is no such robot.
    pub fn drive(&mut self, index: usize, drive: Drive) {
        let (path, course) = self.course(index, drive.span_s[0]);
        course.tell(path, drive);
    }

    /// Puts a robot at a place at the scenario's start and has it move straight on from there. One on the ground keeps its
    /// height, and none leaves the arena. Panics if there is no such robot.
    pub fn place(&mut self, index: usize, position_m: Vector3<f64>, velocity_m_s: Vector3<f64>) {
        self.course(index, 0.0).1.start_at(position_m, velocity_m_s);
    }

    /// Adds a velocity to whatever a robot does, for a while, as in [`Scenario::drive`].
    pub fn push(&mut self, index: usize, push: Drive) {
        let (path, course) = self.course(index, push.span_s[0]);
        course.push(path, push);
    }

    /// Has its robots move as another scenario of the same parameters has them.
    pub(super) fn follow(&mut self, other: &Self) {
        self.courses.clone_from(&other.courses);
    }

    fn course(&mut self, index: usize, time_s: f64) -> (&Path, &mut Course) {
        let path = &self.paths[index];
        let [width_m, depth_m] = self.params.arena_m;
        let z_m = if path.is_flying() {
            [layout::FLYING_LOW_M, self.params.flying_top_m]
        } else {
            [self.params.roundel_height_m; 2]
        };
        let walls = Walls {
            min_m: Vector3::new(-width_m / 2.0, -depth_m / 2.0, z_m[0]),
            max_m: Vector3::new(width_m / 2.0, depth_m / 2.0, z_m[1]),
        };
        let course =
            self.courses.entry(index).or_insert_with(|| Course::leaving(path, time_s, walls));
        (path, course)
    }

    /// The word that a robot's teeth are printed as; `None` for a plain roundel.
    pub(super) fn word(&self, index: usize) -> Option<u16> {
        self.codes[index].map(|printed| printed.word)
    }

    /// Whether the whole roundel lies in a camera's image, whatever may hide it.
    pub fn in_view(&self, camera: &SimCamera, robot: &RobotTruth) -> bool {
        let radius_m = self.params.kinds[usize::from(robot.kind.0)].outer_diameter_m / 2.0;
        (0..8).all(|i| {
            let (sine, cosine) = (f64::from(i) * std::f64::consts::FRAC_PI_4).sin_cos();
            let rim = Point3::new(radius_m * cosine, radius_m * sine, 0.0);
            camera.sees(&(robot.world_from_roundel * rim), 1.0)
        })
    }

    /// Whether a boom or another robot crosses the line from a camera to the roundel's centre.
    pub fn is_hidden(&self, camera: &SimCamera, robot: &RobotTruth, time_s: f64) -> bool {
        let eye = Point3::from(camera.world_from_camera.translation.vector);
        let target = Point3::from(robot.world_from_roundel.translation.vector);
        let crosses = |patch: &Rigid, inside: &dyn Fn(f64, f64) -> bool| {
            let (from, to) =
                (patch.inverse_transform_point(&eye), patch.inverse_transform_point(&target));
            // The patch is the plane z = 0 of its own frame.
            let share = from.z / (from.z - to.z);
            let at = from + (to - from) * share;
            (0.0..0.999).contains(&share) && inside(at.x, at.y)
        };
        let behind_boom = self.booms_at(time_s).iter().any(|boom| {
            let [length, width] = boom.half_m;
            crosses(&boom.world_from_boom, &|x, y| x.abs() < length && y.abs() < width)
        });
        behind_boom
            || self.truth(time_s).iter().filter(|other| other.index != robot.index).any(|other| {
                let kind = &self.params.kinds[usize::from(other.kind.0)];
                let radius_m = kind.outer_diameter_m;
                crosses(&other.world_from_roundel, &|x, y| x.hypot(y) < radius_m)
            })
    }

    pub(super) fn booms_at(&self, time_s: f64) -> Vec<BoomPose> {
        self.booms.iter().map(|boom| boom.pose(time_s)).collect()
    }
}

/// Each robot's code: those of its kind one after the other.
fn codes(params: &ScenarioParams) -> Result<Vec<Option<PrintedCode>>, ScenarioError> {
    let mut codes = vec![None; params.robots];
    for (first, kind) in params.kinds.iter().enumerate() {
        let Pattern::Coded(layout) = kind.pattern else { continue };
        let dictionary = layout.codes()?;
        let robots = codes.iter_mut().skip(first).step_by(params.kinds.len());
        let (found, most) = (robots.len(), dictionary.len());
        if found > most {
            return Err(ScenarioError::Codes { bits: layout.bits, most, found });
        }
        for (robot, (code, word)) in robots.zip(dictionary.iter()) {
            *robot = Some(PrintedCode { code, word });
        }
    }
    Ok(codes)
}

impl Boom {
    fn pose(&self, time_s: f64) -> BoomPose {
        let angle_rad = self.middle_rad + self.swing_rad * (self.rate_rad_s * time_s).sin();
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle_rad);
        let middle = self.pivot_m + turn * Vector3::new(self.length_m / 2.0, 0.0, 0.0);
        BoomPose {
            world_from_boom: Rigid::from_parts(Translation3::from(middle), turn.into()),
            half_m: [self.length_m / 2.0, BOOM_HALF_WIDTH_M],
        }
    }
}

fn cameras(params: &ScenarioParams, rng: &mut ChaCha8Rng) -> Result<Vec<SimCamera>, ScenarioError> {
    let optics = &params.optics;
    let mut spread = |range: f64| rng.random_range(-1.0..=1.0) * range;
    let mut cameras = Vec::with_capacity(params.mounts.len());
    for (index, mount) in params.mounts.iter().enumerate() {
        let camera = Camera::new(Intrinsics {
            width: optics.width,
            height: optics.height,
            fx_px: optics.focal_px,
            fy_px: optics.focal_px,
            cx_px: (optics.width as f64 - 1.0) / 2.0 + spread(optics.center_offset_px),
            cy_px: (optics.height as f64 - 1.0) / 2.0 + spread(optics.center_offset_px),
            lens: optics.lens,
        })?;
        cameras.push(SimCamera {
            name: format!("camera-{index}"),
            camera,
            world_from_camera: look_at(mount.position_m, mount.target_m),
            phase_s: spread(optics.phase_range_s),
            rate_hz: optics.rate_hz * (1.0 + spread(optics.rate_error)),
            line_time_s: optics.line_time_s,
            exposure_s: optics.exposure_s,
        });
    }
    Ok(cameras)
}

fn booms(params: &ScenarioParams, rng: &mut ChaCha8Rng) -> Vec<Boom> {
    let [width_m, depth_m] = params.arena_m;
    (0..params.booms)
        .map(|index| {
            let side = if index % 2 == 0 { 1.0 } else { -1.0 };
            Boom {
                pivot_m: Vector3::new(
                    side * width_m * rng.random_range(0.05..0.3),
                    side * depth_m * rng.random_range(0.3..0.4),
                    params.flying_top_m + 0.6,
                ),
                length_m: 0.3 * depth_m,
                // Towards the middle of the arena, give or take.
                middle_rad: -side * std::f64::consts::FRAC_PI_2 + rng.random_range(-0.3..0.3),
                swing_rad: rng.random_range(0.7..1.0),
                rate_rad_s: rng.random_range(0.08..0.16),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests;

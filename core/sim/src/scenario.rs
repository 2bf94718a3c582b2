//! A seeded world: paths of robots, cameras, and the ground truth.

use nalgebra::{Point3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use roundel_vision::{
    camera::{Camera, Intrinsics},
    id::KindId,
    marker::{Code, Pattern},
    rigid::Rigid,
};

use super::{
    driven_path::{Drive, DrivenPath, Walls},
    layout,
    params::{ScenarioError, ScenarioParams},
    path::Path,
    sim_camera::{SimCamera, look_at},
};

/// A simulated installation. A pure function of parameters, time and commands, so any instant can be evaluated in
/// any order, from any thread.
#[derive(Clone, Debug)]
pub struct Scenario {
    params: ScenarioParams,
    cameras: Vec<SimCamera>,
    /// By robot.
    paths: Vec<DrivenPath>,
    booms: Vec<Boom>,
    /// By robot.
    codes: Vec<Option<PrintedCode>>,
}

/// Code of a robot's roundel and the printed word.
#[derive(Clone, Copy, Debug)]
struct PrintedCode {
    code: Code,
    word: u16,
}

/// Ground truth of one robot at an instant.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotTruth {
    /// Index in the scenario, from 0.
    pub index: usize,
    /// Kind of its roundel, an index of [`ScenarioParams::kinds`].
    pub kind: KindId,
    /// Code of its roundel; `None` for a plain one.
    pub code: Option<Code>,
    /// Pose of its roundel: origin at the rings' centre, z out of the print.
    pub world_from_roundel: Rigid,
    /// Velocity of the roundel's centre, world frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Acceleration of the roundel's centre, world frame, m/s².
    pub acceleration_m_s2: Vector3<f64>,
    /// Angular velocity, world frame, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Whether it flies.
    pub flying: bool,
    /// Whether it has never moved so far.
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

/// A beam at an instant: a flat bar that faces up.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoomPose {
    /// Middle of the bar, x along it.
    pub world_from_boom: Rigid,
    /// Half of its length and width, metres.
    pub half_m: [f64; 2],
}

const BOOM_HALF_WIDTH_M: f64 = 0.045;

impl Scenario {
    /// A scenario with these parameters. Fails on numbers out of range, too many robots, and cameras that see too
    /// little of the arena.
    pub fn new(params: ScenarioParams) -> Result<Self, ScenarioError> {
        params.validate()?;
        // Independent random streams: one more robot does not move the cameras.
        let stream = |number: u64| {
            let mut rng = ChaCha8Rng::seed_from_u64(params.seed);
            rng.set_stream(number);
            rng
        };
        let cameras = cameras(&params, &mut stream(1))?;
        let paths = layout::lay_out(&params, &cameras, &mut stream(2))?;
        let paths = paths.into_iter().map(|path| driven_path(&params, path)).collect();
        let booms = booms(&params, &mut stream(3));
        let codes = codes(&params)?;
        Ok(Self { params, cameras, paths, booms, codes })
    }

    /// The demo's installation, [`ScenarioParams::r4_lite`].
    pub fn r4_lite(seed: u64) -> Self {
        Self::new(ScenarioParams::r4_lite(seed)).expect("the preset is valid")
    }

    /// The reference installation, [`ScenarioParams::r4`].
    pub fn r4(seed: u64) -> Self {
        Self::new(ScenarioParams::r4(seed)).expect("the preset is valid")
    }

    /// The parameters.
    pub fn params(&self) -> &ScenarioParams {
        &self.params
    }

    /// The cameras.
    pub fn cameras(&self) -> &[SimCamera] {
        &self.cameras
    }

    /// All robots by index, `time_s` seconds after the scenario's start (any finite time).
    pub fn truth(&self, time_s: f64) -> Vec<RobotTruth> {
        (0..self.paths.len()).map(|index| self.robot(index, time_s)).collect()
    }

    /// One robot, as in [`Scenario::truth`]. Panics if there is no such robot.
    pub fn robot(&self, index: usize, time_s: f64) -> RobotTruth {
        let path = &self.paths[index];
        let motion = path.motion(time_s);
        let attitude = path.attitude(time_s, &motion);
        RobotTruth {
            index,
            kind: KindId((index % self.params.kinds.len()) as u16),
            code: self.codes[index].map(|printed| printed.code),
            world_from_roundel: Rigid::from_parts(motion.position_m.into(), attitude.orientation),
            velocity_m_s: motion.velocity_m_s,
            acceleration_m_s2: motion.acceleration_m_s2,
            angular_velocity_rad_s: attitude.angular_velocity_rad_s,
            flying: path.path.is_flying(),
            still: path.path.is_still() && !path.has_begun(time_s),
        }
    }

    /// Commands a velocity; it replaces the previous command from its start on and does not change earlier motion.
    /// The robot stops at its end. A ground robot keeps its height and orientation. Panics if there is no such
    /// robot.
    pub fn drive(&mut self, index: usize, drive: Drive) {
        self.paths[index].command(drive);
    }

    /// Places a robot at the scenario's start with constant velocity. A ground robot keeps its height, and no robot
    /// leaves the arena. Panics if there is no such robot.
    pub fn place(&mut self, index: usize, position_m: Vector3<f64>, velocity_m_s: Vector3<f64>) {
        self.paths[index].start_at(position_m, velocity_m_s);
    }

    /// Adds a velocity to a robot's motion for a limited time, as in [`Scenario::drive`].
    pub fn push(&mut self, index: usize, push: Drive) {
        self.paths[index].push(push);
    }

    /// Adopts the commands of another scenario with the same parameters.
    pub(super) fn follow(&mut self, other: &Self) {
        self.paths.clone_from(&other.paths);
    }

    /// The printed word of a robot's code; `None` for a plain roundel.
    pub(super) fn word(&self, index: usize) -> Option<u16> {
        self.codes[index].map(|printed| printed.word)
    }

    /// Whether the whole roundel lies in a camera's image, ignoring occlusion.
    pub fn in_view(&self, camera: &SimCamera, robot: &RobotTruth) -> bool {
        let radius_m = self.params.kinds[usize::from(robot.kind.0)].outer_diameter_m / 2.0;
        (0..8).all(|i| {
            let (sine, cosine) = (f64::from(i) * std::f64::consts::FRAC_PI_4).sin_cos();
            let rim = Point3::new(radius_m * cosine, radius_m * sine, 0.0);
            camera.sees(&(robot.world_from_roundel * rim), 1.0)
        })
    }

    /// Whether a boom or another robot intersects the line from a camera to the roundel's centre.
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

/// A path within the arena, and for ground robots at their height.
fn driven_path(params: &ScenarioParams, path: Path) -> DrivenPath {
    let half_m = params.arena_m.map(|side_m| side_m / 2.0);
    let z_m = if path.is_flying() {
        [layout::FLYING_LOW_M, params.flying_top_m]
    } else {
        [params.roundel_height_m; 2]
    };
    let walls = Walls {
        min_m: Vector3::new(-half_m[0], -half_m[1], z_m[0]),
        max_m: Vector3::new(half_m[0], half_m[1], z_m[1]),
    };
    DrivenPath::new(path, walls)
}

/// Codes of all robots: those of each kind in order.
fn codes(params: &ScenarioParams) -> Result<Vec<Option<PrintedCode>>, ScenarioError> {
    let mut codes = vec![None; params.robots];
    for (first, kind) in params.kinds.iter().enumerate() {
        let Pattern::Coded(layout) = kind.pattern else { continue };
        let dictionary = layout.codes()?;
        let robots = codes.iter_mut().skip(first).step_by(params.kinds.len());
        let (found, max) = (robots.len(), dictionary.len());
        if found > max {
            return Err(ScenarioError::Codes { bits: layout.bits, max, found });
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
            world_from_boom: Rigid::from_parts(middle.into(), turn.into()),
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
                // Roughly towards the middle of the arena.
                middle_rad: -side * std::f64::consts::FRAC_PI_2 + rng.random_range(-0.3..0.3),
                swing_rad: rng.random_range(0.7..1.0),
                rate_rad_s: rng.random_range(0.08..0.16),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests;

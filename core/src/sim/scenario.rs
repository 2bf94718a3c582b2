//! A seeded world: robots on their ways, cameras above them, and the truth about both.

use nalgebra::{Point3, Rotation3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{
    camera::{Camera, Intrinsics},
    id::KindId,
    marker::{Code, Pattern},
    rigid::Rigid,
};

use super::{
    layout,
    params::{ScenarioError, ScenarioParams},
    path::Path,
    rig::{SimCamera, look_at},
};

/// A simulated installation. Pure: what it says depends on parameters and time alone, so any
/// instant can be asked for in any order, from any thread.
#[derive(Clone, Debug)]
pub struct Scenario {
    params: ScenarioParams,
    cameras: Vec<SimCamera>,
    paths: Vec<Path>,
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
    /// Never moves.
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
        Ok(Self { params, cameras, paths, booms, codes })
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
        let motion = path.motion(time_s);
        let attitude = path.attitude(time_s, &motion);
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
            still: path.is_still(),
        }
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
mod tests {
    use super::*;
    use crate::marker::CodeLayout;
    use crate::sim::CameraMount;

    /// Instants over ten minutes, and one a month later.
    fn instants() -> impl Iterator<Item = f64> {
        (0..1500).map(|i| f64::from(i) * 0.4 - 1.0).chain([2.6e6])
    }

    #[test]
    fn truth_is_the_derivative_of_truth() {
        let scenario = Scenario::r4_lite(11);
        let step_s = 1e-4;
        for time_s in instants().step_by(37).take_while(|&t| t < 1e4) {
            let (before, here, after) = (
                scenario.truth(time_s - step_s),
                scenario.truth(time_s),
                scenario.truth(time_s + step_s),
            );
            for ((before, here), after) in before.iter().zip(&here).zip(&after) {
                let place = |truth: &RobotTruth| truth.world_from_roundel.translation.vector;
                let velocity = (place(after) - place(before)) / (2.0 * step_s);
                assert!((velocity - here.velocity_m_s).norm() < 1e-6, "{here:?}: {velocity}");
                let acceleration = (after.velocity_m_s - before.velocity_m_s) / (2.0 * step_s);
                assert!((acceleration - here.acceleration_m_s2).norm() < 1e-6, "{here:?}");
                let turn = |truth: &RobotTruth| truth.world_from_roundel.rotation;
                let rate = (turn(after) * turn(before).inverse()).scaled_axis() / (2.0 * step_s);
                assert!((rate - here.angular_velocity_rad_s).norm() < 1e-5, "{here:?}: {rate}");
            }
        }
    }

    /// Checks limits and distances of all robots at one time.
    fn check_traffic(scenario: &Scenario, time_s: f64) {
        let params = scenario.params();
        let robots = scenario.truth(time_s);
        for (i, robot) in robots.iter().enumerate() {
            let seed = params.seed;
            let place = robot.world_from_roundel.translation.vector;
            let half_m = params.arena_m.map(|side| side / 2.0);
            let inside = place.x.abs() < half_m[0] && place.y.abs() < half_m[1];
            assert!(inside, "seed {seed}, {time_s} s: {robot:?}");
            let acceleration = robot.acceleration_m_s2.norm();
            assert!(acceleration <= params.acceleration_limit_m_s2, "{robot:?}");
            let up = (robot.world_from_roundel.rotation * Vector3::z()).z;
            if robot.flying {
                assert!((1.0..=params.flying_top_m).contains(&place.z), "{robot:?}");
                assert!(up > 15f64.to_radians().cos(), "{robot:?}");
            } else {
                assert_eq!(place.z, params.roundel_height_m);
                assert!((up - 1.0).abs() < 1e-12);
            }
            for other in &robots[..i] {
                let gap_m = (other.world_from_roundel.translation.vector - place).norm();
                assert!(
                    gap_m > 0.4,
                    "seed {seed}, {time_s} s: {} and {} are {gap_m} m apart",
                    other.index,
                    robot.index
                );
            }
        }
    }

    #[test]
    fn robots_keep_their_limits_and_their_distance() {
        for seed in 1..=6 {
            let scenario = Scenario::r4_lite(seed);
            instants().for_each(|time_s| check_traffic(&scenario, time_s));
        }
    }

    #[test]
    fn a_large_arena_takes_two_hundred_robots() {
        let mut params = ScenarioParams::r4(1);
        params.arena_m = [24.0, 18.0];
        let rows = [-6.75, -2.25, 2.25, 6.75];
        params.mounts = [-9.0, -3.0, 3.0, 9.0]
            .into_iter()
            .flat_map(|x| rows.map(|y| [x, y]))
            .map(|[x, y]| CameraMount {
                position_m: [x, y, 8.0],
                target_m: [0.9 * x, 0.9 * y, 0.0],
            })
            .collect();
        (params.robots, params.still) = (200, 20);
        params.kinds[0].pattern = Pattern::Coded(CodeLayout { bits: 12, min_distance: 1 });
        let scenario = Scenario::new(params).unwrap();
        for time_s in instants().step_by(50) {
            check_traffic(&scenario, time_s);
            for robot in scenario.truth(time_s) {
                let seen = scenario.cameras().iter().any(|camera| scenario.in_view(camera, &robot));
                assert!(seen, "{time_s} s: {robot:?}");
            }
        }
    }

    #[test]
    fn a_dense_crowd_still_keeps_its_distance() {
        let mut params = ScenarioParams::r4_lite(5);
        // As many as there is room for.
        (params.flying_share, params.still, params.acceleration_limit_m_s2) = (0.0, 8, 0.2);
        params.robots = 400;
        let Err(ScenarioError::Crowded { most, .. }) = Scenario::new(params.clone()) else {
            panic!("400 robots have no room")
        };
        params.robots = most + params.still;
        let scenario = Scenario::new(params).unwrap();
        instants().step_by(3).for_each(|time_s| check_traffic(&scenario, time_s));
    }

    #[test]
    fn roles_are_dealt_as_asked() {
        let robots = Scenario::r4_lite(2).truth(5.0);
        assert_eq!(robots.len(), 24);
        assert_eq!(robots.iter().filter(|robot| robot.flying).count(), 8);
        assert_eq!(robots.iter().filter(|robot| robot.still).count(), 4);
        let fast = |robot: &RobotTruth| robot.velocity_m_s.norm() > 0.05;
        assert!(robots.iter().filter(|robot| !robot.still).all(fast));
    }

    #[test]
    fn a_camera_sees_every_robot_unless_something_hides_it() {
        let (mut shown, mut hidden) = (0, 0);
        for seed in 1..=3 {
            let scenario = Scenario::r4_lite(seed);
            for time_s in instants().step_by(3) {
                for robot in scenario.truth(time_s) {
                    let viewers: Vec<&SimCamera> = scenario
                        .cameras()
                        .iter()
                        .filter(|camera| scenario.in_view(camera, &robot))
                        .collect();
                    assert!(!viewers.is_empty(), "seed {seed}, {time_s} s: {robot:?} unseen");
                    let clear = viewers
                        .iter()
                        .filter(|camera| !scenario.is_hidden(camera, &robot, time_s))
                        .count();
                    shown += usize::from(clear > 0);
                    hidden += viewers.len() - clear;
                }
            }
        }
        let all = 3 * instants().step_by(3).count() * 24;
        assert!(hidden > 0, "nothing is ever hidden");
        assert!(shown as f64 > 0.97 * all as f64, "{shown} of {all} robots shown");
        assert!(shown < all, "occlusions never hide a robot from all cameras");
    }

    #[test]
    fn cameras_are_out_of_step() {
        let scenario = Scenario::r4_lite(3);
        let cameras = scenario.cameras();
        assert_eq!(cameras.len(), 4);
        for (i, camera) in cameras.iter().enumerate() {
            assert!(camera.phase_s.abs() <= 0.040);
            assert!((camera.rate_hz / 30.0 - 1.0).abs() <= 50e-6);
            assert!(cameras[..i].iter().all(|other| other.phase_s != camera.phase_s));
            let between = camera.frame_time_s(31) - camera.frame_time_s(30);
            assert!((between * 30.0 - 1.0).abs() < 1e-4);
            let rows = camera.row_time_s(0.0, 719.0) - camera.row_time_s(0.0, 0.0);
            assert!((rows - 719.0 * 12e-6).abs() < 1e-12);
        }
    }

    #[test]
    fn a_boom_hides_what_lies_behind_it() {
        let scenario = Scenario::r4_lite(3);
        let boom = scenario.booms_at(7.0)[0];
        let camera = &scenario.cameras()[0];
        let eye = camera.world_from_camera.translation.vector;
        let behind = eye + (boom.world_from_boom.translation.vector - eye) * 1.2;
        let mut robot = scenario.robot(0, 7.0);
        robot.world_from_roundel = Rigid::translation(behind.x, behind.y, behind.z);
        assert!(scenario.is_hidden(camera, &robot, 7.0));
        let before = eye + (behind - eye) * 0.5;
        robot.world_from_roundel = Rigid::translation(before.x, before.y, before.z);
        assert!(!scenario.is_hidden(camera, &robot, 7.0));
    }

    #[test]
    fn too_many_robots_are_refused_with_the_number_that_fits() {
        let mut params = ScenarioParams::r4_lite(1);
        params.robots = 400;
        let message = Scenario::new(params.clone()).unwrap_err().to_string();
        let most: usize = message
            .split_once("expected at most ")
            .and_then(|(_, rest)| rest.split_once(' '))
            .and_then(|(number, _)| number.parse().ok())
            .unwrap_or_else(|| panic!("no number in: {message}"));
        params.robots = most + params.still;
        params.flying_share = 0.0;
        assert!(Scenario::new(params.clone()).is_ok(), "{message}");
        params.robots += 1;
        assert!(Scenario::new(params).is_err(), "{message}");
    }

    #[test]
    fn cameras_that_see_nothing_of_the_arena_are_refused() {
        let mut params = ScenarioParams::r4_lite(1);
        for mount in &mut params.mounts {
            mount.target_m = [mount.position_m[0] * 4.0, mount.position_m[1] * 4.0, 4.0];
        }
        assert!(matches!(Scenario::new(params), Err(ScenarioError::Uncovered { .. })));
    }
}

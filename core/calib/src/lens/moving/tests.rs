use nalgebra::{Matrix3, Point2, Point3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{super::fit::rim, *};
use crate::test_world;
use roundel_vision::camera::{Camera, Lens};

const SIZE: (usize, usize) = (1920, 1080);
const RADIUS_M: f64 = 0.08;
/// Standard deviation and correlation time of positions, and noise of the camera.
const PLACE_M: f64 = 5e-4;
const STAYS_S: f64 = 0.5;
const PIXEL_PX: f64 = 0.05;
/// Delay of the camera's clock.
const LATE_S: f64 = 0.03;
const CLOCK: ClockPrior = ClockPrior { offset_s: 0.04, skew: 1e-4 };

/// Robots on circles at these heights below a camera of R4.
struct Scene {
    heights_m: Vec<f64>,
    camera_from_world: Rigid,
    camera: Camera,
    seconds: f64,
}

impl Scene {
    fn new(heights_m: &[f64], seconds: f64) -> Self {
        let lens = Lens::PlumbBob([-0.08, 0.02, 2e-4, -3e-4, 0.0]);
        let camera = test_world::camera(SIZE, [1103.0, 1100.0, 952.0, 547.0], lens);
        // Looks down obliquely from 5 m.
        let turn = UnitQuaternion::from_euler_angles(std::f64::consts::PI - 0.32, 0.05, 0.3);
        let place = Point3::new(0.4, -1.6, 5.0);
        let camera_from_world = Rigid::from_parts((-(turn * place.coords)).into(), turn);
        Self { heights_m: heights_m.to_vec(), camera_from_world, camera, seconds }
    }

    /// world_from_roundel and velocity.
    fn pose(&self, robot: usize, time_s: f64) -> (Rigid, Vector3<f64>) {
        let number = robot as f64;
        let (radius_m, rate) = (0.5 + 0.35 * (number * 0.7).sin(), 0.7 + 0.06 * number);
        let phase = rate * time_s + number * 2.4;
        let middle = Vector3::new(
            2.1 * (number * 1.9).sin(),
            1.3 * (number * 3.1).cos() + 0.2,
            self.heights_m[robot % self.heights_m.len()],
        );
        let (sin, cos) = phase.sin_cos();
        let place = middle + Vector3::new(radius_m * cos, radius_m * sin, 0.0);
        let velocity = Vector3::new(-sin, cos, 0.0) * (radius_m * rate);
        let turn = UnitQuaternion::from_euler_angles(0.1 * sin, 0.1 * cos, phase);
        (Rigid::from_parts(place.into(), turn), velocity)
    }

    /// Trajectories, and the observations of the camera.
    fn seen(&self, robots: usize, rng: &mut ChaCha8Rng) -> (Vec<Trajectory>, Vec<RimObservation>) {
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let mut trajectories = Vec::new();
        let mut observations = Vec::new();
        for robot in 0..robots {
            let mut off = Vector3::from_fn(|_, _| normal() * PLACE_M);
            let step_s = 1.0 / 60.0;
            let kept = f64::exp(-step_s / STAYS_S);
            let waypoints = (0..(self.seconds / step_s) as usize).map(|step| {
                let time_s = step as f64 * step_s;
                let (pose, velocity_m_s) = self.pose(robot, time_s);
                off = off * kept
                    + Vector3::from_fn(|_, _| normal() * PLACE_M * (1.0 - kept * kept).sqrt());
                Waypoint {
                    time_s,
                    position_m: pose.translation.vector + off,
                    velocity_m_s,
                    orientation: pose.rotation,
                    covariance_m2: Matrix3::identity() * PLACE_M * PLACE_M,
                }
            });
            trajectories.push(Trajectory::new(RADIUS_M, waypoints.collect()));
            for frame in 0..(self.seconds * 30.0) as usize {
                let time_s = frame as f64 / 30.0 + 0.011;
                let (pose, _) = self.pose(robot, time_s);
                let pose = self.camera_from_world * pose;
                let Ok(pixel) = self.camera.project(&pose.translation.vector) else { continue };
                let image =
                    rim::project_rim(&self.camera, &pose, &Point2::origin(), RADIUS_M).unwrap();
                let center = PixelPoint {
                    u: pixel.u + image.offset_px.x + normal() * PIXEL_PX,
                    v: pixel.v + image.offset_px.y + normal() * PIXEL_PX,
                };
                let inside =
                    |place_px: f64, side: usize| (20.0..side as f64 - 20.0).contains(&place_px);
                if inside(center.u, SIZE.0) && inside(center.v, SIZE.1) {
                    let radius_px = RADIUS_M * 1100.0 / pose.translation.z;
                    let stamp_s = time_s + LATE_S;
                    observations.push(RimObservation {
                        trajectory: robot,
                        stamp_s,
                        center,
                        radius_px,
                    });
                }
            }
        }
        (trajectories, observations)
    }
}

fn found(
    trajectories: &[Trajectory],
    observations: &[RimObservation],
) -> Result<MovingLens, MovingLensError> {
    calibrate(&MovingInput { size: SIZE, trajectories, observations, clock: CLOCK }, None)
}

/// Errors with their standard deviations: intrinsics, pose and clock.
fn errors(scene: &Scene, found: &MovingLens) -> Vec<(f64, f64)> {
    let lens = test_world::pinhole_errors(&found.lens.camera, &scene.camera);
    let off = found.world_from_camera.translation.vector
        - scene.camera_from_world.inverse().translation.vector;
    let turned = found.world_from_camera.rotation * scene.camera_from_world.rotation;
    let turned = turned.scaled_axis();
    let place = off.iter().chain(&turned).copied();
    let deviations = found.pose_covariance.diagonal().map(f64::sqrt);
    let lens = lens.into_iter().zip(found.lens.deviations());
    let clock = (found.offset_s.0 - LATE_S, found.offset_s.1);
    lens.chain(place.zip(deviations.iter().copied())).chain([clock]).collect()
}

#[test]
fn a_lens_is_found_from_moving_roundels() {
    let scene = Scene::new(&[0.3, 0.3, 1.4], 15.0);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (trajectories, mut observations) = scene.seen(14, &mut rng);
    // One of fifty belongs to another roundel, and two are invalid.
    for index in (0..observations.len()).step_by(50) {
        observations[index].trajectory = (observations[index].trajectory + 1) % trajectories.len();
    }
    observations[1].center.u = f64::NAN;
    observations[2].trajectory = 99;
    let found = found(&trajectories, &observations).unwrap();
    assert_eq!(found.lens.model.ros_name(), "plumb_bob", "{:?}", found.lens.evidence);
    let errors = errors(&scene, &found);
    for focal in &errors[..2] {
        assert!(focal.0.abs() < 1.1, "{errors:?}");
    }
    assert!(errors[2].0.hypot(errors[3].0) < 1.0, "{errors:?}");
    for (error, deviation) in &errors {
        assert!(error.abs() < 4.0 * deviation, "{errors:?}");
    }
    assert!((found.estimated_noise.0 - PIXEL_PX).abs() < 0.05, "{:?}", found.estimated_noise);
    assert!(found.lens.outliers >= observations.len() / 50, "{}", found.lens.outliers);
    assert!(found.coverage() > 0.8 && found.depths_m[0] < 4.2, "{found:?}");
}

/// Mean square of error over deviation across seeds.
#[test]
fn deviations_are_consistent() {
    let scene = Scene::new(&[0.3, 0.3, 1.4], 15.0);
    const SEEDS: u64 = 20;
    let mut squares = vec![0.0; 11];
    for seed in 0..SEEDS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (trajectories, observations) = scene.seen(10, &mut rng);
        let thin: Vec<RimObservation> = observations.into_iter().step_by(3).collect();
        let seen = MovingInput {
            size: SIZE,
            trajectories: &trajectories,
            observations: &thin,
            clock: CLOCK,
        };
        let found = calibrate(&seen, Some(DistortionModel::Tangential)).unwrap();
        for (sum, (error, deviation)) in squares.iter_mut().zip(errors(&scene, &found)) {
            *sum += (error / deviation).powi(2) / SEEDS as f64;
        }
    }
    // χ² with 20 degrees of freedom, over 20: 99.6 % lie between 0.35 and 2.1 for a single parameter.
    assert!(squares.iter().all(|square| (0.3..2.2).contains(square)), "{squares:?}");
}

#[test]
fn missing_observations_are_named() {
    let scene = Scene::new(&[0.3], 4.0);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (trajectories, observations) = scene.seen(12, &mut rng);
    let error = found(&trajectories, &observations[..60]).unwrap_err().to_string();
    assert!(error.contains("found 60 in") && error.contains("missing: roundels"), "{error}");
    let error = found(&trajectories[..0], &observations).unwrap_err().to_string();
    assert!(error.contains("found 0 in 0"), "{error}");
    let seen = MovingInput {
        size: (0, 9),
        trajectories: &trajectories,
        observations: &observations,
        clock: CLOCK,
    };
    let error = calibrate(&seen, None).unwrap_err().to_string();
    assert!(error.contains("found 0 x 9"), "{error}");
    // All assigned to other trajectories.
    let mixed: Vec<RimObservation> = observations
        .iter()
        .enumerate()
        .map(|(index, it)| RimObservation {
            trajectory: (it.trajectory + 1 + index % 10) % 12,
            ..*it
        })
        .collect();
    let error = found(&trajectories, &mixed).unwrap_err().to_string();
    assert!(error.contains("no lens explains"), "{error}");
}

#[test]
fn a_plane_facing_the_camera_does_not_determine_the_focal_length() {
    let mut scene = Scene::new(&[0.3], 10.0);
    let turn = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    scene.camera_from_world =
        Rigid::from_parts((-(turn * Vector3::new(0.0, 0.2, 5.0))).into(), turn);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let (trajectories, observations) = scene.seen(14, &mut rng);
    let error = found(&trajectories, &observations).unwrap_err();
    assert!(matches!(error, MovingLensError::Undetermined { .. }), "{error}");
    let error = error.to_string();
    assert!(error.contains("distances differ by 0 %"), "{error}");
}

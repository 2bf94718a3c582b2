use nalgebra::Vector6;

use super::*;
use crate::arena::SiteClock;

/// One camera's errors against the truth, with what it stated.
struct Tally {
    /// Normalized squares of position, of the rotation, and of the likelier normal's being right.
    position: Vec<f64>,
    rotation: Vec<f64>,
    right: usize,
    expected_right: f64,
}

/// Errors in the camera's frame at the time that each detection states.
fn tally(arena: &Arena, sensing: Sensing, frames: usize) -> Tally {
    let mut tally =
        Tally { position: Vec::new(), rotation: Vec::new(), right: 0, expected_right: 0.0 };
    for index in 0..arena.sites.len() {
        let mut sensor = Sensor::new(arena, index, sensing);
        let camera_from_world = arena.sites[index].world_from_camera.inverse();
        for frame in (0..frames).map(|frame| sensor.frame(frame)) {
            for seen in &frame.detections {
                let pose = seen.pose.as_ref().unwrap();
                let number = seen.ring.code.unwrap().code.number;
                let truth = arena.truth(seen.capture_time.as_ns())[usize::from(number) - 1];
                let truth = camera_from_world * truth.pose;
                let orientation = |normal: &Vector3<f64>, yaw_rad: f64| {
                    UnitQuaternion::rotation_between(&Vector3::z(), normal).unwrap()
                        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad)
                };
                let first = orientation(&pose.normal, pose.yaw_rad.unwrap());
                let other = orientation(&pose.other_normal, pose.other_yaw_rad().unwrap());
                let is_right = first.angle_to(&truth.rotation) < other.angle_to(&truth.rotation);
                tally.right += usize::from(is_right);
                tally.expected_right += pose.normal_likelihood;
                let error = pose.position_m - truth.translation.vector;
                let block = |from| pose.covariance.fixed_view::<3, 3>(from, from).into_owned();
                let square = |error: &Vector3<f64>, block: Matrix3<f64>| {
                    error.dot(&block.cholesky().unwrap().solve(error))
                };
                tally.position.push(square(&error, block(0)));
                if is_right {
                    let turn = (first * truth.rotation.inverse()).scaled_axis();
                    tally.rotation.push(square(&turn, block(3)));
                } else {
                    // Told second, it is the same orientation.
                    let turn = (other * truth.rotation.inverse()).scaled_axis();
                    assert!(turn.norm() < 0.3, "{turn}");
                }
            }
        }
    }
    tally
}

fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len() as f64
}

/// Every code is read, and a lens at an angle of sight that parts the normals.
const READ: Sensing = Sensing {
    noise_px: 0.2,
    tilt_rad: 0.02,
    yaw_rad: 0.005,
    systematic_share: 0.0,
    systematic_time_s: 1.0,
    is_kept_while_still: false,
    dropout: 0.1,
    clutter: 0.0,
    unread: 0.0,
    misread: 0.0,
    latency_s: (0.01, 0.03),
    shows_rims: false,
};

/// Moving robots, a rolling shutter and a lens that bends: errors are what is stated all the same.
#[test]
fn errors_are_those_stated() {
    let arena = Arena::r4(2);
    let tally = tally(&arena, READ, 300);
    let count = tally.position.len();
    assert!(count > 10_000);
    let inside = |squares: &[f64]| {
        squares.iter().filter(|square| **square <= 7.815).count() as f64 / squares.len() as f64
    };
    assert!((mean(&tally.position) - 3.0).abs() < 0.1, "{}", mean(&tally.position));
    assert!((inside(&tally.position) - 0.95).abs() < 0.01);
    // Where both normals nearly coincide, which one is right cannot be told.
    assert!((mean(&tally.rotation) - 3.0).abs() < 0.15, "{}", mean(&tally.rotation));
    assert!((inside(&tally.rotation) - 0.95).abs() < 0.01);
    let (right, expected) = (tally.right as f64, tally.expected_right);
    assert!((right - expected).abs() < 0.02 * expected, "{right} {expected}");
}

/// The mean of a second's errors of one robot is as far off as the share that stays says.
#[test]
fn a_share_of_the_errors_stays() {
    let mut arena = Arena::r4(3);
    arena.robots.truncate(1);
    arena.robots[0].path = Path::still(Vector3::new(0.3, 0.2, 0.3));
    let mean_square = |systematic_share: f64| {
        let sensing = Sensing { systematic_share, systematic_time_s: 5.0, ..READ };
        let mut sensor = Sensor::new(&arena, 0, sensing);
        let camera_from_world = arena.sites[0].world_from_camera.inverse();
        let truth = (camera_from_world * arena.truth(arena.start_ns)[0].pose).translation.vector;
        let squares: Vec<f64> = (0..400)
            .map(|second| {
                let frames = (0..60).map(|frame| sensor.frame(60 * second + frame));
                let poses: Vec<RoundelPose> =
                    frames.flat_map(|f| f.detections).filter_map(|d| d.pose).collect();
                let errors = poses.iter().map(|pose| pose.position_m - truth);
                let error = errors.sum::<Vector3<f64>>() / poses.len() as f64;
                let block = poses[0].covariance.fixed_view::<3, 3>(0, 0).into_owned();
                error.dot(&block.cholesky().unwrap().solve(&error)) / 3.0
            })
            .collect();
        mean(&squares)
    };
    assert!((mean_square(0.0) - 1.0 / 54.0).abs() < 0.005);
    // Within a second, a process of 5 s keeps 94 % of its mean's variance.
    let stays = mean_square(0.5);
    assert!((0.37..0.57).contains(&stays), "{stays}");
}

/// Kept while still, all of the share is the same at any time; a robot that moves does not keep it.
#[test]
fn what_stands_keeps_its_error_and_what_moves_does_not() {
    let mut arena = Arena::r4(3);
    let sensing = Sensing { systematic_share: 1.0, is_kept_while_still: true, ..READ };
    let mut errors = |path: Option<Path>| -> Vec<Vector3<f64>> {
        arena.robots.truncate(1);
        if let Some(path) = path {
            arena.robots[0].path = path;
        }
        let mut sensor = Sensor::new(&arena, 0, sensing);
        let camera_from_world = arena.sites[0].world_from_camera.inverse();
        let seen = (0..1200).flat_map(|frame| sensor.frame(frame).detections);
        let error = |seen: Detection| {
            let truth = camera_from_world * arena.truth(seen.capture_time.as_ns())[0].pose;
            seen.pose.unwrap().position_m - truth.translation.vector
        };
        seen.map(error).collect()
    };
    let spread = |errors: &[Vector3<f64>]| {
        errors.iter().map(|error| (error - errors[0]).norm()).fold(0.0, f64::max)
    };
    assert!(spread(&errors(None)) > 1e-3);
    assert!(spread(&errors(Some(Path::still(Vector3::new(0.3, 0.2, 0.3))))) < 1e-6);
}

#[test]
fn stated_times_are_the_clocks_and_rows_count() {
    let mut arena = Arena::r4(4);
    arena.sites[1].clock = SiteClock { ahead_s: 0.03, skew: 0.0 };
    let mut sensor = Sensor::new(&arena, 1, READ);
    let frame = sensor.frame(7);
    let true_ns = arena.capture_time_ns(&arena.sites[1], 7);
    assert_eq!(frame.capture_time.as_ns() - true_ns, 30_000_000);
    let latency_s = (frame.received_time.as_ns() - true_ns) as f64 * 1e-9;
    assert!((0.01..0.03).contains(&latency_s));
    for seen in &frame.detections {
        let row_s = (seen.ring.outer.center.v - 539.5) * 12e-6;
        let stated_s = seen.capture_time.seconds_since(frame.capture_time);
        assert!((stated_s - row_s).abs() < 2e-9);
    }
}

#[test]
fn streams_arrive_in_order_and_whole() {
    let arena = Arena::r4(5);
    let sensing = Sensing { latency_s: (0.0, 0.04), clutter: 1.0, ..READ };
    let frames: Vec<_> = Stream::new(&arena, sensing, 2.0).collect();
    assert_eq!(frames.len(), 4 * 120);
    assert!(frames.is_sorted_by_key(|frame| frame.received_time));
    assert!(!frames.is_sorted_by_key(|frame| frame.capture_time));
    let false_ones = |frame: &FrameObservations| {
        frame.detections.iter().filter(|seen| seen.ring.code.is_none()).count()
    };
    let clutter: usize = frames.iter().map(false_ones).sum();
    assert!((400..=480).contains(&clutter), "{clutter}");
}

#[test]
fn a_robot_that_was_hidden_comes_back_under_another_number() {
    let mut arena = Arena::r4(6);
    arena.robots[0].hidden_s = vec![(0.5, 1.0)];
    let sensing = Sensing { dropout: 0.0, ..READ };
    let code = arena.robots[0].code;
    let mut numbers = Vec::new();
    for frame in Stream::new(&arena, sensing, 1.5) {
        for seen in &frame.detections {
            if seen.ring.code.map(|reading| reading.code.number) == code {
                let t = (seen.capture_time.as_ns() - arena.start_ns) as f64 * 1e-9;
                assert!(!(0.51..0.99).contains(&t), "{t}");
                numbers.push((frame.camera, seen.track));
            }
        }
    }
    numbers.sort_unstable();
    numbers.dedup();
    let cameras = numbers.chunk_by(|a, b| a.0 == b.0);
    assert!(cameras.clone().count() >= 1 && cameras.clone().all(|of| of.len() == 2));
}

#[test]
fn mirrored_orientations_have_the_same_image_and_come_back() {
    let seen = UnitQuaternion::from_euler_angles(2.7, 0.3, 1.1);
    let place = Vector3::new(0.4, -0.2, 5.0);
    let other = mirror(&seen, &place);
    assert!(mirror(&other, &place).angle_to(&seen) < 1e-12);
    let pose = |normal, yaw_rad| RoundelPose {
        position_m: place,
        normal,
        normal_likelihood: 0.6,
        other_normal: other * Vector3::z(),
        yaw_rad: Some(yaw_rad),
        yaw_symmetry: 1,
        covariance: Covariance6::from_diagonal(&Vector6::repeat(1e-4)),
    };
    let carried = pose(seen * Vector3::z(), heading_rad(&seen)).other_yaw_rad().unwrap();
    assert!((carried - heading_rad(&other)).abs() < 1e-9);
}

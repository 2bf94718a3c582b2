use nalgebra::Vector6;

use super::*;
use crate::arena::SiteClock;

/// Normalized errors of one camera's detections.
struct ErrorSample {
    /// Normalized squares of position and rotation, and whether the likelier normal was right.
    position: Vec<f64>,
    rotation: Vec<f64>,
    right: usize,
    expected_right: f64,
}

/// Errors in the camera's frame at each detection's stated time.
fn sample(arena: &Arena, sensing: Sensing, frames: usize) -> ErrorSample {
    let mut sample =
        ErrorSample { position: Vec::new(), rotation: Vec::new(), right: 0, expected_right: 0.0 };
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
                sample.right += usize::from(is_right);
                sample.expected_right += pose.normal_likelihood;
                let error = pose.position_m - truth.translation.vector;
                let block = |from| pose.covariance.fixed_view::<3, 3>(from, from).into_owned();
                let square = |error: &Vector3<f64>, block: Matrix3<f64>| {
                    error.dot(&block.cholesky().unwrap().solve(error))
                };
                sample.position.push(square(&error, block(0)));
                if is_right {
                    let turn = (first * truth.rotation.inverse()).scaled_axis();
                    sample.rotation.push(square(&turn, block(3)));
                } else {
                    // The second normal belongs to the same orientation.
                    let turn = (other * truth.rotation.inverse()).scaled_axis();
                    assert!(turn.norm() < 0.3, "{turn}");
                }
            }
        }
    }
    sample
}

fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len() as f64
}

/// Every code is read, at a viewing angle where the two normals differ.
const READ: Sensing = Sensing {
    noise_px: 0.2,
    tilt_rad: 0.02,
    yaw_rad: 0.005,
    systematic_share: 0.0,
    systematic_time_s: 1.0,
    bias_persists_while_still: false,
    dropout: 0.1,
    clutter: 0.0,
    unread: 0.0,
    misread: 0.0,
    latency_s: (0.01, 0.03),
    shows_rims: false,
};

/// Moving robots, a rolling shutter and a distorting lens do not change the error model.
#[test]
fn errors_match_their_covariances() {
    let arena = Arena::r4(2);
    let sample = sample(&arena, READ, 300);
    let count = sample.position.len();
    assert!(count > 10_000);
    let inside = |squares: &[f64]| {
        squares.iter().filter(|square| **square <= 7.815).count() as f64 / squares.len() as f64
    };
    assert!((mean(&sample.position) - 3.0).abs() < 0.1, "{}", mean(&sample.position));
    assert!((inside(&sample.position) - 0.95).abs() < 0.01);
    // Where both normals almost coincide, which one is right cannot be decided.
    assert!((mean(&sample.rotation) - 3.0).abs() < 0.15, "{}", mean(&sample.rotation));
    assert!((inside(&sample.rotation) - 0.95).abs() < 0.01);
    let (right, expected) = (sample.right as f64, sample.expected_right);
    assert!((right - expected).abs() < 0.02 * expected, "{right} {expected}");
}

/// The mean error of one robot over a second has the variance of the persistent share.
#[test]
fn a_share_of_the_errors_persists() {
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
    let persistent = mean_square(0.5);
    assert!((0.37..0.57).contains(&persistent), "{persistent}");
}

/// The persistent error of a still roundel never changes; that of a moving one does.
#[test]
fn still_roundels_keep_their_error_and_moving_ones_do_not() {
    let mut arena = Arena::r4(3);
    let sensing = Sensing { systematic_share: 1.0, bias_persists_while_still: true, ..READ };
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
fn stated_times_are_the_clocks_plus_the_rows_delay() {
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
fn streams_arrive_in_order_and_complete() {
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
fn a_hidden_robot_returns_with_another_track_number() {
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
    assert!(cameras.clone().count() >= 1 && cameras.clone().all(|track| track.len() == 2));
}

#[test]
fn mirroring_keeps_the_image_and_is_its_own_inverse() {
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

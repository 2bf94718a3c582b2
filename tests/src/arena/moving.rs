//! Installations with cameras on robots: a drone above others, and a robot that docks.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{
    Arena, Course, Kind, Landmark, Mount, Path, Sine,
    reference::{Model, site},
};
use crate::random::Random;

/// A small camera of 640 × 480 pixels at 30 Hz.
const fn small(focal_px: f64) -> Model {
    Model { width: 640, height: 480, focal_px, rate_hz: 30.0 }
}

/// Diameter of the docking station's prints.
const STATION_M: f64 = 0.08;
/// Half the distances between the station's prints, horizontally and vertically.
const STATION_HALF_M: [f64; 2] = [0.15, 0.10];

/// The docking camera moves between these distances from the station, metres.
pub const DOCKING_M: [f64; 2] = [0.5, 3.0];
/// Duration of each approach and of each retreat.
pub const DOCKING_S: f64 = 20.0;

impl Arena {
    /// R4's cameras observe a drone at a height of 2 m. Its camera looks down at ten robots that the other cameras do
    /// not see. The drone is robot 0.
    pub fn with_drone(seed: u64) -> Self {
        let mut random = Random::new(seed, 40);
        let middle = Vector3::new(0.0, 1.1, 1.4);
        let drone = Path::wandering(middle, 0.3, Some((0.5, 0.6)), &mut random);
        let mut arena = Self::under_r4(seed, Kind::coded(8), vec![drone]);
        for index in 0..10 {
            let (column, row) = (index % 4, index / 4);
            let place =
                Vector3::new(0.5 * f64::from(column) - 0.75, 0.65 + 0.45 * f64::from(row), 0.3);
            arena.add_robot(Path::circuit(place, 0.12, 0.3, 0.6 * f64::from(index)));
        }
        arena.robots[1..].iter_mut().for_each(|robot| robot.is_hidden_from_fixed_cameras = true);
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let below = Translation3::new(0.05, 0.0, -0.1);
        arena.ride(0, small(350.0), Isometry3::from_parts(below, down), &mut random);
        arena
    }

    /// One robot with a camera (f = 600 px) that looks forward, at a station with four prints of 80 mm. No other
    /// camera sees it. It approaches and retreats, swaying by 0.1 m.
    pub fn docking(seed: u64) -> Self {
        let mut random = Random::new(seed, 41);
        let mut arena = Self::empty(seed, Kind::coded(8), Vec::new());
        let station = Kind {
            name: "station".into(),
            outer_diameter_m: STATION_M,
            inner_diameter_m: 0.6 * STATION_M,
            ..Kind::coded(8)
        };
        arena.kinds.push(station);
        // The camera looks along x, with its image upright.
        let axes = Matrix3::from_columns(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let aboard = Vector3::new(0.2, 0.0, -0.1);
        let [near_m, far_m] = DOCKING_M;
        let course = Course::Sines([
            Sine {
                amplitude_m: (far_m - near_m) / 2.0,
                rate_rad_s: PI / DOCKING_S,
                phase_rad: -PI / 2.0,
            },
            Sine { amplitude_m: 0.1, rate_rad_s: 0.8, phase_rad: 0.0 },
            Sine::default(),
        ]);
        let center_m = Vector3::new(-(near_m + far_m) / 2.0 - aboard.x, 0.0, 0.4);
        arena.add_robot(Path { course, ..Path::still(center_m) });
        arena.ride(0, small(600.0), Isometry3::from_parts(aboard.into(), turn), &mut random);
        // The wall's normal is -x, and the prints' y points up.
        let axes = Matrix3::from_columns(&[-Vector3::y(), Vector3::z(), -Vector3::x()]);
        let faces = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
        arena.landmarks = (11..)
            .zip(corners)
            .map(|(code, (y, z))| {
                let place =
                    Translation3::new(0.0, STATION_HALF_M[0] * y, 0.3 + STATION_HALF_M[1] * z);
                Landmark { kind: 1, code, pose: Isometry3::from_parts(place, faces) }
            })
            .collect();
        arena
    }

    fn ride(
        &mut self,
        robot: usize,
        model: Model,
        robot_from_camera: Isometry3<f64>,
        random: &mut Random,
    ) {
        let mut site = site("aboard".into(), &model, Isometry3::identity(), random);
        site.mount = Some(Mount { robot, robot_from_camera });
        self.sites.push(site);
    }
}

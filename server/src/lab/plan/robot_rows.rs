//! Robots in rows, all of which move alike: as many as a picture has room for.
//!
//! In a scenario of its own accord robots keep clear of each other by more than a dense picture allows, and each has its
//! speed. So they are told to go to places below its first camera, and how to move from a given time on.

use nalgebra::{Point3, Vector2, Vector3};
use roundel_core::{
    camera::{LensError, PixelPoint},
    sim::{Drive, Scenario},
};

/// When they have gone to their places, seconds after the scenario's start: once most of the way, and once more what the
/// first was off by.
const GOING_S: [[f64; 2]; 2] = [[0.0, 100.0], [105.0, 115.0]];
/// When they have stood for long enough, and begin to move.
const MOVING_S: f64 = 120.0;
/// When all move as they were told.
pub const BEGIN_S: f64 = 125.0;
const END_S: f64 = 1000.0;
/// How far a place may be off the middle of its cell, a share of that.
const STRAY_SHARE: f64 = 0.1;

/// Draws all robots up, on the ground at that height, so that they are spread over the first camera's picture
/// [`BEGIN_S`] after the scenario's start plus `half_s`, and move at this velocity until long after.
pub fn arrange_in_rows(
    scenario: &mut Scenario,
    height_m: f64,
    velocity_m_s: Vector3<f64>,
    half_s: f64,
) -> Result<(), LensError> {
    let since_s = BEGIN_S + half_s - MOVING_S;
    let places = places(scenario, height_m)?;
    for (index, place_m) in places.into_iter().enumerate() {
        let start_m = place_m - velocity_m_s * since_s;
        for span_s in GOING_S {
            let way_m =
                start_m - scenario.robot(index, span_s[0]).world_from_roundel.translation.vector;
            let velocity_m_s = Vector3::new(way_m.x, way_m.y, 0.0) / (span_s[1] - span_s[0]);
            scenario.drive(index, Drive { velocity_m_s, span_s });
        }
        scenario.drive(index, Drive { velocity_m_s, span_s: [MOVING_S, END_S] });
    }
    Ok(())
}

/// As many places at that height as there are robots, in the cells of a grid over the picture.
fn places(scenario: &Scenario, height_m: f64) -> Result<Vec<Vector3<f64>>, LensError> {
    let camera = &scenario.cameras()[0];
    let sides = Vector2::new(camera.camera.width() as f64, camera.camera.height() as f64);
    let count = scenario.params().robots;
    let columns = (count as f64 * sides.x / sides.y).sqrt().ceil().max(1.0);
    let rows = (count as f64 / columns).ceil();
    let cell = Vector2::new(sides.x / columns, sides.y / rows);
    let eye = Point3::from(camera.world_from_camera.translation.vector);
    (0..count)
        .map(|index| {
            let (column, row) = (index as f64 % columns, (index as f64 / columns).floor());
            // Not all alike in their pixels.
            let stray = (index as f64 * 2.4).sin_cos();
            let u = (column + 0.5 + STRAY_SHARE * stray.0) * cell.x;
            let v = (row + 0.5 + STRAY_SHARE * stray.1) * cell.y;
            let ray = camera.world_from_camera * camera.camera.bearing(PixelPoint { u, v })?;
            Ok((eye + ray * ((height_m - eye.z) / ray.z)).coords)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use roundel_core::sim::{CameraMount, ScenarioParams};

    use super::*;

    #[test]
    fn robots_stand_over_the_whole_picture_and_move_alike() {
        let mut params = ScenarioParams::r4_lite(1);
        (params.robots, params.still, params.flying_share) = (20, 0, 0.0);
        params.arena_m = [24.0, 18.0];
        params.mounts = [3.0, 40.0]
            .map(|z_m| CameraMount { position_m: [0.0, 0.0, z_m], target_m: [0.0; 3] })
            .to_vec();
        let mut scenario = Scenario::new(params).unwrap();
        let velocity_m_s = Vector3::new(0.3, -0.2, 0.0);
        arrange_in_rows(&mut scenario, 0.3, velocity_m_s, 0.5).unwrap();
        let camera = &scenario.cameras()[0];
        let mut cells: Vec<_> = scenario
            .truth(BEGIN_S + 0.5)
            .iter()
            .map(|robot| {
                assert!((robot.velocity_m_s - velocity_m_s).norm() < 1e-6, "{robot:?}");
                let center = Point3::from(robot.world_from_roundel.translation.vector);
                let pixel = camera.project(&center).unwrap();
                // Six columns, and four rows of 180 pixels.
                ((pixel.u / (1280.0 / 6.0)).floor() as i64, (pixel.v / 180.0).floor() as i64)
            })
            .collect();
        cells.sort_unstable();
        cells.dedup();
        assert_eq!(cells.len(), 20);
        assert!(cells.iter().all(|&(u, v)| (0..6).contains(&u) && (0..4).contains(&v)));
    }
}

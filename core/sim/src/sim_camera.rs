//! Simulated cameras: lens, pose and timing.

use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use roundel_vision::{
    camera::{Camera, PixelPoint},
    rigid::Rigid,
};

/// A camera of a scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct SimCamera {
    /// Unique within the scenario.
    pub name: String,
    /// Intrinsics and lens.
    pub camera: Camera,
    /// Pose.
    pub world_from_camera: Rigid,
    /// Capture time of frame 0 (middle of the exposure at the middle row), seconds after the scenario's start; may
    /// be negative.
    pub phase_s: f64,
    /// Frame rate, hertz, with the camera's own deviation.
    pub rate_hz: f64,
    /// Time from one row's exposure to the next one's, seconds.
    pub line_time_s: f64,
    /// Exposure of a row, seconds.
    pub exposure_s: f64,
}

impl SimCamera {
    /// Capture time of a frame: the middle of the exposure at the middle row, seconds after the scenario's start.
    pub fn frame_time_s(&self, frame: u64) -> f64 {
        self.phase_s + frame as f64 / self.rate_hz
    }

    /// Middle of the exposure at row `v_px` of a frame captured at `frame_time_s`.
    pub fn row_time_s(&self, frame_time_s: f64, v_px: f64) -> f64 {
        frame_time_s + (v_px - (self.camera.height() as f64 - 1.0) / 2.0) * self.line_time_s
    }

    /// Image of a world point, possibly outside of the picture; `None` behind the camera or beyond its lens' range.
    pub fn project(&self, world_m: &Point3<f64>) -> Option<PixelPoint> {
        let in_camera = self.world_from_camera.inverse_transform_point(world_m);
        self.camera.project(&in_camera.coords).ok()
    }

    /// Whether the image of a world point is at least `margin_px` inside the picture.
    pub fn sees(&self, world_m: &Point3<f64>, margin_px: f64) -> bool {
        let (width, height) = (self.camera.width() as f64, self.camera.height() as f64);
        self.project(world_m).is_some_and(|pixel| {
            pixel.u > margin_px - 0.5
                && pixel.v > margin_px - 0.5
                && pixel.u < width - 0.5 - margin_px
                && pixel.v < height - 0.5 - margin_px
        })
    }
}

/// Pose of a camera at `eye_m` that looks at `target_m`, with the top of the image towards world +y (+x if it looks
/// along y), as on a map of the arena.
pub fn look_at(eye_m: [f64; 3], target_m: [f64; 3]) -> Rigid {
    let eye = Vector3::from(eye_m);
    let forward =
        (Vector3::from(target_m) - eye).try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    let right = forward
        .cross(&Vector3::y())
        .try_normalize(1e-6)
        .or_else(|| forward.cross(&Vector3::x()).try_normalize(1e-6))
        .unwrap_or_else(Vector3::x);
    let down = forward.cross(&right);
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
    Rigid::from_parts(Translation3::from(eye), UnitQuaternion::from_rotation_matrix(&turn))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_above_sees_the_arena_as_a_map() {
        let world_from_camera = look_at([0.0, 0.0, 5.0], [0.0, 0.0, 0.0]);
        let east = world_from_camera.rotation.inverse() * Vector3::x();
        let north = world_from_camera.rotation.inverse() * Vector3::y();
        assert!((east - Vector3::x()).norm() < 1e-12, "east is right in the image: {east}");
        assert!((north + Vector3::y()).norm() < 1e-12, "north is up in the image: {north}");
    }

    #[test]
    fn the_optical_axis_meets_the_target() {
        let world_from_camera = look_at([2.5, -2.0, 5.0], [1.25, -1.0, 0.0]);
        let target = world_from_camera.inverse_transform_point(&Point3::new(1.25, -1.0, 0.0));
        assert!(target.x.abs() < 1e-12 && target.y.abs() < 1e-12 && target.z > 5.0);
    }
}

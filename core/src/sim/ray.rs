//! Undistorted rays of all pixels, from a grid of exact ones.
//!
//! Undistorting each pixel of each window in every frame would cost more than painting it. Between
//! nodes 4 px apart the lens is as good as linear: a distortion k r³ / f² bends by h² · 6 k r / (8 f²)
//! there, below 0.004 px for the reference lenses.

use crate::camera::{Camera, LensError, PixelPoint};

/// Between nodes, pixels.
const STEP_PX: usize = 4;

/// Points on the plane z = 1 for the pixels of one camera.
pub(super) struct RayGrid {
    columns: usize,
    nodes: Vec<[f32; 2]>,
}

/// The rays of consecutive pixels of a row.
#[derive(Default)]
pub(super) struct RayRow {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
}

impl RayGrid {
    /// Fails where the lens model ends before the image's corners.
    pub fn new(camera: &Camera) -> Result<Self, LensError> {
        let columns = (camera.width() - 1) / STEP_PX + 2;
        let rows = (camera.height() - 1) / STEP_PX + 2;
        let mut nodes = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let pixel = PixelPoint { u: (column * STEP_PX) as f64, v: (row * STEP_PX) as f64 };
                let ray = camera.undistort(pixel)?;
                nodes.push([ray.x as f32, ray.y as f32]);
            }
        }
        Ok(Self { columns, nodes })
    }

    /// Rays of the pixels `from..to` of row `v`, all within the image.
    pub fn row(&self, v: usize, from: usize, to: usize, rays: &mut RayRow) {
        let (upper_row, below) = (v / STEP_PX, (v % STEP_PX) as f32 / STEP_PX as f32);
        let first = from / STEP_PX;
        let start = upper_row * self.columns;
        let upper = &self.nodes[start..start + self.columns];
        let lower = &self.nodes[start + self.columns..start + 2 * self.columns];
        let node = |i: usize| {
            [0, 1].map(|axis| upper[i][axis] + below * (lower[i][axis] - upper[i][axis]))
        };
        rays.x.clear();
        rays.y.clear();
        let mut left = node(first);
        for cell in first..to.div_ceil(STEP_PX) {
            let right = node(cell + 1);
            let step = [0, 1].map(|axis| (right[axis] - left[axis]) / STEP_PX as f32);
            for i in 0..STEP_PX {
                rays.x.push(left[0] + step[0] * i as f32);
                rays.y.push(left[1] + step[1] * i as f32);
            }
            left = right;
        }
        let skipped = from - first * STEP_PX;
        for rays in [&mut rays.x, &mut rays.y] {
            rays.copy_within(skipped.., 0);
            rays.truncate(to - from);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Scenario;
    use crate::sim::ScenarioParams;

    #[test]
    fn rays_project_back_to_their_pixels() {
        let scenario = Scenario::new(ScenarioParams::r4_lite(5)).unwrap();
        let camera = &scenario.cameras()[0].camera;
        let grid = RayGrid::new(camera).unwrap();
        let mut rays = RayRow::default();
        for (v, from, to) in [(0, 0, 1280), (719, 1, 2), (333, 637, 1280), (718, 1279, 1280)] {
            grid.row(v, from, to, &mut rays);
            assert_eq!((rays.x.len(), rays.y.len()), (to - from, to - from));
            for (i, (&x, &y)) in rays.x.iter().zip(&rays.y).enumerate() {
                let ray = crate::camera::NormalizedPoint { x: f64::from(x), y: f64::from(y) };
                let pixel = camera.distort(ray).unwrap();
                let off = (pixel.u - (from + i) as f64).hypot(pixel.v - v as f64);
                assert!(off < 0.004, "pixel {}, {v}: {off} px off", from + i);
            }
        }
    }
}

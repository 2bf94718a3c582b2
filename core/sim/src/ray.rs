//! Undistorted rays of all pixels, interpolated from a grid of exact ones.
//!
//! Undistorting each painted pixel would cost more than painting it. Between nodes 4 px apart the lens is nearly linear: a
//! distortion k r³ / f² deviates by h² · 6 k r / (8 f²), below 0.004 px for the reference lenses.

use roundel_vision::camera::{Camera, LensError, PixelPoint};

/// Distance of nodes, pixels.
pub(super) const STEP_PX: usize = 4;

/// Points on the plane z = 1 for the pixels of one camera.
pub(super) struct RayGrid {
    columns: usize,
    nodes: Vec<[f32; 2]>,
}

/// Rays of consecutive pixels of a row.
#[derive(Default)]
pub(super) struct RayRow {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
}

impl RayGrid {
    /// Fails if the lens model does not cover the image.
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

    /// Rays of the pixels `from..to` of row `v`, all within the image; `from` must be the column of a node.
    pub fn row(&self, v: usize, from: usize, to: usize, rays: &mut RayRow) {
        debug_assert!(from.is_multiple_of(STEP_PX), "column {from} is not a node's");
        let below = (v % STEP_PX) as f32 / STEP_PX as f32;
        let (first, last) = (from / STEP_PX, to.div_ceil(STEP_PX));
        let start = v / STEP_PX * self.columns;
        let upper = &self.nodes[start + first..=start + last];
        let lower = &self.nodes[start + self.columns + first..=start + self.columns + last];
        let node = |upper: &[f32; 2], lower: &[f32; 2]| {
            [0, 1].map(|axis| upper[axis] + below * (lower[axis] - upper[axis]))
        };
        let length = (last - first) * STEP_PX;
        rays.x.resize(length, 0.0);
        rays.y.resize(length, 0.0);
        let cells = rays.x.chunks_exact_mut(STEP_PX).zip(rays.y.chunks_exact_mut(STEP_PX));
        let mut left = node(&upper[0], &lower[0]);
        for ((xs, ys), (upper, lower)) in cells.zip(upper.iter().zip(lower).skip(1)) {
            let right = node(upper, lower);
            let step = [0, 1].map(|axis| (right[axis] - left[axis]) / STEP_PX as f32);
            for (i, (x, y)) in xs.iter_mut().zip(ys).enumerate() {
                *x = left[0] + step[0] * i as f32;
                *y = left[1] + step[1] * i as f32;
            }
            left = right;
        }
        rays.x.truncate(to - from);
        rays.y.truncate(to - from);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;
    use crate::ScenarioParams;

    #[test]
    fn rays_project_back_to_their_pixels() {
        let scenario = Scenario::new(ScenarioParams::r4_lite(5)).unwrap();
        let camera = &scenario.cameras()[0].camera;
        let grid = RayGrid::new(camera).unwrap();
        let mut rays = RayRow::default();
        for (v, from, to) in [(0, 0, 1280), (719, 4, 6), (333, 636, 1279), (718, 1276, 1280)] {
            grid.row(v, from, to, &mut rays);
            assert_eq!((rays.x.len(), rays.y.len()), (to - from, to - from));
            for (i, (&x, &y)) in rays.x.iter().zip(&rays.y).enumerate() {
                let ray =
                    roundel_vision::camera::NormalizedPoint { x: f64::from(x), y: f64::from(y) };
                let pixel = camera.distort(ray).unwrap();
                let off = (pixel.u - (from + i) as f64).hypot(pixel.v - v as f64);
                assert!(off < 0.004, "pixel {}, {v}: {off} px off", from + i);
            }
        }
    }
}

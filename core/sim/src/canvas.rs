//! Working image with a background that can be restored.

use super::{
    patch::{Patch, Shape},
    ray::{RayGrid, RayRow, STEP_PX},
};
use roundel_vision::camera::{Camera, PixelPoint};

/// Levels in steps of 1 / 64, painted over a background.
pub(super) struct Canvas {
    width: usize,
    pixels: Vec<i16>,
    background: Vec<i16>,
    painted: Vec<Span>,
    rays: RayRow,
    rows: Vec<[f64; 2]>,
}

/// Pixels `from..to` of row `v`.
struct Span {
    v: usize,
    from: usize,
    to: usize,
}

impl Canvas {
    pub fn new(width: usize, background: Vec<i16>) -> Self {
        Self {
            width,
            pixels: background.clone(),
            background,
            painted: Vec::new(),
            rays: RayRow::default(),
            rows: Vec::new(),
        }
    }

    pub fn row(&self, v: usize) -> &[i16] {
        &self.pixels[v * self.width..(v + 1) * self.width]
    }

    /// Restores the background.
    pub fn restore(&mut self) {
        for span in self.painted.drain(..) {
            let range = span.v * self.width + span.from..span.v * self.width + span.to;
            self.pixels[range.clone()].copy_from_slice(&self.background[range]);
        }
    }

    /// Paints the part of a shape that lies in the image.
    pub fn paint(&mut self, camera: &Camera, grid: &RayGrid, patch: &Patch, shape: &Shape) {
        let Some(outline) = patch.outline_px(camera, shape) else { return };
        let height = self.pixels.len() / self.width;
        let (top, bottom) = fill_rows(&outline, height, &mut self.rows);
        for v in top..bottom {
            let [left, right] = self.rows[v - top];
            // Whole cells of the grid, which allows vectorization.
            let from = left.clamp(0.0, self.width as f64) as usize / STEP_PX * STEP_PX;
            let to = (right.max(0.0) as usize + 1).next_multiple_of(STEP_PX).min(self.width);
            if from < to {
                grid.row(v, from, to, &mut self.rays);
                let start = v * self.width;
                patch.paint(shape, &self.rays, &mut self.pixels[start + from..start + to]);
                self.painted.push(Span { v, from, to });
            }
        }
    }
}

/// Extent of a polygon in each image row; returns the first row and the one after the last.
fn fill_rows(polygon: &[PixelPoint], height: usize, rows: &mut Vec<[f64; 2]>) -> (usize, usize) {
    let (low, high) = polygon
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p.v), high.max(p.v)));
    let top = low.ceil().clamp(0.0, height as f64) as usize;
    let bottom = (high.floor() + 1.0).clamp(0.0, height as f64) as usize;
    rows.clear();
    rows.resize(bottom.saturating_sub(top), [f64::INFINITY, f64::NEG_INFINITY]);
    for (i, from) in polygon.iter().enumerate() {
        let to = &polygon[(i + 1) % polygon.len()];
        let (upper, lower) = if from.v <= to.v { (from, to) } else { (to, from) };
        let slope = (lower.u - upper.u) / (lower.v - upper.v).max(1e-12);
        let first = (upper.v.ceil().max(top as f64)) as usize;
        let last = (lower.v.floor() + 1.0).clamp(0.0, bottom as f64) as usize;
        for v in first..last {
            let u = upper.u + slope * (v as f64 - upper.v);
            let row = &mut rows[v - top];
            *row = [row[0].min(u), row[1].max(u)];
        }
    }
    (top, bottom)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polygon_fills_the_pixels_inside_it() {
        let corners = [(2.5, 1.2), (9.0, 4.0), (5.0, 7.5), (-3.0, 5.0)];
        let polygon = corners.map(|(u, v)| PixelPoint { u, v });
        let inside = |u: f64, v: f64| {
            (0..4).all(|i| {
                let ((u0, v0), (u1, v1)) = (corners[i], corners[(i + 1) % 4]);
                (u1 - u0) * (v - v0) - (v1 - v0) * (u - u0) >= 0.0
            })
        };
        let mut rows = Vec::new();
        let (top, bottom) = fill_rows(&polygon, 7, &mut rows);
        assert_eq!((top, bottom), (2, 7), "cut off at the image's last row");
        for v in 0..7 {
            for u in -5..12 {
                let [left, right] =
                    if (top..bottom).contains(&v) { rows[v - top] } else { [1.0, -1.0] };
                let filled = (left..=right).contains(&f64::from(u));
                assert_eq!(filled, inside(f64::from(u), v as f64), "pixel {u}, {v}");
            }
        }
    }

    #[test]
    fn polygons_outside_the_image_fill_nothing() {
        let mut rows = Vec::new();
        let above = [(0.0, -9.0), (5.0, -9.0), (2.0, -1.5)].map(|(u, v)| PixelPoint { u, v });
        let (top, bottom) = fill_rows(&above, 10, &mut rows);
        assert!(top >= bottom);
        let below = above.map(|p| PixelPoint { u: p.u, v: p.v + 40.0 });
        let (top, bottom) = fill_rows(&below, 10, &mut rows);
        assert!(top >= bottom);
    }
}

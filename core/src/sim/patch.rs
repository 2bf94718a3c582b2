//! Flat shapes painted into an image through lens and perspective, with soft edges that lie where
//! the true outline is imaged.
//!
//! For each pixel of a shape's neighbourhood the ray (x, y, 1) meets the shape's plane at
//!
//! (X, Y) = (h₁ · d / h₃ · d, h₂ · d / h₃ · d),  H = [eₓ e_y t]⁻¹, d = ray,
//!
//! exactly, so the outline itself is exact; only the edge's *width* is local: with the outline's
//! signed distance s(X, Y) in the plane and its gradient g in the image, coverage is
//! Φ(s / sqrt(σ² |g|² + (m · g)² / 12)), where σ² is the blur's variance plus 1/12 of the pixel's own
//! square, and m the motion during the exposure in pixels. Coverage is one half on the true outline:
//! the inward shift σ² / 2r that a real lens gives a small disc is left out on purpose.

use nalgebra::{Isometry3, Matrix2, Matrix3, Vector2, Vector3};

use super::{
    light::FALLOFF,
    noise::STEPS_PER_LEVEL,
    ray::{RayGrid, RayRow},
};
use crate::camera::{Camera, PixelPoint};

/// Coverage beyond so many standard deviations of an edge is left out.
const REACH_SIGMA: f64 = 3.6;
/// Full scale of the working image.
const FULL_SCALE: f32 = 255.0 * STEPS_PER_LEVEL as f32;

/// What a patch looks like, in its own plane, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// One tone within a circle.
    Disc { radius_m: f32, tone: Tone },
    /// One tone within a rectangle.
    Bar { half_m: [f32; 2], tone: Tone },
    /// Black ring, white disc, on a white sheet.
    Roundel { outer_radius_m: f32, inner_radius_m: f32, sheet: Sheet },
}

/// A tone with its soft edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tone {
    /// Share of the light given back.
    pub albedo: f32,
    /// 1 hides what lies beneath.
    pub opacity: f32,
    /// Standard deviation of the edge within the plane (a shadow's), metres.
    pub softness_m: f32,
}

/// The white sheet round a roundel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sheet {
    /// Half the side.
    Square(f32),
    /// Radius.
    Disc(f32),
}

/// Albedo of white paper and of black print.
pub(super) const WHITE: f32 = 0.90;
pub(super) const BLACK: f32 = 0.07;

/// A plane seen by a camera, and how it is lit.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    /// Ray at the origin of the plane.
    origin: [f32; 2],
    /// H, for rays relative to `origin`.
    to_plane: [[f32; 3]; 3],
    /// Derivative of H · ray by u and v, rows as in `to_plane`.
    by_pixel: [[f32; 2]; 3],
    /// Motion during the exposure, pixels.
    motion_px: [f32; 2],
    /// Light at the origin, and its slope along X and Y, per metre.
    light: [f32; 3],
    /// Blur's and pixel's variance, pixels².
    variance_px2: f32,
    camera_from_plane: Isometry3<f64>,
    /// Metres in the plane that one pixel spans at most.
    metres_per_px: f64,
}

/// What surrounds a patch: light, motion, blur.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting {
    /// Light at the origin, and its slope along the plane's X and Y, per metre.
    pub light: [f64; 3],
    /// Motion of the origin during the exposure, camera frame, metres.
    pub motion_m: Vector3<f64>,
    /// The lens' blur, standard deviation, pixels.
    pub blur_px: f64,
}

impl Patch {
    /// The plane z = 0 of a frame; `None` if its origin has no image or it is seen from behind.
    pub fn new(
        camera: &Camera,
        camera_from_plane: Isometry3<f64>,
        setting: &Setting,
    ) -> Option<Self> {
        let center = camera_from_plane.translation.vector;
        let turn: Matrix3<f64> = camera_from_plane.rotation.to_rotation_matrix().into_inner();
        let columns = [turn.column(0).into_owned(), turn.column(1).into_owned(), center];
        // Edge-on or from behind there is nothing to see.
        if turn.column(2).dot(&center) > -0.02 * center.norm() {
            return None;
        }
        let to_plane = Matrix3::from_columns(&columns).try_inverse()?;
        let origin = Vector2::new(center.x / center.z, center.y / center.z);
        let on_ray = Vector3::new(origin.x, origin.y, 1.0);
        let (_, jacobian) = camera.project_with_jacobian(&on_ray).ok()?;
        let pixel_by_ray: Matrix2<f64> = jacobian.fixed_view::<2, 2>(0, 0).into_owned();
        let ray_by_pixel = pixel_by_ray.try_inverse()?;
        let by_pixel = to_plane.fixed_view::<3, 2>(0, 0) * ray_by_pixel;
        let motion_px = {
            let half = setting.motion_m / 2.0;
            let (from, to) =
                (camera.project(&(center - half)).ok()?, camera.project(&(center + half)).ok()?);
            [(to.u - from.u) as f32, (to.v - from.v) as f32]
        };
        let mut relative = to_plane;
        relative.set_column(2, &(to_plane * on_ray));
        let plane_by_pixel = by_pixel.fixed_view::<2, 2>(0, 0) * center.z;
        Some(Self {
            origin: [origin.x as f32, origin.y as f32],
            to_plane: [0, 1, 2].map(|i| [0, 1, 2].map(|j| relative[(i, j)] as f32)),
            by_pixel: [0, 1, 2].map(|i| [0, 1].map(|j| by_pixel[(i, j)] as f32)),
            motion_px,
            light: setting.light.map(|x| x as f32),
            variance_px2: (setting.blur_px * setting.blur_px + 1.0 / 12.0) as f32,
            camera_from_plane,
            metres_per_px: plane_by_pixel.norm(),
        })
    }

    /// How far beyond an outline with this softness the shape still shows, metres in the plane.
    fn reach_m(&self, softness_m: f32) -> f64 {
        let motion_px2 = f64::from(self.motion_px[0].hypot(self.motion_px[1])).powi(2) / 12.0;
        let edge_m = (f64::from(self.variance_px2) + motion_px2).sqrt() * self.metres_per_px;
        REACH_SIGMA * edge_m.hypot(f64::from(softness_m)) + self.metres_per_px
    }

    /// Points of the plane round all that the shape touches, metres.
    fn outline_m(&self, shape: &Shape) -> Vec<[f64; 2]> {
        let circle = |radius_m: f64| {
            const CORNERS: u32 = 10;
            // The polygon goes round the circle.
            let radius_m = radius_m / (std::f64::consts::PI / f64::from(CORNERS)).cos();
            (0..CORNERS)
                .map(|i| {
                    let angle = std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS);
                    [radius_m * angle.cos(), radius_m * angle.sin()]
                })
                .collect()
        };
        let rectangle = |half_m: [f64; 2]| {
            // Long sides bend in the lens.
            const PARTS: u32 = 8;
            let corners = [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]];
            (0..4 * PARTS)
                .map(|i| {
                    let (from, share) =
                        ((i / PARTS) as usize, f64::from(i % PARTS) / f64::from(PARTS));
                    let to = (from + 1) % 4;
                    [0, 1].map(|axis| {
                        half_m[axis]
                            * (corners[from][axis] * (1.0 - share) + corners[to][axis] * share)
                    })
                })
                .collect()
        };
        match *shape {
            Shape::Disc { radius_m, tone } => {
                circle(f64::from(radius_m) + self.reach_m(tone.softness_m))
            }
            Shape::Bar { half_m, tone } => {
                rectangle(half_m.map(|half| f64::from(half) + self.reach_m(tone.softness_m)))
            }
            Shape::Roundel { sheet: Sheet::Square(half_m), .. } => {
                rectangle([f64::from(half_m) + self.reach_m(0.0); 2])
            }
            Shape::Roundel { sheet: Sheet::Disc(radius_m), .. } => {
                circle(f64::from(radius_m) + self.reach_m(0.0))
            }
        }
    }

    /// The image of [`Patch::outline_m`]; `None` if part of it has none.
    pub fn outline_px(&self, camera: &Camera, shape: &Shape) -> Option<Vec<PixelPoint>> {
        self.outline_m(shape)
            .into_iter()
            .map(|[x, y]| {
                let point = self.camera_from_plane * nalgebra::Point3::new(x, y, 0.0);
                camera.project(&point.coords).ok()
            })
            .collect()
    }

    /// Paints the shape over a row of the working image whose pixels have these rays.
    pub fn paint(&self, shape: &Shape, rays: &RayRow, row: &mut [i16]) {
        match *shape {
            Shape::Disc { radius_m, tone } => self.paint_with(rays, row, |at| {
                let edge = at.radial(tone.softness_m);
                (
                    tone.opacity * normal_cdf((radius_m - edge.radius_m) * edge.sharpness),
                    tone.albedo,
                )
            }),
            Shape::Bar { half_m, tone } => self.paint_with(rays, row, |at| {
                (tone.opacity * at.within(half_m, tone.softness_m), tone.albedo)
            }),
            Shape::Roundel { outer_radius_m, inner_radius_m, sheet: Sheet::Square(half_m) } => {
                self.paint_with(rays, row, |at| {
                    let albedo = ring_albedo(&at.radial(0.0), outer_radius_m, inner_radius_m);
                    (at.within([half_m; 2], 0.0), albedo)
                });
            }
            Shape::Roundel { outer_radius_m, inner_radius_m, sheet: Sheet::Disc(radius_m) } => {
                self.paint_with(rays, row, |at| {
                    let edge = at.radial(0.0);
                    let albedo = ring_albedo(&edge, outer_radius_m, inner_radius_m);
                    (normal_cdf((radius_m - edge.radius_m) * edge.sharpness), albedo)
                });
            }
        }
    }

    /// `look` gives (coverage, albedo). Kept free of branches so that it becomes vector code.
    #[inline(always)]
    fn paint_with(&self, rays: &RayRow, row: &mut [i16], look: impl Fn(&PlanePoint) -> (f32, f32)) {
        /// Adding it leaves a number's rounded value in the low bits of its mantissa.
        const ROUNDER: f32 = 12_582_912.0;
        let [h0, h1, h2] = self.to_plane;
        let [p0, p1, p2] = self.by_pixel;
        for ((&ray_x, &ray_y), pixel) in rays.x.iter().zip(&rays.y).zip(row) {
            let (dx, dy) = (ray_x - self.origin[0], ray_y - self.origin[1]);
            let depth = 1.0 / (h2[0] * dx + h2[1] * dy + h2[2]);
            let x_m = (h0[0] * dx + h0[1] * dy + h0[2]) * depth;
            let y_m = (h1[0] * dx + h1[1] * dy + h1[2]) * depth;
            let at = PlanePoint {
                x_m,
                y_m,
                x_by_px: [(p0[0] - x_m * p2[0]) * depth, (p0[1] - x_m * p2[1]) * depth],
                y_by_px: [(p1[0] - y_m * p2[0]) * depth, (p1[1] - y_m * p2[1]) * depth],
                motion_px: self.motion_px,
                variance_px2: self.variance_px2,
            };
            let (coverage, albedo) = look(&at);
            let falloff = 1.0 / (1.0 + FALLOFF as f32 * (ray_x * ray_x + ray_y * ray_y));
            let light = self.light[0] + self.light[1] * x_m + self.light[2] * y_m;
            let level = (albedo * light * falloff * FULL_SCALE).min(FULL_SCALE);
            let before = f32::from(*pixel);
            let after = before + coverage * (level - before);
            *pixel = (after + ROUNDER).to_bits() as i16;
        }
    }
}

/// A pixel's point of the plane, with its derivatives by u and v.
struct PlanePoint {
    x_m: f32,
    y_m: f32,
    x_by_px: [f32; 2],
    y_by_px: [f32; 2],
    motion_px: [f32; 2],
    variance_px2: f32,
}

/// Distance from the plane's origin, and what turns a distance to a rim into standard deviations.
struct Radial {
    radius_m: f32,
    sharpness: f32,
}

impl PlanePoint {
    /// 1 / standard deviation, in the plane, of an edge whose distance has this gradient.
    #[inline(always)]
    fn sharpness(&self, gradient: [f32; 2], softness_m: f32) -> f32 {
        let along = self.motion_px[0] * gradient[0] + self.motion_px[1] * gradient[1];
        let slope = gradient[0] * gradient[0] + gradient[1] * gradient[1];
        let variance =
            self.variance_px2 * slope + along * along * (1.0 / 12.0) + softness_m * softness_m;
        1.0 / (variance + 1e-20).sqrt()
    }

    #[inline(always)]
    fn radial(&self, softness_m: f32) -> Radial {
        let radius_m = (self.x_m * self.x_m + self.y_m * self.y_m + 1e-12).sqrt();
        let (cosine, sine) = (self.x_m / radius_m, self.y_m / radius_m);
        let gradient = [0, 1].map(|axis| cosine * self.x_by_px[axis] + sine * self.y_by_px[axis]);
        Radial { radius_m, sharpness: self.sharpness(gradient, softness_m) }
    }

    /// Coverage of a rectangle.
    #[inline(always)]
    fn within(&self, half_m: [f32; 2], softness_m: f32) -> f32 {
        let across = self.sharpness(self.x_by_px, softness_m);
        let along = self.sharpness(self.y_by_px, softness_m);
        normal_cdf((half_m[0] - self.x_m.abs()) * across)
            * normal_cdf((half_m[1] - self.y_m.abs()) * along)
    }
}

#[inline(always)]
fn ring_albedo(edge: &Radial, outer_radius_m: f32, inner_radius_m: f32) -> f32 {
    let outer = normal_cdf((outer_radius_m - edge.radius_m) * edge.sharpness);
    let inner = normal_cdf((inner_radius_m - edge.radius_m) * edge.sharpness);
    WHITE - (WHITE - BLACK) * (outer - inner)
}

/// Standard normal distribution, to 2e-7 (Abramowitz and Stegun 7.1.28, without a branch).
#[inline(always)]
fn normal_cdf(x: f32) -> f32 {
    // Beyond 6 standard deviations nothing changes, but powers would overflow.
    let t = (x.abs() * std::f32::consts::FRAC_1_SQRT_2).min(4.5);
    let series = 1.0
        + t * (0.070_523_08
            + t * (0.042_282_01
                + t * (0.009_270_527
                    + t * (0.000_152_014_3 + t * (0.000_276_567_2 + t * 0.000_043_063_8)))));
    let power2 = series * series;
    let power4 = power2 * power2;
    let power8 = power4 * power4;
    let half_tail = 0.5 / (power8 * power8);
    0.5 + (0.5 - half_tail).copysign(x)
}

/// The working image: levels in steps of 1 / 64, painted over a background that can be restored.
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
    /// A canvas over a background of whole rows.
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

    /// Row `v` as painted.
    pub fn row(&self, v: usize) -> &[i16] {
        &self.pixels[v * self.width..(v + 1) * self.width]
    }

    /// Takes away all that was painted since.
    pub fn restore(&mut self) {
        for span in self.painted.drain(..) {
            let range = span.v * self.width + span.from..span.v * self.width + span.to;
            self.pixels[range.clone()].copy_from_slice(&self.background[range]);
        }
    }

    /// Paints a shape on a patch, as far as it lies in the image.
    pub fn paint(&mut self, camera: &Camera, grid: &RayGrid, patch: &Patch, shape: &Shape) {
        let Some(outline) = patch.outline_px(camera, shape) else { return };
        let height = self.pixels.len() / self.width;
        let (top, bottom) = fill_rows(&outline, height, &mut self.rows);
        for v in top..bottom {
            let [left, right] = self.rows[v - top];
            let from = left.ceil().clamp(0.0, self.width as f64) as usize;
            let to = (right.floor() + 1.0).clamp(0.0, self.width as f64) as usize;
            if from < to {
                grid.row(v, from, to, &mut self.rays);
                let start = v * self.width;
                patch.paint(shape, &self.rays, &mut self.pixels[start + from..start + to]);
                self.painted.push(Span { v, from, to });
            }
        }
    }
}

/// Leftmost and rightmost place of a polygon in each image row that it meets; gives the first row
/// and the one after the last.
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

//! Paints flat shapes through lens and perspective, with soft edges at the position of a blurred outline.
//!
//! The ray (x, y, 1) of each pixel near a shape meets the shape's plane at
//!
//! (X, Y) = (h₁ · d / h₃ · d, h₂ · d / h₃ · d),  H = [eₓ e_y t]⁻¹, d = ray,
//!
//! so outlines are exact; only the *width* of edges is a local approximation. With the outline's signed distance s(X, Y) in
//! the plane and its gradient g in the image, the coverage is Φ(s / sqrt(σ² |g|² + (m · g)² / 12)), where σ² is the variance
//! of the blur plus 1/12 for the pixel's square, and m the motion during the exposure in pixels. With a rolling shutter, the
//! ray of a pixel v rows below the origin is that of the pixel less s v, for the motion s per row in pixels. Blur shifts a
//! curved edge inwards, a circle of radius r by v / 2r with the blur's variance v along the edge in the plane, which
//! preserves the covered area. Straight edges are not shifted.

use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, Vector2, Vector3};

use super::{
    albedo::{PlanePoint, Teeth},
    light::falloff,
    noise::STEPS_PER_LEVEL,
    ray::RayRow,
};
use roundel_vision::camera::{Camera, PixelPoint};

/// Extent of an edge in standard deviations.
const REACH_SIGMA: f64 = 3.6;
const FULL_SCALE: f32 = 255.0 * STEPS_PER_LEVEL as f32;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape<'a> {
    /// Disc of constant albedo.
    Disc { radius_m: f32, albedo: f32 },
    /// Shadow with the opacity profile (1 - r² / radius²)².
    Shadow { radius_m: f32, opacity: f32 },
    /// Rectangle of constant albedo.
    Bar { half_m: [f32; 2], albedo: f32 },
    /// Black ring around a white disc on a white sheet.
    Roundel { outer_radius_m: f32, inside: Inside<'a>, sheet: Sheet },
}

/// White disc of a roundel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Inside<'a> {
    /// Radius.
    Disc(f32),
    /// Semiaxes along x and y.
    Ellipse([f32; 2]),
    /// With the teeth of a code.
    Teeth(&'a Teeth),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sheet {
    /// Half of the side.
    Square(f32),
    /// Radius.
    Disc(f32),
}

/// A plane in the view of a camera, with its light.
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
    /// Row of the origin, and motion per row, pixels.
    row_px: f64,
    px_per_row: Vector2<f64>,
    /// Light that reaches the image from the origin, and its slope along X and Y, per metre.
    light: [f32; 3],
    /// Variance of blur and pixel, pixels².
    variance_px2: f32,
    camera_from_plane: Isometry3<f64>,
    /// Maximum extent of a pixel in the plane, metres.
    metres_per_px: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Setting {
    /// Light at the origin, and its slope along the plane's X and Y, per metre.
    pub light: [f64; 3],
    /// Motion of the origin during the exposure, camera frame, metres.
    pub motion_m: Vector3<f64>,
    /// Motion of the origin per row, camera frame, metres.
    pub per_row_m: Vector3<f64>,
    /// Standard deviation of the lens' blur, pixels.
    pub blur_px: f64,
}

impl Patch {
    /// The plane z = 0 of a frame; `None` if its origin has no image or it faces away.
    pub fn new(
        camera: &Camera,
        camera_from_plane: Isometry3<f64>,
        setting: &Setting,
    ) -> Option<Self> {
        let center = camera_from_plane.translation.vector;
        let turn: Matrix3<f64> = camera_from_plane.rotation.to_rotation_matrix().into_inner();
        let columns = [turn.column(0).into_owned(), turn.column(1).into_owned(), center];
        // Edge-on or facing away.
        if turn.column(2).dot(&center) > -0.02 * center.norm() {
            return None;
        }
        let to_plane = Matrix3::from_columns(&columns).try_inverse()?;
        let origin = Vector2::new(center.x / center.z, center.y / center.z);
        let on_ray = Vector3::new(origin.x, origin.y, 1.0);
        let (pixel, jacobian) = camera.project_with_jacobian(&on_ray).ok()?;
        let pixel_by_ray: Matrix2<f64> = jacobian.fixed_view::<2, 2>(0, 0).into_owned();
        let ray_by_pixel = pixel_by_ray.try_inverse()?;
        let px_per_row = jacobian * setting.per_row_m / center.z;
        let straight = Matrix2::identity() - px_per_row * Vector2::y().transpose();
        let by_pixel = to_plane.fixed_view::<3, 2>(0, 0) * ray_by_pixel * straight;
        let motion_px = {
            let half = setting.motion_m / 2.0;
            let (from, to) =
                (camera.project(&(center - half)).ok()?, camera.project(&(center + half)).ok()?);
            [(to.u - from.u) as f32, (to.v - from.v) as f32]
        };
        let mut relative = to_plane;
        relative.fixed_view_mut::<3, 2>(0, 0).copy_from(&(by_pixel * pixel_by_ray));
        relative.set_column(2, &(to_plane * on_ray));
        let plane_by_pixel = by_pixel.fixed_view::<2, 2>(0, 0) * center.z;
        Some(Self {
            origin: [origin.x as f32, origin.y as f32],
            to_plane: [0, 1, 2].map(|i| [0, 1, 2].map(|j| relative[(i, j)] as f32)),
            by_pixel: [0, 1, 2].map(|i| [0, 1].map(|j| by_pixel[(i, j)] as f32)),
            motion_px,
            row_px: pixel.v,
            px_per_row,
            light: with_falloff(setting.light, &camera_from_plane).map(|x| x as f32),
            variance_px2: (setting.blur_px * setting.blur_px + 1.0 / 12.0) as f32,
            camera_from_plane,
            metres_per_px: plane_by_pixel.norm(),
        })
    }

    /// Extent of a shape's blurred edge beyond its outline, metres in the plane.
    fn reach_m(&self) -> f64 {
        let motion_px2 = f64::from(self.motion_px[0].hypot(self.motion_px[1])).powi(2) / 12.0;
        let edge_m = (f64::from(self.variance_px2) + motion_px2).sqrt() * self.metres_per_px;
        REACH_SIGMA * edge_m + self.metres_per_px
    }

    /// Points of the plane around everything that the shape touches, metres.
    fn outline_m(&self, shape: &Shape) -> Vec<[f64; 2]> {
        let circle = |radius_m: f64| {
            const CORNERS: u32 = 10;
            // The polygon encloses the circle.
            let radius_m = radius_m / (std::f64::consts::PI / f64::from(CORNERS)).cos();
            (0..CORNERS)
                .map(|i| {
                    let angle = std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS);
                    [radius_m * angle.cos(), radius_m * angle.sin()]
                })
                .collect()
        };
        let rectangle = |half_m: [f64; 2]| {
            // Distortion bends long sides.
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
        let reach_m = self.reach_m();
        match *shape {
            Shape::Shadow { radius_m, .. } => circle(f64::from(radius_m)),
            Shape::Disc { radius_m, .. } | Shape::Roundel { sheet: Sheet::Disc(radius_m), .. } => {
                circle(f64::from(radius_m) + reach_m)
            }
            Shape::Bar { half_m, .. } => rectangle(half_m.map(|half| f64::from(half) + reach_m)),
            Shape::Roundel { sheet: Sheet::Square(half_m), .. } => {
                rectangle([f64::from(half_m) + reach_m; 2])
            }
        }
    }

    /// The image of [`Patch::outline_m`]; `None` if part of it has none.
    pub fn outline_px(&self, camera: &Camera, shape: &Shape) -> Option<Vec<PixelPoint>> {
        self.outline_m(shape)
            .into_iter()
            .map(|[x, y]| {
                let point = self.camera_from_plane * Point3::new(x, y, 0.0);
                let pixel = camera.project(&point.coords).ok()?;
                let rows = (pixel.v - self.row_px) / (1.0 - self.px_per_row.y);
                let moved = self.px_per_row * rows;
                Some(PixelPoint { u: pixel.u + moved.x, v: pixel.v + moved.y })
            })
            .collect()
    }

    /// Paints the shape over a row of the working image with these rays.
    pub fn paint(&self, shape: &Shape, rays: &RayRow, row: &mut [i16]) {
        match *shape {
            Shape::Shadow { radius_m, opacity } => self.paint_with(rays, row, |at| {
                let share = 1.0 - (at.x_m * at.x_m + at.y_m * at.y_m) / (radius_m * radius_m);
                let share = share.max(0.0);
                (opacity * share * share, 0.0)
            }),
            Shape::Disc { radius_m, albedo } => {
                self.paint_with(rays, row, |at| (at.radial().inside(radius_m), albedo));
            }
            Shape::Bar { half_m, albedo } => {
                self.paint_with(rays, row, |at| (at.within(half_m), albedo));
            }
            Shape::Roundel { outer_radius_m, inside, sheet } => match inside {
                Inside::Disc(inner_radius_m) => self.paint_sheet(sheet, rays, row, |at| {
                    at.radial().ring_albedo(outer_radius_m, inner_radius_m)
                }),
                Inside::Ellipse(semiaxes_m) => self.paint_sheet(sheet, rays, row, |at| {
                    at.elliptical_albedo(outer_radius_m, semiaxes_m)
                }),
                Inside::Teeth(teeth) => {
                    self.paint_sheet(sheet, rays, row, |at| at.coded_albedo(outer_radius_m, teeth))
                }
            },
        }
    }

    #[inline(always)]
    fn paint_sheet(
        &self,
        sheet: Sheet,
        rays: &RayRow,
        row: &mut [i16],
        albedo: impl Fn(&PlanePoint) -> f32,
    ) {
        match sheet {
            Sheet::Square(half_m) => {
                self.paint_with(rays, row, |at| (at.within([half_m; 2]), albedo(at)));
            }
            Sheet::Disc(radius_m) => {
                self.paint_with(rays, row, |at| (at.radial().inside(radius_m), albedo(at)));
            }
        }
    }

    /// `shade` returns (coverage, albedo). Branch-free, so that it is vectorized.
    #[inline(always)]
    fn paint_with(
        &self,
        rays: &RayRow,
        row: &mut [i16],
        shade: impl Fn(&PlanePoint) -> (f32, f32),
    ) {
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
            let (coverage, albedo) = shade(&at);
            let light = self.light[0] + self.light[1] * x_m + self.light[2] * y_m;
            let level = (albedo * light).clamp(0.0, 1.0) * FULL_SCALE;
            let before = f32::from(*pixel);
            let after = before + coverage * (level - before);
            *pixel = (after + ROUNDER).to_bits() as i16;
        }
    }
}

/// Light on a plane after vignetting.
fn with_falloff(light: [f64; 3], camera_from_plane: &Isometry3<f64>) -> [f64; 3] {
    const STEP_M: f64 = 0.05;
    let at = |x_m: f64, y_m: f64| {
        let point = camera_from_plane * Point3::new(x_m, y_m, 0.0);
        (light[0] + light[1] * x_m + light[2] * y_m) * falloff(point.x / point.z, point.y / point.z)
    };
    let here = at(0.0, 0.0);
    [here, (at(STEP_M, 0.0) - here) / STEP_M, (at(0.0, STEP_M) - here) / STEP_M]
}

#[cfg(test)]
mod tests;

//! Map from a roundel's plane to the image, up to its yaw, by its two rims.
//!
//! An affine map takes the unit circle to the outer rim's ellipse, x ↦ c + A x. The homographies that
//! preserve the circle are the rotations, which are the yaw, and the boosts that move its centre
//! to a point d inside it,
//!
//!   y = (√(1-d²) x + d (1 + κ d·x)) / (1 + d·x),   κ = 1 / (1 + √(1-d²)),
//!
//! so x ↦ c + A y is exactly the plane as seen by a pinhole camera. A concentric circle of radius ρ
//! appears with its centre at d (1-ρ²)/(1-ρ²d²) ≈ d (1-ρ²), so the inner rim gives d: the
//! image of a circle's centre is not its ellipse's centre.
//!
//! x is clockwise in the image: from the major axis towards the minor one, as `angle_rad` grows.

use crate::{camera::PixelPoint, ellipse::Ellipse};

/// Largest perspective shift of a centre, as a share of the radius.
pub(crate) const MAX_OFFSET: f64 = 0.3;
/// Iterations that determine d from the inner centre; each leaves ρ²d² of the error.
const TURNS: usize = 4;

/// A roundel's plane, its outer rim the unit circle, as imaged.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneMap {
    center: (f64, f64),
    /// Columns of A: the semiaxes, pixels.
    major_px: (f64, f64),
    minor_px: (f64, f64),
    /// d, along the semiaxes.
    offset: (f64, f64),
    root: f64,
}

impl PlaneMap {
    /// From the outer rim, and the centre of a concentric circle's image; `ratio` is its radius
    /// over the outer one.
    pub fn new(outer: &Ellipse, inner_center: PixelPoint, ratio: f64) -> Self {
        let flat = Self::with_offset(outer, (0.0, 0.0));
        let (x, y) = flat.plane(inner_center);
        let (distance, r) = (x.hypot(y), ratio * ratio);
        let mut length = 0.0;
        for _ in 0..TURNS {
            length = (distance * (1.0 - r * length * length) / (1.0 - r)).min(MAX_OFFSET);
        }
        // NaN for an invalid ellipse.
        let share = length / distance;
        if share.is_finite() { Self::with_offset(outer, (x * share, y * share)) } else { flat }
    }

    /// From the outer rim and d, along its semiaxes.
    pub fn with_offset(outer: &Ellipse, offset: (f64, f64)) -> Self {
        let (sin, cos) = outer.angle_rad.sin_cos();
        Self {
            center: (outer.center.u, outer.center.v),
            major_px: (outer.semi_major_px * cos, outer.semi_major_px * sin),
            minor_px: (-outer.semi_minor_px * sin, outer.semi_minor_px * cos),
            offset,
            root: (1.0 - offset.0 * offset.0 - offset.1 * offset.1).sqrt(),
        }
    }

    /// d, along the semiaxes.
    pub fn offset(&self) -> (f64, f64) {
        self.offset
    }

    /// The longer semiaxis of the outer rim, pixels.
    pub fn reach_px(&self) -> f64 {
        self.major_px.0.hypot(self.major_px.1)
    }

    /// Image of a point of the plane.
    pub fn image(&self, x: (f64, f64)) -> PixelPoint {
        let (y0, y1) = boost(x, self.offset, self.root);
        PixelPoint {
            u: self.center.0 + self.major_px.0 * y0 + self.minor_px.0 * y1,
            v: self.center.1 + self.major_px.1 * y0 + self.minor_px.1 * y1,
        }
    }

    /// [`PlaneMap::image`] to a thousandth of a pixel.
    #[inline(always)]
    pub fn image_f32(&self, x: (f32, f32)) -> (f32, f32) {
        let (d0, d1, root) = (self.offset.0 as f32, self.offset.1 as f32, self.root as f32);
        let along = d0 * x.0 + d1 * x.1;
        let scale = 1.0 / (1.0 + along);
        let pushed = 1.0 + along / (1.0 + root);
        let y = ((root * x.0 + d0 * pushed) * scale, (root * x.1 + d1 * pushed) * scale);
        (
            self.center.0 as f32 + self.major_px.0 as f32 * y.0 + self.minor_px.0 as f32 * y.1,
            self.center.1 as f32 + self.major_px.1 as f32 * y.0 + self.minor_px.1 as f32 * y.1,
        )
    }

    /// The image of a concentric circle of this radius, displaced by `shift`, which must be small:
    /// its ellipse's centre, and the columns of the map from the unit circle.
    pub fn circle(&self, shift: (f64, f64), radius: f64) -> (PixelPoint, [(f64, f64); 2]) {
        let (d, r) = (self.offset, radius * radius);
        let square = d.0 * d.0 + d.1 * d.1;
        let scale = 1.0 / (1.0 - r * square);
        let flat = Self { offset: (0.0, 0.0), root: 1.0, ..*self };
        let middle = (d.0 * (1.0 - r) * scale + shift.0, d.1 * (1.0 - r) * scale + shift.1);
        // Along d and across it.
        let length = square.sqrt();
        let along = if length > 0.0 { (d.0 / length, d.1 / length) } else { (1.0, 0.0) };
        let (long, wide) = (radius * (1.0 - square) * scale, radius * self.root * scale.sqrt());
        let column = |x: (f64, f64)| {
            (
                self.major_px.0 * x.0 + self.minor_px.0 * x.1,
                self.major_px.1 * x.0 + self.minor_px.1 * x.1,
            )
        };
        let columns =
            [column((along.0 * long, along.1 * long)), column((-along.1 * wide, along.0 * wide))];
        (flat.image(middle), columns)
    }

    /// A box of the image that contains the circle of this radius, slightly enlarged.
    pub fn bounds(&self, radius: f64) -> (PixelPoint, PixelPoint) {
        let shift = self.offset.0.hypot(self.offset.1);
        let reach = radius + shift + 0.01;
        let half_u = reach * self.major_px.0.hypot(self.minor_px.0);
        let half_v = reach * self.major_px.1.hypot(self.minor_px.1);
        let (u, v) = self.center;
        (PixelPoint { u: u - half_u, v: v - half_v }, PixelPoint { u: u + half_u, v: v + half_v })
    }

    /// The point of the plane with this image.
    pub fn plane(&self, at: PixelPoint) -> (f64, f64) {
        let (du, dv) = (at.u - self.center.0, at.v - self.center.1);
        let (a, b) = (self.major_px, self.minor_px);
        let determinant = a.0 * b.1 - a.1 * b.0;
        let y = ((b.1 * du - b.0 * dv) / determinant, (a.0 * dv - a.1 * du) / determinant);
        boost(y, (-self.offset.0, -self.offset.1), self.root)
    }
}

/// The homography above; its inverse is that of -d.
fn boost(x: (f64, f64), d: (f64, f64), root: f64) -> (f64, f64) {
    let along = d.0 * x.0 + d.1 * x.1;
    let scale = 1.0 / (1.0 + along);
    let pushed = 1.0 + along / (1.0 + root);
    ((root * x.0 + d.0 * pushed) * scale, (root * x.1 + d.1 * pushed) * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    /// The ellipse of a circle about the origin of a plane, and its centre's image, by the conic of
    /// the projection matrix, independently of the code above.
    fn imaged_circle(plane_to_image: &nalgebra::Matrix3<f64>, radius: f64) -> Ellipse {
        let inverse = plane_to_image.try_inverse().unwrap();
        let circle = nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -radius * radius));
        let conic = inverse.transpose() * circle * inverse;
        let block = conic.fixed_view::<2, 2>(0, 0).into_owned();
        let center = -block.try_inverse().unwrap() * conic.fixed_view::<2, 1>(0, 2);
        let level = (center.push(1.0).transpose() * conic * center.push(1.0))[0];
        let shape = block * (-1.0 / level);
        let eigen = shape.symmetric_eigen();
        let (long, short) =
            if eigen.eigenvalues[0] < eigen.eigenvalues[1] { (0, 1) } else { (1, 0) };
        let axis = eigen.eigenvectors.column(long);
        Ellipse {
            center: PixelPoint { u: center[0], v: center[1] },
            semi_major_px: eigen.eigenvalues[long].powf(-0.5),
            semi_minor_px: eigen.eigenvalues[short].powf(-0.5),
            angle_rad: axis[1].atan2(axis[0]),
        }
    }

    proptest! {
        #[test]
        fn the_plane_map_is_a_pinhole_projection_up_to_a_rotation(
            tilt in 0.05..1.1f64,
            about in -3.0..3.0f64,
            near in 4.0..30.0f64,
            at in (-0.3..0.3f64, -0.3..0.3f64),
        ) {
            let axis = Vector3::new(about.cos(), about.sin(), 0.0);
            let turn = Rotation3::new(axis * tilt);
            // A print's y is up and the image's v is down, so y is inverted.
            let (x, y) = (turn * Vector3::x(), turn * -Vector3::y());
            let camera = nalgebra::Matrix3::new(800.0, 0.0, 320.0, 0.0, 800.0, 240.0, 0.0, 0.0, 1.0);
            let center = Vector3::new(at.0 * near, at.1 * near, near);
            let plane_to_image = camera * nalgebra::Matrix3::from_columns(&[x, y, center]);
            let pixel = |x: f64, y: f64| {
                let p = plane_to_image * Vector3::new(x, y, 1.0);
                PixelPoint { u: p.x / p.z, v: p.y / p.z }
            };
            let (outer, inner) = (imaged_circle(&plane_to_image, 1.0), imaged_circle(&plane_to_image, 0.6));
            let plane = PlaneMap::new(&outer, inner.center, 0.6);
            // One point determines the rotation; all others must agree.
            let first = plane.plane(pixel(0.5, 0.0));
            prop_assert!((first.0.hypot(first.1) - 0.5).abs() < 1e-5);
            let turned_rad = first.1.atan2(first.0);
            for k in 0..12 {
                let (sin, cos) = (f64::from(k) * 0.7).sin_cos();
                let radius = 0.3 + 0.05 * f64::from(k);
                let pixel = pixel(radius * cos, radius * sin);
                // The print's y is inverted, so its angles count the other way.
                let (sin, cos) = (turned_rad - f64::from(k) * 0.7).sin_cos();
                let there = plane.image((radius * cos, radius * sin));
                let off_px = (there.u - pixel.u).hypot(there.v - pixel.v);
                prop_assert!(off_px < 1e-5 * outer.semi_major_px, "{} px", off_px);
                let back = plane.plane(there);
                prop_assert!((back.0 - radius * cos).abs() < 1e-9);
                prop_assert!((back.1 - radius * sin).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn extreme_rims_leave_the_plane_map_finite() {
        let outer = Ellipse {
            center: PixelPoint { u: 50.0, v: 50.0 },
            semi_major_px: 20.0,
            semi_minor_px: 10.0,
            angle_rad: 0.3,
        };
        let plane = PlaneMap::new(&outer, PixelPoint { u: 90.0, v: 0.0 }, 0.6);
        let center = plane.plane(outer.center);
        assert!(center.0.hypot(center.1) < 0.301);
        let plane = PlaneMap::new(&outer, PixelPoint { u: f64::NAN, v: 0.0 }, 0.6);
        assert_eq!(plane.image((0.0, 0.0)), outer.center);
    }
}

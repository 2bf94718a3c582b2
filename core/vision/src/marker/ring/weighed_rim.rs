//! Rims as weighed by grey levels: area, covariance and ellipse, with what determines their blur.
//!
//! Everything is generic over [`Lane`]: a single ring is the case of one lane.

use crate::{
    camera::PixelPoint,
    ellipse::{Ellipse, Symmetric2, semiaxes_px},
    marker::ring::pixels::ellipse_mask::RimEllipse,
    simd::Lane,
};

/// An ellipse per lane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LaneEllipse<T> {
    pub u: T,
    pub v: T,
    /// Longer and shorter semiaxis, pixels.
    pub a: T,
    pub b: T,
    pub angle_rad: T,
    /// Cosine and sine of twice the angle.
    pub along: (T, T),
}

impl<T: Lane> LaneEllipse<T> {
    #[inline(always)]
    pub fn at(&self, lane: usize) -> Ellipse {
        Ellipse {
            center: PixelPoint { u: self.u.lane(lane), v: self.v.lane(lane) },
            semi_major_px: self.a.lane(lane),
            semi_minor_px: self.b.lane(lane),
            angle_rad: self.angle_rad.lane(lane),
        }
    }

    /// [`Ellipse::matrix`].
    #[inline(always)]
    pub fn matrix_at(&self, lane: usize) -> Symmetric2 {
        let (a, b) = (self.a.lane(lane), self.b.lane(lane));
        let (mean, half) = (0.5 * (a * a + b * b), 0.5 * (a * a - b * b));
        let (cos, sin) = (self.along.0.lane(lane), self.along.1.lane(lane));
        Symmetric2 { uu: mean + half * cos, uv: half * sin, vv: mean - half * cos }
    }

    /// As [`Ellipse::grown`].
    #[inline(always)]
    pub fn grown(&self, by_px: T) -> Self {
        let min = by_px.splat(0.01);
        Self { a: (self.a + by_px).larger(min), b: (self.b + by_px).larger(min), ..*self }
    }

    /// As [`Ellipse::mean_radius_px`].
    #[inline(always)]
    pub fn mean_radius_px(&self) -> T {
        (self.a * self.b).root()
    }
}

/// Where a band ends, inside and outside of a rim, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cuts {
    pub inside_px: f64,
    pub outside_px: f64,
}

/// Weighted sums of 1, v, v², u, uv, u² over pixels, relative to an origin.
pub(crate) type WeighedSums<T> = [T; 6];

/// A weighed rim; see [`crate::ellipse::Shape`].
#[derive(Clone, Copy)]
pub(crate) struct WeighedRim<T: Lane = f64> {
    pub area_px2: T,
    /// uu, uv and vv of the covariance, px².
    pub covariance: [T; 3],
    pub rim: LaneEllipse<T>,
    /// uu, uv and vv of [`Ellipse::matrix`].
    pub matrix: [T; 3],
    pub cuts: Cuts,
    /// Whether the sums are those of a shape.
    pub valid: T::Mask,
}

impl<T: Lane> WeighedRim<T> {
    #[inline(always)]
    pub fn new([n, nv, nvv, nu, nuv, nuu]: WeighedSums<T>, origin: (T, T), cuts: Cuts) -> Self {
        let per = n.under(1.0);
        let (u, v) = (nu * per, nv * per);
        let (uu, uv, vv) = (nuu * per - u * u, nuv * per - u * v, nvv * per - v * v);
        let valid = n.is_positive() & uu.is_positive() & (uu * vv - uv * uv).is_positive();
        let (x, y) = ((uu - vv) * 0.5, uv);
        let radius = (x * x + y * y).root();
        let [a, b] = semiaxes_px(n, radius * 2.0);
        let is_long = radius.is_positive();
        let along = (
            T::choose(is_long, x / radius, radius.splat(1.0)),
            T::choose(is_long, y / radius, radius.splat(0.0)),
        );
        let half_angle = y.angle_from(x) * 0.5;
        let quarter = std::f64::consts::FRAC_PI_2;
        let is_back = half_angle.at_most(half_angle.splat(-quarter));
        // Without a direction the angle is zero.
        let angle_rad = T::choose(is_back, half_angle.splat(quarter), half_angle);
        let angle_rad = T::choose(is_long, angle_rad, radius.splat(0.0));
        let rim = LaneEllipse { u: origin.0 + u, v: origin.1 + v, a, b, angle_rad, along };
        // Half the difference of the squared semiaxes is twice that of the eigenvalues.
        let (mean, half) = ((a * a + b * b) * 0.5, (uu - vv) * 2.0);
        let matrix = [mean + half, uv * 4.0, mean - half];
        Self { area_px2: n, covariance: [uu, uv, vv], rim, matrix, cuts, valid }
    }

    /// The quantities that determine its blur.
    #[inline(always)]
    pub fn spread(&self) -> RimSpread<T> {
        let (a, b) = (self.rim.a, self.rim.b);
        let [uu, _, vv] = self.covariance;
        let spread_px2 = (uu + vv) * 0.5 - (a * a + b * b) * 0.125;
        RimSpread { radius_px: ((a * a + b * b) * 0.5).root(), spread_px2, cuts: self.cuts }
    }
}

impl WeighedRim {
    pub fn matrix(&self) -> Symmetric2 {
        let [uu, uv, vv] = self.matrix;
        Symmetric2 { uu, uv, vv }
    }

    pub fn rim_ellipse(&self) -> RimEllipse {
        RimEllipse { ellipse: self.rim.at(0), matrix: self.matrix() }
    }
}

/// The quantities of a weighed rim that determine its blur.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RimSpread<T> {
    /// Radius of a circle with about the circumference of the rim.
    pub radius_px: T,
    /// Isotropic variance, px², in excess of the ellipse's covariance: blur and pixel width.
    pub spread_px2: T,
    pub cuts: Cuts,
}

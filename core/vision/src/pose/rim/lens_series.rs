//! The ellipse of a rim that the lens hardly distorts, as a power series in closed form.
//!
//! With the outer rim as the unit circle z = e^{it} of the image, and its plane behind the lens
//! scaled accordingly, complex numbers for points, the lens near the rim's centre is
//!
//! Z(z) = z + a z² + b z z̄ + c z̄² + d z³ + e z² z̄ + f z z̄² + g z̄³
//!
//! whose coefficients are the harmonics of Z over t; those of eight points are exact up to fourth
//! order. The ellipse Z = m + (1 + h₀) z + h z̄ crosses the images of the lines from the rim's
//! centre at 1 + q(t) times the rim's distance, with mean(ψ q) = 0 as in [`super::projection`]. To
//! second order in a, b and c and first order in the others,
//!
//! m = ā + b      h₀ = Re e + |a|² - ¾ |c|²      h = d̄ + f - ā² - b̄ c - 2 a c
//!
//! (a moves points along the rim, which shifts the ellipse as b does). The inner rim, z = z₀ + α w + β
//! w̄ with w on the unit circle, has the same Z, and by substitution coefficients of its own.
//!
//! The omitted third order is limited by [`MAX_BEND`] and [`MAX_CUBIC`]: less than 1e-5 of the rim
//! (`tests::the_series_agrees_with_the_iteration`, against [`super::lens_iteration`]).

use std::ops::Mul;

use super::{
    plane_ellipse::{POINTS, PlaneEllipse},
    rim_pair::RimEllipse,
};
use crate::simd::{Lane, Mat2, Vec2, arithmetic};

/// Limits of |a| + |b| + |c| …
const MAX_BEND: f64 = 6e-3;
/// … and of |d| + |e| + |f|.
const MAX_CUBIC: f64 = 4e-4;

/// cos 45°.
const H: f64 = std::f64::consts::FRAC_1_SQRT_2;

#[derive(Clone, Copy, Debug)]
struct Complex<T> {
    re: T,
    im: T,
}

/// Coefficients of Z.
#[derive(Clone, Copy, Debug)]
struct Terms<T> {
    a: Complex<T>,
    b: Complex<T>,
    c: Complex<T>,
    d: Complex<T>,
    e: Complex<T>,
    f: Complex<T>,
    g: Complex<T>,
}

/// The lens near a rim.
#[derive(Clone, Copy, Debug)]
pub struct LensSeries<T> {
    terms: Terms<T>,
    /// Image of the rim's centre in the plane …
    middle: Vec2<T>,
    /// … and of its semiaxes by the derivative there.
    semiaxes: Mat2<T>,
}

/// An ellipse m + p w + r w̄, |w| = 1.
#[derive(Clone, Copy, Debug)]
struct HarmonicEllipse<T> {
    m: Complex<T>,
    p: Complex<T>,
    r: Complex<T>,
}

arithmetic!(Complex { re, im });

impl<T: Lane> Complex<T> {
    #[inline(always)]
    fn new(re: T, im: T) -> Self {
        Self { re, im }
    }

    #[inline(always)]
    fn from_vec(v: Vec2<T>) -> Self {
        Self { re: v.x, im: v.y }
    }

    #[inline(always)]
    fn conj(self) -> Self {
        Self { re: self.re, im: -self.im }
    }

    #[inline(always)]
    fn norm_sqr(self) -> T {
        self.re * self.re + self.im * self.im
    }

    #[inline(always)]
    fn times(self, by: f64) -> Self {
        Self { re: self.re * by, im: self.im * by }
    }

    /// |re| + |im|.
    #[inline(always)]
    fn size(self) -> T {
        self.re.size() + self.im.size()
    }
}

impl<T: Lane> Mul for Complex<T> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self {
            re: self.re * other.re - self.im * other.im,
            im: self.re * other.im + self.im * other.re,
        }
    }
}

impl<T: Lane> LensSeries<T> {
    /// From the images of the rim's eight points, of its centre, and of its semiaxes by the
    /// derivative there; and where the distortion is small enough for the series.
    #[inline(always)]
    pub fn new(points: &[[T; POINTS]; 2], middle: Vec2<T>, semiaxes: Mat2<T>) -> (Self, T::Mask) {
        let (inverse, regular) = semiaxes.inverse();
        let [mut x, mut y] = *points;
        for i in 0..POINTS {
            let v = inverse * (Vec2::new(x[i], y[i]) - middle);
            (x[i], y[i]) = (v.x, v.y);
        }
        let terms = Terms::new(&x, &y);
        let bend = terms.a.size() + terms.b.size() + terms.c.size();
        let cubic = terms.d.size() + terms.e.size() + terms.f.size();
        let little = bend.at_most(bend.splat(MAX_BEND)) & cubic.at_most(bend.splat(MAX_CUBIC));
        (Self { terms, middle, semiaxes }, regular & little)
    }

    #[inline(always)]
    pub fn outer(&self) -> PlaneEllipse<T> {
        let Terms { a, b, .. } = self.terms;
        let (h0, h) = self.terms.ellipse_terms();
        let zero = h0.splat(0.0);
        self.flat(&HarmonicEllipse { m: a.conj() + b, p: Complex::new(h0 + 1.0, zero), r: h })
    }

    #[inline(always)]
    pub fn inner(&self, outer: &RimEllipse<T>, inner: &RimEllipse<T>) -> PlaneEllipse<T> {
        self.flat(&self.terms.image_of(&place(outer, inner)))
    }

    #[inline(always)]
    fn flat(&self, ellipse: &HarmonicEllipse<T>) -> PlaneEllipse<T> {
        let HarmonicEllipse { m, p, r } = *ellipse;
        let center = self.middle + self.semiaxes * Vec2::new(m.re, m.im);
        // At w = 1 and w = i.
        let (first, second) = (p + r, p - r);
        let own = Mat2::new(first.re, -second.im, first.im, second.re);
        PlaneEllipse { center, semiaxes: self.semiaxes.times(own), residual_shape: m.re.splat(0.0) }
    }
}

/// The inner rim where the outer one is the unit circle.
#[inline(always)]
fn place<T: Lane>(outer: &RimEllipse<T>, inner: &RimEllipse<T>) -> HarmonicEllipse<T> {
    let (per_a, per_b) = (outer.semi_major_px.under(1.0), outer.semi_minor_px.under(1.0));
    let unit =
        Mat2::new(outer.cos * per_a, outer.sin * per_a, -(outer.sin * per_b), outer.cos * per_b);
    let [major, minor] = inner.semiaxes();
    let m = Complex::from_vec(unit * (inner.center - outer.center));
    let (major, minor) = (Complex::from_vec(unit * major), Complex::from_vec(unit * minor));
    let turned = Complex::new(-minor.im, minor.re);
    HarmonicEllipse { m, p: (major - turned).times(0.5), r: (major + turned).times(0.5) }
}

/// Means with cos kt and sin kt of the odd orders k = 1 (`sign` 1) or 3 (-1).
#[inline(always)]
fn odd<T: Lane>(v: &[T; 4], sign: f64) -> (T, T) {
    let (cos, sin) = ((v[1] - v[3]) * H, (v[1] + v[3]) * H);
    let per = 1.0 / POINTS as f64;
    ((v[0] + cos * sign) * per, (v[2] * sign + sin) * per)
}

impl<T: Lane> Terms<T> {
    /// Harmonics of eight points: even orders from the sums of opposite ones, odd orders from their
    /// differences.
    #[inline(always)]
    fn new(x: &[T; POINTS], y: &[T; POINTS]) -> Self {
        let zero = x[0].splat(0.0);
        let (mut sum_x, mut sum_y, mut odd_x, mut odd_y) =
            ([zero; 4], [zero; 4], [zero; 4], [zero; 4]);
        for i in 0..4 {
            (sum_x[i], odd_x[i]) = (x[i] + x[i + 4], x[i] - x[i + 4]);
            (sum_y[i], odd_y[i]) = (y[i] + y[i + 4], y[i] - y[i + 4]);
        }
        let per = 1.0 / POINTS as f64;
        let b = Complex::new(
            (sum_x[0] + sum_x[1] + sum_x[2] + sum_x[3]) * per,
            (sum_y[0] + sum_y[1] + sum_y[2] + sum_y[3]) * per,
        );
        // Means of x and y with cos kt and sin kt.
        let (xc, xs) = ((sum_x[0] - sum_x[2]) * per, (sum_x[1] - sum_x[3]) * per);
        let (yc, ys) = ((sum_y[0] - sum_y[2]) * per, (sum_y[1] - sum_y[3]) * per);
        let (a, c) = (Complex::new(xc + ys, yc - xs), Complex::new(xc - ys, yc + xs));
        let ((xc, xs), (yc, ys)) = (odd(&odd_x, 1.0), odd(&odd_y, 1.0));
        let e = Complex::new(xc + ys - 1.0, yc - xs);
        let f = Complex::new(xc - ys, yc + xs);
        let ((xc, xs), (yc, ys)) = (odd(&odd_x, -1.0), odd(&odd_y, -1.0));
        let (d, g) = (Complex::new(xc + ys, yc - xs), Complex::new(xc - ys, yc + xs));
        Self { a, b, c, d, e, f, g }
    }

    /// h₀ and h.
    #[inline(always)]
    fn ellipse_terms(&self) -> (T, Complex<T>) {
        let Self { a, b, c, d, e, f, .. } = *self;
        let h0 = e.re + a.norm_sqr() - c.norm_sqr() * 0.75;
        (h0, d.conj() + f - (a * a).conj() - b.conj() * c - (a * c).times(2.0))
    }

    /// The image of an ellipse.
    #[inline(always)]
    fn image_of(&self, of: &HarmonicEllipse<T>) -> HarmonicEllipse<T> {
        let Self { a, b, c, d, e, f, g } = *self;
        let HarmonicEllipse { m: z, p: alpha, r: beta } = *of;
        let m = z + a * z * z + b * z.norm_sqr() + c * (z * z).conj();
        // Derivatives by z and by z̄, without z² times the cubic terms; below, the images of w and
        // w̄ by them.
        let mut straight = (a * z).times(2.0) + b * z.conj();
        straight.re = straight.re + 1.0;
        let mirror = b * z + (c * z.conj()).times(2.0);
        // About z, the cubic terms contribute quadratic ones.
        let a = a + (d * z).times(3.0) + e * z.conj();
        let b = b + (e * z + f * z.conj()).times(2.0);
        let c = c + f * z + (g * z.conj()).times(3.0);
        let p = straight * alpha + mirror * beta.conj();
        let r = straight * beta + mirror * alpha.conj();
        let own_a = a * alpha * alpha + b * alpha * beta.conj() + c * (beta * beta).conj();
        let own_b = (a * alpha * beta + c * (alpha * beta).conj()).times(2.0)
            + b * (alpha.norm_sqr() + beta.norm_sqr());
        let own_c = a * beta * beta + b * beta * alpha.conj() + c * (alpha * alpha).conj();
        // Divided by that image, x ↦ p x + r x̄.
        let per = (p.norm_sqr() - r.norm_sqr()).under(1.0);
        let (q, s) = (p.conj() * per, r * per);
        let square = alpha.norm_sqr();
        let own = Terms {
            a: q * own_a - s * own_c.conj(),
            b: q * own_b - s * own_b.conj(),
            c: q * own_c - s * own_a.conj(),
            d: d * alpha * alpha,
            e: e * square,
            f: f * (alpha * alpha).conj(),
            g,
        };
        let (h0, h) = own.ellipse_terms();
        let shift = own.a.conj() + own.b;
        HarmonicEllipse {
            m: m + p * shift + r * shift.conj(),
            p: p * (h0 + 1.0) + r * h.conj(),
            r: p * h + r * (h0 + 1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;
    use proptest::prelude::*;

    use super::*;
    use crate::{
        camera::{Lens, PixelPoint},
        ellipse::Ellipse,
        marker::Ring,
        pose::{
            rim::projection::{flatten_by_iteration, flatten_by_series},
            tests::camera,
        },
    };

    /// Largest difference of two ellipses, relative to their size.
    fn off(one: &PlaneEllipse<f64>, other: &PlaneEllipse<f64>) -> f64 {
        let semiaxes = |flat: &PlaneEllipse<f64>| Matrix2::from(flat.semiaxes);
        let size = semiaxes(one).norm();
        let shape = |flat: &PlaneEllipse<f64>| semiaxes(flat) * semiaxes(flat).transpose();
        let moved = (one.center - other.center).square().sqrt() / size;
        moved.max((shape(one) - shape(other)).norm() / (size * size))
    }

    proptest! {
        #[test]
        fn the_series_agrees_with_the_iteration(
            u in 100.0..1800.0f64, v in 100.0..980.0f64, radius_px in 4.0..60.0f64,
            share in 0.3..1.0f64, angle_rad in -1.5..1.5f64, apart in -0.05..0.05f64,
            turned_rad in -0.05..0.05f64,
        ) {
            let lenses = [
                Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
                Lens::PlumbBob([-0.28, 0.09, 0.0012, -0.0008, -0.012]),
                Lens::Rational([8.1, 5.2, 0.0004, -0.0002, 0.21, 8.4, 8.0, 1.3]),
                Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]),
            ];
            for lens in lenses {
                let camera = camera(lens);
                let rim = |scale: f64, off_px: f64, turned_rad: f64| Ellipse {
                    center: PixelPoint { u: u + off_px, v: v - off_px },
                    semi_major_px: radius_px * scale,
                    semi_minor_px: radius_px * scale * share,
                    angle_rad: angle_rad + turned_rad,
                };
                let inner = rim(0.4, apart * radius_px * share, turned_rad * (1.0 - share));
                let ring = Ring::of_rims(rim(1.0, 0.0, 0.0), inner);
                let rims = [&ring.outer, &ring.inner].map(RimEllipse::new);
                let series = flatten_by_series(&camera, &rims);
                if !series.valid {
                    continue;
                }
                let iterated = flatten_by_iteration(&camera, &rims).unwrap();
                for (series, iterated) in series.flats.iter().zip(&iterated.flats) {
                    let off = off(series, iterated);
                    prop_assert!(off < 1e-5, "{lens:?}: {off}");
                }
            }
        }
    }
}

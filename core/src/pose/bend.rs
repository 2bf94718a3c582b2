//! What a lens makes of rims so small that it hardly bends them, in closed form.
//!
//! With the outer rim as the unit circle z = e^{it} of the picture, and its plane behind the lens scaled
//! alike, complex numbers for points, the lens near the rim's centre is
//!
//! Z(z) = z + a z² + b z z̄ + c z̄² + d z³ + e z² z̄ + f z z̄² + g z̄³
//!
//! whose coefficients are the harmonics of Z over t: those of eight points are exact up to the fourth
//! order. The ellipse Z = m + (1 + h₀) z + h z̄ that is sought crosses the images of the lines from the
//! rim's centre at 1 + q(t) times the rim's distance, with mean(ψ q) = 0 as in [`super::rim`]. To the
//! second order of a, b and c and the first of the others,
//!
//! m = ā + b      h₀ = Re e + |a|² - ¾ |c|²      h = d̄ + f - ā² - b̄ c - 2 a c
//!
//! (a slides points along the rim, which is why it moves the ellipse like b). The inner rim,
//! z = z₀ + α w + β w̄ with w on the unit circle, has the same Z, and by this substitution coefficients of
//! its own.
//!
//! What is left out is the third order, as little as [`MAX_BEND`] and [`MAX_CUBIC`] allow: less than ten
//! millionths of the rim (`tests::bends_are_those_of_the_turns`, against the turns of [`super::rim`]).

use nalgebra::{Complex, Matrix2, Vector2};

use super::rim::{Flat, POINTS};
use crate::ellipse::Ellipse;

/// |a| + |b| + |c| at most …
const MAX_BEND: f64 = 6e-3;
/// … and |d| + |e| + |f|.
const MAX_CUBIC: f64 = 4e-4;

/// cos 45°.
const H: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Coefficients of Z.
#[derive(Clone, Copy, Debug)]
struct Terms {
    a: Complex<f64>,
    b: Complex<f64>,
    c: Complex<f64>,
    d: Complex<f64>,
    e: Complex<f64>,
    f: Complex<f64>,
    g: Complex<f64>,
}

/// A lens near a rim.
#[derive(Clone, Copy, Debug)]
pub struct Bend {
    terms: Terms,
    /// Image of the rim's centre in the plane …
    middle: Vector2<f64>,
    /// … and of its semiaxes by the derivative there.
    semiaxes: Matrix2<f64>,
}

/// An ellipse m + p w + r w̄, |w| = 1.
#[derive(Clone, Copy, Debug)]
struct Oval {
    m: Complex<f64>,
    p: Complex<f64>,
    r: Complex<f64>,
}

impl Bend {
    /// From the images of the rim's eight points, of its centre and of its semiaxes by the derivative
    /// there; `None` where the lens bends it more than the closed form holds for.
    #[inline(always)]
    pub fn of(
        points: &[[f64; POINTS]; 2],
        middle: Vector2<f64>,
        semiaxes: Matrix2<f64>,
    ) -> Option<Self> {
        let inverse = semiaxes.try_inverse()?;
        let (mut x, mut y) = ([0.0; POINTS], [0.0; POINTS]);
        for i in 0..POINTS {
            let (dx, dy) = (points[0][i] - middle.x, points[1][i] - middle.y);
            x[i] = inverse.m11 * dx + inverse.m12 * dy;
            y[i] = inverse.m21 * dx + inverse.m22 * dy;
        }
        let terms = Terms::of(&x, &y);
        let size = |z: Complex<f64>| z.re.abs() + z.im.abs();
        let bend = size(terms.a) + size(terms.b) + size(terms.c);
        let cubic = size(terms.d) + size(terms.e) + size(terms.f);
        (bend <= MAX_BEND && cubic <= MAX_CUBIC).then_some(Self { terms, middle, semiaxes })
    }

    /// The outer rim's ellipse.
    #[inline(always)]
    pub fn outer(&self) -> Flat {
        let Terms { a, b, .. } = self.terms;
        let (h0, h) = self.terms.second_order();
        self.flat(&Oval { m: a.conj() + b, p: Complex::new(1.0 + h0, 0.0), r: h })
    }

    /// The ellipse of the inner rim, whose centre is so far from the outer one's, in units of the outer
    /// one's semiaxes and in their directions.
    #[inline(always)]
    pub fn inner(&self, outer: &Ellipse, inner: &Ellipse) -> Flat {
        let oval = self.terms.carried(&place(outer, inner));
        self.flat(&oval)
    }

    #[inline(always)]
    fn flat(&self, oval: &Oval) -> Flat {
        let Oval { m, p, r } = oval;
        let center = self.middle + self.semiaxes * Vector2::new(m.re, m.im);
        // At w = 1 and w = i.
        let (first, second) = (p + r, p - r);
        let own = Matrix2::new(first.re, -second.im, first.im, second.re);
        Flat { center, semiaxes: self.semiaxes * own }
    }
}

/// The inner rim where the outer one is the unit circle.
#[inline(always)]
fn place(outer: &Ellipse, inner: &Ellipse) -> Oval {
    let (sin, cos) = outer.angle_rad.sin_cos();
    let (per_a, per_b) = (1.0 / outer.semi_major_px, 1.0 / outer.semi_minor_px);
    let scaled =
        |u: f64, v: f64| Complex::new((cos * u + sin * v) * per_a, (cos * v - sin * u) * per_b);
    let m = scaled(inner.center.u - outer.center.u, inner.center.v - outer.center.v);
    let (sin_own, cos_own) = inner.angle_rad.sin_cos();
    let (a, b) = (inner.semi_major_px, inner.semi_minor_px);
    let major = scaled(a * cos_own, a * sin_own);
    let minor = scaled(-b * sin_own, b * cos_own);
    let turned = Complex::new(-minor.im, minor.re);
    Oval { m, p: (major - turned) * 0.5, r: (major + turned) * 0.5 }
}

impl Terms {
    /// Harmonics of eight points: of even order from the sums of opposite ones, of odd order from their
    /// differences.
    #[inline(always)]
    fn of(x: &[f64; POINTS], y: &[f64; POINTS]) -> Self {
        let (mut sum_x, mut sum_y, mut odd_x, mut odd_y) = ([0.0; 4], [0.0; 4], [0.0; 4], [0.0; 4]);
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
        let odd = |v: &[f64; 4], sign: f64| {
            let (cos, sin) = (H * (v[1] - v[3]), H * (v[1] + v[3]));
            ((v[0] + sign * cos) * per, (sign * v[2] + sin) * per)
        };
        let ((xc, xs), (yc, ys)) = (odd(&odd_x, 1.0), odd(&odd_y, 1.0));
        let e = Complex::new(xc + ys - 1.0, yc - xs);
        let f = Complex::new(xc - ys, yc + xs);
        let ((xc, xs), (yc, ys)) = (odd(&odd_x, -1.0), odd(&odd_y, -1.0));
        let (d, g) = (Complex::new(xc + ys, yc - xs), Complex::new(xc - ys, yc + xs));
        Self { a, b, c, d, e, f, g }
    }

    /// h₀ and h.
    #[inline(always)]
    fn second_order(&self) -> (f64, Complex<f64>) {
        let Self { a, b, c, d, e, f, .. } = *self;
        let h0 = e.re + a.norm_sqr() - 0.75 * c.norm_sqr();
        (h0, d.conj() + f - (a * a).conj() - b.conj() * c - a * c * 2.0)
    }

    /// The image of an ellipse.
    #[inline(always)]
    fn carried(&self, of: &Oval) -> Oval {
        let Self { a, b, c, d, e, f, g } = *self;
        let Oval { m: z, p: alpha, r: beta } = *of;
        let m = z + a * z * z + b * z.norm_sqr() + c * (z * z).conj();
        // The derivative there, of z and of z̄, but for z² times the cubic terms, and below the image of
        // w and of w̄ by it.
        let straight = a * z * 2.0 + b * z.conj() + 1.0;
        let mirror = b * z + c * z.conj() * 2.0;
        // About z, the cubic terms are quadratic ones too.
        let a = a + d * z * 3.0 + e * z.conj();
        let b = b + (e * z + f * z.conj()) * 2.0;
        let c = c + f * z + g * z.conj() * 3.0;
        let p = straight * alpha + mirror * beta.conj();
        let r = straight * beta + mirror * alpha.conj();
        let own_a = a * alpha * alpha + b * alpha * beta.conj() + c * (beta * beta).conj();
        let own_b = (a * alpha * beta + c * (alpha * beta).conj()) * 2.0
            + b * (alpha.norm_sqr() + beta.norm_sqr());
        let own_c = a * beta * beta + b * beta * alpha.conj() + c * (alpha * alpha).conj();
        // Divided by that image, x ↦ p x + r x̄.
        let per = 1.0 / (p.norm_sqr() - r.norm_sqr());
        let divided = |by_w: Complex<f64>, by_conj: Complex<f64>| {
            (p.conj() * by_w - r * by_conj.conj()) * per
        };
        let square = alpha.norm_sqr();
        let own = Terms {
            a: divided(own_a, own_c),
            b: divided(own_b, own_b),
            c: divided(own_c, own_a),
            d: d * alpha * alpha,
            e: e * square,
            f: f * (alpha * alpha).conj(),
            g,
        };
        let (h0, h) = own.second_order();
        let shift = own.a.conj() + own.b;
        Oval {
            m: m + p * shift + r * shift.conj(),
            p: p * (1.0 + h0) + r * h.conj(),
            r: p * h + r * (1.0 + h0),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{
        rim::{flat_by_turns, flat_closed},
        tests::camera,
    };
    use super::*;
    use crate::{
        camera::{Lens, PixelPoint},
        marker::Ring,
    };

    /// The most that two ellipses differ by, as a share of the size.
    fn off(one: &Flat, other: &Flat) -> f64 {
        let size = one.semiaxes.norm();
        let shape = |flat: &Flat| flat.semiaxes * flat.semiaxes.transpose();
        let moved = (one.center - other.center).norm() / size;
        moved.max((shape(one) - shape(other)).norm() / (size * size))
    }

    proptest! {
        #[test]
        fn bends_are_those_of_the_turns(
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
                let Some((_, closed)) = flat_closed(&camera, &ring) else { continue };
                let (_, turns) = flat_by_turns(&camera, &ring).unwrap();
                for (closed, turns) in closed.iter().zip(&turns) {
                    let off = off(closed, turns);
                    prop_assert!(off < 1e-5, "{lens:?}: {off}");
                }
            }
        }
    }
}

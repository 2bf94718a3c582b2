//! A circle and its image: the closed way there, and the closed way back.
//!
//! A plane through the camera's centre with normal l touches the circle of radius R about p with the
//! unit normal n where (l·p)² = R² (|l|² - (l·n)²). The circle's image therefore has the dual conic
//!
//! D ∝ p pᵀ - R² (I - n nᵀ)
//!
//! In a frame whose z is near p, with p = d (α, 1), r = R/d, n = (w, -√(1 - |w|²)) and
//! κ = 1 - r² |w|², that is an ellipse with centre and shape A Aᵀ
//!
//! c = (α + r² w n_z)/κ      M = c cᵀ - (α αᵀ - r² (I - w wᵀ))/κ
//!
//! The *lean* w says how the circle is tilted: |w| is the sine. M has it squared, so that w and -w look
//! nearly alike, and face-on nothing is left to the first order; c has it linearly, but times r².
//!
//! Back: in the frame along the axis of the cone, D ∝ diag(-a², -b², 1) in the semiaxes' directions, and
//! since D + R² I/k has rank 2 for the right scale k, the smallest eigenvalue -a² is -R²/k, and
//!
//! d = R/a √((1 + a²)/(1 + b²))      |w|² = (a² - b²)/(a² (1 + b²)), w along the minor axis, ±
//! α = b √(a² - b²)/√(1 + a²), along w
//!
//! (paper, eqs. 9 and 10 and section 4.3 as corrected in [`crate::errata`], which have the same conic by
//! its points where this has it by its tangents.)

use nalgebra::{Vector2, Vector3};

use super::rim::{Harmonics, Information, Rim};

/// A circle's place in a local frame, by the numbers that its image depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// α: where the centre is in the plane z = 1.
    pub aside: Vector2<f64>,
    /// d: the centre's z, metres.
    pub depth_m: f64,
    /// w: the unit normal's x and y; its z is negative.
    pub lean: Vector2<f64>,
}

/// 1/√2.
pub const PER_ROOT: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// The largest sine of the tilt: 89°, where a ring is hardly a line.
const MAX_LEAN_SQUARED: f64 = 0.9997;

impl Circle {
    /// The two circles of which this rim, near the frame's axis, is the image; `None` if it is no
    /// image of a circle in front of the camera.
    #[inline(always)]
    pub fn both(rim: &Rim) -> Option<[Circle; 2]> {
        let m = rim.shape;
        let (x, y) = (0.5 * (m.m11 - m.m22), m.m12);
        let spread = (x * x + y * y).sqrt();
        let a2 = 0.5 * (m.m11 + m.m22) + spread;
        let b2 = a2 - 2.0 * spread;
        if b2.is_nan() || b2 <= 0.0 {
            return None;
        }
        let lean_squared = 2.0 * spread / (a2 * (1.0 + b2));
        let depth_m = rim.radius_m * ((1.0 + a2) / (a2 * (1.0 + b2))).sqrt();
        let lean = Circle::held(minor_direction(x, y, spread) * lean_squared.sqrt());
        let r2 = (rim.radius_m / depth_m).powi(2);
        let squeeze = 1.0 - r2 * lean.norm_squared();
        Some([lean, -lean].map(|lean| {
            // What puts the image's centre where it is: the axis may be off by rounding and less.
            let aside = rim.center * squeeze + lean * (r2 * (1.0 - lean.norm_squared()).sqrt());
            Circle { aside, depth_m, lean }
        }))
    }

    /// A lean, held at what a circle can have.
    #[inline(always)]
    pub fn held(lean: Vector2<f64>) -> Vector2<f64> {
        lean * (MAX_LEAN_SQUARED / lean.norm_squared().max(MAX_LEAN_SQUARED)).sqrt()
    }

    /// Centre, metres.
    #[inline(always)]
    pub fn position_m(&self) -> Vector3<f64> {
        self.aside.push(1.0) * self.depth_m
    }

    /// z of the normal.
    #[inline(always)]
    pub fn facing(&self) -> f64 {
        -(1.0 - self.lean.norm_squared()).sqrt()
    }

    /// Unit normal facing the camera.
    #[inline(always)]
    pub fn normal(&self) -> Vector3<f64> {
        self.lean.push(self.facing())
    }

    /// The circle moved by (α, ln d, w); `None` if it is then no circle in front of the camera.
    #[inline(always)]
    pub fn moved(&self, by: &[f64; 5]) -> Option<Circle> {
        let moved = Circle {
            aside: self.aside + Vector2::new(by[0], by[1]),
            depth_m: self.depth_m * by[2].exp(),
            lean: self.lean + Vector2::new(by[3], by[4]),
        };
        let upright = moved.lean.norm_squared() < MAX_LEAN_SQUARED;
        (upright && moved.normal().dot(&moved.position_m()) < 0.0).then_some(moved)
    }

    /// A rim's five numbers as seen less those that this circle would give it.
    #[inline(always)]
    pub fn compare(&self, rim: &Rim) -> Harmonics {
        let Circle { aside, depth_m, lean } = *self;
        let r2 = (rim.radius_m / depth_m).powi(2);
        let per_squeeze = 1.0 / (1.0 - r2 * lean.norm_squared());
        let center = (aside + lean * (r2 * self.facing())) * per_squeeze;
        let shape = |i: usize, j: usize, same: f64| {
            let inner = aside[i] * aside[j] - r2 * (same - lean[i] * lean[j]);
            center[i] * center[j] - inner * per_squeeze
        };
        let (m11, m12, m22) = (shape(0, 0, 1.0), shape(0, 1, 0.0), shape(1, 1, 1.0));
        let seen = &rim.shape;
        harmonics(rim, &(rim.center - center), [seen.m11 - m11, seen.m12 - m12, seen.m22 - m22])
    }
}

/// The unit vector along the minor axis of the shape with half the difference `x` of its diagonal, `y`
/// off it, and `spread` their root of squares.
#[inline(always)]
fn minor_direction(x: f64, y: f64, spread: f64) -> Vector2<f64> {
    if spread <= 0.0 {
        return Vector2::new(1.0, 0.0);
    }
    // The major axis has twice its angle along (x, y); of the two halves of its cosine the larger one
    // keeps its digits.
    let cos_2 = x / spread;
    if x >= 0.0 {
        let cos = (0.5 * (1.0 + cos_2)).sqrt();
        Vector2::new(-0.5 * y / (spread * cos), cos)
    } else {
        let sin = (0.5 * (1.0 - cos_2)).sqrt();
        Vector2::new(-sin, 0.5 * y / (spread * sin))
    }
}

/// The five numbers of a small change of a rim's centre and shape (its 11, 12 and 22): with y = A⁻¹ δc
/// and N = A⁻¹ δM A⁻ᵀ, q = u·y + ½ uᵀ N u over the unit vectors u.
#[inline(always)]
fn harmonics(rim: &Rim, center: &Vector2<f64>, [m11, m12, m22]: [f64; 3]) -> Harmonics {
    let i = &rim.inverse;
    let (p, q) = (i.m11 * m11 + i.m12 * m12, i.m11 * m12 + i.m12 * m22);
    let (s, t) = (i.m21 * m11 + i.m22 * m12, i.m21 * m12 + i.m22 * m22);
    let n11 = p * i.m11 + q * i.m12;
    let n12 = p * i.m21 + q * i.m22;
    let n22 = s * i.m21 + t * i.m22;
    [
        0.25 * (n11 + n22),
        PER_ROOT * (i.m11 * center.x + i.m12 * center.y),
        PER_ROOT * (i.m21 * center.x + i.m22 * center.y),
        0.25 * PER_ROOT * (n11 - n22),
        0.5 * PER_ROOT * n12,
    ]
}

impl Information {
    /// These five numbers weighted.
    #[inline(always)]
    pub fn times(&self, h: &Harmonics) -> Harmonics {
        [
            self.size * h[0] + self.size_and_elongation * h[3],
            self.along * h[1],
            self.across * h[2],
            self.size_and_elongation * h[0] + self.elongation * h[3],
            self.turn * h[4],
        ]
    }
}

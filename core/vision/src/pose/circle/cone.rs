//! A circle and its image, in closed form in both directions.
//!
//! A plane through the camera's centre with normal l touches the circle of radius R about p with
//! unit normal n where (l·p)² = R² (|l|² - (l·n)²). The circle's image therefore has the dual conic
//!
//! D ∝ p pᵀ - R² (I - n nᵀ)
//!
//! In a frame whose z is near p, with p = d (α, 1), r = R/d, n = (w, -√(1 - |w|²)) and κ = 1 - r²
//! |w|², this is an ellipse with centre and shape A Aᵀ
//!
//! c = (α + r² w n_z)/κ      M = c cᵀ - (α αᵀ - r² (I - w wᵀ))/κ
//!
//! The *lean* w is the normal's component across the line of sight; |w| is the sine of the tilt. M
//! depends on its square, so w and -w look nearly the same, and face-on the first-order term
//! vanishes. c depends on w linearly, but with the factor r².
//!
//! Inverse: in the frame along the cone's axis, D ∝ diag(-a², -b², 1) in the directions of the semiaxes. D + R² I/k has
//! rank 2 for the right scale k, so the smallest eigenvalue -a² equals -R²/k, and
//!
//! d = R/a √((1 + a²)/(1 + b²))      |w|² = (a² - b²)/(a² (1 + b²)), w along the minor axis, ±
//! α = b √(a² - b²)/√(1 + a²), along w
//!
//! (paper, eqs. 9 and 10 and section 4.3 as corrected in [`crate::errata`]; they describe the conic
//! by its points, this module by its tangents.)

use crate::{
    pose::rim::{information::Harmonics, projection::Rim},
    simd::{Lane, Vec2, Vec3},
};

/// A circle in a local frame, by the parameters that its image depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle<T> {
    /// α: the centre in the plane z = 1.
    pub aside: Vec2<T>,
    /// d: z of the centre, metres.
    pub depth_m: T,
    /// w: x and y of the unit normal, whose z is negative.
    pub lean: Vec2<T>,
}

pub const PER_ROOT: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Squared sine of 89°, beyond which a ring is hardly more than a line.
const MAX_LEAN_SQUARED: f64 = 0.9997;

impl<T: Lane> Circle<T> {
    /// The two circles whose image this rim, near the frame's axis, can be; and where they lie in
    /// front of the camera.
    #[inline(always)]
    pub fn both(rim: &Rim<T>) -> ([Self; 2], T::Mask) {
        let m = rim.shape;
        let (x, y) = ((m.m11 - m.m22) * 0.5, m.m12);
        let spread = (x * x + y * y).root();
        let a2 = (m.m11 + m.m22) * 0.5 + spread;
        let b2 = a2 - spread * 2.0;
        let per_both = (a2 * (b2 + 1.0)).under(1.0);
        let lean_squared = spread * 2.0 * per_both;
        let depth_m = rim.radius_m * ((a2 + 1.0) * per_both).root();
        let lean = Self::clamped(minor_direction(x, y, spread) * lean_squared.root());
        let r2 = (rim.radius_m / depth_m).squared();
        let square = lean.square();
        // Compensates a frame whose axis is off by rounding.
        let middle = rim.center * (-(r2 * square) + 1.0);
        let aside = lean * (r2 * (-square + 1.0).root());
        let first = Self { aside: middle + aside, depth_m, lean };
        let second = Self { aside: middle - aside, depth_m, lean: -lean };
        ([first, second], b2.is_positive())
    }

    /// The lean, shortened to at most 89°.
    #[inline(always)]
    pub fn clamped(lean: Vec2<T>) -> Vec2<T> {
        let limit = lean.x.splat(MAX_LEAN_SQUARED);
        lean * (limit / lean.square().larger(limit)).root()
    }

    #[inline(always)]
    pub fn position_m(&self) -> Vec3<T> {
        let aside = self.aside * self.depth_m;
        aside.push(self.depth_m)
    }

    #[inline(always)]
    pub fn normal_z(&self) -> T {
        -(-self.lean.square() + 1.0).root()
    }

    #[inline(always)]
    pub fn normal(&self) -> Vec3<T> {
        self.lean.push(self.normal_z())
    }

    /// The circle after a change of (α, ln d, w), and where the result is a circle in front of the
    /// camera.
    #[inline(always)]
    pub fn moved(&self, by: &[T; 5]) -> (Self, T::Mask) {
        let moved = Self {
            aside: self.aside + Vec2::new(by[0], by[1]),
            depth_m: self.depth_m * by[2].exponential(),
            lean: self.lean + Vec2::new(by[3], by[4]),
        };
        let upright = moved.lean.square().below(by[0].splat(MAX_LEAN_SQUARED));
        let away = moved.normal().dot(moved.position_m());
        (moved, upright & away.below(by[0].splat(0.0)))
    }

    /// The rim's five harmonics, measured less predicted by this circle.
    #[inline(always)]
    pub fn residuals(&self, rim: &Rim<T>) -> Harmonics<T> {
        let Self { aside, depth_m, lean } = *self;
        let r2 = (rim.radius_m / depth_m).squared();
        let per_squeeze = (-(r2 * lean.square()) + 1.0).under(1.0);
        let center = (aside + lean * (r2 * self.normal_z())) * per_squeeze;
        let (a, w, c) = (aside, lean, center);
        let m11 = c.x * c.x - (a.x * a.x - r2 * (-(w.x * w.x) + 1.0)) * per_squeeze;
        let m12 = c.x * c.y - (a.x * a.y + r2 * (w.x * w.y)) * per_squeeze;
        let m22 = c.y * c.y - (a.y * a.y - r2 * (-(w.y * w.y) + 1.0)) * per_squeeze;
        let shape = &rim.shape;
        harmonics(rim, rim.center - center, [shape.m11 - m11, shape.m12 - m12, shape.m22 - m22])
    }

    #[inline(always)]
    pub fn choose(mask: T::Mask, yes: &Self, no: &Self) -> Self {
        Self {
            aside: Vec2::choose(mask, yes.aside, no.aside),
            depth_m: T::choose(mask, yes.depth_m, no.depth_m),
            lean: Vec2::choose(mask, yes.lean, no.lean),
        }
    }
}

/// The unit vector along the minor axis of a shape with half the difference `x` of its diagonal,
/// off-diagonal `y` and `spread` = √(x² + y²).
#[inline(always)]
fn minor_direction<T: Lane>(x: T, y: T, spread: T) -> Vec2<T> {
    let (zero, one) = (x.splat(0.0), x.splat(1.0));
    // The major axis has half the angle of (x, y). The larger of cosine and sine keeps its digits;
    // the other one follows from it.
    let larger = ((x.size() / spread + 1.0) * 0.5).root();
    let smaller = y * 0.5 / (spread * larger);
    let along =
        Vec2::choose(zero.at_most(x), Vec2::new(-smaller, larger), Vec2::new(-larger, smaller));
    Vec2::choose(spread.is_positive(), along, Vec2::new(one, zero))
}

/// Harmonics of a small change of a rim's centre and shape (11, 12, 22): with y = A⁻¹ δc and N =
/// A⁻¹ δM A⁻ᵀ, q = u·y + ½ uᵀ N u over the unit vectors u.
#[inline(always)]
fn harmonics<T: Lane>(rim: &Rim<T>, center: Vec2<T>, [m11, m12, m22]: [T; 3]) -> Harmonics<T> {
    let i = &rim.inverse;
    let (p, q) = (i.m11 * m11 + i.m12 * m12, i.m11 * m12 + i.m12 * m22);
    let (s, t) = (i.m21 * m11 + i.m22 * m12, i.m21 * m12 + i.m22 * m22);
    let n11 = p * i.m11 + q * i.m12;
    let n12 = p * i.m21 + q * i.m22;
    let n22 = s * i.m21 + t * i.m22;
    let (shift, shape) = (*i * center, shape_harmonics(n11, n12, n22));
    [shape.x, shift.x * PER_ROOT, shift.y * PER_ROOT, shape.y, shape.z]
}

/// Size, elongation and turn of N.
#[inline(always)]
pub fn shape_harmonics<T: Lane>(n11: T, n12: T, n22: T) -> Vec3<T> {
    Vec3::new((n11 + n22) * 0.25, (n11 - n22) * (0.25 * PER_ROOT), n12 * (0.5 * PER_ROOT))
}

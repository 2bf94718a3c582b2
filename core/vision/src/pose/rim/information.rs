//! Information about a rim, from the errors of its samples.
//!
//! A rim is described by five harmonics h, with the basis ψ ([`super::projection`]). Its samples
//! are displaced across it by n(s), independently from one pixel of arc s to the next, so q = g n /
//! (ab) with g = ds/dt = √(a² sin² t + b² cos² t) and cov h = σ²/(2π a²b²) mean(g ψψᵀ). The floor
//! and, equally for all five, the unevenness add to it. By symmetry only size and elongation are
//! correlated. The means of g, g cos 2t and g cos 4t are those over eight points.

use super::{
    noise::{DiscWeights, RimErrors},
    rim_pair::RimEllipse,
};
use crate::simd::{Lane, Vec3, lane_by_field};

/// Size, shift along either axis, elongation and turn.
pub type Harmonics<T> = [T; 5];

/// Share of the floor that centre, elongation and turn have: blur and bloom are nearly uniform
/// around a rim.
const REST_OF_FLOOR: f64 = 0.25;

/// Inverse covariance of the harmonics; entries that are not here are zero.
#[derive(Clone, Copy, Debug)]
pub struct Information<T> {
    pub size: T,
    pub size_and_elongation: T,
    pub elongation: T,
    pub along: T,
    pub across: T,
    pub turn: T,
}

lane_by_field!(Information { size, size_and_elongation, elongation, along, across, turn });

impl<T: Lane> Information<T> {
    /// Also returns where the rim is valid.
    #[inline(always)]
    pub fn new(rim: &RimEllipse<T>, noise: &RimErrors<T>) -> (Self, T::Mask) {
        let (a, b) = (rim.semi_major_px, rim.semi_minor_px);
        let between = ((a * a + b * b) * 0.5).root();
        let (g0, g2, g4) =
            ((a + b + between * 2.0) * 0.25, (b - a) * 0.25, (a + b - between * 2.0) * 0.25);
        let per_area = (a * b).under(1.0);
        let edge = (noise.edge_px * per_area).squared() * (1.0 / std::f64::consts::TAU);
        // A shift η of the whole rim across itself: q = g η/(ab), with harmonics size and
        // elongation.
        let per_shift = noise.floor_px * per_area;
        let (shift_size, shift_elongation) =
            (g0 * per_shift, g2 * per_shift * std::f64::consts::SQRT_2);
        let rest = (noise.floor_px * REST_OF_FLOOR).squared();
        let uneven = noise.uneven_px.squared() * per_area;
        let size = edge * g0 + shift_size * shift_size + uneven;
        let quarter = rest * per_area * 0.25 + uneven;
        let elongation = edge * (g0 + g4) + shift_elongation * shift_elongation + quarter;
        let coupling = edge * g2 * std::f64::consts::SQRT_2 + shift_size * shift_elongation;
        // 1/a² is b²/(ab)².
        let half = rest * per_area.squared() * 0.5;
        let along = edge * (g0 + g2) + half * b.squared() + uneven;
        let across = edge * (g0 - g2) + half * a.squared() + uneven;
        let turn = edge * (g0 - g4) + quarter;
        let determinant = size * elongation - coupling * coupling;
        let per_determinant = determinant.under(1.0);
        let information = Self {
            size: elongation * per_determinant,
            size_and_elongation: -coupling * per_determinant,
            elongation: size * per_determinant,
            along: along.under(1.0),
            across: across.under(1.0),
            turn: turn.under(1.0),
        };
        let valid = determinant.is_positive()
            & along.is_positive()
            & across.is_positive()
            & turn.is_positive();
        (information, valid)
    }

    /// Removes the numbers that carry no information about the pose. Unused elongation and turn are
    /// marginalized, which reduces the information about the size.
    #[inline(always)]
    pub fn weighted_by(&self, valid: &DiscWeights<T>) -> Self {
        let DiscWeights { size: by_size, shape: by_shape } = *valid;
        let by_elongation = self.size_and_elongation.squared() / self.elongation;
        Self {
            size: (self.size - (-by_shape + 1.0) * by_elongation) * by_size,
            size_and_elongation: self.size_and_elongation * by_shape,
            elongation: self.elongation * by_shape,
            turn: self.turn * by_shape,
            ..*self
        }
    }

    #[inline(always)]
    pub fn times(&self, h: &Harmonics<T>) -> Harmonics<T> {
        [
            self.size * h[0] + self.size_and_elongation * h[3],
            self.along * h[1],
            self.across * h[2],
            self.size_and_elongation * h[0] + self.elongation * h[3],
            self.turn * h[4],
        ]
    }

    /// As [`Self::times`], of size, elongation and turn.
    #[inline(always)]
    pub fn times_shape(&self, h: Vec3<T>) -> Vec3<T> {
        Vec3::new(
            self.size * h.x + self.size_and_elongation * h.y,
            self.size_and_elongation * h.x + self.elongation * h.y,
            self.turn * h.z,
        )
    }
}

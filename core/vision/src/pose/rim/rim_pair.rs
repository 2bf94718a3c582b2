//! Input of the closed form: one ring, or several in the lanes of a vector.

use std::f64::consts::{FRAC_PI_2, PI};

use super::noise::{DiscWeights, RimErrors, RingNoise};
use crate::{
    ellipse::Ellipse,
    marker::Ring,
    simd::{Lane, Vec2},
};

#[derive(Clone, Copy, Debug)]
pub struct RimEllipse<T> {
    pub center: Vec2<T>,
    pub semi_major_px: T,
    pub semi_minor_px: T,
    /// Cosine of the major axis' angle.
    pub cos: T,
    pub sin: T,
}

/// Both rims, outer and inner, with all else that a pose depends on.
#[derive(Clone, Copy, Debug)]
pub struct RimPair<T> {
    pub rims: [RimEllipse<T>; 2],
    /// Radii of the print's rims.
    pub radii_m: [T; 2],
    pub noise: RingNoise<T>,
}

/// A detected ring, with all else that its pose depends on.
#[derive(Clone, Copy, Debug)]
pub struct RingMeasurement {
    rims: [Ellipse; 2],
    radii_m: [f64; 2],
    noise: RingNoise<f64>,
}

impl RingMeasurement {
    pub fn new(ring: &Ring, radii_m: [f64; 2], noise: RingNoise<f64>) -> Self {
        Self { rims: [ring.outer, ring.inner], radii_m, noise }
    }

    #[inline(always)]
    pub fn rim_pair(&self) -> RimPair<f64> {
        RimPair::gather(0.0, &[self])
    }
}

impl<T: Lane> RimPair<T> {
    /// One ring per lane of `like`.
    #[inline(always)]
    pub fn gather(like: T, rings: &[&RingMeasurement]) -> Self {
        let radii_m = like.each(
            #[inline(always)]
            |lane| rings[lane].radii_m,
        );
        let [size, shape] = like.each(
            #[inline(always)]
            |lane| [rings[lane].noise.disc.size, rings[lane].noise.disc.shape],
        );
        let errors = [0, 1].map(
            #[inline(always)]
            |rim| {
                let [edge_px, floor_px, uneven_px] = like.each(
                    #[inline(always)]
                    |lane| {
                        let RimErrors { edge_px, floor_px, uneven_px } =
                            rings[lane].noise.rims[rim];
                        [edge_px, floor_px, uneven_px]
                    },
                );
                RimErrors { edge_px, floor_px, uneven_px }
            },
        );
        let rims = [0, 1].map(
            #[inline(always)]
            |rim| {
                RimEllipse::from_numbers(like.each(
                    #[inline(always)]
                    |lane| numbers(&rings[lane].rims[rim]),
                ))
            },
        );
        let noise = RingNoise { rims: errors, disc: DiscWeights { size, shape } };
        Self { rims, radii_m, noise }
    }
}

/// Centre, semiaxes, and angle in [-π/2, π/2].
#[inline(always)]
fn numbers(ellipse: &Ellipse) -> [f64; 5] {
    let Ellipse { center, semi_major_px, semi_minor_px, angle_rad } = *ellipse;
    // An ellipse is invariant under rotation by π.
    let angle_rad = if angle_rad.abs() > FRAC_PI_2 {
        angle_rad - PI * (angle_rad / PI).round()
    } else {
        angle_rad
    };
    [center.u, center.v, semi_major_px, semi_minor_px, angle_rad]
}

impl RimEllipse<f64> {
    #[inline(always)]
    pub fn new(ellipse: &Ellipse) -> Self {
        Self::from_numbers(numbers(ellipse))
    }
}

impl<T: Lane> RimEllipse<T> {
    #[inline(always)]
    fn from_numbers([u, v, semi_major_px, semi_minor_px, angle_rad]: [T; 5]) -> Self {
        let (sin, cos) = angle_rad.sine_and_cosine();
        Self { center: Vec2::new(u, v), semi_major_px, semi_minor_px, cos, sin }
    }

    /// As vectors in the image.
    #[inline(always)]
    pub fn semiaxes(&self) -> [Vec2<T>; 2] {
        let (a, b) = (self.semi_major_px, self.semi_minor_px);
        [Vec2::new(self.cos * a, self.sin * a), Vec2::new(-(self.sin * b), self.cos * b)]
    }
}

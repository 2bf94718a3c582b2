//! Grey levels around the teeth, as a periodic profile.
//!
//! The annulus between the white core and the disc's rim is sampled on a few circles well inside it, at
//! angles counter-clockwise on the print, a whole number of them per slot. The circles are rotated
//! against each other by a fraction of a sample, so that a sharp edge affects the profile at any position within a
//! sample. The result is the whiteness of each angle, as a share of half the contrast about its mean:
//! +1 in a gap, -1 in a tooth, rounded by blur.

use fearless_simd::{Simd, dispatch};
use fearless_simd_macros::simd;

use crate::{
    frame::Frame,
    marker::{
        Polarity,
        coded::{plane_map::PlaneMap, sampler::Sampler},
    },
    simd::floor,
};

/// Largest number of samples of a profile.
pub(crate) const MAX_SAMPLES: usize = 128;
/// Sampled circles, as shares of the annulus' width from the core.
const CIRCLES: [f64; 3] = [0.3, 0.5, 0.7];
/// Variance that pixel width and interpolation add to the blur, px².
const SAMPLING_PX2: f32 = 1.0 / 12.0 + 1.0 / 6.0;
/// Variance due to the rotated circles, squared samples.
const SAMPLE_VARIANCE: f32 = 1.0 / 12.0;

/// Positions of the samples in the plane, the same for every roundel of a layout.
#[derive(Clone, Debug)]
pub(crate) struct Directions {
    /// By circle, the outermost last; angles on the print count the other way.
    circles: [Vec<(f32, f32)>; CIRCLES.len()],
    /// Radius of the outermost circle.
    reach: f64,
}

/// A profile and its blur.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Profile {
    /// Whiteness by angle; the first `len` are valid.
    pub white: [f32; MAX_SAMPLES],
    /// Variance of the blur along the circle, squared samples.
    pub spread: [f32; MAX_SAMPLES],
    /// Number of samples.
    pub len: usize,
}

/// Grey levels and blur of a ring.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RingLevels {
    pub black: f64,
    pub white: f64,
    pub polarity: Polarity,
    pub blur_px: f64,
}

impl Directions {
    /// `samples` directions for an annulus from `core` to `rim` times the outer radius.
    pub fn new(samples: usize, core: f64, rim: f64) -> Self {
        let step_rad = std::f64::consts::TAU / samples as f64;
        let radius = |circle: usize| core + CIRCLES[circle] * (rim - core);
        let circle = |circle: usize| {
            let part = (circle as f64 + 0.5) / CIRCLES.len() as f64 - 0.5;
            let place = |index: usize| {
                let (sin, cos) = (-step_rad * (index as f64 + part)).sin_cos();
                ((radius(circle) * cos) as f32, (radius(circle) * sin) as f32)
            };
            (0..samples).map(place).collect()
        };
        Self { circles: std::array::from_fn(circle), reach: radius(CIRCLES.len() - 1) }
    }

    /// Samples per revolution.
    pub fn len(&self) -> usize {
        self.circles[0].len()
    }

    /// The profile of one roundel; `None` if the annulus is not completely inside the frame, or
    /// there is no contrast.
    pub fn profile(
        &self,
        sampler: &Sampler,
        plane: &PlaneMap,
        levels: &RingLevels,
    ) -> Option<Profile> {
        dispatch!(sampler.level, simd => self.profile_with(simd, sampler.frame, plane, levels))
    }

    #[simd]
    fn profile_with<S: Simd>(
        &self,
        _simd: S,
        frame: &Frame,
        plane: &PlaneMap,
        levels: &RingLevels,
    ) -> Option<Profile> {
        let contrast = levels.white - levels.black;
        let sign = if levels.polarity == Polarity::BlackRing { 1.0 } else { -1.0 };
        let scale = (sign * 2.0 / contrast / CIRCLES.len() as f64) as f32;
        if !(scale.is_finite() && self.fits(frame, plane)) {
            return None;
        }
        let len = self.len();
        let mut profile = Profile { white: [0.0; MAX_SAMPLES], spread: [0.0; MAX_SAMPLES], len };
        let mut places = [(0.0f32, 0.0f32); MAX_SAMPLES];
        for (circle, points) in self.circles.iter().enumerate() {
            for (place, &point) in places.iter_mut().zip(points) {
                *place = plane.image_f32(point);
            }
            for (sum, &(u, v)) in profile.white.iter_mut().zip(&places[..len]) {
                *sum += level_at(frame.pixels(), u, v);
            }
            if circle == CIRCLES.len() / 2 {
                let variance_px2 = (levels.blur_px * levels.blur_px) as f32 + SAMPLING_PX2;
                for index in 0..len {
                    let (from, to) = (places[index], places[(index + 1) % len]);
                    let (du, dv) = (to.0 - from.0, to.1 - from.1);
                    profile.spread[index] =
                        variance_px2 / (du * du + dv * dv).max(1e-3) + SAMPLE_VARIANCE;
                }
            }
        }
        let white = &mut profile.white[..len];
        let mean = white.iter().sum::<f32>() / len as f32;
        white.iter_mut().for_each(|level| *level = (*level - mean) * scale);
        Some(profile)
    }

    /// Whether all samples have four pixels around them.
    fn fits(&self, frame: &Frame, plane: &PlaneMap) -> bool {
        let (low, high) = plane.bounds(self.reach);
        low.u >= 0.0
            && low.v >= 0.0
            && high.u < (frame.width() - 1) as f64
            && high.v < (frame.height() - 1) as f64
    }
}

/// Grey level between four pixels of the frame.
#[inline(always)]
fn level_at((pixels, stride): (&[u8], usize), u: f32, v: f32) -> f32 {
    let (left, top) = (floor(u), floor(v));
    let (du, dv) = (u - left as f32, v - top as f32);
    let at = top as usize * stride + left as usize;
    let rows = &pixels[at..at + stride + 2];
    let row = |[left, right]: [u8; 2]| {
        let (left, right) = (f32::from(left), f32::from(right));
        left + (right - left) * du
    };
    let (above, below) = (row([rows[0], rows[1]]), row([rows[stride], rows[stride + 1]]));
    above + (below - above) * dv
}

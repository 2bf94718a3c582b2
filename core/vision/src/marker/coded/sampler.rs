//! Grey levels between pixels, at one point or many.

use fearless_simd::Level;

use crate::{camera::PixelPoint, frame::Frame, simd::floor};

/// Bilinear interpolation of a frame, extended beyond its edges by the last pixels.
pub(crate) struct Sampler<'a, 'f> {
    pub frame: &'a Frame<'f>,
    /// Instruction set.
    pub level: Level,
    /// Inverts levels, so that a white ring looks like a black one.
    pub inverted: bool,
}

/// Points relative to a pixel near all of them, so that single precision suffices.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SamplePoints<const COUNT: usize> {
    pub origin: (i32, i32),
    pub u: [f32; COUNT],
    pub v: [f32; COUNT],
}

impl Sampler<'_, '_> {
    pub fn at(&self, u: f64, v: f64) -> f64 {
        let level = self.frame.level_at(PixelPoint { u, v });
        if self.inverted { 255.0 - level } else { level }
    }

    /// [`Sampler::at`] at many points, for a frame of at least two pixels a side.
    ///
    /// Only the pixels are loaded one by one; the rest is vectorized by the compiler.
    #[inline(always)]
    pub fn each<const COUNT: usize>(&self, points: &SamplePoints<COUNT>) -> [f32; COUNT] {
        let SamplePoints { origin, u, v } = points;
        let (left, du) = split(u, origin.0, self.frame.width());
        let (top, dv) = split(v, origin.1, self.frame.height());
        let (pixels, stride) = self.frame.pixels();
        let (mut above, mut below) = ([[0u8; COUNT]; 2], [[0u8; COUNT]; 2]);
        for index in 0..COUNT {
            let at = top[index] as usize * stride + left[index] as usize;
            let (rows, next) = (&pixels[at..at + stride + 2], stride);
            (above[0][index], above[1][index]) = (rows[0], rows[1]);
            (below[0][index], below[1][index]) = (rows[next], rows[next + 1]);
        }
        let (from, sign) = if self.inverted { (255.0, -1.0) } else { (0.0, 1.0) };
        let mut levels = [0.0; COUNT];
        for index in 0..COUNT {
            let row = |[here, next]: &[[u8; COUNT]; 2]| {
                let (here, next) = (f32::from(here[index]), f32::from(next[index]));
                here + (next - here) * du[index]
            };
            let (above, below) = (row(&above), row(&below));
            levels[index] = from + sign * (above + (below - above) * dv[index]);
        }
        levels
    }
}

/// The pixels before points along one side of the frame, and the points' distances beyond them.
#[inline(always)]
fn split<const COUNT: usize>(
    points: &[f32; COUNT],
    origin: i32,
    side: usize,
) -> ([i32; COUNT], [f32; COUNT]) {
    let (low, high) = (-origin as f32, (side as i32 - 1 - origin) as f32 - 0.001);
    let (mut pixels, mut beyond) = ([0; COUNT], [0.0; COUNT]);
    for index in 0..COUNT {
        // NaN maps to the edge.
        let place = points[index].max(low).min(high);
        let whole = floor(place);
        beyond[index] = place - whole as f32;
        // If single precision has rounded up to the last pixel.
        pixels[index] = (whole + origin).min(side as i32 - 2);
    }
    (pixels, beyond)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIZE: (usize, usize) = (70, 50);

    proptest! {
        #[test]
        fn many_points_equal_single_points(
            at in prop::array::uniform16((-20.0..90.0f64, -20.0..70.0f64)),
            origin in (-10..80i32, -10..60i32),
            inverted in any::<bool>(),
        ) {
            let pixels: Vec<u8> =
                (0..SIZE.0 * SIZE.1).map(|at| (at * 7919 % 251) as u8).collect();
            let frame = Frame::new(&pixels, SIZE.0, SIZE.1, SIZE.0).unwrap();
            let sampler = Sampler { frame: &frame, level: Level::new(), inverted };
            let points = SamplePoints {
                origin,
                u: at.map(|(u, _)| (u - f64::from(origin.0)) as f32),
                v: at.map(|(_, v)| (v - f64::from(origin.1)) as f32),
            };
            for (level, (u, v)) in sampler.each(&points).into_iter().zip(at) {
                let alone = sampler.at(u, v);
                prop_assert!((f64::from(level) - alone).abs() < 0.02, "{level} {alone}");
            }
        }
    }

    #[test]
    fn nan_maps_to_the_edge() {
        let pixels = [1, 2, 3, 4];
        let frame = Frame::new(&pixels, 2, 2, 2).unwrap();
        let sampler = Sampler { frame: &frame, level: Level::new(), inverted: false };
        let (u, v) = ([f32::NAN, f32::INFINITY, f32::NEG_INFINITY], [f32::NAN; 3]);
        let levels = sampler.each(&SamplePoints { origin: (1000, -1000), u, v });
        assert!(
            levels.iter().zip([1.0, 2.0, 1.0]).all(|(level, edge)| (level - edge).abs() < 0.01)
        );
    }
}

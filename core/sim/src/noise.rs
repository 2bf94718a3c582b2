//! Reproducible randomness: an integer hash, smooth noise over the plane, and sensor noise.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Steps of the working image per grey level.
pub(super) const STEPS_PER_LEVEL: i16 = 64;

/// Number of positions in the tile where a row may begin.
const STARTS: usize = 1 << 16;

/// Hash of two numbers (finalizer of splitmix64, Steele et al. 2014).
pub(super) fn mix(a: u64, b: u64) -> u64 {
    let mut z = a.wrapping_add(b.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Smooth noise of about unit wavelength, -1 to 1: cubic interpolation of random values at integers.
pub(super) fn smooth_noise(seed: u64, x: f64, y: f64) -> f64 {
    let corner = |i: i64, j: i64| {
        let hash = mix(mix(seed, i as u64), j as u64);
        (hash >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let (i, j) = (x.floor() as i64, y.floor() as i64);
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (s, t) = (ease(x - x.floor()), ease(y - y.floor()));
    let along = |j: i64| corner(i, j) * (1.0 - s) + corner(i + 1, j) * s;
    along(j) * (1.0 - t) + along(j + 1) * t
}

/// Normal sensor noise, independent of the signal. Each row of each frame reads a tile at a pseudorandom position;
/// drawing a million normal numbers per frame would cost more than the rest of the picture.
pub(super) struct SensorNoise {
    seed: u64,
    tile: Vec<i16>,
}

impl SensorNoise {
    /// Standard deviation in grey levels, for rows of up to `width` pixels.
    pub fn new(seed: u64, width: usize, levels: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let step = f64::from(STEPS_PER_LEVEL);
        let tile = (0..STARTS + width)
            .map(|_| {
                let normal: f64 = rng.sample(StandardNormal);
                // Half a level, so that truncation rounds to nearest.
                (normal.clamp(-6.0, 6.0) * levels * step + step / 2.0).round() as i16
            })
            .collect();
        Self { seed, tile }
    }

    /// Converts a row of the working image to 8-bit pixels with noise.
    pub fn develop(&self, frame: u64, row: usize, working: &[i16], pixels: &mut [u8]) {
        const SHIFT: u32 = STEPS_PER_LEVEL.trailing_zeros();
        let start = mix(mix(self.seed, frame), row as u64) as usize % STARTS;
        let noise = &self.tile[start..start + working.len()];
        for ((pixel, &level), &noise) in pixels.iter_mut().zip(working).zip(noise) {
            // Levels are at most 255 · 64 and noise 180 · 64, so the sum fits into 16 bits.
            *pixel = (level.wrapping_add(noise) >> SHIFT).clamp(0, 255) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn developed_noise_has_its_mean_and_deviation() {
        let noise = SensorNoise::new(3, 4096, 2.0);
        let working = vec![100 * STEPS_PER_LEVEL; 4096];
        let mut pixels = vec![0; 4096];
        let (mut sum, mut squares) = (0.0, 0.0);
        for row in 0..100 {
            noise.develop(7, row, &working, &mut pixels);
            for &pixel in &pixels {
                let off = f64::from(pixel) - 100.0;
                sum += off;
                squares += off * off;
            }
        }
        let count = 409_600.0;
        // The rows share a tile of about 65,536 samples.
        assert!((sum / count).abs() < 0.03, "mean {}", sum / count);
        let expected = 4.0 + 1.0 / 12.0;
        assert!((squares / count - expected).abs() < 0.1, "variance {}", squares / count);
    }

    #[test]
    fn frames_and_rows_differ() {
        let noise = SensorNoise::new(3, 64, 2.0);
        let working = [100 * STEPS_PER_LEVEL; 64];
        let developed = |frame, row| {
            let mut pixels = [0; 64];
            noise.develop(frame, row, &working, &mut pixels);
            pixels
        };
        assert_ne!(developed(1, 5), developed(2, 5));
        assert_ne!(developed(1, 5), developed(1, 6));
        assert_eq!(developed(1, 5), developed(1, 5));
    }

    #[test]
    fn smooth_noise_is_bounded_and_continuous() {
        for i in 0..1000 {
            let x = f64::from(i) * 0.0137 - 5.0;
            let here = smooth_noise(9, x, 0.3 * x);
            let near = smooth_noise(9, x + 1e-6, 0.3 * x);
            assert!(here.abs() <= 1.0 && (here - near).abs() < 1e-5, "at {x}: {here}, {near}");
        }
    }
}

//! Normal distribution (density, cumulative function, quantiles) and a seeded generator that is fast enough for the
//! noise of whole image sequences.

use std::sync::LazyLock;

pub fn density(z: f64) -> f64 {
    const INVERSE_ROOT_TWO_PI: f64 = 0.398_942_280_401_432_7;
    INVERSE_ROOT_TWO_PI * (-0.5 * z * z).exp()
}

/// Cumulative function of the standard normal distribution, to about 1e-15.
///
/// Φ(z) = 1/2 + φ(z) (z + z³/3 + z⁵/(3·5) + …). All terms have one sign, so nothing cancels. Beyond |z| = 8.3 it
/// returns 0 or 1.
pub fn cumulative(z: f64) -> f64 {
    if z.abs() > 8.3 {
        return if z < 0.0 { 0.0 } else { 1.0 };
    }
    let (mut term, mut sum, mut odd) = (z, z, 1.0);
    while term.abs() > 1e-17 * sum.abs() {
        odd += 2.0;
        term *= z * z / odd;
        sum += term;
    }
    0.5 + density(z) * sum
}

/// Integral of [`cumulative`] from -∞ to z.
pub fn cumulative_integral(z: f64) -> f64 {
    z * cumulative(z) + density(z)
}

/// Quantiles at (i + 1/2) / 65536, which map 16 random bits to normal deviates within ±4.3.
static QUANTILES: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let mut z: f64 = -4.4;
    (0..1u32 << 16)
        .map(|i| {
            let wanted = (f64::from(i) + 0.5) / 65_536.0;
            for _ in 0..60 {
                // Newton may overshoot where Φ is convex, so steps are limited to 1/2.
                let step = ((cumulative(z) - wanted) / density(z)).clamp(-0.5, 0.5);
                z -= step;
                if step.abs() < 1e-10 {
                    break;
                }
            }
            z as f32
        })
        .collect()
});

/// A seeded stream of random numbers (SplitMix64: Steele, Lea, Flood 2014).
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
    bits: u64,
    left: u32,
}

impl Random {
    /// `stream` separates the parts of one world: the same seed with another stream gives independent numbers.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut random = Self { state: seed, bits: 0, left: 0 };
        random.state = random.next_u64() ^ stream.wrapping_mul(0xd134_2543_de82_ef95);
        random
    }

    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.next_u64() >> 11) as f64 / (1u64 << 53) as f64)
    }

    /// Standard normal deviate from 16 bits; its quantiles are exact to 1/131072.
    pub fn normal(&mut self) -> f32 {
        if self.left == 0 {
            self.bits = self.next_u64();
            self.left = 4;
        }
        let deviate = QUANTILES[(self.bits & 0xffff) as usize];
        self.bits >>= 16;
        self.left -= 1;
        deviate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cumulative_matches_tables() {
        // Abramowitz and Stegun, table 26.1.
        for (z, expected) in [
            (0.0, 0.5),
            (0.5, 0.691_462_461_274_013),
            (1.0, 0.841_344_746_068_543),
            (2.0, 0.977_249_868_051_821),
            (3.0, 0.998_650_101_968_370),
            (-4.0, 0.000_031_671_241_833),
        ] {
            assert!((cumulative(z) - expected).abs() < 1e-14, "{z}");
        }
        assert_eq!((cumulative(-40.0), cumulative(40.0)), (0.0, 1.0));
    }

    #[test]
    fn cumulative_integral_has_the_cumulative_as_slope() {
        for z in [-3.0, -0.7, 0.0, 1.9] {
            let slope = (cumulative_integral(z + 1e-4) - cumulative_integral(z - 1e-4)) / 2e-4;
            assert!((slope - cumulative(z)).abs() < 1e-8);
        }
    }

    #[test]
    fn deviates_have_the_moments_of_the_normal_distribution() {
        let mut random = Random::new(7, 1);
        let count = 1_000_000;
        let (mut mean, mut square, mut fourth, mut lag) = (0.0, 0.0, 0.0, 0.0);
        let mut last = 0.0;
        for _ in 0..count {
            let z = f64::from(random.normal());
            mean += z;
            square += z * z;
            fourth += z.powi(4);
            lag += z * last;
            last = z;
        }
        let n = f64::from(count);
        assert!((mean / n).abs() < 0.004);
        assert!((square / n - 1.0).abs() < 0.006);
        assert!((fourth / n - 3.0).abs() < 0.05);
        assert!((lag / n).abs() < 0.004);
    }

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let (mut one, mut two) = (Random::new(3, 0), Random::new(3, 1));
        let first = one.next_u64();
        assert_ne!(first, two.next_u64());
        assert_eq!(first, Random::new(3, 0).next_u64());
    }
}

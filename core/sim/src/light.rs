//! Brightness over the arena and over the image.

use super::{noise::mix, params::ScenarioParams};

/// Vignetting: share of the light that reaches the image along a ray (x, y, 1).
pub(super) fn falloff(x: f64, y: f64) -> f64 {
    1.0 / (1.0 + 0.16 * (x * x + y * y))
}

/// Light over the arena: a gradient and the pools of a few lamps.
#[derive(Clone, Debug)]
pub(super) struct Light {
    level: f64,
    slope_per_m: [f64; 2],
    lamps_m: [[f64; 2]; 3],
}

/// Share of the level that a lamp adds at its centre, and radius of its pool.
const LAMP_SHARE: f64 = 0.08;
const LAMP_RADIUS_M: f64 = 1.6;

impl Light {
    pub fn new(params: &ScenarioParams) -> Self {
        let unit =
            |number: u64| (mix(params.seed ^ 0x11, number) >> 11) as f64 / (1u64 << 53) as f64;
        let direction_rad = std::f64::consts::TAU * unit(0);
        let half = params.arena_m.map(|side| side / 2.0);
        let share = params.image.light_gradient / (half[0].hypot(half[1]));
        let (sine, cosine) = direction_rad.sin_cos();
        let lamp =
            |i: u64| [0, 1].map(|axis| half[axis as usize] * (2.0 * unit(2 * i + axis) - 1.0));
        Self {
            level: params.image.light,
            slope_per_m: [share * cosine, share * sine],
            lamps_m: [lamp(1), lamp(2), lamp(3)],
        }
    }

    /// Level of a white, horizontal sheet at this position in the middle of an image, as a share of full scale.
    pub fn at(&self, x_m: f64, y_m: f64) -> f64 {
        let slope = 1.0 + self.slope_per_m[0] * x_m + self.slope_per_m[1] * y_m;
        let pool = |lamp: &[f64; 2]| {
            let squared = (x_m - lamp[0]).powi(2) + (y_m - lamp[1]).powi(2);
            (-squared / (2.0 * LAMP_RADIUS_M * LAMP_RADIUS_M)).exp()
        };
        let lamps: f64 = self.lamps_m.iter().map(pool).sum();
        // Outside of the arena the slope must stay positive.
        self.level * (slope.max(0.2) + LAMP_SHARE * (lamps - 0.5))
    }
}

//! The scale of a map's colours, and round numbers for its marks.

use super::{picture::Show, report::PlanMap};

/// Colours of the scale, from the best to the worst: those of viridis, from its light end on.
const COLOURS: [[f64; 3]; 5] = [
    [253.0, 231.0, 37.0],
    [94.0, 201.0, 98.0],
    [33.0, 145.0, 140.0],
    [59.0, 82.0, 139.0],
    [68.0, 1.0, 84.0],
];
/// Steps of the scale: neighbours of one colour become one area.
const SHADES: f64 = 48.0;

/// Where a value lies between the best (0) and the worst (1), and what stands at the scale's marks.
pub(super) struct Scale {
    best: f64,
    worst: f64,
    is_log: bool,
}

impl Scale {
    pub(super) fn of(map: &PlanMap, show: Show) -> Self {
        match show {
            Show::Cameras => {
                let most = map.cameras.iter().copied().max().unwrap_or(1).max(2);
                Self { best: most as f64, worst: 1.0, is_log: false }
            }
            Show::Precision => {
                let mut all: Vec<f64> = map.deviation_m.iter().flatten().copied().collect();
                all.sort_by(f64::total_cmp);
                let at = |share: f64| {
                    let last = all.len().saturating_sub(1) as f64;
                    all.get((share * last).round() as usize).copied().unwrap_or(1e-3)
                };
                let (best, worst) = (at(0.01), at(0.99));
                Self { best, worst: worst.max(best * 1.5), is_log: true }
            }
        }
    }

    pub(super) fn value(&self, share: f64) -> f64 {
        if self.is_log {
            self.best * (self.worst / self.best).powf(share)
        } else {
            self.best + share * (self.worst - self.best)
        }
    }

    pub(super) fn colour(&self, value: f64) -> [u8; 3] {
        let share = if self.is_log {
            (value / self.best).ln() / (self.worst / self.best).ln()
        } else {
            (value - self.best) / (self.worst - self.best)
        };
        let share = (share.clamp(0.0, 1.0) * SHADES).round() / SHADES;
        let place = share * (COLOURS.len() - 1) as f64;
        let from = (place as usize).min(COLOURS.len() - 2);
        let part = place - from as f64;
        [0, 1, 2].map(|channel| {
            let (one, other) = (COLOURS[from][channel], COLOURS[from + 1][channel]);
            (one + part * (other - one)).round() as u8
        })
    }
}

/// 1, 2 or 5 times a power of ten, not below this.
pub(super) fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|digit| digit * power)
        .find(|step| *step >= least)
        .unwrap_or(10.0 * power)
}

/// Two significant digits.
pub(super) fn significant(value: f64) -> f64 {
    if value == 0.0 {
        return 0.0;
    }
    let unit = 10f64.powf(value.abs().log10().floor() - 1.0);
    let digits = (value / unit).round();
    if unit < 1.0 { digits / (1.0 / unit).round() } else { digits * unit }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_round() {
        assert!((round_step(0.13) - 0.2).abs() < 1e-12);
        assert!((round_step(7.0) - 10.0).abs() < 1e-12);
        assert!((significant(0.123_4) - 0.12).abs() < 1e-12);
        assert!((significant(1234.0) - 1200.0).abs() < 1e-9);
    }
}

//! The colour scale of a map.

use super::plan_map::{MapLayer, PlanMap};

/// Colours from the best to the worst value: viridis, reversed.
const COLOURS: [[f64; 3]; 5] = [
    [253.0, 231.0, 37.0],
    [94.0, 201.0, 98.0],
    [33.0, 145.0, 140.0],
    [59.0, 82.0, 139.0],
    [68.0, 1.0, 84.0],
];
/// Number of distinct colours. Adjacent spots of one colour are drawn as one area, so few colours keep files small.
const SHADES: f64 = 48.0;

/// Quantiles of the deviations at which a precision scale has its marks.
const QUANTILES: [f64; 5] = [0.01, 0.25, 0.5, 0.75, 0.99];
/// Minimum ratio of successive marks of a precision scale, so that negligible differences do not look large.
const MIN_FACTOR: f64 = 1.1;
/// Maximum number of intervals between the marks of a count scale.
const MAX_STEPS: usize = 5;

/// Maps values to colours. Marks are evenly spaced along the scale, from the best value to the worst.
///
/// On a precision scale the marks are quantiles, and the colour between two marks depends on the logarithm of the deviation.
/// On a linear scale, a few distant spots with large errors would take most of the colours.
pub(super) struct ColorScale {
    pub(super) marks: Vec<Mark>,
}

/// A labelled value of the scale.
pub(super) struct Mark {
    /// Increases from the best value to the worst: the negative count, or the logarithm of the deviation.
    position: f64,
    pub(super) label: String,
}

impl ColorScale {
    pub(super) fn of(map: &PlanMap, show: MapLayer) -> Self {
        let marks = match show {
            MapLayer::Cameras => counts(map.cameras.iter().copied().max().unwrap_or(1).max(2)),
            MapLayer::Precision => quantiles(map.deviation_m.iter().flatten().copied().collect()),
        };
        Self { marks }
    }

    pub(super) fn of_count(&self, cameras: usize) -> [u8; 3] {
        self.colour(-(cameras as f64))
    }

    pub(super) fn of_deviation(&self, deviation_m: f64) -> [u8; 3] {
        self.colour(deviation_m.ln())
    }

    fn colour(&self, position: f64) -> [u8; 3] {
        let intervals = self.marks.len() - 1;
        let interval = self.marks[1..intervals].partition_point(|mark| mark.position <= position);
        let [from, to] = [interval, interval + 1].map(|index| self.marks[index].position);
        color_at((interval as f64 + (position - from) / (to - from)) / intervals as f64)
    }
}

/// The colour at a share of the scale: 0 is the best value, 1 the worst.
pub(super) fn color_at(share: f64) -> [u8; 3] {
    let share = (share.clamp(0.0, 1.0) * SHADES).round() / SHADES;
    let place = share * (COLOURS.len() - 1) as f64;
    let from = (place as usize).min(COLOURS.len() - 2);
    let part = place - from as f64;
    [0, 1, 2].map(|channel| {
        let (one, other) = (COLOURS[from][channel], COLOURS[from + 1][channel]);
        (one + part * (other - one)).round() as u8
    })
}

/// Marks from `max` down to 1.
fn counts(max: usize) -> Vec<Mark> {
    let step = (max - 1).div_ceil(MAX_STEPS);
    let values = (2..=max).rev().step_by(step).chain([1]);
    values.map(|count| Mark { position: -(count as f64), label: count.to_string() }).collect()
}

/// Marks at quantiles of deviations in metres.
fn quantiles(mut all: Vec<f64>) -> Vec<Mark> {
    all.sort_by(f64::total_cmp);
    let mut values = QUANTILES.map(|share| {
        let last = all.len().saturating_sub(1) as f64;
        all.get((share * last).round() as usize).copied().unwrap_or(1e-3)
    });
    let middle = values.len() / 2;
    for place in middle + 1..values.len() {
        values[place] = values[place].max(values[place - 1] * MIN_FACTOR);
    }
    for place in (0..middle).rev() {
        values[place] = values[place].min(values[place + 1] / MIN_FACTOR);
    }
    let mark = |value: f64| {
        let better = all.partition_point(|&one| one < value) as f64 / all.len().max(1) as f64;
        let label = format!("{} mm {:.0} %", two_digits(value * 1e3), better * 100.0);
        Mark { position: value.ln(), label }
    };
    values.map(mark).into()
}

fn two_digits(value: f64) -> f64 {
    format!("{value:.1e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distance of the colours of two values along the scale, 0 to 1.
    fn apart(scale: &ColorScale, one: f64, other: f64) -> f64 {
        let place = |value: f64| {
            let shades = (0..=SHADES as usize).map(|shade| shade as f64 / SHADES);
            shades.into_iter().find(|&share| color_at(share) == scale.of_deviation(value)).unwrap()
        };
        place(other) - place(one)
    }

    #[test]
    fn a_few_distant_spots_do_not_compress_the_other_colours() {
        let near = (0..95).map(|spot| 1e-3 * (1.0 + f64::from(spot) / 95.0));
        let far = [0.05, 0.1, 0.2, 0.4, 0.8];
        let scale = ColorScale { marks: quantiles(near.chain(far).collect()) };
        assert!(apart(&scale, 1.05e-3, 1.9e-3) > 0.6);
        assert!(apart(&scale, 1.9e-3, 0.4) > 0.15);
        let texts: Vec<&str> = scale.marks.iter().map(|mark| mark.label.as_str()).collect();
        assert_eq!(texts, ["1 mm 1 %", "1.3 mm 25 %", "1.5 mm 50 %", "1.8 mm 74 %", "400 mm 98 %"]);
        // Nearly equal deviations get nearly equal colours.
        let even = (0..100).map(|spot| 1e-3 * (1.0 + 1e-4 * f64::from(spot)));
        let scale = ColorScale { marks: quantiles(even.collect()) };
        assert!(apart(&scale, 1.0e-3, 1.01e-3).abs() < 0.05);
        assert_eq!(scale.marks[0].label, "0.83 mm 0 %");
    }

    #[test]
    fn marks_of_counts_are_whole_numbers() {
        for (most, expected) in
            [(2, "2 1"), (3, "3 2 1"), (6, "6 5 4 3 2 1"), (9, "9 7 5 3 1"), (16, "16 13 10 7 4 1")]
        {
            let texts: Vec<String> = counts(most).into_iter().map(|mark| mark.label).collect();
            assert_eq!(texts.join(" "), expected);
        }
        let scale = ColorScale { marks: counts(9) };
        assert_eq!([9, 5, 1].map(|count| scale.of_count(count)), [0.0, 0.5, 1.0].map(color_at));
    }
}

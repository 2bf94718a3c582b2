//! The scale of a map's colours, and round numbers for its values.

use super::plan_map::{MapLayer, PlanMap};

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

/// Shares of the seen spots that are better than each mark of a scale of precision.
const QUANTILES: [f64; 5] = [0.01, 0.25, 0.5, 0.75, 0.99];
/// From one mark to the next precision is worse by this factor at least, or what nobody could measure would look like much.
const MIN_FACTOR: f64 = 1.1;
/// Most steps between marks of a scale of counts.
const MAX_STEPS: usize = 5;

/// Colours between marks, which stand evenly along the scale, from the best value to the worst.
///
/// Marks of precision are quantiles, and colours go with the logarithm from one to the next: some far places with many
/// times the error of all others would take the colours from them else.
pub(super) struct ColorScale {
    marks: Vec<Mark>,
    show: MapLayer,
}

/// A value that has its place along the scale.
pub(super) struct Mark {
    value: f64,
    /// What stands beside it.
    pub(super) text: String,
}

impl ColorScale {
    pub(super) fn of(map: &PlanMap, show: MapLayer) -> Self {
        let marks = match show {
            MapLayer::Cameras => counts(map.cameras.iter().copied().max().unwrap_or(1).max(2)),
            MapLayer::Precision => quantiles(map.deviation_m.iter().flatten().copied().collect()),
        };
        Self { marks, show }
    }

    pub(super) fn marks(&self) -> &[Mark] {
        &self.marks
    }

    pub(super) fn colour(&self, value: f64) -> [u8; 3] {
        // Grows from the best to the worst.
        let along = |value: f64| match self.show {
            MapLayer::Cameras => -value,
            MapLayer::Precision => value.ln(),
        };
        let (at, steps) = (along(value), self.marks.len() - 1);
        let before = self.marks[1..steps].partition_point(|mark| along(mark.value) <= at);
        let [from, to] = [before, before + 1].map(|place| along(self.marks[place].value));
        color_at((before as f64 + (at - from) / (to - from)) / steps as f64)
    }
}

/// The colour at a share of the way from the best to the worst.
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

/// From the most to one.
fn counts(most: usize) -> Vec<Mark> {
    let step = (most - 1).div_ceil(MAX_STEPS);
    let values = (2..=most).rev().step_by(step).chain([1]);
    values.map(|count| Mark { value: count as f64, text: count.to_string() }).collect()
}

/// Of deviations, metres.
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
        Mark { value, text: format!("{} mm {:.0} %", significant(value * 1e3), better * 100.0) }
    };
    values.map(mark).into()
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

    /// How far apart the colours of two values are, of at most 1 (from end to end of all colours).
    fn apart(scale: &ColorScale, one: f64, other: f64) -> f64 {
        let place = |value: f64| {
            let shades = (0..=SHADES as usize).map(|shade| shade as f64 / SHADES);
            shades.into_iter().find(|&share| color_at(share) == scale.colour(value)).unwrap()
        };
        place(other) - place(one)
    }

    #[test]
    fn some_far_places_leave_the_others_their_colours() {
        let near = (0..95).map(|spot| 1e-3 * (1.0 + f64::from(spot) / 95.0));
        let far = [0.05, 0.1, 0.2, 0.4, 0.8];
        let scale =
            ColorScale { marks: quantiles(near.chain(far).collect()), show: MapLayer::Precision };
        assert!(apart(&scale, 1.05e-3, 1.9e-3) > 0.6);
        assert!(apart(&scale, 1.9e-3, 0.4) > 0.15);
        let texts: Vec<&str> = scale.marks().iter().map(|mark| mark.text.as_str()).collect();
        assert_eq!(texts, ["1 mm 1 %", "1.3 mm 25 %", "1.5 mm 50 %", "1.8 mm 74 %", "400 mm 98 %"]);
        // What is nearly the same looks nearly the same.
        let even = (0..100).map(|spot| 1e-3 * (1.0 + 1e-4 * f64::from(spot)));
        let scale = ColorScale { marks: quantiles(even.collect()), show: MapLayer::Precision };
        assert!(apart(&scale, 1.0e-3, 1.01e-3).abs() < 0.05);
        assert_eq!(scale.marks()[0].text, "0.83 mm 0 %");
    }

    #[test]
    fn counts_of_cameras_stand_at_whole_numbers() {
        for (most, expected) in
            [(2, "2 1"), (3, "3 2 1"), (6, "6 5 4 3 2 1"), (9, "9 7 5 3 1"), (16, "16 13 10 7 4 1")]
        {
            let texts: Vec<String> = counts(most).into_iter().map(|mark| mark.text).collect();
            assert_eq!(texts.join(" "), expected);
        }
        let scale = ColorScale { marks: counts(9), show: MapLayer::Cameras };
        assert_eq!(
            [scale.colour(9.0), scale.colour(5.0), scale.colour(1.0)],
            [0.0, 0.5, 1.0].map(color_at)
        );
    }

    #[test]
    fn values_are_round() {
        assert!((significant(0.123_4) - 0.12).abs() < 1e-12);
        assert!((significant(1234.0) - 1200.0).abs() < 1e-9);
    }
}

//! Scenarios of fusion with many cameras: seeded worlds, scored against ground truth.
//!
//! `cargo run --release -p roundel-tests -- scenarios` runs all and prints one table. A row has the scenario, its
//! bar, the measurements (in bold if they miss the bar), the shares of position, velocity and orientation inside
//! their 95 % ellipsoids, and whether the bar holds. The last row checks the shares: they must lie within [`BAND`] in
//! every scenario.
//!
//! | names | content | module |
//! | --- | --- | --- |
//! | `alone`, `late` | 64 objects, 8 cameras, in order and late: identities and speed | [`swarm`] |
//! | `r16` | 200 coded objects, 16 cameras: speed | [`swarm`] |
//! | `r4` | 24 coded robots in R4 | [`swarm`] |
//! | `static`, `walking`, `driving` | R4 from rendered frames | [`pixels`] |
//! | `plane` | ground robots under one camera: homography or the plane in the filter | [`plane`] |
//! | `clocks` | clocks that are not synchronized | [`clocks`] |
//! | `crossing` | plain roundels that pass each other, occluded, for ten minutes | [`crossing`] |
//! | `drone`, `docking` | moving cameras, and cameras that localize by landmarks | [`moving`] |
//! | `twice`, `overdue`, … | faulty streams | [`fault`] |
//!
//! All run in virtual time on the calling thread, except for rendering. Poses are scored as a server publishes them:
//! at the time of the tick, predicted over the frames' latency. Speeds count only the time in calls of fusion.

pub mod clocks;
pub mod crossing;
pub mod fault;
pub mod moving;
pub mod pixels;
pub mod plane;
pub mod run;
pub mod swarm;

use std::fmt::Write as _;

use crate::score::{CHI2_95_2, CHI2_95_3, Score};

/// Shares inside 95 % that count as consistent.
pub const BAND: std::ops::RangeInclusive<f64> = 0.92..=0.98;

/// Duration of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Length {
    /// For the table.
    Full,
    /// A few seconds, for tests.
    Short,
}

impl Length {
    /// The duration that applies.
    pub fn seconds(self, full: f64, short: f64) -> f64 {
        match self {
            Length::Full => full,
            Length::Short => short,
        }
    }
}

/// One measurement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// With its unit.
    pub text: String,
    /// Whether it meets its bar; true without a bar.
    pub holds: bool,
}

/// One row of the table.
#[derive(Clone, Debug, Default)]
pub struct Row {
    pub scenario: String,
    pub bar: &'static str,
    pub parts: Vec<Part>,
    /// `None` where consistency is not defined.
    pub score: Option<Score>,
}

impl Row {
    /// A row without measurements.
    pub fn new(scenario: impl Into<String>, bar: &'static str) -> Self {
        Self { scenario: scenario.into(), bar, ..Self::default() }
    }

    /// Adds a measurement with a bar.
    pub fn check(mut self, text: impl Into<String>, holds: bool) -> Self {
        self.parts.push(Part { text: text.into(), holds });
        self
    }

    /// Adds a measurement without a bar.
    pub fn note(self, text: impl Into<String>) -> Self {
        self.check(text, true)
    }

    /// Adds ids, swaps, strays and misses. Bars: one id per object, and none of the others.
    pub fn check_identities(self, objects: usize, score: &Score) -> Self {
        let Score { ids, swaps, strays, misses, wrong_codes, .. } = *score;
        let row = self
            .check(format!("{ids} ids for {objects}"), ids == objects)
            .check(format!("{swaps} swaps"), swaps == 0)
            .check(format!("{strays} strays"), strays == 0)
            .check(format!("{misses} misses"), misses == 0);
        if wrong_codes == 0 { row } else { row.check(format!("{wrong_codes} wrong codes"), false) }
    }

    /// Adds rms errors of position, in the plane and in height.
    pub fn note_errors(self, score: &Score) -> Self {
        self.note(format!(
            "rms {:.2} mm: {:.2} in the plane, {:.2} in height",
            score.position.rms() * 1e3,
            score.plane.rms() * 1e3,
            score.height.rms() * 1e3
        ))
    }

    /// Completes the row with its score, which has the shares for the consistency check.
    pub fn scored(self, score: Score) -> Self {
        Self { score: Some(score), ..self }
    }

    /// Whether all measurements meet their bars.
    pub fn holds(&self) -> bool {
        self.parts.iter().all(|part| part.holds)
    }

    /// Shares of position, velocity and orientation inside 95 %.
    pub fn shares(&self) -> Option<[f64; 3]> {
        self.score.as_ref().map(shares)
    }
}

/// Shares of position, velocity and orientation inside 95 %. Orientation is that of the normal where no yaw is
/// observed.
pub fn shares(score: &Score) -> [f64; 3] {
    let orientation = if score.rotation.count() > 0 {
        score.rotation.share_within(CHI2_95_3)
    } else {
        score.normal.share_within(CHI2_95_2)
    };
    let [position, velocity] =
        [&score.position, &score.velocity].map(|errors| errors.share_within(CHI2_95_3));
    [position, velocity, orientation]
}

/// Runs one scenario.
pub type Run = fn(Length) -> Vec<Row>;

/// Every scenario by its name, in the order of the table.
pub const ALL: [(&str, Run); 21] = [
    ("alone", swarm::alone),
    ("late", swarm::late),
    ("r16", swarm::r16),
    ("r4", swarm::r4),
    ("static", pixels::still),
    ("walking", pixels::walking),
    ("driving", pixels::driving),
    ("plane", plane::plane),
    ("clocks", clocks::unset),
    ("crossing", crossing::crossing),
    ("drone", moving::drone),
    ("docking", moving::docking),
    ("twice", fault::twice),
    ("overdue", fault::overdue),
    ("reordered", fault::reordered),
    ("missing", fault::missing),
    ("stopped", fault::stopped),
    ("hour-ahead", fault::hour_ahead),
    ("hour-behind", fault::hour_behind),
    ("hour-for-good", fault::hour_for_good),
    ("everything", fault::everything),
];

/// The row that checks the shares of all rows. The table shows shares outside the band in bold.
pub fn consistency(rows: &[Row]) -> Row {
    let mut row = Row::new(
        "covariances of all the above",
        "95 % inside 95 %, give or take 3 points: position, velocity and orientation",
    );
    for (index, what) in ["positions", "velocities", "orientations"].into_iter().enumerate() {
        let shares: Vec<f64> =
            rows.iter().filter_map(Row::shares).map(|shares| shares[index]).collect();
        let inside = shares.iter().filter(|share| BAND.contains(share)).count();
        let min = shares.iter().copied().fold(1.0, f64::min) * 100.0;
        let max = shares.iter().copied().fold(0.0, f64::max) * 100.0;
        let text = format!("{what} {inside} of {}, {min:.1} to {max:.1} %", shares.len());
        row = row.check(text, inside == shares.len());
    }
    row
}

/// Rows as a markdown table.
pub fn table(rows: &[Row]) -> String {
    let mut text = String::from(
        "| scenario | bar | measured | inside 95 %: position, velocity, orientation | holds |\n\
         | --- | --- | --- | --- | --- |\n",
    );
    for row in rows {
        let parts: Vec<String> = row
            .parts
            .iter()
            .map(|part| if part.holds { part.text.clone() } else { format!("**{}**", part.text) })
            .collect();
        let share = |share: f64| {
            let text = format!("{:.1}", share * 100.0);
            if BAND.contains(&share) { text } else { format!("**{text}**") }
        };
        let shares = row.shares().map_or(String::new(), |shares| shares.map(share).join(", "));
        let verdict = if row.holds() { "yes" } else { "**no**" };
        let _ = writeln!(
            text,
            "| {} | {} | {} | {shares} | {verdict} |",
            row.scenario,
            row.bar,
            parts.join("; ")
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(inside: usize, outside: usize) -> Row {
        let mut score = Score::default();
        for errors in [&mut score.position, &mut score.velocity, &mut score.normal] {
            (0..inside).for_each(|_| errors.push(0.001, 1.0));
            (0..outside).for_each(|_| errors.push(0.01, 100.0));
        }
        Row::new("a", "b").note("c").scored(score)
    }

    #[test]
    fn misses_are_marked() {
        let bad = Row::new("slow", "fast").check("fast", false).note("seen");
        assert!(!bad.holds());
        let text = table(&[row(95, 5), bad, row(80, 20)]);
        let lines: Vec<&str> = text.lines().skip(2).collect();
        assert_eq!(lines[0], "| a | b | c | 95.0, 95.0, 95.0 | yes |");
        assert_eq!(lines[1], "| slow | fast | **fast**; seen |  | **no** |");
        assert_eq!(lines[2], "| a | b | c | **80.0**, **80.0**, **80.0** | yes |");
    }

    #[test]
    fn consistency_counts_shares_inside_the_band() {
        assert!(consistency(&[row(95, 5), row(93, 7)]).holds());
        let bad = consistency(&[row(95, 5), row(100, 0)]);
        assert!(!bad.holds());
        assert_eq!(bad.parts[0].text, "positions 1 of 2, 95.0 to 100.0 %");
    }
}

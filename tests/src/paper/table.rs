//! A table of the paper's figures and ours, as Markdown.

use std::fmt;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aim {
    /// Less is better: errors, times, smallest sizes.
    Less,
    /// More is better: distances.
    More,
    /// Shown for comparison only.
    Neither,
}

/// A ratio of measurement to prediction from which on the difference is mentioned.
const NEAR: f64 = 1.1;

/// One figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The quantity, with its unit.
    pub case: String,
    /// The paper's measurement.
    pub paper: Option<f64>,
    /// The paper's prediction.
    pub paper_model: Option<f64>,
    /// The sensor model's prediction for our measurement.
    pub model: Option<f64>,
    /// Our measurement, or `None` where there is none.
    pub here: Option<f64>,
    pub aim: Aim,
    /// Causes of differences.
    pub note: String,
    /// Reason for which it may be worse than the paper's. Without one it must not be worse.
    pub excuse: Option<&'static str>,
}

impl Row {
    /// A figure without any comparison.
    pub fn new(case: impl Into<String>, here: f64) -> Self {
        Self { here: Some(here), ..Self::absent(case) }
    }

    /// A figure that only the paper has.
    pub fn absent(case: impl Into<String>) -> Self {
        Self {
            case: case.into(),
            paper: None,
            paper_model: None,
            model: None,
            here: None,
            aim: Aim::Neither,
            note: String::new(),
            excuse: None,
        }
    }

    #[must_use]
    pub fn paper(self, paper: f64, aim: Aim) -> Self {
        Self { paper: Some(paper), aim, ..self }
    }

    #[must_use]
    pub fn paper_model(self, paper_model: f64) -> Self {
        Self { paper_model: Some(paper_model), ..self }
    }

    #[must_use]
    pub fn model(self, model: f64) -> Self {
        Self { model: Some(model), ..self }
    }

    #[must_use]
    pub fn note(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }

    #[must_use]
    pub fn excuse(self, excuse: &'static str) -> Self {
        Self { excuse: Some(excuse), ..self }
    }

    /// Improvement over the paper's measurement, if both are known; below 1 it is worse.
    pub fn factor(&self) -> Option<f64> {
        let (paper, here) = (self.paper?, self.here?);
        match self.aim {
            Aim::Less => Some(paper / here),
            Aim::More => Some(here / paper),
            Aim::Neither => None,
        }
    }

    /// Whether it is worse than the paper's, or unknown, without an excuse.
    pub fn is_unexcused(&self) -> bool {
        self.excuse.is_none() && self.factor().is_some_and(|factor| factor.is_nan() || factor < 1.0)
    }

    /// Whether every number in it is finite.
    pub fn is_finite(&self) -> bool {
        let all = [self.paper, self.paper_model, self.model, self.here];
        all.into_iter().flatten().all(f64::is_finite)
    }

    /// The sentence beside its figures: the deviation from the model, the excuse if it is worse than the paper's, and
    /// the causes of differences.
    pub fn why(&self) -> String {
        let ratio = self.model.zip(self.here).map(|(model, here)| here / model);
        let far = ratio.filter(|ratio| !(1.0 / NEAR..NEAR).contains(ratio));
        let deviation = far.map(|ratio| format!("{ratio:.2} times our model"));
        let is_worse = self.factor().is_some_and(|factor| factor < 1.0);
        let excuse = self.excuse.filter(|_| is_worse).map(|why| format!("worse: {why}"));
        let note = Some(self.note.clone()).filter(|note| !note.is_empty());
        [deviation, excuse, note].into_iter().flatten().collect::<Vec<_>>().join("; ")
    }
}

/// The figures of one experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    pub title: String,
    pub rows: Vec<Row>,
    /// The method, and the differences from the paper.
    pub remarks: Vec<String>,
    /// Rows that were skipped here, and why.
    pub skipped: Vec<String>,
}

/// Three significant digits, without trailing zeros after the decimal point.
fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let whole = value.abs().log10().floor() as i32 + 1;
    format!("{value:.*}", (3 - whole).clamp(0, 7) as usize)
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let optional = |value: Option<f64>| value.map_or("–".to_owned(), digits);
        writeln!(f, "## {}\n", self.title)?;
        for remark in &self.remarks {
            writeln!(f, "{remark}\n")?;
        }
        writeln!(f, "| | paper | its model | our model | here | better by | why |")?;
        writeln!(f, "| --- | ---: | ---: | ---: | ---: | ---: | --- |")?;
        for row in &self.rows {
            let [paper, paper_model, model] = [row.paper, row.paper_model, row.model].map(optional);
            let better = row.factor().map_or("–".to_owned(), |factor| format!("{factor:.2}"));
            let (case, here, why) = (&row.case, optional(row.here), row.why());
            writeln!(
                f,
                "| {case} | {paper} | {paper_model} | {model} | {here} | {better} | {why} |"
            )?;
        }
        for what in &self.skipped {
            writeln!(f, "\nskipped: {what}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_significant_digits() {
        let shown = [(0.012_34, "0.0123"), (1.0, "1.00"), (19.84, "19.8"), (1234.5, "1234")];
        for (value, text) in shown {
            assert_eq!(digits(value), text);
        }
    }

    #[test]
    fn improvement_follows_the_aim() {
        assert_eq!(Row::new("error", 1.0).paper(4.0, Aim::Less).factor(), Some(4.0));
        assert_eq!(Row::new("distance", 6.0).paper(4.0, Aim::More).factor(), Some(1.5));
        assert_eq!(Row::new("of another", 6.0).paper(4.0, Aim::Neither).factor(), None);
        assert!(!Row::new("none", f64::NAN).is_finite());
        assert_eq!(Row::absent("elsewhere").paper(4.0, Aim::Less).factor(), None);
    }

    #[test]
    fn worse_rows_need_an_excuse_and_deviations_are_reported() {
        let worse = Row::new("error", 5.0).paper(4.0, Aim::Less).note("noise");
        assert!(worse.is_unexcused());
        let excused = worse.excuse("a smaller lens");
        assert!(!excused.is_unexcused());
        assert_eq!(excused.clone().model(4.9).why(), "worse: a smaller lens; noise");
        assert_eq!(excused.model(2.0).why(), "2.50 times our model; worse: a smaller lens; noise");
        let better = Row::new("error", 3.0).paper(4.0, Aim::Less).excuse("a smaller lens");
        assert!(!better.is_unexcused() && better.why().is_empty());
        assert!(Row::new("error", f64::NAN).paper(4.0, Aim::Less).is_unexcused());
    }
}

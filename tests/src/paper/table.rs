//! A table of the paper's figures beside ours, as Markdown.

use std::fmt;

/// What counts as better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aim {
    /// Less: errors, times, smallest sizes.
    Less,
    /// More: distances.
    More,
    /// Neither: what is told for the sake of comparison.
    Neither,
}

/// What is measured is told to be off its prediction from this ratio on.
const NEAR: f64 = 1.1;

/// One figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Of what, with its unit.
    pub case: String,
    /// As the paper measured it.
    pub paper: Option<f64>,
    /// As the paper predicted it.
    pub paper_model: Option<f64>,
    /// As the sensor model predicts what is measured here.
    pub model: Option<f64>,
    /// As measured here; `None` where it cannot be.
    pub here: Option<f64>,
    /// What counts as better than the paper's measurement.
    pub aim: Aim,
    /// What makes it differ.
    pub note: String,
    /// What makes it worse than the paper's, if it is; without one it must not be.
    pub excuse: Option<&'static str>,
}

impl Row {
    /// A figure with nothing to compare yet.
    pub fn new(case: impl Into<String>, here: f64) -> Self {
        Self { here: Some(here), ..Self::absent(case) }
    }

    /// One that only the paper has.
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

    /// With the paper's measurement, and what counts as better than that.
    #[must_use]
    pub fn paper(self, paper: f64, aim: Aim) -> Self {
        Self { paper: Some(paper), aim, ..self }
    }

    /// With the paper's prediction.
    #[must_use]
    pub fn paper_model(self, paper_model: f64) -> Self {
        Self { paper_model: Some(paper_model), ..self }
    }

    /// With the model's prediction.
    #[must_use]
    pub fn model(self, model: f64) -> Self {
        Self { model: Some(model), ..self }
    }

    /// With what makes it differ.
    #[must_use]
    pub fn note(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }

    /// With what makes it worse than the paper's, should it be.
    #[must_use]
    pub fn excuse(self, excuse: &'static str) -> Self {
        Self { excuse: Some(excuse), ..self }
    }

    /// How many times better than the paper's measurement it is, where that can be said; below 1 it is worse.
    pub fn factor(&self) -> Option<f64> {
        let (paper, here) = (self.paper?, self.here?);
        match self.aim {
            Aim::Less => Some(paper / here),
            Aim::More => Some(here / paper),
            Aim::Neither => None,
        }
    }

    /// Whether it is worse than the paper's, or cannot be told, and nothing says why.
    pub fn is_unexcused(&self) -> bool {
        self.excuse.is_none() && self.factor().is_some_and(|factor| factor.is_nan() || factor < 1.0)
    }

    /// Whether every number in it is finite.
    pub fn is_finite(&self) -> bool {
        let all = [self.paper, self.paper_model, self.model, self.here];
        all.into_iter().flatten().all(f64::is_finite)
    }

    /// The sentence beside its figures: how far it is from the model, why it is worse than the paper's if it is, and
    /// what makes it differ.
    pub fn why(&self) -> String {
        let ratio = self.model.zip(self.here).map(|(model, here)| here / model);
        let far = ratio.filter(|ratio| !(1.0 / NEAR..NEAR).contains(ratio));
        let of_model = far.map(|ratio| format!("{ratio:.2} times our model"));
        let is_worse = self.factor().is_some_and(|factor| factor < 1.0);
        let excuse = self.excuse.filter(|_| is_worse).map(|why| format!("worse: {why}"));
        let note = Some(self.note.clone()).filter(|note| !note.is_empty());
        [of_model, excuse, note].into_iter().flatten().collect::<Vec<_>>().join("; ")
    }
}

/// The figures of one experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Which of the paper's, and of what.
    pub title: String,
    /// Figures.
    pub rows: Vec<Row>,
    /// How it was measured, and what makes it differ from the paper.
    pub remarks: Vec<String>,
    /// What was left out here, by name, and why.
    pub skipped: Vec<String>,
}

/// Three digits that count, none of them after a point that says nothing.
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
    fn digits_count() {
        let shown = [(0.012_34, "0.0123"), (1.0, "1.00"), (19.84, "19.8"), (1234.5, "1234")];
        for (value, text) in shown {
            assert_eq!(digits(value), text);
        }
    }

    #[test]
    fn better_is_less_or_more() {
        assert_eq!(Row::new("error", 1.0).paper(4.0, Aim::Less).factor(), Some(4.0));
        assert_eq!(Row::new("distance", 6.0).paper(4.0, Aim::More).factor(), Some(1.5));
        assert_eq!(Row::new("of another", 6.0).paper(4.0, Aim::Neither).factor(), None);
        assert!(!Row::new("none", f64::NAN).is_finite());
        assert_eq!(Row::absent("elsewhere").paper(4.0, Aim::Less).factor(), None);
    }

    #[test]
    fn what_is_worse_needs_an_excuse_and_what_is_off_the_model_is_told() {
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

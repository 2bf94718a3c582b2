//! Reads a TOML document key by key and collects every problem with its location, so that one run reports them all.

use std::{
    cell::{Cell, RefCell},
    ops::{Range, RangeInclusive},
};

use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use super::error::{Lines, Problem};
use crate::model::{
    redact::redact,
    suggestion::{did_you_mean, list, nearest},
};

/// Further problems are counted, but not listed.
const MAX_PROBLEMS: usize = 100;

/// The problems of one document.
pub(super) struct Problems<'s> {
    lines: Lines<'s>,
    found: RefCell<Vec<(usize, Problem)>>,
    /// Number of problems beyond [`MAX_PROBLEMS`].
    unlisted: Cell<usize>,
}

impl<'s> Problems<'s> {
    pub(super) fn new(source: &'s str) -> Self {
        Self { lines: Lines::of(source), found: RefCell::default(), unlisted: Cell::new(0) }
    }

    /// Whether further problems are not listed.
    pub(super) fn are_full(&self) -> bool {
        self.found.borrow().len() >= MAX_PROBLEMS
    }

    /// An empty `help` is omitted.
    pub(super) fn add(
        &self,
        span: &Range<usize>,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        if self.are_full() {
            self.unlisted.set(self.unlisted.get() + 1);
            return;
        }
        let place = Some(self.lines.locate(span));
        let help = Some(help.into()).filter(|help| !help.is_empty());
        let message = redact(&message.into());
        let problem = Problem { message, help, place };
        self.found.borrow_mut().push((span.start, problem));
    }

    pub(super) fn any(&self) -> bool {
        !self.found.borrow().is_empty()
    }

    /// The problems in the order of their locations, and how many there are besides.
    pub(super) fn into_sorted(self) -> Vec<Problem> {
        let mut found = self.found.into_inner();
        found.sort_by_key(|(start, _)| *start);
        let mut problems: Vec<Problem> = found.into_iter().map(|(_, problem)| problem).collect();
        if self.unlisted.get() > 0 {
            let message = format!("{} more problems are not listed", self.unlisted.get());
            let help = Some("correct those above first".to_owned());
            problems.push(Problem { message, help, place: None });
        }
        problems
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) enum NumberRange {
    /// Above 0, up to this.
    PositiveUpTo(f64),
    /// From 0 up to this.
    ZeroUpTo(f64),
    /// At most this, of either sign.
    Within(f64),
}

impl NumberRange {
    fn contains(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::PositiveUpTo(most) => value > 0.0 && value <= most,
                Self::ZeroUpTo(most) => (0.0..=most).contains(&value),
                Self::Within(most) => value.abs() <= most,
            }
    }

    fn describe(self) -> String {
        match self {
            Self::PositiveUpTo(most) => format!("a number above 0, at most {most}"),
            Self::ZeroUpTo(most) => format!("a number from 0 to {most}"),
            Self::Within(most) => format!("a number from -{most} to {most}"),
        }
    }
}

/// One table of the document, with a fixed set of keys. Every method that returns `None` for a wrong value has reported
/// it.
pub(super) struct Table<'t, 'i> {
    /// As written in the file: `[server]`, `[[camera]]`.
    title: &'static str,
    span: Range<usize>,
    /// `None`: the table is absent.
    entries: Option<&'t DeTable<'i>>,
    problems: &'t Problems<'t>,
    /// Known keys for which unknown ones were probably mistyped; they are not reported as missing.
    suspected: RefCell<Vec<&'static str>>,
    broken: Cell<bool>,
}

impl<'t, 'i> Table<'t, 'i> {
    /// Reports unknown keys.
    pub(super) fn new(
        title: &'static str,
        span: Range<usize>,
        entries: Option<&'t DeTable<'i>>,
        known: &[&'static str],
        problems: &'t Problems<'t>,
    ) -> Self {
        let (suspected, broken) = Default::default();
        let table = Self { title, span, entries, problems, suspected, broken };
        for key in entries.into_iter().flat_map(|entries| entries.keys()) {
            let name: &str = key.get_ref();
            if known.contains(&name) {
                continue;
            }
            let place = if title.is_empty() { String::new() } else { format!(" in {title}") };
            let mut message = format!("unknown key `{name}`{place}");
            if let Some(meant) = nearest(name, known.iter().copied()) {
                message.push_str(&format!("; did you mean `{meant}`?"));
                table.suspected.borrow_mut().push(meant);
            }
            let help = format!("known keys here: {}", list(known.iter().copied()));
            table.fail_at(&key.span(), message, help);
        }
        table
    }

    pub(super) fn fail_at(
        &self,
        span: &Range<usize>,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.broken.set(true);
        self.problems.add(span, message, help);
    }

    /// Reports a problem at the value of `key`, or at the table if that is absent. An empty `help` is omitted.
    pub(super) fn fail(&self, key: &str, message: impl Into<String>, help: impl Into<String>) {
        let span = self.value(key).map_or_else(|| self.span.clone(), Spanned::span);
        self.fail_at(&span, message, help);
    }

    /// [`Self::fail`] that returns `None`.
    pub(super) fn reject<T>(
        &self,
        key: &str,
        message: impl Into<String>,
        help: impl Into<String>,
    ) -> Option<T> {
        self.fail(key, message, help);
        None
    }

    /// Whether a further problem would not be listed, so that its text need not be made.
    pub(super) fn is_full(&self) -> bool {
        self.problems.are_full()
    }

    /// Whether this table has had a problem so far.
    pub(super) fn is_broken(&self) -> bool {
        self.broken.get()
    }

    pub(super) fn value(&self, key: &str) -> Option<&'t Spanned<DeValue<'i>>> {
        self.entries?.iter().find(|(name, _)| name.get_ref() == key).map(|(_, value)| value)
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    /// Reports an absent key, unless an unknown key was probably meant to be it.
    pub(super) fn require(&self, key: &'static str, example: &str) {
        if self.has(key) || self.suspected.borrow().contains(&key) {
            return;
        }
        let place = if self.title.is_empty() { "the file" } else { self.title };
        let message = format!("missing key `{key}` in {place}");
        self.fail_at(&self.span, message, format!("add `{key} = {example}`"));
    }

    fn reject_type<T>(&self, key: &str, value: &Spanned<DeValue<'_>>, expected: &str) -> Option<T> {
        let message = format!("`{key}` must be {expected}, found {}", found(value.get_ref()));
        self.fail_at(&value.span(), message, "");
        None
    }

    /// A text that is not empty; `None` if absent or wrong.
    pub(super) fn text(&self, key: &'static str) -> Option<&'t str> {
        let value = self.value(key)?;
        match value.get_ref() {
            DeValue::String(text) if !text.trim().is_empty() => Some(text),
            _ => self.reject_type(key, value, "a text in quotes that is not empty"),
        }
    }

    pub(super) fn required_text(&self, key: &'static str, example: &str) -> Option<&'t str> {
        self.require(key, example);
        self.text(key)
    }

    /// A number; the default if absent or wrong.
    pub(super) fn number(&self, key: &'static str, allowed: NumberRange, default: f64) -> f64 {
        self.optional_number(key, allowed).unwrap_or(default)
    }

    /// A number; `None` if absent or wrong.
    pub(super) fn optional_number(&self, key: &'static str, allowed: NumberRange) -> Option<f64> {
        let value = self.value(key)?;
        let read = number(value.get_ref()).filter(|read| allowed.contains(*read));
        read.or_else(|| self.reject_type(key, value, &allowed.describe()))
    }

    pub(super) fn required_number(
        &self,
        key: &'static str,
        allowed: NumberRange,
        example: &str,
    ) -> Option<f64> {
        self.require(key, example);
        self.optional_number(key, allowed)
    }

    /// A whole number; `None` if absent or wrong.
    pub(super) fn whole(&self, key: &'static str, range: RangeInclusive<usize>) -> Option<usize> {
        let value = self.value(key)?;
        let (least, most) = (*range.start(), *range.end());
        let whole = number(value.get_ref()).filter(|_| value.get_ref().is_integer());
        let whole = whole.filter(|whole| (least as f64..=most as f64).contains(whole));
        let expected = || format!("a whole number from {least} to {most}");
        whole.map(|whole| whole as usize).or_else(|| self.reject_type(key, value, &expected()))
    }

    /// A flag; `None` if absent or wrong.
    pub(super) fn flag(&self, key: &'static str) -> Option<bool> {
        let value = self.value(key)?;
        value.get_ref().as_bool().or_else(|| self.reject_type(key, value, "true or false"))
    }

    /// The meaning of one of the known words; `None` if absent or wrong.
    pub(super) fn choice<T: Copy>(&self, key: &'static str, known: &[(&str, T)]) -> Option<T> {
        let value = self.value(key)?;
        let text = value.get_ref().as_str();
        if let Some((_, meaning)) = known.iter().find(|(word, _)| text == Some(word)) {
            return Some(*meaning);
        }
        let words = known.iter().map(|(word, _)| *word);
        let quoted: Vec<String> = words.clone().map(|word| format!("\"{word}\"")).collect();
        let (expected, found) = (quoted.join(" or "), found(value.get_ref()));
        let meant = text.map(|text| did_you_mean(text, words)).unwrap_or_default();
        self.reject(key, format!("`{key}` must be {expected}, found {found}{meant}"), "")
    }

    /// A list of texts; `None` if absent or wrong.
    pub(super) fn texts(&self, key: &'static str, expected: &str) -> Option<Vec<String>> {
        let value = self.value(key)?;
        let items = value.get_ref().as_array().map(|items| items.iter());
        let text = |item: &Spanned<DeValue<'_>>| item.get_ref().as_str().map(str::to_owned);
        let texts: Option<Vec<String>> = items.and_then(|items| items.map(text).collect());
        texts.or_else(|| self.reject_type(key, value, expected))
    }

    /// `N` finite numbers; `None` if absent or wrong.
    pub(super) fn numbers<const N: usize>(&self, key: &'static str) -> Option<[f64; N]> {
        let value = self.value(key)?;
        let expected = format!("a list of {N} finite numbers");
        let Some(items) = value.get_ref().as_array() else {
            return self.reject_type(key, value, &expected);
        };
        if items.len() != N {
            let message = format!("`{key}` must be {expected}, found {} of them", items.len());
            return self.reject(key, message, "");
        }
        let read = items.iter().filter_map(|item| number(item.get_ref()));
        let read: Vec<f64> = read.filter(|number| number.is_finite()).collect();
        read.try_into().ok().or_else(|| self.reject_type(key, value, &expected))
    }

    pub(super) fn required_numbers<const N: usize>(
        &self,
        key: &'static str,
        example: &str,
    ) -> Option<[f64; N]> {
        self.require(key, example);
        self.numbers(key)
    }

    /// The table under a key; `None` if absent or wrong.
    pub(super) fn table(
        &self,
        key: &'static str,
        title: &'static str,
        known: &[&'static str],
    ) -> Option<Table<'t, 'i>> {
        let value = self.value(key)?;
        let Some(entries) = value.get_ref().as_table() else {
            let expected = format!("a table: write `{title}` above its keys");
            return self.reject_type(key, value, &expected);
        };
        Some(Table::new(title, value.span(), Some(entries), known, self.problems))
    }

    /// The table under a key; an empty one if absent or wrong.
    pub(super) fn section(
        &self,
        key: &'static str,
        title: &'static str,
        known: &[&'static str],
    ) -> Table<'t, 'i> {
        let absent = || Table::new(title, self.span.clone(), None, known, self.problems);
        self.table(key, title, known).unwrap_or_else(absent)
    }

    /// The list of tables under a key; empty if absent or wrong.
    pub(super) fn tables(
        &self,
        key: &'static str,
        title: &'static str,
        known: &[&'static str],
    ) -> Vec<Table<'t, 'i>> {
        let Some(value) = self.value(key) else { return Vec::new() };
        let expected = format!("a list of tables: write `{title}` above each one's keys");
        let Some(items) = value.get_ref().as_array() else {
            return self.reject_type(key, value, &expected).unwrap_or_default();
        };
        let table = |item: &'t Spanned<DeValue<'i>>| match item.get_ref().as_table() {
            Some(entries) => {
                Some(Table::new(title, item.span(), Some(entries), known, self.problems))
            }
            None => self.reject_type(key, item, &expected),
        };
        items.iter().filter_map(table).collect()
    }
}

pub(super) fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|whole| whole as f64)
        }
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

pub(super) fn found(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(text) => format!("the text \"{text}\""),
        DeValue::Integer(integer) => integer.as_str().to_owned(),
        DeValue::Float(float) => float.as_str().to_owned(),
        DeValue::Boolean(value) => value.to_string(),
        DeValue::Datetime(time) => format!("the date {time}"),
        DeValue::Array(items) => {
            if items.iter().all(|item| number(item.get_ref()).is_some()) {
                let items: Vec<String> = items.iter().map(|item| found(item.get_ref())).collect();
                format!("[{}]", items.join(", "))
            } else {
                "a list".to_owned()
            }
        }
        DeValue::Table(_) => "a table".to_owned(),
    }
}

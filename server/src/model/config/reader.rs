//! Reads a TOML document key by key and remembers every problem with its place, so that a person
//! sees all of them at once instead of one a run.

use std::{
    cell::{Cell, RefCell},
    ops::{Range, RangeInclusive},
};

use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use super::error::{Problem, TextLocation};
use crate::model::suggestion::{list, nearest};

/// Collects what is wrong with one document.
pub(super) struct Problems<'s> {
    source: &'s str,
    found: RefCell<Vec<(usize, Problem)>>,
}

impl<'s> Problems<'s> {
    pub(super) fn new(source: &'s str) -> Self {
        Self { source, found: RefCell::default() }
    }

    pub(super) fn add(&self, span: &Range<usize>, message: impl Into<String>) {
        self.push(span, message.into(), None);
    }

    pub(super) fn add_with_help(
        &self,
        span: &Range<usize>,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.push(span, message.into(), Some(help.into()));
    }

    fn push(&self, span: &Range<usize>, message: String, help: Option<String>) {
        let place = Some(TextLocation::of(self.source, span));
        self.found.borrow_mut().push((span.start, Problem { message, help, place }));
    }

    pub(super) fn any(&self) -> bool {
        !self.found.borrow().is_empty()
    }

    /// All problems in the order of their places.
    pub(super) fn into_sorted(self) -> Vec<Problem> {
        let mut found = self.found.into_inner();
        found.sort_by_key(|(start, _)| *start);
        found.into_iter().map(|(_, problem)| problem).collect()
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

/// One table of the document, of which only known keys may be used.
pub(super) struct Table<'t, 'i> {
    /// As people write it: `[server]`, `[[camera]]`.
    title: &'static str,
    span: Range<usize>,
    entries: &'t DeTable<'i>,
    problems: &'t Problems<'t>,
    /// Known keys that an unknown one was probably meant to be: these are not missed again.
    suspected: RefCell<Vec<&'static str>>,
    /// Whether a problem was found while reading this table.
    broken: Cell<bool>,
}

impl<'t, 'i> Table<'t, 'i> {
    /// A table, once its unknown keys are reported.
    pub(super) fn new(
        title: &'static str,
        span: Range<usize>,
        entries: &'t DeTable<'i>,
        known: &[&'static str],
        problems: &'t Problems<'t>,
    ) -> Self {
        let table = Self {
            title,
            span,
            entries,
            problems,
            suspected: RefCell::default(),
            broken: Cell::new(false),
        };
        for key in entries.keys() {
            let name: &str = key.get_ref();
            if !known.contains(&name) {
                table.report_unknown(name, &key.span(), known);
            }
        }
        table
    }

    fn report_unknown(&self, name: &str, span: &Range<usize>, known: &[&'static str]) {
        let place =
            if self.title.is_empty() { String::new() } else { format!(" in {}", self.title) };
        let mut message = format!("unknown key `{name}`{place}");
        if let Some(meant) = nearest(name, known.iter().copied()) {
            message.push_str(&format!("; did you mean `{meant}`?"));
            self.suspected.borrow_mut().push(meant);
        }
        self.fail_with_help(
            span,
            message,
            format!("known keys here: {}", list(known.iter().copied())),
        );
    }

    pub(super) fn span(&self) -> &Range<usize> {
        &self.span
    }

    pub(super) fn fail(&self, span: &Range<usize>, message: impl Into<String>) {
        self.broken.set(true);
        self.problems.add(span, message);
    }

    pub(super) fn fail_with_help(
        &self,
        span: &Range<usize>,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        self.broken.set(true);
        self.problems.add_with_help(span, message, help);
    }

    /// Whether this table had a problem so far.
    pub(super) fn is_broken(&self) -> bool {
        self.broken.get()
    }

    pub(super) fn value(&self, key: &str) -> Option<&'t Spanned<DeValue<'i>>> {
        self.entries.iter().find(|(name, _)| name.get_ref() == key).map(|(_, value)| value)
    }

    /// The value's place, or the table's if it is absent.
    pub(super) fn span_of(&self, key: &str) -> Range<usize> {
        self.value(key).map_or_else(|| self.span.clone(), Spanned::span)
    }

    /// Reports that a key is missing, unless a mistyped one probably was meant to be it.
    pub(super) fn report_missing(&self, key: &'static str, example: &str) {
        if self.suspected.borrow().contains(&key) {
            return;
        }
        let place =
            if self.title.is_empty() { "the file".to_owned() } else { self.title.to_owned() };
        self.fail_with_help(
            &self.span.clone(),
            format!("missing key `{key}` in {place}"),
            format!("add `{key} = {example}`"),
        );
    }

    fn report_type(&self, key: &str, value: &Spanned<DeValue<'_>>, expected: &str) {
        self.fail(
            &value.span(),
            format!("`{key}` must be {expected}, found {}", found(value.get_ref())),
        );
    }

    /// A text that is not empty; `None` if absent or wrong (then it is reported).
    pub(super) fn text(&self, key: &'static str) -> Option<&'t str> {
        let value = self.value(key)?;
        match value.get_ref() {
            DeValue::String(text) if !text.trim().is_empty() => Some(text),
            _ => {
                self.report_type(key, value, "a text in quotes that is not empty");
                None
            }
        }
    }

    /// A text that must be there.
    pub(super) fn required_text(&self, key: &'static str, example: &str) -> Option<&'t str> {
        if self.value(key).is_none() {
            self.report_missing(key, example);
        }
        self.text(key)
    }

    /// A number; the default if absent, or wrong (then it is reported).
    pub(super) fn number(&self, key: &'static str, allowed: NumberRange, default: f64) -> f64 {
        let Some(value) = self.value(key) else { return default };
        self.checked(key, value, allowed).unwrap_or(default)
    }

    /// A number that must be there.
    pub(super) fn required_number(
        &self,
        key: &'static str,
        allowed: NumberRange,
        example: &str,
    ) -> Option<f64> {
        match self.value(key) {
            Some(value) => self.checked(key, value, allowed),
            None => {
                self.report_missing(key, example);
                None
            }
        }
    }

    /// A whole number from 1 to `most`; the default if absent or wrong.
    pub(super) fn count(&self, key: &'static str, most: usize, default: usize) -> usize {
        self.whole(key, 1..=most).unwrap_or(default)
    }

    /// A whole number within a range; `None` if absent or wrong (then it is reported).
    pub(super) fn whole(&self, key: &'static str, range: RangeInclusive<usize>) -> Option<usize> {
        let value = self.value(key)?;
        let whole = match value.get_ref() {
            DeValue::Integer(_) => number(value.get_ref()),
            _ => None,
        };
        let (least, most) = (*range.start(), *range.end());
        let whole = whole.filter(|whole| (least as f64..=most as f64).contains(whole));
        if whole.is_none() {
            self.report_type(key, value, &format!("a whole number from {least} to {most}"));
        }
        whole.map(|whole| whole as usize)
    }

    /// Yes or no; `None` if absent or neither (then it is reported).
    pub(super) fn flag(&self, key: &'static str) -> Option<bool> {
        let value = self.value(key)?;
        if let DeValue::Boolean(flag) = value.get_ref() {
            return Some(*flag);
        }
        self.report_type(key, value, "true or false");
        None
    }

    /// What one of the known words means; `None` if absent or another word (then it is reported).
    pub(super) fn choice<T: Copy>(&self, key: &'static str, known: &[(&str, T)]) -> Option<T> {
        let value = self.value(key)?;
        let words = || known.iter().map(|(word, _)| *word);
        let quoted: Vec<String> = words().map(|word| format!("\"{word}\"")).collect();
        let text = value.get_ref().as_str();
        let meaning =
            known.iter().find(|(word, _)| text == Some(word)).map(|(_, meaning)| *meaning);
        if meaning.is_none() {
            let meant = text
                .and_then(|text| nearest(text, words()))
                .map(|meant| format!("; did you mean \"{meant}\"?"))
                .unwrap_or_default();
            let (expected, found) = (quoted.join(" or "), found(value.get_ref()));
            self.fail(&value.span(), format!("`{key}` must be {expected}, found {found}{meant}"));
        }
        meaning
    }

    fn checked(
        &self,
        key: &str,
        value: &Spanned<DeValue<'_>>,
        allowed: NumberRange,
    ) -> Option<f64> {
        let read = number(value.get_ref()).filter(|read| allowed.contains(*read));
        if read.is_none() {
            self.report_type(key, value, &allowed.describe());
        }
        read
    }

    /// `N` finite numbers; `None` if absent or wrong.
    pub(super) fn numbers<const N: usize>(&self, key: &'static str) -> Option<[f64; N]> {
        let value = self.value(key)?;
        let expected = format!("a list of {N} finite numbers");
        let Some(items) = value.get_ref().as_array() else {
            self.report_type(key, value, &expected);
            return None;
        };
        let read: Vec<f64> = items
            .iter()
            .filter_map(|item| number(item.get_ref()))
            .filter(|number| number.is_finite())
            .collect();
        if items.len() != N {
            self.fail(
                &value.span(),
                format!("`{key}` must be {expected}, found {} of them", items.len()),
            );
            return None;
        }
        let Ok(read) = <[f64; N]>::try_from(read) else {
            self.report_type(key, value, &expected);
            return None;
        };
        Some(read)
    }

    /// `N` finite numbers that must be there.
    pub(super) fn required_numbers<const N: usize>(
        &self,
        key: &'static str,
        example: &str,
    ) -> Option<[f64; N]> {
        if self.value(key).is_none() {
            self.report_missing(key, example);
        }
        self.numbers(key)
    }

    /// The table under a key, if it is there.
    pub(super) fn table(
        &self,
        key: &'static str,
        title: &'static str,
        known: &[&'static str],
    ) -> Option<Table<'t, 'i>> {
        let value = self.value(key)?;
        let Some(entries) = value.get_ref().as_table() else {
            self.report_type(key, value, &format!("a table: write `{title}` above its keys"));
            return None;
        };
        Some(Table::new(title, value.span(), entries, known, self.problems))
    }

    /// The list of tables under a key; empty if it is not there.
    pub(super) fn tables(
        &self,
        key: &'static str,
        title: &'static str,
        known: &[&'static str],
    ) -> Vec<Table<'t, 'i>> {
        let Some(value) = self.value(key) else { return Vec::new() };
        let expected = format!("a list of tables: write `{title}` above each one's keys");
        let Some(items) = value.get_ref().as_array() else {
            self.report_type(key, value, &expected);
            return Vec::new();
        };
        let mut tables = Vec::new();
        for item in items.iter() {
            match item.get_ref().as_table() {
                Some(entries) => {
                    tables.push(Table::new(title, item.span(), entries, known, self.problems));
                }
                None => self.report_type(key, item, &expected),
            }
        }
        tables
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

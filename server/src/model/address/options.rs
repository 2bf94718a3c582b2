//! `KEY=VALUE&…`: the options of an address.

use std::{str::FromStr, time::Duration};

use super::AddressError;

const MAX_FPS: f64 = 1000.0;
const MAX_STALL_S: f64 = 3600.0;
pub(super) const DEFAULT_STALL: Duration = Duration::from_secs(1);

/// If an option is given twice, the last value counts.
pub(super) struct Options<'q>(Vec<(&'q str, &'q str)>);

impl<'q> Options<'q> {
    /// Rejects unknown options.
    pub(super) fn parse(
        scheme: &'static str,
        known: &'static [&'static str],
        query: &'q str,
    ) -> Result<Self, AddressError> {
        let options = Self::parse_any(query);
        match options.0.iter().find(|(key, _)| !known.contains(key)) {
            Some((key, _)) => {
                Err(AddressError::UnknownOption { scheme, found: (*key).to_owned(), known })
            }
            None => Ok(options),
        }
    }

    pub(super) fn parse_any(query: &'q str) -> Self {
        let options = query.split('&').filter(|option| !option.is_empty());
        Self(options.map(|option| option.split_once('=').unwrap_or((option, ""))).collect())
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (&'q str, &'q str)> {
        self.0.iter().copied()
    }

    pub(super) fn get(&self, key: &str) -> Option<&'q str> {
        self.iter().filter(|(name, _)| *name == key).last().map(|(_, value)| value)
    }

    /// `expected` describes the values that `read` accepts.
    pub(super) fn parsed<T>(
        &self,
        key: &str,
        read: impl Fn(&str) -> Option<T>,
        expected: impl Fn() -> String,
    ) -> Result<Option<T>, AddressError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        read(value).map(Some).ok_or_else(|| AddressError::Value {
            what: format!("option `{key}`"),
            expected: expected(),
            found: value.to_owned(),
        })
    }

    /// Whether the option has the second of two values; the first is the default.
    pub(super) fn choice(&self, key: &str, values: [&str; 2]) -> Result<bool, AddressError> {
        let read = |value: &str| {
            values.iter().position(|known| *known == value).map(|position| position == 1)
        };
        let expected = || format!("`{}` or `{}`", values[0], values[1]);
        Ok(self.parsed(key, read, expected)?.unwrap_or(false))
    }

    pub(super) fn whole<T: FromStr>(&self, key: &str) -> Result<Option<T>, AddressError> {
        self.parsed(key, |value| value.parse().ok(), || "a whole number from 0".to_owned())
    }

    pub(super) fn frame_rate(&self) -> Result<Option<f64>, AddressError> {
        let expected = || format!("a number above 0, at most {MAX_FPS}");
        self.parsed("fps", |value| positive(value, MAX_FPS), expected)
    }

    pub(super) fn stall(&self) -> Result<Duration, AddressError> {
        let expected = || format!("seconds above 0, at most {MAX_STALL_S}");
        let seconds = self.parsed("stall", |value| positive(value, MAX_STALL_S), expected)?;
        Ok(seconds.map_or(DEFAULT_STALL, Duration::from_secs_f64))
    }
}

fn positive(value: &str, most: f64) -> Option<f64> {
    value.parse().ok().filter(|number| *number > 0.0 && *number <= most)
}

//! Problems of a configuration, with location and remedy.

use std::{error::Error, fmt, ops::Range, path::PathBuf};

use crate::model::redact::redact_line;

/// Longer lines are not quoted.
const MAX_EXCERPT_BYTES: usize = 1000;

/// All problems of one file, in the order of its lines.
#[derive(Debug)]
pub struct ConfigError {
    pub path: PathBuf,
    /// At least one.
    pub problems: Vec<Problem>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    pub message: String,
    pub help: Option<String>,
    /// `None` if the file could not be read.
    pub place: Option<TextLocation>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextLocation {
    /// From 1.
    pub line: usize,
    /// In characters, from 1.
    pub column: usize,
    /// The line, without secrets; empty if it is longer than [`MAX_EXCERPT_BYTES`].
    pub text: String,
    /// In characters, at least 1.
    pub width: usize,
}

/// A text with the beginnings of its lines, so that locating many problems takes linear time.
pub(super) struct Lines<'s> {
    source: &'s str,
    begins: Vec<usize>,
}

impl<'s> Lines<'s> {
    pub(super) fn of(source: &'s str) -> Self {
        let begins = source.match_indices('\n').map(|(newline, _)| newline + 1);
        Self { source, begins: std::iter::once(0).chain(begins).collect() }
    }

    /// A range of bytes, cut at the end of its first line.
    pub(super) fn locate(&self, span: &Range<usize>) -> TextLocation {
        let source = self.source;
        let floor = |at: usize| {
            (0..=at.min(source.len())).rev().find(|&at| source.is_char_boundary(at)).unwrap_or(0)
        };
        let start = floor(span.start);
        let line = self.begins.partition_point(|begin| *begin <= start);
        let line_start = self.begins[line - 1];
        let line_end = self.begins.get(line).map_or(source.len(), |next| next - 1);
        let end = floor(span.end.clamp(start, line_end));
        let text = source[line_start..line_end].trim_end();
        let is_shown = text.len() <= MAX_EXCERPT_BYTES;
        TextLocation {
            line,
            column: source[line_start..start].chars().count() + 1,
            text: if is_shown { redact_line(text) } else { String::new() },
            width: source[start..end].chars().count().max(1),
        }
    }
}

impl TextLocation {
    /// Its first byte in `source`.
    pub fn offset(&self, source: &str) -> usize {
        let lines = source.split_inclusive('\n').take(self.line - 1);
        let before: usize = lines.map(str::len).sum();
        let line = source[before.min(source.len())..].chars();
        before + line.take(self.column - 1).map(char::len_utf8).sum::<usize>()
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, problem) in self.problems.iter().enumerate() {
            if index > 0 {
                writeln!(f)?;
            }
            write!(f, "{}:", self.path.display())?;
            if let Some(place) = &problem.place {
                write!(f, "{}:{}:", place.line, place.column)?;
            }
            write!(f, " {}", problem.message)?;
            if let Some(place) = problem.place.as_ref().filter(|place| !place.text.is_empty()) {
                let number = place.line.to_string();
                let gutter = " ".repeat(number.len());
                // Tabs stay, to align the marks.
                let before = place.text.chars().take(place.column - 1);
                let indent: String = before.map(|c| if c == '\t' { c } else { ' ' }).collect();
                write!(f, "\n{gutter} |\n{number} | {}", place.text)?;
                write!(f, "\n{gutter} | {indent}{}", "^".repeat(place.width))?;
            }
            if let Some(help) = &problem.help {
                write!(f, "\n  help: {help}")?;
            }
        }
        Ok(())
    }
}

impl Error for ConfigError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_location_counts_characters_and_stays_in_its_line() {
        let source = "a = 1\nname = \"Größe\" # x\nb = 2\n";
        let start = source.find("# x").unwrap();
        let place = Lines::of(source).locate(&(start..start + 20));
        assert_eq!((place.line, place.column, place.width), (2, 16, 3));
        assert_eq!(place.offset(source), start);
        let past_the_end = Lines::of(source).locate(&(900..901));
        assert_eq!((past_the_end.line, past_the_end.width), (4, 1));
    }

    #[test]
    fn the_excerpt_marks_the_location() {
        let source = "[server]\n  listn = \"x\"\n";
        let error = ConfigError {
            path: "lab.toml".into(),
            problems: vec![Problem {
                message: "unknown key `listn`".into(),
                help: Some("the keys of [server] are …".into()),
                place: Some(Lines::of(source).locate(&(11..16))),
            }],
        };
        assert_eq!(
            error.to_string(),
            "lab.toml:2:3: unknown key `listn`\n  |\n2 |   listn = \"x\"\n  |   ^^^^^\n  \
             help: the keys of [server] are …"
        );
    }
}

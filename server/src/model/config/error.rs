//! What is wrong with a configuration, told so that a person finds the place and the remedy.

use std::{error::Error, fmt, ops::Range, path::PathBuf};

/// Everything that is wrong with one configuration file, in the order of its lines.
#[derive(Debug)]
pub struct ConfigError {
    /// The file, as it was named.
    pub path: PathBuf,
    /// At least one.
    pub problems: Vec<Problem>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// What was expected and what was found.
    pub message: String,
    /// What to do, where it does not follow from the message.
    pub help: Option<String>,
    /// The place in the file; `None` if the file itself could not be read.
    pub place: Option<TextLocation>,
}

/// A place in a text file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextLocation {
    /// From 1.
    pub line: usize,
    /// In characters, from 1.
    pub column: usize,
    pub text: String,
    /// Characters of the line that are meant, at least 1.
    pub width: usize,
}

impl TextLocation {
    /// The place that a range of bytes of `source` begins at; what goes past the end of that line
    /// is cut.
    pub(super) fn of(source: &str, span: &Range<usize>) -> Self {
        let start = floor_char_boundary(source, span.start.min(source.len()));
        let line_start = source[..start].rfind('\n').map_or(0, |newline| newline + 1);
        let line_end = source[start..].find('\n').map_or(source.len(), |length| start + length);
        let end = floor_char_boundary(source, span.end.clamp(start, line_end));
        Self {
            line: source[..start].matches('\n').count() + 1,
            column: source[line_start..start].chars().count() + 1,
            text: source[line_start..line_end].trim_end().to_owned(),
            width: source[start..end].chars().count().max(1),
        }
    }

    /// The byte of `source` that it begins at.
    pub fn offset(&self, source: &str) -> usize {
        let lines = source.split_inclusive('\n').take(self.line - 1);
        let before: usize = lines.map(str::len).sum();
        let line = source[before.min(source.len())..].chars();
        before + line.take(self.column - 1).map(char::len_utf8).sum::<usize>()
    }
}

fn floor_char_boundary(source: &str, mut at: usize) -> usize {
    while !source.is_char_boundary(at) {
        at -= 1;
    }
    at
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
            if let Some(place) = &problem.place {
                let number = place.line.to_string();
                let gutter = " ".repeat(number.len());
                // Tabs stay tabs, so that the marks stand below what they mark.
                let indent: String = place
                    .text
                    .chars()
                    .take(place.column - 1)
                    .map(|c| if c == '\t' { '\t' } else { ' ' })
                    .collect();
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
    fn a_place_counts_characters_and_stays_in_its_line() {
        let source = "a = 1\nname = \"Größe\" # x\nb = 2\n";
        let start = source.find("# x").unwrap();
        let place = TextLocation::of(source, &(start..start + 20));
        assert_eq!((place.line, place.column, place.width), (2, 16, 3));
        assert_eq!(place.offset(source), start);
        let past_the_end = TextLocation::of(source, &(900..901));
        assert_eq!((past_the_end.line, past_the_end.width), (4, 1));
    }

    #[test]
    fn the_excerpt_marks_the_place() {
        let source = "[server]\n  listn = \"x\"\n";
        let error = ConfigError {
            path: "lab.toml".into(),
            problems: vec![Problem {
                message: "unknown key `listn`".into(),
                help: Some("the keys of [server] are …".into()),
                place: Some(TextLocation::of(source, &(11..16))),
            }],
        };
        assert_eq!(
            error.to_string(),
            "lab.toml:2:3: unknown key `listn`\n  |\n2 |   listn = \"x\"\n  |   ^^^^^\n  \
             help: the keys of [server] are …"
        );
    }
}

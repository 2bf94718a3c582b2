//! Texts of other programs, for logs, events and pages.

/// Longest text that is taken from another program, bytes.
pub const MAX_TEXT_BYTES: usize = 1024;

const ELLIPSIS: &str = "…";

/// The text as one line: cut to [`MAX_TEXT_BYTES`], with escapes for control characters and for marks that start a line or
/// change the direction of writing.
pub fn sanitized(text: &str) -> String {
    let mut line = String::new();
    for letter in text.chars() {
        let before = line.len();
        if letter.is_control() || is_layout_mark(letter) {
            line.extend(letter.escape_default());
        } else {
            line.push(letter);
        }
        if line.len() > MAX_TEXT_BYTES - ELLIPSIS.len() {
            line.truncate(before);
            line.push_str(ELLIPSIS);
            break;
        }
    }
    line
}

fn is_layout_mark(letter: char) -> bool {
    matches!(letter, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_becomes_one_short_line() {
        assert_eq!(sanitized("no cable, größer"), "no cable, größer");
        assert_eq!(sanitized("a\nINFO forged\u{1b}[31m\r"), r"a\nINFO forged\u{1b}[31m\r");
        assert_eq!(sanitized("a\u{202e}b\u{2028}"), r"a\u{202e}b\u{2028}");
        for long in ["x".repeat(15_000_000), "\n".repeat(2000), "…".repeat(700)] {
            let line = sanitized(&long);
            assert!((MAX_TEXT_BYTES - 16..=MAX_TEXT_BYTES).contains(&line.len()), "{}", line.len());
            assert!(line.ends_with(ELLIPSIS));
        }
    }
}

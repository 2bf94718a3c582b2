//! Reduces Rust source to the code that ships.

/// Source without comments, the contents of strings, and items under `#[cfg(test)]`.
pub fn shipped_code(source: &str) -> String {
    let code = without_comments_and_strings(source);
    let mut shipped = String::new();
    let mut rest = code.as_str();
    while let Some(at) = rest.find("#[cfg(test)]") {
        shipped.push_str(&rest[..at]);
        rest = after_item(&rest[at + "#[cfg(test)]".len()..]);
    }
    shipped.push_str(rest);
    shipped
}

/// The text after the first item of `code`: after its `;`, or after its outermost braces.
fn after_item(code: &str) -> &str {
    let mut depth = 0usize;
    for (i, c) in code.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth <= 1 => return &code[i + 1..],
            '}' => depth -= 1,
            ';' if depth == 0 => return &code[i + 1..],
            _ => {}
        }
    }
    ""
}

fn without_comments_and_strings(source: &str) -> String {
    let bytes: Vec<char> = source.chars().collect();
    let (mut out, mut i) = (String::with_capacity(source.len()), 0);
    while i < bytes.len() {
        let next = bytes.get(i + 1).copied();
        match bytes[i] {
            '/' if next == Some('/') => {
                while i < bytes.len() && bytes[i] != '\n' {
                    i += 1;
                }
            }
            '/' if next == Some('*') => i = end_of_block_comment(&bytes, i),
            'r' if matches!(next, Some('"' | '#')) && !out.ends_with(is_word) => {
                i = end_of_raw_string(&bytes, i, &mut out);
            }
            '"' => {
                i += 1;
                while i < bytes.len() && bytes[i] != '"' {
                    i += if bytes[i] == '\\' { 2 } else { 1 };
                }
                i += 1;
                out.push_str("\"\"");
            }
            // A character literal, not a lifetime.
            '\'' if next == Some('\\') || bytes.get(i + 2) == Some(&'\'') => {
                i += if next == Some('\\') { 3 } else { 2 };
                while i < bytes.len() && bytes[i] != '\'' {
                    i += 1;
                }
                i += 1;
                out.push_str("' '");
            }
            c => {
                out.push(c);
                i += 1;
            }
        }
    }
    out
}

pub(super) fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

fn end_of_block_comment(text: &[char], start: usize) -> usize {
    let (mut depth, mut i) = (0usize, start);
    while i < text.len() {
        match (text[i], text.get(i + 1)) {
            ('/', Some('*')) => (depth, i) = (depth + 1, i + 2),
            ('*', Some('/')) if depth == 1 => return i + 2,
            ('*', Some('/')) => (depth, i) = (depth - 1, i + 2),
            _ => i += 1,
        }
    }
    i
}

/// Skips `r"…"` or `r#"…"#`; `r#name` is not a string and is copied.
fn end_of_raw_string(text: &[char], start: usize, out: &mut String) -> usize {
    let hashes = text[start + 1..].iter().take_while(|c| **c == '#').count();
    if text.get(start + 1 + hashes) != Some(&'"') {
        out.push('r');
        return start + 1;
    }
    out.push_str("\"\"");
    let mut i = start + 2 + hashes;
    while i < text.len() {
        let closing = text[i] == '"'
            && text[i + 1..].iter().take(hashes).filter(|c| **c == '#').count() == hashes;
        if closing {
            return i + 1 + hashes;
        }
        i += 1;
    }
    i
}

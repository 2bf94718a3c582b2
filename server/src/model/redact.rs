//! Removes secrets from texts that are shown: in APIs, events, logs, recordings and errors.
//!
//! | secret | example | shown |
//! | --- | --- | --- |
//! | user and password of a URL | `rtsp://lab:pw@cam/live` | `rtsp://cam/live` |
//! | the same, escaped | `rtsp%3A%2F%2Flab%3Apw%40cam` | `rtsp%3A%2F%2Fcam` |
//! | a value whose name says that it is secret | `?password=pw`, `user-pw="pw"`, `token: pw` | `?password=***` |
//!
//! Redacting a text again does not change it.

use std::{borrow::Cow, ops::Range};

use percent_encoding::percent_decode_str;

const HIDDEN: &str = "***";

/// Parts of names of secret values, in lower case and without punctuation.
const SECRET_PARTS: [&str; 9] = [
    "passw",
    "passphrase",
    "pwd",
    "token",
    "secret",
    "apikey",
    "credential",
    "privatekey",
    "authorization",
];
/// Names of values that identify a user. In free text they are too common, so only `NAME=VALUE` counts.
const USER_NAMES: [&str; 8] =
    ["pass", "auth", "user", "username", "userid", "usr", "login", "proxyid"];
/// Further names in the query of a URL.
const QUERY_NAMES: [&str; 4] = ["key", "sig", "signature", "sid"];
/// Schemes of an Authorization header; the secret follows.
const AUTHORIZATION_SCHEMES: [&str; 3] = ["basic", "bearer", "digest"];

/// In messages that show how to write a URL; in lower case.
const PLACEHOLDER: &str = "user:password@";

/// The text without secrets.
pub fn redact(text: &str) -> String {
    without_secret_values(&without_users(text))
}

/// Whether a value of this name is hidden from everyone.
pub fn is_secret_name(name: &str) -> bool {
    let name = normalized(name);
    is_surely_secret(&name) || USER_NAMES.contains(&name.as_str())
}

/// A line of a configuration without secrets. In a comment, everything after a word such as "password" is hidden.
pub fn redact_line(line: &str) -> String {
    let plain = unescaped(line);
    let shown = redact(&plain);
    // Without secrets, the line is shown as it is written.
    let shown = if shown == plain { Cow::Borrowed(line) } else { Cow::Owned(shown) };
    match shown.find('#') {
        Some(at) => format!("{}{}", &shown[..at], redact_comment(&shown[at..])),
        None => shown.into_owned(),
    }
}

/// A comment without secrets.
pub fn redact_comment(comment: &str) -> String {
    let shown = redact(comment);
    let lower = shown.to_ascii_lowercase();
    let ends = SECRET_PARTS.iter().filter_map(|part| Some(lower.find(part)? + part.len()));
    match ends.min() {
        Some(end) => {
            let word = lower[end..].find(|it: char| !it.is_alphanumeric());
            match word.map(|length| end + length).filter(|&end| !shown[end..].trim().is_empty()) {
                Some(end) => format!("{} {HIDDEN}", &shown[..end]),
                None => shown,
            }
        }
        None => shown,
    }
}

/// Removes USER:PASSWORD@ of URLs.
fn without_users(text: &str) -> String {
    let lower = text.to_ascii_lowercase();
    let mut shown = String::with_capacity(text.len());
    let mut done = 0;
    while let Some((begin, escaped)) = next_authority(&lower, done) {
        let (before, after) = (&text[done..begin], &text[begin..]);
        shown += before;
        let length = url_length(before, after);
        done = begin + user_info_length(&lower[begin..begin + length], escaped);
    }
    shown + &text[done..]
}

/// Where the authority of the next URL begins, and whether the URL is escaped.
fn next_authority(lower: &str, from: usize) -> Option<(usize, bool)> {
    let next = |marker: &str| lower[from..].find(marker).map(|at| from + at + marker.len());
    let plain = next("://").map(|at| (at, false));
    let escaped = next("%3a%2f%2f").map(|at| (at, true));
    [plain, escaped].into_iter().flatten().min()
}

/// Length of a URL from its authority on: up to white space, or to the quote that was opened before it.
fn url_length(before: &str, after: &str) -> usize {
    let is_scheme = |it: char| it.is_alphanumeric() || "+-.:/%".contains(it);
    let opener = before.trim_end_matches(is_scheme).chars().next_back();
    let closer = match opener {
        Some(quote @ ('"' | '\'' | '`')) => quote,
        Some('(') => ')',
        Some('<') => '>',
        _ => ' ',
    };
    after.find(|it: char| it.is_whitespace() || it == closer).unwrap_or(after.len())
}

/// Length of USER:PASSWORD@ at the start of a lower-case URL without its scheme.
fn user_info_length(lower: &str, escaped: bool) -> usize {
    let (at_sign, ends): (&str, &[&str]) = match escaped {
        true => ("%40", &["%2f", "%3f", "%23", "&"]),
        false => ("@", &["/", "?", "#"]),
    };
    let end = ends.iter().filter_map(|end| lower.find(end)).min().unwrap_or(lower.len());
    // A password may contain an unescaped @.
    let user_info = lower[..end].rfind(at_sign).or_else(|| {
        // It may also contain an unescaped delimiter; then no port is before that.
        let port = lower[..end].rsplit_once(':')?.1;
        let is_port = port.ends_with(']') || port.bytes().all(|it| it.is_ascii_digit());
        if is_port { None } else { lower.rfind(at_sign) }
    });
    let length = user_info.map_or(0, |at| at + at_sign.len());
    if lower[..length] == *PLACEHOLDER { 0 } else { length }
}

fn without_secret_values(text: &str) -> String {
    let lower = text.to_ascii_lowercase();
    let mut shown = String::with_capacity(text.len());
    let mut done = 0;
    for (at, _) in text.char_indices() {
        let separator = ["=", ":", "%3d"].into_iter().find(|it| lower[at..].starts_with(it));
        let Some(separator) = separator.filter(|_| at >= done) else { continue };
        if let Some(value) = secret_value(text, at, separator) {
            shown += &text[done..value.start];
            shown += HIDDEN;
            done = value.end;
        }
    }
    shown + &text[done..]
}

/// The value behind a separator if the name before it is that of a secret.
fn secret_value(text: &str, at: usize, separator: &str) -> Option<Range<usize>> {
    let before = text[..at].trim_end().trim_end_matches(['"', '\'', '\\']);
    let is_name = |it: char| it.is_ascii_alphanumeric() || "_-.%".contains(it);
    let name = before.len() - before.trim_end_matches(is_name).len();
    let (head, name) = before.split_at(before.len() - name);
    // An escaped query is one word: `%3Fpassword`.
    let decoded = percent_decode_str(name).decode_utf8_lossy();
    let is_in_query = head.ends_with(['?', '&']) || decoded.contains(['?', '&']);
    let last = decoded.rsplit(|it: char| !is_name(it)).next().unwrap_or_default();
    let name = normalized(last);
    let is_secret = is_surely_secret(&name)
        || separator != ":" && USER_NAMES.contains(&name.as_str())
        || is_in_query && QUERY_NAMES.contains(&name.as_str());
    // In a message, `secret.txt:` is a file.
    let is_file = separator == ":" && last.contains('.');
    if !is_secret || is_file {
        return None;
    }
    let behind = &text[at + separator.len()..];
    let begin = at + separator.len() + (behind.len() - behind.trim_start_matches(' ').len());
    let value = &text[begin..];
    let quote =
        ["\"\"\"", "'''", "\\\"", "\"", "'", "`"].into_iter().find(|it| value.starts_with(it));
    if let Some(quote) = quote {
        let inside = begin + quote.len();
        let length = text[inside..].find(quote).unwrap_or(text.len() - inside);
        return Some(inside..inside + length).filter(|value| !value.is_empty());
    }
    let is_end = |it: char| it.is_whitespace() || "&\"`<>".contains(it) || it == '#' && is_in_query;
    let word = |text: &str| {
        let word = &text[..text.find(is_end).unwrap_or(text.len())];
        word.find("%26").unwrap_or(word.len())
    };
    let mut length = word(value);
    if AUTHORIZATION_SCHEMES.contains(&value[..length].to_ascii_lowercase().as_str()) {
        let gap = value[length..].len() - value[length..].trim_start_matches(' ').len();
        length += gap + word(&value[length + gap..]);
    }
    Some(begin..begin + length).filter(|value| !value.is_empty())
}

fn is_surely_secret(name: &str) -> bool {
    name.ends_with("pw") || SECRET_PARTS.iter().any(|part| name.contains(part))
}

fn normalized(name: &str) -> String {
    name.chars().filter(|it| it.is_alphanumeric()).collect::<String>().to_ascii_lowercase()
}

/// The text with TOML's escapes of characters by number decoded.
fn unescaped(text: &str) -> Cow<'_, str> {
    if !text.contains('\\') {
        return text.into();
    }
    let mut plain = String::new();
    let mut rest = text;
    while let Some(at) = rest.find('\\') {
        plain += &rest[..at];
        rest = &rest[at..];
        let digits = match rest.as_bytes().get(1) {
            Some(b'x') => 2,
            Some(b'u') => 4,
            Some(b'U') => 8,
            _ => 0,
        };
        let number = rest.get(2..2 + digits).and_then(|it| u32::from_str_radix(it, 16).ok());
        let length = match number.and_then(char::from_u32) {
            Some(character) => {
                plain.push(character);
                2 + digits
            }
            None => {
                plain.push('\\');
                1
            }
        };
        rest = &rest[length..];
    }
    (plain + rest).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_removed_and_the_rest_stays() {
        for (text, shown) in [
            ("http://u:p@h/x", "http://h/x"),
            ("http://u:p@q@h:81", "http://h:81"),
            ("http://u:p/q@h/x", "http://h/x"),
            ("http://u:p#q?r@h/x", "http://h/x"),
            ("http://h:81/x@y", "http://h:81/x@y"),
            ("http://[::1]:81/x@y", "http://[::1]:81/x@y"),
            ("http://h/x@y", "http://h/x@y"),
            ("images:a@b/*.png", "images:a@b/*.png"),
            ("cannot open `rtsp://u:p'@h/1`: no answer", "cannot open `rtsp://h/1`: no answer"),
            ("rtsp://u:p@h,rtsp://v:q@i", "rtsp://h,rtsp://i"),
            (
                "http://h/?url=rtsp%3A%2F%2Fu%3Ap%40i%2F1&a=1",
                "http://h/?url=rtsp%3A%2F%2Fi%2F1&a=1",
            ),
            ("http://h/cgi?usr=u&pwd=p&a=1#stall=5", "http://h/cgi?usr=***&pwd=***&a=1#stall=5"),
            ("http://h/?a=1&p%61ssword=p#fps=2", "http://h/?a=1&p%61ssword=***#fps=2"),
            ("http://h/?next=%2F%3Ftoken%3Dp%26a%3D1", "http://h/?next=%2F%3Ftoken%3D***%26a%3D1"),
            ("http://h/?Access_Token=p", "http://h/?Access_Token=***"),
            ("http://h/?key=p", "http://h/?key=***"),
            (
                "gst:rtspsrc location=rtsp://h user-id=u user-pw=\"p q\" ! decodebin",
                "gst:rtspsrc location=rtsp://h user-id=*** user-pw=\"***\" ! decodebin",
            ),
            ("{\"password\": \"p\", \"a\": 1}", "{\"password\": \"***\", \"a\": 1}"),
            ("{\\\"token\\\":\\\"p\\\"}", "{\\\"token\\\":\\\"***\\\"}"),
            ("Authorization: Basic dTpw and more", "Authorization: *** and more"),
            ("authorization=Bearer p", "authorization=***"),
            ("its user or password is no UTF-8", "its user or password is no UTF-8"),
            ("at 12:30:05, key = value, user: none", "at 12:30:05, key = value, user: none"),
            ("sim:?seed=1&robots=2", "sim:?seed=1&robots=2"),
            ("größer = 5 €, passwort=ü", "größer = 5 €, passwort=***"),
        ] {
            assert_eq!(redact(text), shown);
            assert_eq!(redact(shown), shown, "redacted twice");
        }
    }

    #[test]
    fn comments_and_escapes_of_a_configuration_hide_no_secret() {
        for (line, shown) in [
            ("fps = 5 # the password is hunter2", "fps = 5 # the password ***"),
            ("# Token hunter2", "# Token ***"),
            ("# source = \"rtsp://u:hunter2@h\"", "# source = \"rtsp://h\""),
            ("# asks for a password", "# asks for a password"),
            ("source = \"http:\\u002f\\u002fu:hunter2\\u0040h\"", "source = \"http://h\""),
            ("name = \"a\\u0062\\tc\" # plain", "name = \"a\\u0062\\tc\" # plain"),
            ("source = \"http://h/#stall=5\"", "source = \"http://h/#stall=5\""),
        ] {
            assert_eq!(redact_line(line), shown);
        }
        assert!(is_secret_name("user-pw") && is_secret_name("password") && !is_secret_name("name"));
    }
}

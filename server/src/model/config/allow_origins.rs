//! `[server] allow_origins`: pages of which servers browsers let ask this one.

use std::ops::Range;

use axum::http::uri::Authority;
use toml::de::DeValue;

use super::reader::{Table, found};

const KEY: &str = "allow_origins";
const HELP: &str = "an origin is a page's address up to its host and port, such as \"https://lab.example.org\" or \
                    \"http://localhost:5173\"; \"*\" is any";

/// Origins as browsers write them: scheme, host, and port if it is not the scheme's own.
pub(super) fn allow_origins(table: &Table<'_, '_>) -> Vec<String> {
    let Some(value) = table.value(KEY) else { return Vec::new() };
    let wrong = |span: &Range<usize>, found: &str, help: &str| {
        let message = format!("`{KEY}` must be a list of origins of pages, found {found}");
        table.fail_with_help(span, message, help);
    };
    let Some(items) = value.get_ref().as_array() else {
        wrong(&value.span(), &found(value.get_ref()), HELP);
        return Vec::new();
    };
    let mut origins = Vec::new();
    for item in items.iter() {
        match item.get_ref() {
            DeValue::String(text) if is_origin(text) => {
                // Browsers write hosts in small letters.
                origins.push(text.to_ascii_lowercase());
            }
            DeValue::String(text) => {
                let host = text.find("://").map(|at| at + 3);
                let path = host.and_then(|host| Some(host + text[host..].find('/')?));
                let help = path.map_or_else(
                    || HELP.to_owned(),
                    |path| format!("leave out the path: \"{}\"", &text[..path]),
                );
                wrong(&item.span(), &format!("\"{text}\""), &help);
            }
            other => wrong(&item.span(), &found(other), HELP),
        }
    }
    origins
}

fn is_origin(text: &str) -> bool {
    let host = ["http://", "https://"].iter().find_map(|scheme| text.strip_prefix(scheme));
    let is_plain = |host: &str| {
        let authority = host.parse::<Authority>();
        authority.is_ok_and(|it| !it.host().is_empty() && !host.contains('@'))
    };
    text == "*" || host.is_some_and(is_plain)
}

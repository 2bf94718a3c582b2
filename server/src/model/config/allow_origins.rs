//! `[server] allow_origins`: origins of web pages that may use this server from a browser.

use axum::http::uri::Authority;
use toml::de::DeValue;

use super::reader::{Table, found};

const HELP: &str = "an origin is a page's address up to its host and port, such as \"https://lab.example.org\" or \
                    \"http://localhost:5173\"; \"*\" is any";

/// Origins as browsers send them: scheme, host, and a port that is not the scheme's own.
pub(super) fn allow_origins(table: &Table<'_, '_>) -> Vec<String> {
    let Some(value) = table.value("allow_origins") else { return Vec::new() };
    let message =
        |found: &str| format!("`allow_origins` must be a list of origins of pages, found {found}");
    let Some(items) = value.get_ref().as_array() else {
        let message = message(&found(value.get_ref()));
        return table.reject("allow_origins", message, HELP).unwrap_or_default();
    };
    let mut origins = Vec::new();
    for item in items.iter() {
        match item.get_ref() {
            // Browsers send hosts in lower case.
            DeValue::String(text) if is_origin(text) => origins.push(text.to_ascii_lowercase()),
            DeValue::String(text) => {
                let host = text.find("://").map(|at| at + 3);
                let path = host.and_then(|host| Some(host + text[host..].find('/')?));
                let help = path.map_or_else(
                    || HELP.to_owned(),
                    |path| format!("leave out the path: \"{}\"", &text[..path]),
                );
                table.fail_at(&item.span(), message(&format!("\"{text}\"")), help);
            }
            other => table.fail_at(&item.span(), message(&found(other)), HELP),
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

//! The text of a configuration without secrets, and their return into a text that a client has edited.
//!
//! Secrets are found in every value and comment ([`crate::model::redact`]), not only in the sources of cameras.

use std::collections::BTreeMap;

use toml_edit::{DocumentMut, Item, TableLike, Value};
use toml_parser::{Source, lexer::TokenKind};

use super::{EditError, parse, set_value};
use crate::model::redact::{is_secret_name, redact, redact_comment};

const HIDDEN: &str = "***";

/// The text without secrets.
pub fn redacted(text: &str) -> Result<String, EditError> {
    let mut document = parse(text)?;
    hide_table(document.as_table_mut());
    Ok(replace_comments(&document.to_string(), redact_comment))
}

/// Puts the secrets of `known` back into a text that was made from its redacted form. Tables of a list are matched by
/// name. Values and comments that were changed stay as they are.
pub fn restored(text: &str, known: &str) -> Result<String, EditError> {
    let mut originals = BTreeMap::<String, Vec<&str>>::new();
    for comment in comments(known) {
        let shown = redact_comment(comment);
        if shown != comment {
            originals.entry(shown).or_default().push(comment);
        }
    }
    let text = replace_comments(text, |comment| match originals.get_mut(comment) {
        Some(found) if found.len() > 1 => found.remove(0).to_owned(),
        Some(found) => found[0].to_owned(),
        None => comment.to_owned(),
    });
    let (mut document, known): (DocumentMut, DocumentMut) = (parse(&text)?, parse(known)?);
    restore_table(document.as_table_mut(), known.as_table());
    Ok(document.to_string())
}

fn hide_table(table: &mut dyn TableLike) {
    for (key, item) in table.iter_mut() {
        match item {
            Item::Value(value) => hide(key.get(), value),
            Item::Table(table) => hide_table(table),
            Item::ArrayOfTables(tables) => {
                tables.iter_mut().for_each(|table| hide_table(table));
            }
            Item::None => {}
        }
    }
}

fn hide(key: &str, value: &mut Value) {
    match value {
        Value::Array(values) => values.iter_mut().for_each(|value| hide(key, value)),
        Value::InlineTable(table) => hide_table(table),
        value => {
            if let Some(shown) = shown(key, value) {
                set_value(value, shown.into());
            }
        }
    }
}

/// What is shown instead of a value; `None`: the value itself.
fn shown(key: &str, value: &Value) -> Option<String> {
    if is_secret_name(key) {
        return Some(HIDDEN.to_owned());
    }
    let text = value.as_str()?;
    Some(redact(text)).filter(|shown| shown != text)
}

fn restore_table(table: &mut dyn TableLike, known: &dyn TableLike) {
    for (key, item) in table.iter_mut() {
        let Some(known) = known.get(key.get()) else { continue };
        match (item, known) {
            (Item::Value(Value::Array(values)), Item::Value(Value::Array(known))) => {
                let known: Vec<_> = known.iter().filter_map(Value::as_inline_table).collect();
                for table in values.iter_mut().filter_map(Value::as_inline_table_mut) {
                    if let Some(known) = same_name(table, known.iter().copied()) {
                        restore_table(table, known);
                    }
                }
            }
            (Item::ArrayOfTables(tables), Item::ArrayOfTables(known)) => {
                for table in tables.iter_mut() {
                    if let Some(known) = same_name(table, known.iter()) {
                        restore_table(table, known);
                    }
                }
            }
            (Item::Value(value), Item::Value(known)) => {
                let is_redacted =
                    shown(key.get(), known).is_some_and(|shown| value.as_str() == Some(&*shown));
                match (value.as_inline_table_mut(), known.as_inline_table()) {
                    (Some(table), Some(known)) => restore_table(table, known),
                    _ if is_redacted => set_value(value, known.clone()),
                    _ => {}
                }
            }
            (item, known) => {
                if let (Some(table), Some(known)) =
                    (item.as_table_like_mut(), known.as_table_like())
                {
                    restore_table(table, known);
                }
            }
        }
    }
}

/// The first table with the name of another one.
fn same_name<'t, T: TableLike>(
    table: &dyn TableLike,
    all: impl IntoIterator<Item = &'t T>,
) -> Option<&'t T> {
    let name = table.get("name").and_then(Item::as_str)?;
    all.into_iter().find(|it| it.get("name").and_then(Item::as_str) == Some(name))
}

fn comments(text: &str) -> impl Iterator<Item = &str> {
    let spans = Source::new(text).lex().filter(|token| token.kind() == TokenKind::Comment);
    spans.map(|token| &text[token.span().start()..token.span().end()])
}

fn replace_comments(text: &str, mut replacement: impl FnMut(&str) -> String) -> String {
    let mut replaced = String::with_capacity(text.len());
    let mut done = 0;
    for token in Source::new(text).lex().filter(|token| token.kind() == TokenKind::Comment) {
        let (start, end) = (token.span().start(), token.span().end());
        replaced += &text[done..start];
        replaced += &replacement(&text[start..end]);
        done = end;
    }
    replaced + &text[done..]
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r##"# The cameras' password is hunter1.
name = "lab" # a # b
[node]
server = "http://u:hunter2@h:1"
[[camera]]
name = "north"
source = """
rtsp://u:hunter3@h/1"""
[[camera]]
name = "east"
source = "http:\u002f\u002fu:hunter4\u0040h/1" # escaped
pose = { password = 5, note = ["rtsp://u:hunter5@h"] }
# The cameras' password is hunter6.
[[access]]
name = "robot"
token = "hunter7"
"##;

    #[test]
    fn secrets_are_hidden_and_return() {
        let shown = redacted(TEXT).unwrap();
        assert!(!shown.contains("hunter") && !shown.contains("= 5"), "{shown}");
        assert!(shown.contains("# a # b") && shown.contains("# escaped"), "{shown}");
        assert_eq!(redacted(&shown).unwrap(), shown);
        let kept = restored(&shown, TEXT).unwrap();
        for number in [1, 2, 3, 4, 6, 7] {
            assert!(kept.contains(&format!("hunter{number}")), "{number}: {kept}");
        }
        let order = ["hunter1", "hunter6"].map(|it| kept.find(it));
        assert!(order[0] < order[1] && kept.contains("password = 5"), "{kept}");
    }

    #[test]
    fn what_a_client_changed_stays() {
        let shown = redacted(TEXT).unwrap();
        let edited = shown.replace("\"north\"", "\"south\"").replace("h:1", "i:1");
        let edited = edited.replace("# escaped", "# mine").replace("\"***\"\n", "\"new\"\n");
        let kept = restored(&edited, TEXT).unwrap();
        assert!(kept.contains("server = \"http://i:1\"") && !kept.contains("hunter2"), "{kept}");
        assert!(!kept.contains("hunter3"), "another camera: {kept}");
        assert!(kept.contains("# mine") && kept.contains("hunter4"), "{kept}");
        assert!(kept.contains("token = \"new\""), "{kept}");
    }
}

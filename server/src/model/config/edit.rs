//! Edits cameras and objects in a configuration's text. Comments, order and the notation of unchanged values stay.
//!
//! The result is not checked; [`super::Config::parse`] does that.

pub mod access;
mod message;
mod redaction;

use thiserror::Error;
use toml_edit::{
    ArrayOfTables, DocumentMut, InlineTable, Item, RawString, Table, TableLike, Value,
};

pub use self::message::Message;
use self::message::{of_table, to_table};
pub use self::redaction::{redacted, restored};
use crate::model::redact::redact_line;

#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EditError {
    #[error("the configuration cannot be edited: {0}")]
    Text(String),
    #[error("the configuration has no {what} \"{name}\"")]
    Missing { what: &'static str, name: String },
}

/// Appends a table to its list.
pub fn add<M: Message>(text: &str, message: &M) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let keys = to_table(message)?;
    let list = document.entry(M::SECTION).or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
    match list {
        Item::ArrayOfTables(tables) => {
            let mut table = keys.into_table();
            // An empty line before it.
            table.decor_mut().set_prefix("\n");
            tables.push(table);
        }
        Item::Value(Value::Array(tables)) => tables.push(keys),
        _ => return Err(EditError::Text(format!("`{}` is no list of tables", M::SECTION))),
    }
    Ok(document.to_string())
}

/// Sets these keys of a table to their values in `message`, and removes keys that are absent or empty there.
pub fn change<M: Message>(
    text: &str,
    name: &str,
    message: &M,
    keys: &[&str],
) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let changed = to_table(message)?;
    let table = table_of::<M>(&mut document, name)?;
    // A key may occur twice: two fields of a message can correspond to one key.
    for key in keys {
        match changed.get(key) {
            Some(value) => set(table, key, value.clone()),
            None => {
                table.remove(key);
            }
        }
    }
    Ok(document.to_string())
}

/// The keys whose values differ.
pub fn difference<M: Message>(before: &M, after: &M) -> Result<Vec<&'static str>, EditError> {
    let (before, after) = (to_table(before)?, to_table(after)?);
    let text = |table: &InlineTable, key: &str| table.get(key).map(|value| value.to_string());
    let differs = |key: &&&str| text(&before, key) != text(&after, key);
    Ok(M::KEYS.iter().filter(differs).copied().collect())
}

/// Renames the object of mounted cameras.
pub fn rename_carrier(text: &str, from: &str, to: &str) -> Result<String, EditError> {
    let mut document = parse(text)?;
    for camera in tables(&mut document, "camera") {
        let pose = camera.get_mut("pose").and_then(Item::as_table_like_mut);
        if let Some(pose) =
            pose.filter(|pose| pose.get("object").and_then(Item::as_str) == Some(from))
        {
            set(pose, "object", to.into());
        }
    }
    Ok(document.to_string())
}

/// Removes a table, with the comments directly above it.
pub fn remove<M: Message>(text: &str, name: &str) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let index = index_of::<M>(&mut document, name)?;
    match document.get_mut(M::SECTION) {
        Some(Item::ArrayOfTables(tables)) => {
            let gone = tables.get(index).cloned().unwrap_or_default();
            tables.remove(index);
            let kept = comments_above(&gone);
            if !kept.is_empty() {
                prepend(&mut document, gone.position(), &kept);
            }
        }
        Some(Item::Value(Value::Array(tables))) => {
            tables.remove(index);
        }
        _ => {}
    }
    Ok(document.to_string())
}

/// One table of a list, by name.
pub fn read<M: Message>(text: &str, name: &str) -> Result<M, EditError> {
    let mut document = parse(text)?;
    of_table(table_of::<M>(&mut document, name)?)
}

pub fn read_all<M: Message>(text: &str) -> Result<Vec<M>, EditError> {
    let mut document = parse(text)?;
    tables(&mut document, M::SECTION).into_iter().map(|table| of_table(table)).collect()
}

/// Index of the table, and its key, at a byte of the text.
pub fn key_at<M: Message>(text: &str, at: usize) -> Option<(usize, &'static str)> {
    let document = toml_edit::Document::parse(text).ok()?;
    let tables: Vec<&dyn TableLike> = match document.get(M::SECTION)? {
        Item::ArrayOfTables(tables) => tables.iter().map(|table| table as &dyn TableLike).collect(),
        Item::Value(Value::Array(tables)) => {
            let tables = tables.iter().filter_map(Value::as_inline_table);
            tables.map(|table| table as &dyn TableLike).collect()
        }
        _ => return None,
    };
    let is_there = |table: &dyn TableLike, key: &str| {
        let Some((name, item)) = table.get_key_value(key) else { return false };
        let begins = [name.span(), item.span()].into_iter().flatten().map(|span| span.start);
        let Some(begin) = begins.min() else { return false };
        let mut end = item.span().map_or(0, |span| span.end);
        // The span of a table with a header is that of the header.
        let inner: Vec<&Table> = match item {
            Item::Table(table) => vec![table],
            Item::ArrayOfTables(tables) => tables.iter().collect(),
            _ => Vec::new(),
        };
        for table in inner {
            let ends = table.iter().filter_map(|(_, item)| Some(item.span()?.end));
            end = ends.chain(table.span().map(|span| span.end)).fold(end, usize::max);
        }
        (begin..end).contains(&at)
    };
    tables.into_iter().enumerate().find_map(|(index, table)| {
        let key = M::KEYS.iter().find(|key| is_there(table, key))?;
        Some((index, *key))
    })
}

/// The first key that an error message names.
pub fn key_named<M: Message>(message: &str) -> Option<&'static str> {
    let named = message.split('`').skip(1).step_by(2);
    named.filter_map(|name| M::KEYS.iter().find(|key| **key == name).copied()).next()
}

fn parse(text: &str) -> Result<DocumentMut, EditError> {
    text.parse().map_err(|error: toml_edit::TomlError| {
        // It quotes a line of the text.
        let lines: Vec<String> = error.to_string().lines().map(redact_line).collect();
        EditError::Text(lines.join("\n"))
    })
}

fn tables<'a>(document: &'a mut DocumentMut, section: &str) -> Vec<&'a mut dyn TableLike> {
    match document.get_mut(section) {
        Some(Item::ArrayOfTables(tables)) => {
            tables.iter_mut().map(|table| table as &mut dyn TableLike).collect()
        }
        Some(Item::Value(Value::Array(tables))) => {
            let tables = tables.iter_mut().filter_map(Value::as_inline_table_mut);
            tables.map(|table| table as &mut dyn TableLike).collect()
        }
        _ => Vec::new(),
    }
}

fn index_of<M: Message>(document: &mut DocumentMut, name: &str) -> Result<usize, EditError> {
    let named = |table: &&mut dyn TableLike| table.get("name").and_then(Item::as_str) == Some(name);
    let place = tables(document, M::SECTION).iter().position(named);
    place.ok_or_else(|| EditError::Missing { what: M::SECTION, name: name.to_owned() })
}

fn table_of<'a, M: Message>(
    document: &'a mut DocumentMut,
    name: &str,
) -> Result<&'a mut dyn TableLike, EditError> {
    let place = index_of::<M>(document, name)?;
    Ok(tables(document, M::SECTION).swap_remove(place))
}

/// Sets a value and keeps the comment behind it. An equal value keeps its notation.
fn set(table: &mut dyn TableLike, key: &str, value: Value) {
    match (table.get_mut(key), &value) {
        (Some(Item::Value(before)), _) => {
            if !is_same(before, &value) {
                set_value(before, value);
            }
        }
        // A table with a header.
        (Some(Item::Table(before)), Value::InlineTable(wanted)) => set_all(before, wanted),
        (Some(Item::ArrayOfTables(before)), Value::Array(wanted)) => {
            while before.len() > wanted.len() {
                before.remove(before.len() - 1);
            }
            for (index, wanted) in wanted.iter().filter_map(Value::as_inline_table).enumerate() {
                if before.get(index).is_none() {
                    before.push(Table::new());
                }
                if let Some(table) = before.get_mut(index) {
                    set_all(table, wanted);
                }
            }
        }
        _ => {
            table.insert(key, Item::Value(value));
        }
    }
}

/// Keeps the comment behind the value.
fn set_value(before: &mut Value, value: Value) {
    let decor = before.decor().clone();
    *before = value;
    *before.decor_mut() = decor;
}

fn set_all(table: &mut Table, wanted: &InlineTable) {
    table.retain(|key, _| wanted.contains_key(key));
    for (key, value) in wanted {
        set(table, key, value.clone());
    }
}

fn is_same(a: &Value, b: &Value) -> bool {
    let number = |value: &Value| value.as_float().or(value.as_integer().map(|whole| whole as f64));
    match (a, b) {
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(a, b))
        }
        (Value::InlineTable(a), Value::InlineTable(b)) => {
            let is_in_b = |key: &str, a: &Value| b.get(key).is_some_and(|b| is_same(a, b));
            a.len() == b.len() && a.iter().all(|(key, a)| is_in_b(key, a))
        }
        (Value::String(a), Value::String(b)) => a.value() == b.value(),
        (Value::Boolean(a), Value::Boolean(b)) => a.value() == b.value(),
        _ => number(a).is_some() && number(a) == number(b),
    }
}

/// Comments above a table that do not belong to it: those before the last empty line.
fn comments_above(table: &Table) -> String {
    let prefix = table.decor().prefix().and_then(RawString::as_str).unwrap_or_default();
    let mut kept = 0;
    let mut at = 0;
    for line in prefix.split_inclusive('\n') {
        at += line.len();
        if line.trim().is_empty() {
            kept = at;
        }
    }
    let kept = &prefix[..kept];
    if kept.trim().is_empty() { String::new() } else { kept.to_owned() }
}

/// Inserts a text above the next table after `position`, or at the end.
fn prepend(document: &mut DocumentMut, position: Option<isize>, text: &str) {
    fn following<'a>(table: &'a mut Table, after: Option<isize>, found: &mut Vec<&'a mut Table>) {
        for (_, item) in table.iter_mut() {
            let tables: Vec<&mut Table> = match item {
                Item::Table(table) => vec![table],
                Item::ArrayOfTables(tables) => tables.iter_mut().collect(),
                _ => Vec::new(),
            };
            for table in tables {
                if table.position() > after {
                    found.push(table);
                } else {
                    following(table, after, found);
                }
            }
        }
    }
    let mut found = Vec::new();
    following(document.as_table_mut(), position, &mut found);
    let next = found.into_iter().min_by_key(|table| table.position());
    let joined = |below: Option<&RawString>| {
        let below = below.and_then(RawString::as_str).unwrap_or_default();
        format!("{text}{}", below.trim_start_matches('\n'))
    };
    match next {
        Some(table) => {
            let above = joined(table.decor().prefix());
            table.decor_mut().set_prefix(above);
        }
        None => {
            let above = joined(Some(document.trailing()));
            document.set_trailing(above);
        }
    }
}

#[cfg(test)]
mod tests;

//! Changes to the cameras and objects of a configuration's text: everything else in it, comments and order included, stays as a
//! person wrote it.
//!
//! What comes out is only text. Whether it is a good configuration is for [`super::Config::parse`] to say, as if a
//! person had changed it.

mod camera;
mod object;

use thiserror::Error;
use toml_edit::{
    Array, ArrayOfTables, DocumentMut, InlineTable, Item, RawString, Table, TableLike, Value,
};

pub use self::{
    camera::{WrittenCamera, WrittenPose},
    object::{WrittenMount, WrittenObject, WrittenRoundels, rename_carrier},
};

/// One table of a list of them, as it is written; what is `None` or empty in it is not.
pub trait Written {
    /// Key of the list.
    const SECTION: &'static str;
    /// All keys that one has.
    const KEYS: &'static [&'static str];

    /// Unique in the list.
    fn name(&self) -> &str;
    /// What a key is to be; `None`: not there.
    fn value(&self, key: &str) -> Option<Value>;
    /// As far as it can be read.
    fn of(table: &dyn TableLike) -> Self;
}

/// Why a text is not changed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EditError {
    /// It is none that could be changed.
    #[error("the configuration cannot be edited: {0}")]
    Text(String),
    /// There is none of that name in the list.
    #[error("the configuration has no {what} \"{name}\"")]
    Missing {
        /// Key of the list.
        what: &'static str,
        /// Which name.
        name: String,
    },
}

/// Puts one behind the last of its list.
pub fn add<W: Written>(text: &str, one: &W) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let keys = W::KEYS.iter().filter_map(|key| Some((*key, one.value(key)?)));
    let list = document.entry(W::SECTION).or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
    match list {
        Item::ArrayOfTables(tables) => {
            let mut table = Table::new();
            table.extend(keys);
            // An empty line before it.
            table.decor_mut().set_prefix("\n");
            tables.push(table);
        }
        Item::Value(Value::Array(tables)) => tables.push(InlineTable::from_iter(keys)),
        _ => return Err(EditError::Text(format!("`{}` is no list of tables", W::SECTION))),
    }
    Ok(document.to_string())
}

/// Gives these keys of one other values, as `one` says; its other keys are not looked at.
pub fn change<W: Written>(
    text: &str,
    name: &str,
    one: &W,
    keys: &[&str],
) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let table = table_of::<W>(&mut document, name)?;
    let before = W::of(table);
    let same = |key: &str| {
        let text = |it: &W| it.value(key).map(|value| value.to_string());
        text(&before) == text(one)
    };
    for key in keys.iter().filter(|key| !same(key)) {
        match one.value(key) {
            Some(value) => set(table, key, value),
            None => {
                table.remove(key);
            }
        }
    }
    Ok(document.to_string())
}

/// Takes one out, with the comments that stand directly above it.
pub fn remove<W: Written>(text: &str, name: &str) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let index = place_of::<W>(&mut document, name)?;
    match document.get_mut(W::SECTION) {
        Some(Item::ArrayOfTables(tables)) => {
            let gone = tables.get(index).cloned().unwrap_or_default();
            tables.remove(index);
            let kept = paragraphs_above(&gone);
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

/// One as it is written.
pub fn read<W: Written>(text: &str, name: &str) -> Result<W, EditError> {
    let mut document = parse(text)?;
    Ok(W::of(table_of::<W>(&mut document, name)?))
}

/// All of a list as they are written, in their order.
pub fn read_all<W: Written>(text: &str) -> Result<Vec<W>, EditError> {
    let mut document = parse(text)?;
    Ok(tables(&mut document, W::SECTION).into_iter().map(|table| W::of(table)).collect())
}

/// The key of one that stands at that byte of the text, with its value, and its place in the list; `None` between them.
pub fn key_at<W: Written>(text: &str, at: usize) -> Option<(usize, &'static str)> {
    let document = toml_edit::Document::parse(text).ok()?;
    let tables: Vec<&dyn TableLike> = match document.get(W::SECTION)? {
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
        // The spans of tables with headers of their own are those of the headers.
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
        let key = W::KEYS.iter().find(|key| is_there(table, key))?;
        Some((index, *key))
    })
}

/// The key that a message names first.
pub fn key_named<W: Written>(message: &str) -> Option<&'static str> {
    let named = message.split('`').skip(1).step_by(2);
    named.filter_map(|name| W::KEYS.iter().find(|key| **key == name).copied()).next()
}

fn parse(text: &str) -> Result<DocumentMut, EditError> {
    text.parse().map_err(|error: toml_edit::TomlError| EditError::Text(error.to_string()))
}

/// All of a list, in their order.
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

fn place_of<W: Written>(document: &mut DocumentMut, name: &str) -> Result<usize, EditError> {
    let named = |table: &&mut dyn TableLike| table.get("name").and_then(Item::as_str) == Some(name);
    let place = tables(document, W::SECTION).iter().position(named);
    place.ok_or_else(|| EditError::Missing { what: W::SECTION, name: name.to_owned() })
}

fn table_of<'a, W: Written>(
    document: &'a mut DocumentMut,
    name: &str,
) -> Result<&'a mut dyn TableLike, EditError> {
    let place = place_of::<W>(document, name)?;
    Ok(tables(document, W::SECTION).swap_remove(place))
}

/// Another value; what stands behind the one before stays.
fn set(table: &mut dyn TableLike, key: &str, value: Value) {
    match (table.get_mut(key), &value) {
        (Some(Item::Value(before)), _) => {
            let decor = before.decor().clone();
            *before = value;
            *before.decor_mut() = decor;
        }
        // A table under a header of its own, with whatever else a person has written there.
        (Some(Item::Table(before)), Value::InlineTable(wanted)) => {
            set_all(before, wanted);
        }
        // Several of them.
        (Some(Item::ArrayOfTables(before)), Value::Array(wanted)) => {
            while before.len() > wanted.len() {
                before.remove(before.len() - 1);
            }
            for (index, wanted) in wanted.iter().filter_map(Value::as_inline_table).enumerate() {
                if before.get(index).is_none() {
                    before.push(Table::new());
                }
                before.get_mut(index).into_iter().for_each(|table| set_all(table, wanted));
            }
        }
        _ => {
            table.insert(key, Item::Value(value));
        }
    }
}

fn set_all(table: &mut Table, wanted: &InlineTable) {
    let gone: Vec<String> = table.iter().map(|(key, _)| key.to_owned()).collect();
    for key in gone.iter().filter(|key| !wanted.contains_key(key)) {
        table.remove(key);
    }
    for (key, value) in wanted.iter() {
        let before = table.get(key).and_then(Item::as_value);
        if !before.is_some_and(|before| is_same(before, value)) {
            set(table, key, value.clone());
        }
    }
}

/// Whether both mean the same, however they are written.
fn is_same(a: &Value, b: &Value) -> bool {
    if let (Some(a), Some(b)) = (number(a), number(b)) {
        return a == b;
    }
    match (a.as_array(), b.as_array()) {
        (Some(a), Some(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(a, b)),
        _ => a.to_string().trim() == b.to_string().trim(),
    }
}

/// What stands above a table and is not of it: all before the last empty line.
fn paragraphs_above(table: &Table) -> String {
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

/// Puts a text above the table that follows that position, or at the end.
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

fn numbers<const N: usize>(table: &dyn TableLike, key: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = table.get(key)?.as_array()?.iter().map(number).collect();
    numbers?.try_into().ok()
}

fn text(table: &dyn TableLike, key: &str) -> Option<String> {
    table.get(key).and_then(Item::as_str).map(str::to_owned)
}

fn array(numbers: &[f64]) -> Value {
    Value::Array(numbers.iter().copied().collect::<Array>())
}

fn float(item: &Item) -> Option<f64> {
    item.as_value().and_then(number)
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

#[cfg(test)]
mod tests;

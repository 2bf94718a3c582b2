//! Changes to the cameras of a configuration's text: everything else in it, comments and order included, stays as a
//! person wrote it.
//!
//! What comes out is only text. Whether it is a good configuration is for [`super::Config::parse`] to say, as if a
//! person had changed it.

use thiserror::Error;
use toml_edit::{
    Array, ArrayOfTables, DocumentMut, InlineTable, Item, RawString, Table, TableLike, Value,
};

pub use super::camera::CAMERA_KEYS;

/// A `[[camera]]` as it is written; what is `None` or empty is not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WrittenCamera {
    /// `name`
    pub name: String,
    /// `source`, with user and password.
    pub source: String,
    /// `calibration`
    pub calibration: Option<String>,
    /// `pose`
    pub pose: Option<WrittenPose>,
    /// `line_time_us`
    pub line_time_us: Option<f64>,
    /// `clock_uncertainty_ms`
    pub clock_uncertainty_ms: Option<f64>,
    /// `rate_hz`
    pub rate_hz: Option<f64>,
    /// `mode`
    pub mode: Option<String>,
    /// `mask`: polygons of corners, pixels.
    pub mask: Vec<Vec<[f64; 2]>>,
}

/// `pose` of a `[[camera]]`.
#[derive(Clone, Debug, PartialEq)]
pub enum WrittenPose {
    /// To be found from the reference roundels.
    Unknown,
    /// In the world, or on an object.
    At {
        /// `position_m`
        position_m: [f64; 3],
        /// `orientation_xyzw`
        orientation_xyzw: [f64; 4],
        /// `object`, on which it rides.
        object: Option<String>,
        /// `localizes`
        localizes: bool,
    },
}

/// Why a text is not changed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EditError {
    /// It is none that could be changed.
    #[error("the configuration cannot be edited: {0}")]
    Text(String),
    /// There is no such camera.
    #[error("the configuration has no camera \"{0}\"")]
    NoCamera(String),
}

impl WrittenCamera {
    /// What a key is to be; `None`: not there.
    fn value(&self, key: &str) -> Option<Value> {
        let number = |number: Option<f64>| number.map(Value::from);
        match key {
            "name" => Some(self.name.as_str().into()),
            "source" => Some(self.source.as_str().into()),
            "calibration" => self.calibration.as_deref().map(Value::from),
            "pose" => self.pose.as_ref().map(WrittenPose::value),
            "line_time_us" => number(self.line_time_us),
            "clock_uncertainty_ms" => number(self.clock_uncertainty_ms),
            "rate_hz" => number(self.rate_hz),
            "mode" => self.mode.as_deref().map(Value::from),
            "mask" => (!self.mask.is_empty()).then(|| polygons(&self.mask)),
            _ => None,
        }
    }

    fn of(table: &dyn TableLike) -> Self {
        let text = |key: &str| table.get(key).and_then(Item::as_str).map(str::to_owned);
        let number = |key: &str| table.get(key).and_then(float);
        Self {
            name: text("name").unwrap_or_default(),
            source: text("source").unwrap_or_default(),
            calibration: text("calibration"),
            pose: table.get("pose").and_then(WrittenPose::of),
            line_time_us: number("line_time_us"),
            clock_uncertainty_ms: number("clock_uncertainty_ms"),
            rate_hz: number("rate_hz"),
            mode: text("mode"),
            mask: table.get("mask").map(corners).unwrap_or_default(),
        }
    }
}

impl WrittenPose {
    fn value(&self) -> Value {
        let Self::At { position_m, orientation_xyzw, object, localizes } = self else {
            return "unknown".into();
        };
        let mut table = InlineTable::new();
        table.insert("position_m", Value::Array(position_m.iter().copied().collect()));
        table.insert("orientation_xyzw", Value::Array(orientation_xyzw.iter().copied().collect()));
        if let Some(object) = object {
            table.insert("object", object.as_str().into());
        }
        if *localizes {
            table.insert("localizes", true.into());
        }
        table.into()
    }

    fn of(item: &Item) -> Option<Self> {
        let Some(table) = item.as_table_like() else {
            return (item.as_str() == Some("unknown")).then_some(Self::Unknown);
        };
        let numbers = |key: &str| -> Option<Vec<f64>> {
            table.get(key)?.as_array()?.iter().map(number).collect()
        };
        Some(Self::At {
            position_m: numbers("position_m")?.try_into().ok()?,
            orientation_xyzw: numbers("orientation_xyzw")?.try_into().ok()?,
            object: table.get("object").and_then(Item::as_str).map(str::to_owned),
            localizes: table.get("localizes").and_then(Item::as_bool).unwrap_or(false),
        })
    }
}

/// Puts a camera behind the last one.
pub fn add(text: &str, camera: &WrittenCamera) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let keys = CAMERA_KEYS.iter().filter_map(|key| Some((*key, camera.value(key)?)));
    let cameras = document.entry("camera").or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
    match cameras {
        Item::ArrayOfTables(tables) => {
            let mut table = Table::new();
            table.extend(keys);
            // An empty line before it.
            table.decor_mut().set_prefix("\n");
            tables.push(table);
        }
        Item::Value(Value::Array(tables)) => tables.push(InlineTable::from_iter(keys)),
        _ => return Err(EditError::Text("`camera` is no list of tables".to_owned())),
    }
    Ok(document.to_string())
}

/// Gives these keys of a camera other values, as `camera` says; its other keys are not looked at.
pub fn change(
    text: &str,
    name: &str,
    camera: &WrittenCamera,
    keys: &[&str],
) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let table = table_of(&mut document, name)?;
    let before = WrittenCamera::of(table);
    let same = |key: &str| {
        let text = |it: &WrittenCamera| it.value(key).map(|value| value.to_string());
        text(&before) == text(camera)
    };
    for key in keys.iter().filter(|key| !same(key)) {
        match camera.value(key) {
            Some(value) => set(table, key, value),
            None => {
                table.remove(key);
            }
        }
    }
    Ok(document.to_string())
}

/// Takes a camera out, with the comments that stand directly above it.
pub fn remove(text: &str, name: &str) -> Result<String, EditError> {
    let mut document = parse(text)?;
    let index = place_of(&mut document, name)?;
    match document.get_mut("camera") {
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

/// A camera as it is written.
pub fn read(text: &str, name: &str) -> Result<WrittenCamera, EditError> {
    let mut document = parse(text)?;
    Ok(WrittenCamera::of(table_of(&mut document, name)?))
}

/// The key of a camera that stands at that byte of the text, with its value, and the camera's place; `None` between them.
pub fn key_at(text: &str, at: usize) -> Option<(usize, &'static str)> {
    let document = toml_edit::Document::parse(text).ok()?;
    let tables: Vec<&dyn TableLike> = match document.get("camera")? {
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
        // The span of a table with a header of its own is that of the header.
        if let Item::Table(table) = item {
            let ends = table.iter().filter_map(|(_, item)| Some(item.span()?.end));
            end = ends.fold(end, usize::max);
        }
        (begin..end).contains(&at)
    };
    tables.into_iter().enumerate().find_map(|(index, table)| {
        let key = CAMERA_KEYS.into_iter().find(|key| is_there(table, key))?;
        Some((index, key))
    })
}

/// The key of a camera that a message names first.
pub fn key_named(message: &str) -> Option<&'static str> {
    let named = message.split('`').skip(1).step_by(2);
    named.filter_map(|name| CAMERA_KEYS.into_iter().find(|key| *key == name)).next()
}

fn parse(text: &str) -> Result<DocumentMut, EditError> {
    text.parse().map_err(|error: toml_edit::TomlError| EditError::Text(error.to_string()))
}

/// All cameras, in their order.
fn tables(document: &mut DocumentMut) -> Vec<&mut dyn TableLike> {
    match document.get_mut("camera") {
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

fn place_of(document: &mut DocumentMut, name: &str) -> Result<usize, EditError> {
    let named = |table: &&mut dyn TableLike| table.get("name").and_then(Item::as_str) == Some(name);
    let place = tables(document).iter().position(named);
    place.ok_or_else(|| EditError::NoCamera(name.to_owned()))
}

fn table_of<'a>(
    document: &'a mut DocumentMut,
    name: &str,
) -> Result<&'a mut dyn TableLike, EditError> {
    let place = place_of(document, name)?;
    Ok(tables(document).swap_remove(place))
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
            let gone: Vec<String> = before.iter().map(|(key, _)| key.to_owned()).collect();
            for key in gone.iter().filter(|key| !wanted.contains_key(key)) {
                before.remove(key);
            }
            for (key, value) in wanted.iter() {
                set(before, key, value.clone());
            }
        }
        _ => {
            table.insert(key, Item::Value(value));
        }
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

fn polygons(polygons: &[Vec<[f64; 2]>]) -> Value {
    let corner = |corner: &[f64; 2]| Value::Array(corner.iter().copied().collect());
    let polygon = |corners: &Vec<[f64; 2]>| Value::Array(corners.iter().map(corner).collect());
    Value::Array(polygons.iter().map(polygon).collect::<Array>())
}

/// The corners of polygons, as far as they are any.
fn corners(item: &Item) -> Vec<Vec<[f64; 2]>> {
    let corner = |value: &Value| -> Option<[f64; 2]> {
        let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(number).collect();
        numbers?.try_into().ok()
    };
    let polygon = |value: &Value| value.as_array()?.iter().map(corner).collect();
    item.as_array().into_iter().flat_map(Array::iter).filter_map(polygon).collect()
}

fn float(item: &Item) -> Option<f64> {
    item.as_value().and_then(number)
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

#[cfg(test)]
mod tests;

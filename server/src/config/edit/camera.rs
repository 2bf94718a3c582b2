//! A `[[camera]]` as it is written.

use toml_edit::{Array, InlineTable, Item, TableLike, Value};

use super::{Written, float, number, numbers};
use crate::config::camera::CAMERA_KEYS;

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

impl Written for WrittenCamera {
    const SECTION: &'static str = "camera";
    const KEYS: &'static [&'static str] = &CAMERA_KEYS;

    fn name(&self) -> &str {
        &self.name
    }

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
        let text = |key: &str| super::text(table, key);
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
        Some(Self::At {
            position_m: numbers(table, "position_m")?,
            orientation_xyzw: numbers(table, "orientation_xyzw")?,
            object: table.get("object").and_then(Item::as_str).map(str::to_owned),
            localizes: table.get("localizes").and_then(Item::as_bool).unwrap_or(false),
        })
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

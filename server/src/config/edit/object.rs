//! An `[[object]]` as it is written.

use toml_edit::{Array, InlineTable, Item, TableLike, Value};

use super::{EditError, Written, array, float, numbers, parse, set, tables, text};
use crate::config::object::OBJECT_KEYS;

/// An `[[object]]` as it is written; what is `None` is not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WrittenObject {
    /// `name`
    pub name: String,
    /// `roundel`
    pub roundel: Option<WrittenRoundels>,
    /// `code`
    pub code: Option<u32>,
    /// `offset_m`
    pub offset_m: Option<[f64; 3]>,
    /// `motion`
    pub motion: Option<String>,
    /// `height_m`
    pub height_m: Option<f64>,
}

/// `roundel` of an `[[object]]`.
#[derive(Clone, Debug, PartialEq)]
pub enum WrittenRoundels {
    /// One of this kind.
    One(String),
    /// Several at measured places.
    Several(Vec<WrittenMount>),
}

/// One of several roundels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WrittenMount {
    /// `kind`
    pub kind: String,
    /// `code`
    pub code: Option<u32>,
    /// `position_m`
    pub position_m: Option<[f64; 3]>,
    /// `yaw_deg`
    pub yaw_deg: Option<f64>,
    /// `right`
    pub right: Option<[f64; 3]>,
    /// `top`
    pub top: Option<[f64; 3]>,
}

impl Written for WrittenObject {
    const SECTION: &'static str = "object";
    const KEYS: &'static [&'static str] = &OBJECT_KEYS;

    fn name(&self) -> &str {
        &self.name
    }

    fn value(&self, key: &str) -> Option<Value> {
        match key {
            "name" => Some(self.name.as_str().into()),
            "roundel" => self.roundel.as_ref().map(|roundel| match roundel {
                WrittenRoundels::One(kind) => kind.as_str().into(),
                WrittenRoundels::Several(mounts) => {
                    Value::Array(mounts.iter().map(WrittenMount::table).collect::<Array>())
                }
            }),
            "code" => self.code.map(|code| i64::from(code).into()),
            "offset_m" => self.offset_m.map(|offset_m| array(&offset_m)),
            "motion" => self.motion.as_deref().map(Value::from),
            "height_m" => self.height_m.map(Value::from),
            _ => None,
        }
    }

    fn of(table: &dyn TableLike) -> Self {
        Self {
            name: text(table, "name").unwrap_or_default(),
            roundel: table.get("roundel").map(|item| match item.as_str() {
                Some(kind) => WrittenRoundels::One(kind.to_owned()),
                None => WrittenRoundels::Several(mounts(item)),
            }),
            code: whole(table, "code"),
            offset_m: numbers(table, "offset_m"),
            motion: text(table, "motion"),
            height_m: table.get("height_m").and_then(float),
        }
    }
}

impl WrittenMount {
    fn table(&self) -> Value {
        let places = [("position_m", self.position_m), ("right", self.right), ("top", self.top)];
        let mut table = InlineTable::new();
        table.insert("kind", self.kind.as_str().into());
        self.code.into_iter().for_each(|code| {
            table.insert("code", i64::from(code).into());
        });
        for (key, place) in places {
            place.into_iter().for_each(|place| {
                table.insert(key, array(&place));
            });
        }
        self.yaw_deg.into_iter().for_each(|yaw_deg| {
            table.insert("yaw_deg", yaw_deg.into());
        });
        table.into()
    }

    fn of(table: &dyn TableLike) -> Self {
        Self {
            kind: text(table, "kind").unwrap_or_default(),
            code: whole(table, "code"),
            position_m: numbers(table, "position_m"),
            yaw_deg: table.get("yaw_deg").and_then(float),
            right: numbers(table, "right"),
            top: numbers(table, "top"),
        }
    }
}

/// Has cameras that ride on an object ride on it by another name.
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

fn mounts(item: &Item) -> Vec<WrittenMount> {
    if let Item::ArrayOfTables(tables) = item {
        return tables.iter().map(|table| WrittenMount::of(table)).collect();
    }
    let values = item.as_array().into_iter().flat_map(Array::iter);
    values.filter_map(Value::as_inline_table).map(|table| WrittenMount::of(table)).collect()
}

fn whole(table: &dyn TableLike, key: &str) -> Option<u32> {
    table.get(key).and_then(Item::as_integer).and_then(|whole| u32::try_from(whole).ok())
}

//! TOML forms of the messages: `[[camera]]` is a `v1::CameraSetup`, `[[object]]` a `v1::ObjectSetup`.
//!
//! Keys and fields have the same names, and serde converts between them. Points, vectors and quaternions are messages of
//! coordinates, and lists of numbers in TOML: serde reads a message from a list of its fields, so only writing needs a
//! conversion. `pose` and `mask` of a camera and `roundel` of an object have different forms.

use roundel_proto::v1;
use serde::{Serialize, de::DeserializeOwned, de::IntoDeserializer};
use toml_edit::{Array, InlineTable, TableLike, Value, ser::ValueSerializer};

use super::EditError;
use crate::model::config::{camera::CAMERA_KEYS, object::OBJECT_KEYS};

/// Fields of messages that are lists in TOML.
const COORDINATES: [&str; 6] = ["u", "v", "x", "y", "z", "w"];
/// Keys that are written even if empty, so that the error names them.
const REQUIRED: [&str; 2] = ["name", "source"];

/// A message that is a table of a list.
pub trait Message: Serialize + DeserializeOwned {
    const SECTION: &'static str;
    const KEYS: &'static [&'static str];

    /// Converts fields to keys of a different form.
    fn to_keys(&self, table: &mut InlineTable) -> Result<(), EditError>;
    /// Converts keys of a different form to fields.
    fn to_fields(table: &mut InlineTable);
}

impl Message for v1::CameraSetup {
    const SECTION: &'static str = "camera";
    const KEYS: &'static [&'static str] = &CAMERA_KEYS;

    fn to_keys(&self, table: &mut InlineTable) -> Result<(), EditError> {
        if let Some(pose) = &self.pose {
            table.insert("pose", pose_value(pose)?);
        }
        let polygons = self.mask.iter().map(|polygon| value(&polygon.corners));
        table.insert("mask", Value::Array(polygons.collect::<Result<_, _>>()?));
        Ok(())
    }

    fn to_fields(table: &mut InlineTable) {
        if let Some(Value::Array(polygons)) = table.get_mut("mask") {
            for polygon in polygons.iter_mut() {
                *polygon = Value::Array(Array::from_iter([polygon.clone()]));
            }
        }
        if let Some(Value::InlineTable(pose)) = table.get_mut("pose") {
            let place = ["position_m", "orientation_xyzw"].map(|key| pose.remove(key));
            pose.insert("pose", Value::Array(place.into_iter().flatten().collect()));
        } else if let Some(unknown) = table.get_mut("pose") {
            *unknown = Value::InlineTable(InlineTable::from_iter([("unknown", true)]));
        }
    }
}

fn pose_value(pose: &v1::CameraPoseSetup) -> Result<Value, EditError> {
    if pose.unknown {
        return Ok("unknown".into());
    }
    let place = pose.pose.unwrap_or_default();
    let mut table = InlineTable::new();
    table.insert("position_m", value(&place.position.unwrap_or_default())?);
    table.insert("orientation_xyzw", value(&place.orientation.unwrap_or_default())?);
    if !pose.object.is_empty() {
        table.insert("object", pose.object.as_str().into());
    }
    if pose.localizes {
        table.insert("localizes", true.into());
    }
    Ok(table.into())
}

impl Message for v1::ObjectSetup {
    const SECTION: &'static str = "object";
    const KEYS: &'static [&'static str] = &OBJECT_KEYS;

    fn to_keys(&self, table: &mut InlineTable) -> Result<(), EditError> {
        // The list takes precedence.
        let roundels = table.remove("roundels").filter(|_| !self.roundels.is_empty());
        if let Some(roundels) = roundels {
            table.insert("roundel", roundels);
        }
        Ok(())
    }

    fn to_fields(table: &mut InlineTable) {
        if table.get("roundel").is_some_and(Value::is_array) {
            let roundels = table.remove("roundel");
            table.extend(roundels.map(|roundels| ("roundels", roundels)));
        }
    }
}

/// Without absent and empty keys.
pub(super) fn to_table<M: Message>(message: &M) -> Result<InlineTable, EditError> {
    let Value::InlineTable(mut table) = value(message)? else {
        return Err(EditError::Text(format!("`{}` is no table", M::SECTION)));
    };
    message.to_keys(&mut table)?;
    let is_empty = |value: &Value| {
        value.as_str().is_some_and(str::is_empty) || value.as_array().is_some_and(Array::is_empty)
    };
    table.retain(|key, value| REQUIRED.contains(&key) || !is_empty(value));
    Ok(table)
}

pub(super) fn of_table<M: Message>(table: &dyn TableLike) -> Result<M, EditError> {
    let values =
        table.iter().filter_map(|(key, item)| Some((key, item.clone().into_value().ok()?)));
    let mut table = InlineTable::from_iter(values);
    M::to_fields(&mut table);
    let message = M::deserialize(Value::InlineTable(table).into_deserializer());
    message.map_err(|error| EditError::Text(error.to_string()))
}

fn value(message: &impl Serialize) -> Result<Value, EditError> {
    let value = message.serialize(ValueSerializer::new());
    value.map(coordinates_as_lists).map_err(|error| EditError::Text(error.to_string()))
}

fn coordinates_as_lists(value: Value) -> Value {
    match value {
        Value::Array(items) => Value::Array(items.into_iter().map(coordinates_as_lists).collect()),
        Value::InlineTable(fields) => {
            let is_list = fields.iter().all(|(key, _)| COORDINATES.contains(&key));
            let fields = fields.into_iter().map(|(key, value)| (key, coordinates_as_lists(value)));
            if is_list {
                Value::Array(fields.map(|(_, value)| value).collect())
            } else {
                Value::InlineTable(fields.collect())
            }
        }
        scalar => scalar,
    }
}

#[cfg(test)]
mod tests {
    use prost::Message as _;
    use prost_types::FileDescriptorSet;

    use super::*;

    fn fields(message: &str) -> Vec<String> {
        let files = FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap().file;
        let mut messages = files.iter().flat_map(|file| &file.message_type);
        let found = messages.find(|found| found.name() == message).unwrap();
        found.field.iter().map(|field| field.name().to_owned()).collect()
    }

    #[test]
    fn keys_are_the_fields_of_the_messages() {
        assert_eq!(fields("CameraSetup"), CAMERA_KEYS);
        let mut object = fields("ObjectSetup");
        object.retain(|field| field != "roundels");
        assert_eq!(object, OBJECT_KEYS);
    }
}

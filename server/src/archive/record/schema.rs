//! Topics of a recording and their schemas. An MCAP schema of a message holds the descriptors of its file and of all files
//! that it imports.

use std::collections::BTreeSet;

use prost::Message;
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

/// Encoding of schemas and messages.
pub const ENCODING: &str = "protobuf";
/// Name of the metadata record that identifies Roundel's recordings.
pub const METADATA: &str = "roundel";
/// Highest version that this program reads.
pub const FORMAT_VERSION: u32 = 1;
/// Prefix of the topics of frames; the camera's name follows.
pub const FRAME_TOPIC_PREFIX: &str = "/frames/";
/// Schema of a frame, known to viewers of MCAP files.
pub const IMAGE_SCHEMA: &str = "foxglove.CompressedImage";

/// A topic other than frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    Snapshots,
    Observations,
    Events,
    /// Camera updates applied by fusion.
    Calibration,
    Configuration,
    Health,
}

impl Topic {
    /// In the order of their channels.
    pub const ALL: [Self; 6] = [
        Self::Snapshots,
        Self::Observations,
        Self::Events,
        Self::Calibration,
        Self::Configuration,
        Self::Health,
    ];

    fn name_and_schema(self) -> (&'static str, &'static str) {
        match self {
            Self::Snapshots => ("/snapshots", "roundel.v1.Snapshot"),
            Self::Observations => ("/observations", "roundel.v1.FrameObservations"),
            Self::Events => ("/events", "roundel.v1.Event"),
            Self::Calibration => ("/calibration", "roundel.v1.FusedCamera"),
            Self::Configuration => ("/configuration", "roundel.v1.RecordedConfiguration"),
            Self::Health => ("/health", "roundel.v1.ListCamerasResponse"),
        }
    }

    pub fn name(self) -> &'static str {
        self.name_and_schema().0
    }

    pub fn schema(self) -> &'static str {
        self.name_and_schema().1
    }
}

/// The message of [`IMAGE_SCHEMA`].
#[derive(Clone, PartialEq, Message)]
pub struct CompressedImage {
    /// Capture time.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<prost_types::Timestamp>,
    #[prost(bytes = "vec", tag = "2")]
    pub data: Vec<u8>,
    /// `jpeg` or `png`.
    #[prost(string, tag = "3")]
    pub format: String,
    #[prost(string, tag = "4")]
    pub frame_id: String,
}

/// Descriptors of a message of `roundel.v1`, by its full name.
pub fn descriptors(schema: &str) -> Vec<u8> {
    let all = FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap_or_default();
    let name = schema.rsplit('.').next().unwrap_or(schema);
    let has = |file: &&FileDescriptorProto| file.message_type.iter().any(|it| it.name() == name);
    let mut wanted: Vec<&str> = all.file.iter().filter(has).map(|file| file.name()).collect();
    let mut needed = BTreeSet::new();
    while let Some(name) = wanted.pop() {
        if needed.insert(name) {
            let file = all.file.iter().filter(|file| file.name() == name);
            wanted.extend(file.flat_map(|file| &file.dependency).map(String::as_str));
        }
    }
    // Imported files stay ahead of the files that import them.
    let files = all.file.iter().filter(|file| needed.contains(file.name())).cloned();
    let plain = |file| FileDescriptorProto { source_code_info: None, service: Vec::new(), ..file };
    FileDescriptorSet { file: files.map(plain).collect() }.encode_to_vec()
}

/// Descriptors of [`CompressedImage`].
pub fn image_descriptors() -> Vec<u8> {
    let field = |name: &str, number, r#type: Type, of: Option<&str>| FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        label: Some(Label::Optional.into()),
        r#type: Some(r#type.into()),
        type_name: of.map(str::to_owned),
        json_name: Some(name.into()),
        ..FieldDescriptorProto::default()
    };
    let file = |name: &str, package: &str, message: &str, field| FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        syntax: Some("proto3".into()),
        message_type: vec![DescriptorProto {
            name: Some(message.into()),
            field,
            ..DescriptorProto::default()
        }],
        ..FileDescriptorProto::default()
    };
    const TIME: &str = "google/protobuf/timestamp.proto";
    let time = vec![field("seconds", 1, Type::Int64, None), field("nanos", 2, Type::Int32, None)];
    let image = vec![
        field("timestamp", 1, Type::Message, Some(".google.protobuf.Timestamp")),
        field("frame_id", 4, Type::String, None),
        field("data", 2, Type::Bytes, None),
        field("format", 3, Type::String, None),
    ];
    let image = FileDescriptorProto {
        dependency: vec![TIME.into()],
        ..file("foxglove/CompressedImage.proto", "foxglove", "CompressedImage", image)
    };
    let time = file(TIME, "google.protobuf", "Timestamp", time);
    FileDescriptorSet { file: vec![time, image] }.encode_to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_schema_has_its_imports_and_nothing_else() {
        for topic in Topic::ALL {
            let set = FileDescriptorSet::decode(descriptors(topic.schema()).as_slice()).unwrap();
            let names: Vec<&str> = set.file.iter().map(|file| file.name()).collect();
            for (place, file) in set.file.iter().enumerate() {
                for import in &file.dependency {
                    let at = names.iter().position(|name| name == import);
                    assert!(at.is_some_and(|at| at < place), "{topic:?}: {import} in {names:?}");
                }
            }
            let message = topic.schema().trim_start_matches("roundel.v1.");
            let has = |file: &FileDescriptorProto| {
                file.message_type.iter().any(|it| it.name() == message)
            };
            assert!(set.file.iter().any(has), "{topic:?}: {names:?}");
        }
        let set = FileDescriptorSet::decode(descriptors("roundel.v1.Snapshot").as_slice()).unwrap();
        let names: Vec<&str> = set.file.iter().map(|file| file.name()).collect();
        assert_eq!(
            names,
            ["roundel/v1/geometry.proto", "roundel/v1/code.proto", "roundel/v1/snapshot.proto"]
        );
    }
}

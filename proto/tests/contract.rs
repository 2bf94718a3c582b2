//! Compatibility of the `.proto` files: `contract.txt` lists every field, value and call with its number, type and
//! meaning. Entries are added, and never removed or changed in number or type.
//!
//! After an addition: `ROUNDEL_CONTRACT=write cargo test -p roundel-proto --test contract`. It rejects changed numbers
//! and types. A comment may be reworded if its meaning stays the same; the diff of `contract.txt` shows it to reviewers.

use std::{collections::BTreeMap, fs, path::Path};

use prost::Message;
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto,
    FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

const CONTRACT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/contract.txt");
const HOW_TO_UPDATE: &str =
    "to update it: ROUNDEL_CONTRACT=write cargo test -p roundel-proto --test contract";

/// Number and type of a name, and its comment.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Entry {
    shape: String,
    meaning: String,
}

type Contract = BTreeMap<String, Entry>;

#[test]
fn the_contract_is_kept() {
    let now = contract(&FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap());
    let kept = read(&fs::read_to_string(CONTRACT).unwrap_or_default());
    let broken = broken(&kept, &now);
    assert!(broken.is_empty(), "incompatible with roundel.v1:\n{}", broken.join("\n"));
    if std::env::var("ROUNDEL_CONTRACT").is_ok_and(|mode| mode == "write") {
        fs::write(Path::new(CONTRACT), written(&now)).unwrap();
        return;
    }
    for (name, entry) in &now {
        match kept.get(name) {
            None => panic!("{name} is not in {CONTRACT}; {HOW_TO_UPDATE}"),
            Some(kept) => assert_eq!(
                entry.meaning, kept.meaning,
                "the comment of {name} differs from {CONTRACT}; a new meaning needs a new field; {HOW_TO_UPDATE}"
            ),
        }
    }
}

#[test]
fn changed_numbers_types_and_removed_names_are_found() {
    let now = contract(&FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap());
    assert_eq!(broken(&now, &now), Vec::<String>::new());
    assert_eq!(read(&written(&now)), now);
    let field = "Snapshot.pose_time_ns";
    assert_eq!(now[field].shape, "3 int64");
    assert!(now[field].meaning.contains("ns since the Unix epoch"), "{:?}", now[field]);
    for shape in ["3 uint64", "4 int64", "3 repeated int64"] {
        let mut changed = now.clone();
        changed.get_mut(field).unwrap().shape = shape.into();
        let found = broken(&now, &changed);
        assert!(
            found.len() == 1 && found[0].contains(field) && found[0].contains(shape),
            "{found:?}"
        );
    }
    let mut lost = now.clone();
    lost.remove("Roundel.GetTime");
    assert_eq!(broken(&now, &lost).len(), 1);
    // Numbers are unique.
    let numbers = now.iter().filter(|(name, _)| name.starts_with("ObjectState."));
    let mut numbers: Vec<&str> =
        numbers.map(|(_, entry)| entry.shape.split(' ').next().unwrap()).collect();
    let count = numbers.len();
    numbers.sort_unstable();
    numbers.dedup();
    assert_eq!((numbers.len(), count), (18, 18));
}

/// Suffixes that state the unit of a number.
const UNITS: [&str; 11] =
    ["_us", "_ms", "_s", "_hz", "_m", "_mm", "_m_s2", "_rad", "_deg", "_px", "_ppm"];
/// Words that state the unit of a number without such a suffix, or that it has none.
const UNIT_WORDS: [&str; 14] = [
    "metre",
    "radian",
    "second",
    "pixel",
    "grey level",
    "likelihood",
    "share",
    "about 1",
    "axis",
    "half the angle",
    "relative",
    "(position m, rotation rad)",
    "(m/s)^2",
    "without a unit",
];

#[test]
fn every_name_has_a_comment_with_its_unit_and_clock() {
    let now = contract(&FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap());
    let incomplete = incomplete(&now);
    assert!(
        incomplete.is_empty(),
        "these need a comment in proto/roundel/v1 with meaning, unit, and frame or clock:\n{}",
        incomplete.join("\n")
    );
}

#[test]
fn missing_comments_units_and_clocks_are_found() {
    let entry = |shape: &str, meaning: &str| Entry { shape: shape.into(), meaning: meaning.into() };
    let count =
        |name: &str, entry: Entry| incomplete(&Contract::from([(name.into(), entry)])).len();
    assert_eq!(count("Object.name", entry("2 string", "")), 1);
    assert_eq!(count("Object.name", entry("2 string", "Configured name, or empty.")), 0);
    // A time needs its clock or epoch in the comment, and its unit in the name.
    assert_eq!(count("Event.time_ns", entry("2 int64", "When it happened.")), 1);
    assert_eq!(count("Event.time_ns", entry("2 int64", "When, ns since the Unix epoch.")), 0);
    assert_eq!(count("Event.time", entry("2 int64", "When, ns since the Unix epoch.")), 1);
    // A number needs its unit, in the name or in the comment.
    assert_eq!(count("Camera.speed", entry("2 double", "How fast it is.")), 1);
    assert_eq!(count("Camera.speed_px", entry("2 double", "How far it is.")), 0);
    assert_eq!(count("Camera.noise", entry("2 repeated double", "Its deviation, grey levels.")), 0);
}

/// Names with an incomplete comment, each with the missing part.
fn incomplete(contract: &Contract) -> Vec<String> {
    let missing = |(name, Entry { shape, meaning }): (&String, &Entry)| {
        let field = name.rsplit('.').next().unwrap_or_default();
        let mentions =
            |words: &[&str]| words.iter().any(|word| meaning.to_lowercase().contains(word));
        let ends = |units: &[&str]| units.iter().any(|unit| field.ends_with(unit));
        let is_time =
            shape.ends_with("int64") && (field.contains("time") || field.ends_with("_ns"));
        let is_number = shape.split(' ').any(|word| word == "double" || word == "float");
        let problem = if meaning.is_empty() {
            "no comment"
        } else if is_time && !field.ends_with("_ns") {
            "a time without its unit in its name"
        } else if is_time && !mentions(&["unix epoch", "as in", "clock", "time minus"]) {
            "a time without its epoch or clock"
        } else if is_number && !ends(&UNITS) && !mentions(&UNIT_WORDS) {
            "a number without its unit"
        } else {
            return None;
        };
        Some(format!("{name}: {problem}"))
    };
    contract.iter().filter_map(missing).collect()
}

fn broken(kept: &Contract, now: &Contract) -> Vec<String> {
    let check = |(name, entry): (&String, &Entry)| match now.get(name) {
        None => Some(format!("{name} = {} was removed", entry.shape)),
        Some(found) if found.shape != entry.shape => {
            Some(format!("{name}: expected {}, found {}", entry.shape, found.shape))
        }
        Some(_) => None,
    };
    kept.iter().filter_map(check).collect()
}

fn written(contract: &Contract) -> String {
    let head = "# The contract of roundel.v1: names, numbers and types never change. Checked by tests/contract.rs.\n";
    let line = |(name, entry): (&String, &Entry)| {
        format!(
            "{name} = {}{}{}\n",
            entry.shape,
            if entry.meaning.is_empty() { "" } else { "  # " },
            entry.meaning
        )
    };
    std::iter::once(head.to_owned()).chain(contract.iter().map(line)).collect()
}

fn read(text: &str) -> Contract {
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
    let entry = |line: &str| {
        let (name, rest) = line.split_once(" = ").expect("NAME = NUMBER TYPE  # MEANING");
        let (shape, meaning) = rest.split_once("  # ").unwrap_or((rest, ""));
        (name.to_owned(), Entry { shape: shape.to_owned(), meaning: meaning.to_owned() })
    };
    lines.map(entry).collect()
}

fn contract(files: &FileDescriptorSet) -> Contract {
    let mut contract = Contract::new();
    for file in &files.file {
        let comments = Comments::of(file);
        for (index, message) in (0..).zip(&file.message_type) {
            add_message(&mut contract, &comments, message, &[4, index]);
        }
        for (index, values) in (0..).zip(&file.enum_type) {
            add_enumeration(&mut contract, &comments, values, &[5, index]);
        }
        for (index, service) in (0..).zip(&file.service) {
            for (position, method) in (0..).zip(&service.method) {
                let stream =
                    |is_stream: Option<bool>| if is_stream == Some(true) { "stream " } else { "" };
                let shape = format!(
                    "({}{}) returns ({}{})",
                    stream(method.client_streaming),
                    short(method.input_type()),
                    stream(method.server_streaming),
                    short(method.output_type())
                );
                let meaning = comments.at(&[6, index, 2, position]);
                let name = format!("{}.{}", service.name(), method.name());
                contract.insert(name, Entry { shape, meaning });
            }
        }
    }
    contract
}

fn add_message(
    contract: &mut Contract,
    comments: &Comments,
    message: &DescriptorProto,
    path: &[i32],
) {
    for (index, field) in (0..).zip(&message.field) {
        let meaning = comments.at(&[path, &[2, index]].concat());
        let name = format!("{}.{}", message.name(), field.name());
        contract.insert(name, Entry { shape: shape(message, field), meaning });
    }
    assert!(
        message.nested_type.is_empty() && message.enum_type.is_empty(),
        "nested types are not listed yet"
    );
}

fn add_enumeration(
    contract: &mut Contract,
    comments: &Comments,
    values: &EnumDescriptorProto,
    path: &[i32],
) {
    for (index, value) in (0..).zip(&values.value) {
        let meaning = comments.at(&[path, &[2, index]].concat());
        let name = format!("{}.{}", values.name(), value.name());
        contract.insert(name, Entry { shape: value.number().to_string(), meaning });
    }
}

/// `number [optional|repeated] type [of ALTERNATIVES]`.
fn shape(message: &DescriptorProto, field: &FieldDescriptorProto) -> String {
    let name = match field.r#type() {
        Type::Message | Type::Enum => short(field.type_name()).to_owned(),
        plain => plain.as_str_name().trim_start_matches("TYPE_").to_ascii_lowercase(),
    };
    let label = match field.label() {
        Label::Repeated => "repeated ",
        _ if field.proto3_optional() => "optional ",
        _ => "",
    };
    let alternatives = match field.oneof_index {
        Some(index) if !field.proto3_optional() => {
            format!(" of {}", message.oneof_decl[index as usize].name())
        }
        _ => String::new(),
    };
    format!("{} {label}{name}{alternatives}", field.number())
}

fn short(name: &str) -> &str {
    name.trim_start_matches(".roundel.v1.")
}

/// Leading comments by path in the file, each on one line.
struct Comments(BTreeMap<Vec<i32>, String>);

impl Comments {
    fn of(file: &FileDescriptorProto) -> Self {
        let locations = file.source_code_info.iter().flat_map(|info| &info.location);
        let comment = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        Self(locations.map(|at| (at.path.clone(), comment(at.leading_comments()))).collect())
    }

    fn at(&self, path: &[i32]) -> String {
        self.0.get(path).cloned().unwrap_or_default()
    }
}

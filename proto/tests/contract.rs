//! Holds the `.proto` files to what clients build on: `contract.txt` has every field, value and call with its number,
//! type and meaning. What stands there is never changed; what is new is added.
//!
//! After adding something: `ROUNDEL_CONTRACT=write cargo test -p roundel-proto --test contract`. It refuses to write a
//! change of a number or type. Words may be made clearer, which shows in the diff of `contract.txt`; there whoever
//! reviews sees that they still mean the same.

use std::{collections::BTreeMap, fs, path::Path};

use prost::Message;
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto,
    FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

const CONTRACT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/contract.txt");
const HOW: &str =
    "if it is new, ROUNDEL_CONTRACT=write cargo test -p roundel-proto --test contract adds it";

/// What a name is bound to: `= number type`, and what it means.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Entry {
    shape: String,
    meaning: String,
}

type Contract = BTreeMap<String, Entry>;

#[test]
fn what_clients_build_on_is_as_it_was() {
    let now = contract(&FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap());
    let kept = read(&fs::read_to_string(CONTRACT).unwrap_or_default());
    let broken = broken(&kept, &now);
    assert!(broken.is_empty(), "roundel.v1 has promised otherwise:\n{}", broken.join("\n"));
    if std::env::var("ROUNDEL_CONTRACT").is_ok_and(|what| what == "write") {
        fs::write(Path::new(CONTRACT), written(&now)).unwrap();
        return;
    }
    for (name, entry) in &now {
        match kept.get(name) {
            None => panic!("{name} is not in {CONTRACT}; {HOW}"),
            Some(kept) => assert_eq!(
                entry.meaning, kept.meaning,
                "{name} says something else than in {CONTRACT}: a new meaning wants a new field; {HOW}, and clearer words too"
            ),
        }
    }
}

#[test]
fn a_changed_number_or_type_and_a_lost_field_are_broken_promises() {
    let now = contract(&FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap());
    assert_eq!(broken(&now, &now), Vec::<String>::new());
    assert_eq!(read(&written(&now)), now);
    let field = "Snapshot.pose_time_ns";
    assert_eq!(now[field].shape, "3 int64");
    assert!(now[field].meaning.contains("ns since the Unix epoch"), "{:?}", now[field]);
    for shape in ["3 uint64", "4 int64", "3 repeated int64"] {
        let mut changed = now.clone();
        changed.get_mut(field).unwrap().shape = shape.into();
        let told = broken(&now, &changed);
        assert!(told.len() == 1 && told[0].contains(field) && told[0].contains(shape), "{told:?}");
    }
    let mut lost = now.clone();
    lost.remove("Roundel.GetTime");
    assert_eq!(broken(&now, &lost).len(), 1);
    // Nobody may take a number that something else had.
    let numbers = now.iter().filter(|(name, _)| name.starts_with("ObjectState."));
    let mut numbers: Vec<&str> =
        numbers.map(|(_, entry)| entry.shape.split(' ').next().unwrap()).collect();
    let count = numbers.len();
    numbers.sort_unstable();
    numbers.dedup();
    assert_eq!((numbers.len(), count), (17, 17));
}

/// Endings of names that say the unit of a number.
const UNITS: [&str; 11] =
    ["_us", "_ms", "_s", "_hz", "_m", "_mm", "_m_s2", "_rad", "_deg", "_px", "_ppm"];
/// Words that say what a number without such an ending counts in, or that it has no unit.
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
fn everything_that_clients_build_on_says_what_it_means() {
    let now = contract(&FileDescriptorSet::decode(roundel_proto::DESCRIPTORS).unwrap());
    let wordless = wordless(&now);
    assert!(
        wordless.is_empty(),
        "a comment above each of these in proto/roundel/v1 has to say what it is, and its unit, frame or time base:\n{}",
        wordless.join("\n")
    );
}

#[test]
fn a_field_without_words_and_a_number_without_its_unit_are_found() {
    let entry = |shape: &str, meaning: &str| Entry { shape: shape.into(), meaning: meaning.into() };
    let told = |name: &str, entry: Entry| wordless(&Contract::from([(name.into(), entry)])).len();
    assert_eq!(told("Object.name", entry("2 string", "")), 1);
    assert_eq!(told("Object.name", entry("2 string", "Configured name, or empty.")), 0);
    // A time says its clock or epoch, and its unit in its name.
    assert_eq!(told("Event.time_ns", entry("2 int64", "When it happened.")), 1);
    assert_eq!(told("Event.time_ns", entry("2 int64", "When, ns since the Unix epoch.")), 0);
    assert_eq!(told("Event.time", entry("2 int64", "When, ns since the Unix epoch.")), 1);
    // A number says its unit, in its name or in words.
    assert_eq!(told("Camera.speed", entry("2 double", "How fast it is.")), 1);
    assert_eq!(told("Camera.speed_px", entry("2 double", "How far it is.")), 0);
    assert_eq!(told("Camera.noise", entry("2 repeated double", "Its deviation, grey levels.")), 0);
}

/// What does not say what it means, each with what is missing.
fn wordless(contract: &Contract) -> Vec<String> {
    let missing = |(name, Entry { shape, meaning }): (&String, &Entry)| {
        let field = name.rsplit('.').next().unwrap_or_default();
        let says = |words: &[&str]| words.iter().any(|word| meaning.to_lowercase().contains(word));
        let ends = |units: &[&str]| units.iter().any(|unit| field.ends_with(unit));
        let is_time =
            shape.ends_with("int64") && (field.contains("time") || field.ends_with("_ns"));
        let is_number = shape.split(' ').any(|word| word == "double" || word == "float");
        let what = if meaning.is_empty() {
            "no words"
        } else if is_time && !field.ends_with("_ns") {
            "a time without its unit in its name"
        } else if is_time && !says(&["unix epoch", "as in", "clock", "time less"]) {
            "a time without its epoch or clock"
        } else if is_number && !ends(&UNITS) && !says(&UNIT_WORDS) {
            "a number without its unit"
        } else {
            return None;
        };
        Some(format!("{name}: {what}"))
    };
    contract.iter().filter_map(missing).collect()
}

/// What was promised and is not so.
fn broken(kept: &Contract, now: &Contract) -> Vec<String> {
    let check = |(name, entry): (&String, &Entry)| match now.get(name) {
        None => Some(format!("{name} = {} is gone", entry.shape)),
        Some(found) if found.shape != entry.shape => {
            Some(format!("{name}: expected {}, found {}", entry.shape, found.shape))
        }
        Some(_) => None,
    };
    kept.iter().filter_map(check).collect()
}

fn written(contract: &Contract) -> String {
    let head = "# What clients of roundel.v1 build on: never changed, only added to. Checked by tests/contract.rs.\n";
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
            for (place, method) in (0..).zip(&service.method) {
                let stream =
                    |is_stream: Option<bool>| if is_stream == Some(true) { "stream " } else { "" };
                let shape = format!(
                    "({}{}) returns ({}{})",
                    stream(method.client_streaming),
                    short(method.input_type()),
                    stream(method.server_streaming),
                    short(method.output_type())
                );
                let meaning = comments.at(&[6, index, 2, place]);
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
        "none so far; add them here"
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

/// What stands above each thing in a file, on one line.
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

//! `[[object]]`: what carries roundels, known by a whole kind of them, by one code, or by several roundels
//! at measured places.
//!
//! Places are what a tape measure gives: the centre of each print from the object's origin, and how the print is
//! turned, for one that lies flat by an angle, for any other by the ways that its right and its top point to.

use nalgebra::Vector3;
use roundel_core::{
    id::KindId,
    marker::{Code, Pattern},
    rigid::Rigid,
    world::{Body, MotionClass, Mount},
};

use super::{
    ReferenceConfig, geometry,
    reader::Table,
    roundel::{ParsedKinds, kind_named, motion},
};

pub const OBJECT_KEYS: [&str; 6] = ["name", "roundel", "code", "offset_m", "motion", "height_m"];
const PART_KEYS: [&str; 6] = ["kind", "code", "position_m", "yaw_deg", "right", "top"];
const MAX_CODES: usize = u16::MAX as usize;

/// `[[object]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectConfig {
    pub name: String,
    pub carries: ObjectRoundels,
}

/// The roundels that an object is known by.
#[derive(Clone, Debug, PartialEq)]
pub enum ObjectRoundels {
    Kind {
        kind: KindId,
        /// The tracked point in the roundel's frame, metres.
        offset_m: Vector3<f64>,
        /// How it moves, if not as its kind says.
        motion: Option<MotionClass>,
    },
    /// Several at known places, or one of known code; or none, if a camera on it finds itself.
    Body(Body),
}

/// What is taken: by whom, for errors.
struct Claims<'a> {
    kinds: &'a ParsedKinds,
    references: &'a [ReferenceConfig],
    taken: Vec<(KindId, Option<Code>, String)>,
}

/// The objects that could be read.
pub(super) struct ParsedObjects<'t, 'i> {
    pub(super) configs: Vec<ObjectConfig>,
    /// Of all, those that could not be read included.
    pub(super) names: Vec<&'t str>,
    tables: Vec<Table<'t, 'i>>,
    /// Of each that could be read.
    table_of: Vec<usize>,
}

/// No roundel is on two objects, or on one of them and among the references.
pub(super) fn objects<'t, 'i>(
    root: &Table<'t, 'i>,
    kinds: &ParsedKinds,
    references: &[ReferenceConfig],
) -> ParsedObjects<'t, 'i> {
    let tables = root.tables("object", "[[object]]", &OBJECT_KEYS);
    let mut claims = Claims { kinds, references, taken: Vec::new() };
    let (mut configs, mut table_of, mut names) = (Vec::<ObjectConfig>::new(), vec![], vec![]);
    for (index, table) in tables.iter().enumerate() {
        let name = table.required_text("name", "\"robot one\"");
        names.extend(name);
        let shown = name.unwrap_or("?");
        let carries = match table.value("roundel") {
            None => object_without_roundels(table),
            Some(it) if it.get_ref().as_array().is_some() => {
                several(table, shown, kinds, &mut claims)
            }
            Some(_) => single(table, shown, kinds, &mut claims),
        };
        let (Some(name), Some(carries)) = (name, carries) else { continue };
        if configs.iter().any(|object| object.name == name) {
            let message = format!("two objects are named \"{name}\"");
            table.fail_with_help(&table.span_of("name"), message, "give each its own name");
        }
        configs.push(ObjectConfig { name: name.to_owned(), carries });
        table_of.push(index);
    }
    ParsedObjects { configs, names, tables, table_of }
}

impl ParsedObjects<'_, '_> {
    /// Those that nothing is printed on.
    pub(super) fn without_roundels(&self) -> impl Iterator<Item = usize> + '_ {
        let is_bare = |object: &ObjectConfig| match &object.carries {
            ObjectRoundels::Kind { .. } => false,
            ObjectRoundels::Body(body) => body.mounts.is_empty(),
        };
        (0..self.configs.len()).filter(move |&index| is_bare(&self.configs[index]))
    }

    /// Reports that nobody can tell where one of them is, which a camera may ride on.
    pub(super) fn report_unobservable(&self, object: usize, carries_camera: bool) {
        let table = &self.tables[self.table_of[object]];
        if !carries_camera {
            return table.report_missing("roundel", "\"robot\"");
        }
        let name = &self.configs[object].name;
        table.fail_with_help(
            table.span(),
            format!(
                "object \"{name}\" carries no roundel, and its camera does not say where it is"
            ),
            "add its `roundel`, or `localizes = true` to the pose of the camera that rides on it",
        );
    }
}

/// An object that is known by what its own camera sees.
fn object_without_roundels(table: &Table<'_, '_>) -> Option<ObjectRoundels> {
    for key in ["code", "offset_m"].into_iter().filter(|key| table.value(key).is_some()) {
        table.fail_with_help(
            &table.span_of(key),
            format!("`{key}` is for an object with one roundel, and `roundel` is missing"),
            "add `roundel = \"NAME\"`",
        );
    }
    let motion = explicit_motion(table)?.unwrap_or_default();
    Some(ObjectRoundels::Body(Body { motion, mounts: Vec::new() }))
}

/// An object by one roundel, of a kind that is its own or with a code.
fn single(
    table: &Table<'_, '_>,
    name: &str,
    kinds: &ParsedKinds,
    claims: &mut Claims<'_>,
) -> Option<ObjectRoundels> {
    let kind = kind_named(table, "roundel", kinds);
    let offset = match table.value("offset_m") {
        Some(_) => table.numbers::<3>("offset_m"),
        None => Some([0.0; 3]),
    };
    let motion = explicit_motion(table)?;
    let (kind, offset_m) = (kind?, Vector3::from(offset?));
    if table.value("code").is_none() {
        claims.take(table, "roundel", (kind, None), name)?;
        return Some(ObjectRoundels::Kind { kind, offset_m, motion });
    }
    let code = code(table, kind, kinds)?;
    claims.take(table, "code", (kind, code), name)?;
    let object_from_roundel = Rigid::translation(-offset_m.x, -offset_m.y, -offset_m.z);
    let mounts = vec![Mount { kind, code, object_from_roundel }];
    let motion = motion.unwrap_or_else(|| inherited_motion(&mounts[0], kinds));
    Some(ObjectRoundels::Body(Body { motion, mounts }))
}

/// An object by a list of roundels.
fn several(
    table: &Table<'_, '_>,
    name: &str,
    kinds: &ParsedKinds,
    claims: &mut Claims<'_>,
) -> Option<ObjectRoundels> {
    for key in ["code", "offset_m"].into_iter().filter(|key| table.value(key).is_some()) {
        table.fail_with_help(
            &table.span_of(key),
            format!("`{key}` is for an object with one roundel, and `roundel` lists several"),
            "each roundel of the list has its own `code`, and `position_m` from the object's origin",
        );
    }
    let motion = explicit_motion(table);
    let parts = table.tables("roundel", "[[object.roundel]]", &PART_KEYS);
    if parts.is_empty() && !table.is_broken() {
        table.fail_with_help(
            &table.span_of("roundel"),
            "`roundel` lists no roundel",
            "an object is known by one roundel at least",
        );
    }
    let mut mounts = Vec::new();
    let mut is_whole = true;
    for part in &parts {
        match mount(part, name, kinds, claims) {
            Some(mount) => mounts.push(mount),
            None => is_whole = false,
        }
    }
    let first = mounts.first().filter(|_| is_whole)?;
    let motion = motion?.unwrap_or_else(|| inherited_motion(first, kinds));
    Some(ObjectRoundels::Body(Body { motion, mounts }))
}

fn mount(
    part: &Table<'_, '_>,
    name: &str,
    kinds: &ParsedKinds,
    claims: &mut Claims<'_>,
) -> Option<Mount> {
    let kind = kind_named(part, "kind", kinds);
    let position = part.required_numbers::<3>("position_m", "[0.2, 0.0, 0.1]");
    let rotation = geometry::rotation(part, "the object's frame");
    let kind = kind?;
    let code = code(part, kind, kinds)?;
    let key = if code.is_some() { "code" } else { "kind" };
    claims.take(part, key, (kind, code), name)?;
    let object_from_roundel = Rigid::from_parts(Vector3::from(position?).into(), rotation?);
    Some(Mount { kind, code, object_from_roundel })
}

/// How the object itself is said to move; `None` if that is wrong (then it is reported).
fn explicit_motion(table: &Table<'_, '_>) -> Option<Option<MotionClass>> {
    let is_said = table.value("motion").is_some() || table.value("height_m").is_some();
    if is_said { motion(table).map(Some) } else { Some(None) }
}

/// As the kind of its first roundel moves, whose height is that of the roundel.
fn inherited_motion(first: &Mount, kinds: &ParsedKinds) -> MotionClass {
    let above_m = first.object_from_roundel.translation.z;
    match kinds.motions.get(usize::from(first.kind.0)).copied().unwrap_or_default() {
        MotionClass::Ground { height_m } => {
            MotionClass::Ground { height_m: height_m.map(|height_m| height_m - above_m) }
        }
        MotionClass::Free => MotionClass::Free,
    }
}

/// The code of a coded roundel; `None` within for one of another kind, outside if it is wrong or missing
/// (then it is reported).
pub(super) fn code(
    table: &Table<'_, '_>,
    kind: KindId,
    kinds: &ParsedKinds,
) -> Option<Option<Code>> {
    let kind = kinds.kinds.get(usize::from(kind.0))?;
    let Pattern::Coded(layout) = kind.pattern else {
        if table.value("code").is_none() {
            return Some(None);
        }
        table.fail_with_help(
            &table.span_of("code"),
            format!("roundels \"{}\" have no codes", kind.name),
            "leave out `code`, or name a [[roundel]] with `code = { bits = … }`",
        );
        return None;
    };
    if table.value("code").is_none() {
        table.report_missing("code", "3");
        return None;
    }
    let number = table.whole("code", 0..=MAX_CODES)?;
    let count = layout.codes().ok()?.len();
    if number == 0 || number > count {
        table.fail_with_help(
            &table.span_of("code"),
            format!("`code` must be 1 to {count}, found {number}"),
            format!(
                "roundels \"{}\" have {count} identities: {} bits at `min_distance` {}",
                kind.name, layout.bits, layout.min_distance
            ),
        );
        return None;
    }
    let number = u16::try_from(number).ok()?;
    Some(Some(Code { bits: layout.bits, number }))
}

impl Claims<'_> {
    fn is_coded(&self, kind: KindId) -> bool {
        let kind = self.kinds.kinds.get(usize::from(kind.0));
        kind.is_some_and(|kind| matches!(kind.pattern, Pattern::Coded(_)))
    }

    /// Takes a roundel for an object; reports it and gives `None` if it is another's, or its own twice.
    fn take(
        &mut self,
        table: &Table<'_, '_>,
        key: &str,
        (kind, code): (KindId, Option<Code>),
        name: &str,
    ) -> Option<()> {
        let is_reference =
            |it: &ReferenceConfig| it.kind == kind && (code.is_none() || it.code == code);
        let reference = self.references.iter().position(is_reference);
        let same =
            |(other, taken, _): &&(KindId, Option<Code>, String)| (*other, *taken) == (kind, code);
        let owner = match (self.taken.iter().find(same), reference) {
            (Some((.., owner)), _) if owner == name => None,
            (Some((.., owner)), _) => Some(format!("objects \"{owner}\" and \"{name}\"")),
            (None, Some(index)) => Some(format!("reference {} and object \"{name}\"", index + 1)),
            (None, None) => {
                self.taken.push((kind, code, name.to_owned()));
                return Some(());
            }
        };
        let (what, remedy) = match code {
            Some(code) => (
                format!("code {}", code.number),
                "a code is on one print: give the other one its own",
            ),
            None if self.is_coded(kind) => (
                "the same kind of roundel".to_owned(),
                "write the `code` of the object's own roundel",
            ),
            None => (
                "the same kind of roundel".to_owned(),
                "roundels of one kind without codes cannot be told apart: print another ratio for one \
                 of them",
            ),
        };
        let message = match owner {
            Some(both) => format!("{both} carry {what}"),
            None => format!("object \"{name}\" carries {what} twice"),
        };
        table.fail_with_help(&table.span_of(key), message, remedy);
        None
    }
}

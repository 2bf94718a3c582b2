//! `[[object]]`: an object identified by a kind of roundel, by one code, or by several roundels at measured positions.
//!
//! A position is the centre of a print from the object's origin. The orientation of a flat print is an angle; that of
//! any other is given by the directions of its right and its top.

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
    roundel::{ParsedKinds, motion},
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

#[derive(Clone, Debug, PartialEq)]
pub enum ObjectRoundels {
    Kind {
        kind: KindId,
        /// The tracked point in the roundel's frame, metres.
        offset_m: Vector3<f64>,
        /// `None`: as its kind.
        motion: Option<MotionClass>,
    },
    /// Several at known positions, one with a code, or none if a camera on it localizes itself.
    Body(Body),
}

/// Roundels that belong to an object, with its name.
struct Claims<'a> {
    kinds: &'a ParsedKinds,
    references: &'a [ReferenceConfig],
    taken: Vec<(KindId, Option<Code>, String)>,
}

pub(super) struct ParsedObjects<'t, 'i> {
    /// The readable objects.
    pub(super) configs: Vec<ObjectConfig>,
    /// Names of all objects, including unreadable ones.
    pub(super) names: Vec<&'t str>,
    /// Tables of the readable objects.
    tables: Vec<Table<'t, 'i>>,
}

/// A roundel belongs to one object, or to the references.
pub(super) fn objects<'t, 'i>(
    root: &Table<'t, 'i>,
    kinds: &ParsedKinds,
    references: &[ReferenceConfig],
) -> ParsedObjects<'t, 'i> {
    let mut claims = Claims { kinds, references, taken: Vec::new() };
    let mut objects = ParsedObjects { configs: Vec::new(), names: Vec::new(), tables: Vec::new() };
    for table in root.tables("object", "[[object]]", &OBJECT_KEYS) {
        let name = table.required_text("name", "\"robot one\"");
        objects.names.extend(name);
        let shown = name.unwrap_or("?");
        let carries = match table.value("roundel") {
            None => without_roundels(&table),
            Some(it) if it.get_ref().is_array() => several(&table, shown, &mut claims),
            Some(_) => single(&table, shown, &mut claims),
        };
        let (Some(name), Some(carries)) = (name, carries) else { continue };
        if objects.configs.iter().any(|object| object.name == name) {
            let message = format!("two objects are named \"{name}\"");
            table.fail("name", message, "give each its own name");
        }
        objects.configs.push(ObjectConfig { name: name.to_owned(), carries });
        objects.tables.push(table);
    }
    objects
}

impl ParsedObjects<'_, '_> {
    /// Indices of the objects without roundels.
    pub(super) fn without_roundels(&self) -> impl Iterator<Item = usize> + '_ {
        let is_bare = |object: &ObjectConfig| match &object.carries {
            ObjectRoundels::Kind { .. } => false,
            ObjectRoundels::Body(body) => body.mounts.is_empty(),
        };
        (0..self.configs.len()).filter(move |&index| is_bare(&self.configs[index]))
    }

    /// Reports an object that nothing can localize.
    pub(super) fn report_unobservable(&self, object: usize, carries_camera: bool) {
        let (table, name) = (&self.tables[object], &self.configs[object].name);
        if !carries_camera {
            return table.require("roundel", "\"robot\"");
        }
        let message = format!(
            "object \"{name}\" carries no roundel, and its camera does not say where it is"
        );
        let help =
            "add its `roundel`, or `localizes = true` to the pose of the camera that rides on it";
        table.fail("roundel", message, help);
    }
}

/// Reports keys that only an object with one roundel has.
fn reject_keys_of_single(table: &Table<'_, '_>, why: &str, help: &str) {
    for key in ["code", "offset_m"].into_iter().filter(|key| table.has(key)) {
        let message = format!("`{key}` is for an object with one roundel, and `roundel` {why}");
        table.fail(key, message, help);
    }
}

/// An object that its own camera localizes.
fn without_roundels(table: &Table<'_, '_>) -> Option<ObjectRoundels> {
    reject_keys_of_single(table, "is missing", "add `roundel = \"NAME\"`");
    let motion = explicit_motion(table)?.unwrap_or_default();
    Some(ObjectRoundels::Body(Body { motion, mounts: Vec::new() }))
}

/// An object with one roundel, which has a code or a kind of its own.
fn single(table: &Table<'_, '_>, name: &str, claims: &mut Claims<'_>) -> Option<ObjectRoundels> {
    let kind = claims.kinds.named(table, "roundel");
    let offset = if table.has("offset_m") { table.numbers("offset_m") } else { Some([0.0; 3]) };
    let motion = explicit_motion(table)?;
    let (kind, offset_m) = (kind?, Vector3::from(offset?));
    if !table.has("code") {
        claims.take(table, "roundel", (kind, None), name)?;
        return Some(ObjectRoundels::Kind { kind, offset_m, motion });
    }
    let code = code(table, kind, claims.kinds)?;
    claims.take(table, "code", (kind, code), name)?;
    let object_from_roundel = Rigid::translation(-offset_m.x, -offset_m.y, -offset_m.z);
    let mount = Mount { kind, code, object_from_roundel };
    let motion = motion.unwrap_or_else(|| inherited_motion(&mount, claims.kinds));
    Some(ObjectRoundels::Body(Body { motion, mounts: vec![mount] }))
}

/// An object with a list of roundels.
fn several(table: &Table<'_, '_>, name: &str, claims: &mut Claims<'_>) -> Option<ObjectRoundels> {
    reject_keys_of_single(
        table,
        "lists several",
        "each roundel of the list has its own `code`, and `position_m` from the object's origin",
    );
    let motion = explicit_motion(table);
    let parts = table.tables("roundel", "[[object.roundel]]", &PART_KEYS);
    if parts.is_empty() && !table.is_broken() {
        let help = "an object is known by one roundel at least";
        table.fail("roundel", "`roundel` lists no roundel", help);
    }
    let mounts: Vec<_> = parts.iter().map(|part| mount(part, name, claims)).collect();
    let mounts = mounts.into_iter().collect::<Option<Vec<Mount>>>()?;
    let motion = motion?.unwrap_or(inherited_motion(mounts.first()?, claims.kinds));
    Some(ObjectRoundels::Body(Body { motion, mounts }))
}

fn mount(part: &Table<'_, '_>, name: &str, claims: &mut Claims<'_>) -> Option<Mount> {
    let kind = claims.kinds.named(part, "kind");
    let position = part.required_numbers::<3>("position_m", "[0.2, 0.0, 0.1]");
    let rotation = geometry::rotation(part, "the object's frame");
    let kind = kind?;
    let code = code(part, kind, claims.kinds)?;
    let key = if code.is_some() { "code" } else { "kind" };
    claims.take(part, key, (kind, code), name)?;
    let object_from_roundel = Rigid::from_parts(Vector3::from(position?).into(), rotation?);
    Some(Mount { kind, code, object_from_roundel })
}

/// The object's own motion, if it has one; `None` if wrong.
fn explicit_motion(table: &Table<'_, '_>) -> Option<Option<MotionClass>> {
    if table.has("motion") || table.has("height_m") { motion(table).map(Some) } else { Some(None) }
}

/// The motion of the kind of the first roundel; its height is that of the roundel.
fn inherited_motion(first: &Mount, kinds: &ParsedKinds) -> MotionClass {
    let above_m = first.object_from_roundel.translation.z;
    match kinds.motions.get(usize::from(first.kind.0)).copied().unwrap_or_default() {
        MotionClass::Ground { height_m } => {
            MotionClass::Ground { height_m: height_m.map(|height_m| height_m - above_m) }
        }
        MotionClass::Free => MotionClass::Free,
    }
}

/// The code, or none for a kind without codes; `None` if missing or wrong.
pub(super) fn code(
    table: &Table<'_, '_>,
    kind: KindId,
    kinds: &ParsedKinds,
) -> Option<Option<Code>> {
    let name = &kinds.kinds.get(usize::from(kind.0))?.name;
    let Pattern::Coded(layout) = kinds.pattern(kind) else {
        if !table.has("code") {
            return Some(None);
        }
        let help = "leave out `code`, or name a [[roundel]] with `code = { bits = … }`";
        return table.reject("code", format!("roundels \"{name}\" have no codes"), help);
    };
    table.require("code", "3");
    let number = table.whole("code", 0..=MAX_CODES)?;
    let count = kinds.code_count(kind);
    if number == 0 || number > count {
        return table.reject(
            "code",
            format!("`code` must be 1 to {count}, found {number}"),
            format!(
                "roundels \"{name}\" have {count} identities: {} bits at `min_distance` {}",
                layout.bits, layout.min_distance
            ),
        );
    }
    let number = u16::try_from(number).ok()?;
    Some(Some(Code { bits: layout.bits, number }))
}

impl Claims<'_> {
    /// Takes a roundel for an object; `None` if it is taken already.
    fn take(
        &mut self,
        table: &Table<'_, '_>,
        key: &str,
        (kind, code): (KindId, Option<Code>),
        name: &str,
    ) -> Option<()> {
        let is_same =
            |(other, taken, _): &&(KindId, Option<Code>, String)| (*other, *taken) == (kind, code);
        let owner = self.taken.iter().find(is_same).map(|(.., owner)| owner);
        let is_reference =
            |it: &ReferenceConfig| it.kind == kind && (code.is_none() || it.code == code);
        let reference = self.references.iter().position(is_reference);
        let (what, remedy) = match (code, self.kinds.pattern(kind)) {
            (Some(code), _) => (
                format!("code {}", code.number),
                "a code is on one print: give the other one its own",
            ),
            (None, Pattern::Coded(_)) => (
                "the same kind of roundel".to_owned(),
                "write the `code` of the object's own roundel",
            ),
            (None, _) => (
                "the same kind of roundel".to_owned(),
                "roundels of one kind without codes cannot be distinguished: print another ratio for one \
                 of them",
            ),
        };
        let message = match (owner, reference) {
            (Some(owner), _) if owner == name => format!("object \"{name}\" carries {what} twice"),
            (Some(owner), _) => format!("objects \"{owner}\" and \"{name}\" carry {what}"),
            (None, Some(index)) => {
                format!("reference {} and object \"{name}\" carry {what}", index + 1)
            }
            (None, None) => {
                self.taken.push((kind, code, name.to_owned()));
                return Some(());
            }
        };
        table.reject(key, message, remedy)
    }
}

//! `[[object]]`: what carries roundels, known by a whole kind of them, by one code, or by several roundels
//! at measured places.
//!
//! Places are what a tape measure gives: the centre of each print from the object's origin, and how the print is
//! turned, for one that lies flat by an angle, for any other by the ways that its right and its top point to.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use roundel_core::{
    id::KindId,
    marker::{Code, Pattern},
    rigid::Rigid,
    world::{Body, MotionClass, Mount},
};

use super::{
    Carried, ObjectConfig,
    reader::{Allowed, Table},
    roundel::{NamedKinds, kind_named, motion},
};

const OBJECT_KEYS: [&str; 6] = ["name", "roundel", "code", "offset_m", "motion", "height_m"];
const PART_KEYS: [&str; 6] = ["kind", "code", "position_m", "yaw_deg", "right", "top"];
const MOST_CODES: usize = u16::MAX as usize;
/// `right` and `top` may be off from a right angle by this, as the sine of what is missing.
const SQUARE_TOLERANCE: f64 = 0.02;

/// What is taken: by whom, for errors.
struct Claims {
    taken: Vec<(KindId, Option<Code>, String)>,
}

pub(super) fn objects(root: &Table<'_, '_>, kinds: &NamedKinds) -> Vec<ObjectConfig> {
    let tables = root.tables("object", "[[object]]", &OBJECT_KEYS);
    let mut claims = Claims { taken: Vec::new() };
    let mut objects: Vec<ObjectConfig> = Vec::new();
    for table in &tables {
        let name = table.required_text("name", "\"robot one\"");
        let shown = name.unwrap_or("?");
        let is_list = table.value("roundel").is_some_and(|it| it.get_ref().as_array().is_some());
        let carries = if is_list {
            several(table, shown, kinds, &mut claims)
        } else {
            single(table, shown, kinds, &mut claims)
        };
        let (Some(name), Some(carries)) = (name, carries) else { continue };
        if objects.iter().any(|object| object.name == name) {
            let message = format!("two objects are named \"{name}\"");
            table.fail_with_help(&table.span_of("name"), message, "give each its own name");
        }
        objects.push(ObjectConfig { name: name.to_owned(), carries });
    }
    objects
}

/// An object by one roundel, of a kind that is its own or with a code.
fn single(
    table: &Table<'_, '_>,
    name: &str,
    kinds: &NamedKinds,
    claims: &mut Claims,
) -> Option<Carried> {
    let kind = kind_named(table, "roundel", kinds);
    let offset = match table.value("offset_m") {
        Some(_) => table.numbers::<3>("offset_m"),
        None => Some([0.0; 3]),
    };
    let motion = own_motion(table)?;
    let (kind, offset_m) = (kind?, Vector3::from(offset?));
    if table.value("code").is_none() {
        claims.take(table, "roundel", (kind, None), name)?;
        return Some(Carried::Kind { kind, offset_m, motion });
    }
    let code = code(table, kind, kinds)?;
    claims.take(table, "code", (kind, code), name)?;
    let object_from_roundel = Rigid::translation(-offset_m.x, -offset_m.y, -offset_m.z);
    let mounts = vec![Mount { kind, code, object_from_roundel }];
    let motion = motion.unwrap_or_else(|| inherited(&mounts[0], kinds));
    Some(Carried::Body(Body { motion, mounts }))
}

/// An object by a list of roundels.
fn several(
    table: &Table<'_, '_>,
    name: &str,
    kinds: &NamedKinds,
    claims: &mut Claims,
) -> Option<Carried> {
    for key in ["code", "offset_m"].into_iter().filter(|key| table.value(key).is_some()) {
        table.fail_with_help(
            &table.span_of(key),
            format!("`{key}` is for an object with one roundel, and `roundel` lists several"),
            "each roundel of the list has its own `code`, and `position_m` from the object's origin",
        );
    }
    let motion = own_motion(table);
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
    let motion = motion?.unwrap_or_else(|| inherited(first, kinds));
    Some(Carried::Body(Body { motion, mounts }))
}

/// One roundel of a list.
fn mount(
    part: &Table<'_, '_>,
    name: &str,
    kinds: &NamedKinds,
    claims: &mut Claims,
) -> Option<Mount> {
    let kind = kind_named(part, "kind", kinds);
    let position = part.required_numbers::<3>("position_m", "[0.2, 0.0, 0.1]");
    let rotation = rotation(part);
    let kind = kind?;
    let code = code(part, kind, kinds)?;
    let key = if code.is_some() { "code" } else { "kind" };
    claims.take(part, key, (kind, code), name)?;
    let object_from_roundel = Rigid::from_parts(Vector3::from(position?).into(), rotation?);
    Some(Mount { kind, code, object_from_roundel })
}

/// How the object itself is said to move; `None` if that is wrong (then it is reported).
fn own_motion(table: &Table<'_, '_>) -> Option<Option<MotionClass>> {
    let is_said = table.value("motion").is_some() || table.value("height_m").is_some();
    if is_said { motion(table).map(Some) } else { Some(None) }
}

/// As the kind of its first roundel moves, whose height is that of the roundel.
fn inherited(first: &Mount, kinds: &NamedKinds) -> MotionClass {
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
fn code(table: &Table<'_, '_>, kind: KindId, kinds: &NamedKinds) -> Option<Option<Code>> {
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
    let number = table.whole("code", 0..=MOST_CODES)?;
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

/// How a print is turned on its object; `None` if it is wrong (then it is reported).
fn rotation(part: &Table<'_, '_>) -> Option<UnitQuaternion<f64>> {
    let (right, top) = (part.value("right").is_some(), part.value("top").is_some());
    if !right && !top {
        let yaw_deg = part.number("yaw_deg", Allowed::Within(360.0), 0.0);
        return Some(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_deg.to_radians()));
    }
    if part.value("yaw_deg").is_some() {
        part.fail_with_help(
            &part.span_of("yaw_deg"),
            "`yaw_deg` turns a print that lies flat, `right` and `top` any print: found both",
            "leave out `yaw_deg`",
        );
        return None;
    }
    let right = part.required_numbers::<3>("right", "[0.0, 1.0, 0.0]").map(Vector3::from);
    let top = part.required_numbers::<3>("top", "[0.0, 0.0, 1.0]").map(Vector3::from);
    let (right, top) = (right?, top?);
    let (Some(x), Some(y)) = (right.try_normalize(1e-9), top.try_normalize(1e-9)) else {
        part.fail(&part.span_of("right"), "`right` and `top` must point somewhere, found zeros");
        return None;
    };
    if x.dot(&y).abs() > SQUARE_TOLERANCE {
        let between_deg = x.dot(&y).acos().to_degrees();
        part.fail_with_help(
            &part.span_of("top"),
            format!("`right` and `top` must be at right angles, found {between_deg:.1} degrees"),
            "they are the ways in the object's frame that the print's right and its top point to",
        );
        return None;
    }
    let z = x.cross(&y).normalize();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    Some(UnitQuaternion::from_rotation_matrix(&rotation))
}

impl Claims {
    /// Takes a roundel for an object; reports it and gives `None` if it is another's, or its own twice.
    fn take(
        &mut self,
        table: &Table<'_, '_>,
        key: &str,
        (kind, code): (KindId, Option<Code>),
        name: &str,
    ) -> Option<()> {
        let same =
            |(other, taken, _): &&(KindId, Option<Code>, String)| (*other, *taken) == (kind, code);
        let Some((.., owner)) = self.taken.iter().find(same) else {
            self.taken.push((kind, code, name.to_owned()));
            return Some(());
        };
        let (what, remedy) = match code {
            Some(code) => (
                format!("code {}", code.number),
                "a code is on one print: give the other one its own",
            ),
            None => (
                "the same kind of roundel".to_owned(),
                "roundels of one kind without codes cannot be told apart: print another ratio for one \
                 of them",
            ),
        };
        let message = if owner == name {
            format!("object \"{name}\" carries {what} twice")
        } else {
            format!("objects \"{owner}\" and \"{name}\" carry {what}")
        };
        table.fail_with_help(&table.span_of(key), message, remedy);
        None
    }
}

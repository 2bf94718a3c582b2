//! `[[roundel]]`: the kinds of roundel in use, and which of them cannot be told apart.

use roundel_core::{
    id::KindId,
    marker::{
        AXIS_RATIO_LIMIT, CodeLayout, Kind, Pattern, Polarity, RATIO_LIMITS, is_measurable,
        tells_heading,
    },
    world::MotionClass,
};

use super::reader::{NumberRange, Table};
use crate::model::suggestion::{list, nearest};

const ROUNDEL_KEYS: [&str; 8] =
    ["name", "outer_mm", "inner_mm", "inner_minor_mm", "code", "polarity", "motion", "height_m"];
const CODE_KEYS: [&str; 2] = ["bits", "min_distance"];
pub const POLARITIES: [(&str, Polarity); 2] =
    [("black_ring", Polarity::BlackRing), ("white_ring", Polarity::WhiteRing)];

/// The words for how objects move: whether on the ground.
const MOTIONS: [(&str, bool); 2] = [("free", false), ("ground", true)];
const MAX_HEIGHT_M: f64 = 1000.0;

/// Kinds whose ratios of diameters (of elliptical discs, both of them) differ by less than this, relatively, are mixed up.
const MIN_RATIO_DIFFERENCE: f64 = 0.1;
const MAX_DIAMETER_MM: f64 = 100_000.0;

/// The kinds that could be read, and whether these are all.
pub(super) struct ParsedKinds {
    pub(super) kinds: Vec<Kind>,
    /// How the objects that carry them move.
    pub(super) motions: Vec<MotionClass>,
    pub(super) complete: bool,
}

pub(super) fn kinds(root: &Table<'_, '_>) -> ParsedKinds {
    let tables = root.tables("roundel", "[[roundel]]", &ROUNDEL_KEYS);
    if root.value("roundel").is_none() {
        root.fail_with_help(
            &root.span().clone(),
            "no kind of roundel is configured",
            "add [[roundel]] with `name`, `outer_mm` and `inner_mm` as measured on the print",
        );
    }
    let mut kinds: Vec<Kind> = Vec::new();
    let mut motions = Vec::new();
    let mut complete = true;
    for table in &tables {
        let kind = kind(table).filter(|kind| is_distinct(table, kind, &kinds));
        match (kind, motion(table)) {
            (Some(kind), Some(motion)) => {
                kinds.push(kind);
                motions.push(motion);
            }
            _ => complete = false,
        }
    }
    ParsedKinds { kinds, motions, complete }
}

/// How what carries it moves; `None` if it is wrong (then it is reported).
pub(super) fn motion(table: &Table<'_, '_>) -> Option<MotionClass> {
    let is_ground = match table.value("motion") {
        Some(_) => table.choice("motion", &MOTIONS)?,
        None => false,
    };
    if table.value("height_m").is_none() {
        return Some(if is_ground {
            MotionClass::Ground { height_m: None }
        } else {
            MotionClass::Free
        });
    }
    if !is_ground {
        table.fail_with_help(
            &table.span_of("height_m"),
            "`height_m` is the height of what drives, and this may fly",
            "write motion = \"ground\", or leave out `height_m`",
        );
        return None;
    }
    let height_m = table.required_number("height_m", NumberRange::Within(MAX_HEIGHT_M), "0.3")?;
    Some(MotionClass::Ground { height_m: Some(height_m) })
}

fn kind(table: &Table<'_, '_>) -> Option<Kind> {
    let size = NumberRange::PositiveUpTo(MAX_DIAMETER_MM);
    let name = table.required_text("name", "\"robot\"");
    let outer_mm = table.required_number("outer_mm", size, "160.0");
    let pattern = pattern(table);
    let polarity = match table.value("polarity") {
        Some(_) => table.choice("polarity", &POLARITIES),
        None => Some(Polarity::default()),
    };
    let inner_mm = match (&pattern, outer_mm) {
        // Coded prints have one ratio, so it need not be written.
        (Some(Pattern::Coded(_)), Some(outer_mm)) if table.value("inner_mm").is_none() => {
            Some(outer_mm * CodeLayout::RATIO)
        }
        _ => table.required_number("inner_mm", size, "64.0"),
    };
    let (name, outer_mm, inner_mm) = (name?, outer_mm?, inner_mm?);
    let (pattern, polarity) = (pattern?, polarity?);
    if inner_mm >= outer_mm {
        table.fail(
            &table.span_of("inner_mm"),
            format!("`inner_mm` must be below `outer_mm` = {outer_mm}, found {inner_mm}"),
        );
        return None;
    }
    let kind = Kind { pattern, polarity, ..Kind::plain(name, outer_mm * 1e-3, inner_mm * 1e-3) };
    if !is_measurable(kind.ratio()) {
        let (least, most) = RATIO_LIMITS;
        table.fail_with_help(
            &table.span_of("inner_mm"),
            format!(
                "`inner_mm` must be {least} to {most} of `outer_mm` = {outer_mm}, found {inner_mm}, \
                 which is {:.3} of it",
                kind.ratio()
            ),
            "outside of this either the disc or the ring is too thin to be measured",
        );
        return None;
    }
    with_ellipse(table, kind)
}

/// The kind with the elliptical disc that `inner_minor_mm` makes of it, if it is there; `None` if it is
/// wrong (then it is reported).
fn with_ellipse(table: &Table<'_, '_>, kind: Kind) -> Option<Kind> {
    if table.value("inner_minor_mm").is_none() {
        return Some(kind);
    }
    let span = table.span_of("inner_minor_mm");
    if let Pattern::Coded(_) = kind.pattern {
        let message =
            "`inner_minor_mm` is the shorter diameter of an elliptical disc, which has no `code`";
        table.fail_with_help(&span, message, "leave out one of them");
        return None;
    }
    let size = NumberRange::PositiveUpTo(MAX_DIAMETER_MM);
    let minor_mm = table.required_number("inner_minor_mm", size, "64.0")?;
    let minor_diameter_m = minor_mm * 1e-3;
    let (outer_m, inner_m) = (kind.outer_diameter_m, kind.inner_diameter_m);
    if !(is_measurable(minor_diameter_m / outer_m) && tells_heading(minor_diameter_m / inner_m)) {
        table.fail_with_help(
            &span,
            format!(
                "`inner_minor_mm` must be {:.1} to {:.1} here ({} of `outer_mm` to {AXIS_RATIO_LIMIT} \
                 of `inner_mm`), found {minor_mm}",
                RATIO_LIMITS.0 * outer_m * 1e3,
                AXIS_RATIO_LIMIT * inner_m * 1e3,
                RATIO_LIMITS.0
            ),
            "`inner_mm` is the disc's longer diameter; of a round disc leave out `inner_minor_mm`",
        );
        return None;
    }
    let pattern = Pattern::Elliptical { minor_diameter_m };
    Some(Kind { pattern, ..kind })
}

/// What is inside the ring, but for an ellipse; `None` if it is wrong (then it is reported).
fn pattern(table: &Table<'_, '_>) -> Option<Pattern> {
    let Some(value) = table.value("code") else { return Some(Pattern::Plain) };
    const EXAMPLE: &str =
        "write code = { bits = 8, min_distance = 2 }, as the roundels were printed";
    if value.get_ref().as_table().is_none() {
        table.fail_with_help(&value.span(), "`code` must be a table", EXAMPLE);
        return None;
    }
    let code = table.table("code", "code", &CODE_KEYS)?;
    if code.value("bits").is_none() {
        code.report_missing("bits", "8");
    }
    let (fewest, most) = CodeLayout::BITS;
    let bits = code.whole("bits", usize::from(fewest)..=usize::from(most));
    let min_distance = match code.value("min_distance") {
        Some(_) => code.whole("min_distance", 1..=usize::from(most)),
        None => Some(1),
    };
    let (bits, min_distance) = (bits?, min_distance?);
    let layout = CodeLayout {
        bits: u8::try_from(bits).ok()?,
        min_distance: u8::try_from(min_distance).ok()?,
    };
    match layout.check() {
        Ok(()) => Some(Pattern::Coded(layout)),
        Err(error) => {
            code.fail(&code.span_of("min_distance"), format!("`min_distance`: {error}"));
            None
        }
    }
}

/// Whether a kind can be told from the earlier ones; if not, it is reported.
fn is_distinct(table: &Table<'_, '_>, kind: &Kind, earlier: &[Kind]) -> bool {
    let name = &kind.name;
    for other in earlier {
        if other.name == *name {
            let message = format!("two kinds of roundel are named \"{name}\"");
            table.fail_with_help(&table.span_of("name"), message, "give each its own name");
            return false;
        }
        if let Some((common, remedy)) = shared_signature(kind, other) {
            let message = format!(
                "roundels \"{}\" and \"{name}\" cannot be told apart: {common}",
                other.name
            );
            let key = if table.value("code").is_some() { "code" } else { "inner_mm" };
            table.fail_with_help(&table.span_of(key), message, remedy);
            return false;
        }
    }
    true
}

/// What two kinds have in common so that nothing tells them apart, and the remedy. Plain, coded and
/// elliptical ones always differ, and so do black and white rings.
fn shared_signature(kind: &Kind, other: &Kind) -> Option<(String, &'static str)> {
    if kind.polarity != other.polarity {
        return None;
    }
    match (kind.pattern, other.pattern) {
        (Pattern::Plain, Pattern::Plain) => {
            let (ratio, other_ratio) = (kind.ratio(), other.ratio());
            are_ratios_alike(ratio, other_ratio).then(|| {
                (
                    format!("inner to outer diameter {other_ratio:.3} and {ratio:.3}"),
                    "kinds are told apart by this ratio: make them differ by a tenth at least",
                )
            })
        }
        (Pattern::Coded(layout), Pattern::Coded(other)) => (layout.bits == other.bits).then(|| {
            (
                format!("both have codes of {} bits", layout.bits),
                "give one of them codes of other bits; prints of one size need one [[roundel]] only",
            )
        }),
        (
            Pattern::Elliptical { minor_diameter_m },
            Pattern::Elliptical { minor_diameter_m: other_minor_m },
        ) => {
            let (minor, other_minor) =
                (minor_diameter_m / kind.outer_diameter_m, other_minor_m / other.outer_diameter_m);
            let (major, other_major) = (kind.ratio(), other.ratio());
            (are_ratios_alike(major, other_major) && are_ratios_alike(minor, other_minor)).then(|| {
                (
                    format!(
                        "the disc's diameters are {other_major:.3} and {other_minor:.3} of the outer \
                         one, and {major:.3} and {minor:.3}"
                    ),
                    "elliptical ones are told apart by both ratios: make one differ by a tenth at least",
                )
            })
        }
        _ => None,
    }
}

/// Whether two ratios of diameters are mixed up.
fn are_ratios_alike(one: f64, other: f64) -> bool {
    (one - other).abs() < MIN_RATIO_DIFFERENCE * one.max(other)
}

/// The kind that `roundel = …`, or another key, names.
pub(super) fn kind_named(
    table: &Table<'_, '_>,
    key: &'static str,
    kinds: &ParsedKinds,
) -> Option<KindId> {
    let name = table.required_text(key, "\"robot\"")?;
    let place = kinds.kinds.iter().position(|kind| kind.name == name);
    // A kind that is itself wrong is reported where it stands, not at each of its uses.
    if place.is_none() && kinds.complete {
        let names = || kinds.kinds.iter().map(|kind| kind.name.as_str());
        let meant = nearest(name, names())
            .map(|meant| format!("; did you mean \"{meant}\"?"))
            .unwrap_or_default();
        table.fail_with_help(
            &table.span_of(key),
            format!("no [[roundel]] is named \"{name}\"{meant}"),
            format!("configured: {}", list(names())),
        );
    }
    place.and_then(|place| u16::try_from(place).ok()).map(KindId)
}

//! `[[roundel]]`: the kinds of roundel in use, which must be distinguishable.

use roundel_core::{
    id::KindId,
    marker::{
        AXIS_RATIO_LIMIT, CodeLayout, Kind, Pattern, Polarity, RATIO_LIMITS, is_measurable,
        shows_heading,
    },
    world::MotionClass,
};

use super::reader::{NumberRange, Table};
use crate::model::suggestion::{did_you_mean, list};

const ROUNDEL_KEYS: [&str; 9] = [
    "name",
    "outer_mm",
    "inner_mm",
    "inner_minor_mm",
    "tolerance",
    "code",
    "polarity",
    "motion",
    "height_m",
];
pub const POLARITIES: [(&str, Polarity); 2] =
    [("black_ring", Polarity::BlackRing), ("white_ring", Polarity::WhiteRing)];

/// Whether objects move on the ground.
const MOTIONS: [(&str, bool); 2] = [("free", false), ("ground", true)];
const MAX_HEIGHT_M: f64 = 1000.0;

/// Relative difference of the ratios of diameters (of elliptical discs, both) that is needed to tell kinds apart.
const MIN_RATIO_DIFFERENCE: f64 = 0.1;
const MAX_DIAMETER_MM: f64 = 100_000.0;
/// Relative tolerance of printed diameters: "fit to page" is within it.
const DEFAULT_TOLERANCE: f64 = 0.03;
const MAX_TOLERANCE: f64 = 0.1;

pub(super) struct ParsedKinds {
    /// The readable kinds.
    pub(super) kinds: Vec<Kind>,
    /// How the objects that carry them move.
    pub(super) motions: Vec<MotionClass>,
    /// Relative tolerances of their diameters.
    pub(super) tolerances: Vec<f64>,
    /// Number of identities of each kind; 0 without codes.
    code_counts: Vec<usize>,
    /// Whether all kinds are readable.
    pub(super) complete: bool,
}

impl ParsedKinds {
    /// The kind that `roundel = …`, or another key, names.
    pub(super) fn named(&self, table: &Table<'_, '_>, key: &'static str) -> Option<KindId> {
        let name = table.required_text(key, "\"robot\"")?;
        let place = self.kinds.iter().position(|kind| kind.name == name);
        // Problems of an unreadable kind are reported there, not at each of its uses.
        if place.is_none() && self.complete && table.is_full() {
            table.fail(key, "", "");
        } else if place.is_none() && self.complete {
            let names = || self.kinds.iter().map(|kind| kind.name.as_str());
            let meant = did_you_mean(name, names());
            let message = format!("no [[roundel]] is named \"{name}\"{meant}");
            table.fail(key, message, format!("configured: {}", list(names())));
        }
        place.and_then(|place| u16::try_from(place).ok()).map(KindId)
    }

    /// Number of identities; 0 without codes.
    pub(super) fn code_count(&self, kind: KindId) -> usize {
        self.code_counts.get(usize::from(kind.0)).copied().unwrap_or(0)
    }

    /// Plain for an unknown kind.
    pub(super) fn pattern(&self, kind: KindId) -> Pattern {
        self.kinds.get(usize::from(kind.0)).map_or(Pattern::Plain, |kind| kind.pattern)
    }
}

pub(super) fn kinds(root: &Table<'_, '_>) -> ParsedKinds {
    let tables = root.tables("roundel", "[[roundel]]", &ROUNDEL_KEYS);
    if !root.has("roundel") {
        let help =
            "add [[roundel]] with `name`, `outer_mm` and `inner_mm` as measured on the print";
        root.fail("roundel", "no kind of roundel is configured", help);
    }
    let (kinds, motions, tolerances, code_counts) = Default::default();
    let mut parsed = ParsedKinds { kinds, motions, tolerances, code_counts, complete: true };
    for table in &tables {
        let kind = kind(table).filter(|kind| is_distinct(table, kind, &parsed.kinds));
        if let (Some(kind), Some(motion)) = (kind, motion(table)) {
            let count = match kind.pattern {
                Pattern::Coded(layout) => layout.codes().map_or(0, |codes| codes.len()),
                _ => 0,
            };
            parsed.kinds.push(kind);
            parsed.motions.push(motion);
            let range = NumberRange::ZeroUpTo(MAX_TOLERANCE);
            parsed.tolerances.push(table.number("tolerance", range, DEFAULT_TOLERANCE));
            parsed.code_counts.push(count);
        } else {
            parsed.complete = false;
        }
    }
    parsed
}

/// `motion` and `height_m`; `None` if wrong.
pub(super) fn motion(table: &Table<'_, '_>) -> Option<MotionClass> {
    let is_ground = table.has("motion") && table.choice("motion", &MOTIONS)?;
    if !is_ground && table.has("height_m") {
        let message = "`height_m` is the height of what drives, and this may fly";
        let help = "write motion = \"ground\", or leave out `height_m`";
        return table.reject("height_m", message, help);
    }
    let height_m = table.optional_number("height_m", NumberRange::Within(MAX_HEIGHT_M));
    if height_m.is_none() && table.has("height_m") {
        return None;
    }
    Some(if is_ground { MotionClass::Ground { height_m } } else { MotionClass::Free })
}

fn kind(table: &Table<'_, '_>) -> Option<Kind> {
    let size = NumberRange::PositiveUpTo(MAX_DIAMETER_MM);
    let name = table.required_text("name", "\"robot\"");
    let outer_mm = table.required_number("outer_mm", size, "160.0");
    let pattern = pattern(table);
    let polarity = if table.has("polarity") {
        table.choice("polarity", &POLARITIES)
    } else {
        Some(Polarity::default())
    };
    let inner_mm = match (&pattern, outer_mm) {
        // Coded prints have one ratio.
        (Some(Pattern::Coded(_)), Some(outer_mm)) if !table.has("inner_mm") => {
            Some(outer_mm * CodeLayout::RATIO)
        }
        _ => table.required_number("inner_mm", size, "64.0"),
    };
    let (name, outer_mm, inner_mm) = (name?, outer_mm?, inner_mm?);
    let (pattern, polarity) = (pattern?, polarity?);
    if inner_mm >= outer_mm {
        let message = format!("`inner_mm` must be below `outer_mm` = {outer_mm}, found {inner_mm}");
        return table.reject("inner_mm", message, "");
    }
    let kind = Kind { pattern, polarity, ..Kind::plain(name, outer_mm * 1e-3, inner_mm * 1e-3) };
    if !is_measurable(kind.ratio()) {
        let (least, most) = RATIO_LIMITS;
        return table.reject(
            "inner_mm",
            format!(
                "`inner_mm` must be {least} to {most} of `outer_mm` = {outer_mm}, found {inner_mm}, \
                 which is {:.3} of it",
                kind.ratio()
            ),
            "outside of this either the disc or the ring is too thin to be measured",
        );
    }
    with_ellipse(table, kind)
}

/// Makes the disc elliptical if `inner_minor_mm` is given; `None` if wrong.
fn with_ellipse(table: &Table<'_, '_>, kind: Kind) -> Option<Kind> {
    if !table.has("inner_minor_mm") {
        return Some(kind);
    }
    if let Pattern::Coded(_) = kind.pattern {
        let message =
            "`inner_minor_mm` is the shorter diameter of an elliptical disc, which has no `code`";
        return table.reject("inner_minor_mm", message, "leave out one of them");
    }
    let size = NumberRange::PositiveUpTo(MAX_DIAMETER_MM);
    let minor_mm = table.optional_number("inner_minor_mm", size)?;
    let minor_diameter_m = minor_mm * 1e-3;
    let (outer_m, inner_m) = (kind.outer_diameter_m, kind.inner_diameter_m);
    if !(is_measurable(minor_diameter_m / outer_m) && shows_heading(minor_diameter_m / inner_m)) {
        return table.reject(
            "inner_minor_mm",
            format!(
                "`inner_minor_mm` must be {:.1} to {:.1} here ({} of `outer_mm` to {AXIS_RATIO_LIMIT} \
                 of `inner_mm`), found {minor_mm}",
                RATIO_LIMITS.0 * outer_m * 1e3,
                AXIS_RATIO_LIMIT * inner_m * 1e3,
                RATIO_LIMITS.0
            ),
            "`inner_mm` is the disc's longer diameter; of a round disc leave out `inner_minor_mm`",
        );
    }
    Some(Kind { pattern: Pattern::Elliptical { minor_diameter_m }, ..kind })
}

/// Plain or coded; `None` if wrong.
fn pattern(table: &Table<'_, '_>) -> Option<Pattern> {
    let Some(value) = table.value("code") else { return Some(Pattern::Plain) };
    if value.get_ref().as_table().is_none() {
        let help = "write code = { bits = 8, min_distance = 2 }, as the roundels were printed";
        return table.reject("code", "`code` must be a table", help);
    }
    let code = table.table("code", "code", &["bits", "min_distance"])?;
    code.require("bits", "8");
    let (fewest_cameras, most) = CodeLayout::BITS;
    let bits = code.whole("bits", usize::from(fewest_cameras)..=usize::from(most));
    let min_distance = if code.has("min_distance") {
        code.whole("min_distance", 1..=usize::from(most))
    } else {
        Some(1)
    };
    let layout = CodeLayout {
        bits: u8::try_from(bits?).ok()?,
        min_distance: u8::try_from(min_distance?).ok()?,
    };
    if let Err(error) = layout.check() {
        return code.reject("min_distance", format!("`min_distance`: {error}"), "");
    }
    Some(Pattern::Coded(layout))
}

/// Reports a kind that cannot be distinguished from an earlier one.
fn is_distinct(table: &Table<'_, '_>, kind: &Kind, earlier: &[Kind]) -> bool {
    let name = &kind.name;
    for other in earlier {
        if other.name == *name {
            let message = format!("two kinds of roundel are named \"{name}\"");
            table.fail("name", message, "give each its own name");
            return false;
        }
        if let Some((common, remedy)) = shared_signature(kind, other) {
            let other = &other.name;
            let message =
                format!("roundels \"{other}\" and \"{name}\" cannot be distinguished: {common}");
            table.fail(if table.has("code") { "code" } else { "inner_mm" }, message, remedy);
            return false;
        }
    }
    true
}

/// What makes two kinds indistinguishable, and the remedy. Plain, coded and elliptical ones always differ, and so do
/// black and white rings.
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
                    "kinds are distinguished by this ratio: make them differ by a tenth at least",
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
                    "elliptical ones are distinguished by both ratios: make one differ by a tenth at least",
                )
            })
        }
        _ => None,
    }
}

fn are_ratios_alike(one: f64, other: f64) -> bool {
    (one - other).abs() < MIN_RATIO_DIFFERENCE * one.max(other)
}

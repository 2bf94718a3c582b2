//! `[[reference]]`: roundels with known places, and what cameras find from them.

use std::ops::Range;

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{id::KindId, marker::Code};

use super::{
    geometry,
    object::code,
    reader::{NumberRange, Table},
    roundel::{ParsedKinds, kind_named},
};

const REFERENCE_KEYS: [&str; 7] =
    ["roundel", "code", "position_m", "uncertainty_mm", "yaw_deg", "right", "top"];
/// Who surveys by hand reaches this, millimetres …
const DEFAULT_UNCERTAINTY_MM: f64 = 1.0;
/// … and what is worse than this is no reference.
const MAX_UNCERTAINTY_MM: f64 = 1000.0;
const TURN_KEYS: [&str; 3] = ["yaw_deg", "right", "top"];

/// `[[reference]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceConfig {
    pub kind: KindId,
    /// Its code, if that is known.
    pub code: Option<Code>,
    /// Its centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each coordinate, metres.
    pub deviation_m: f64,
    /// world_from_roundel, if that is known.
    pub orientation: Option<UnitQuaternion<f64>>,
}

/// The references that could be read.
pub(super) struct ParsedReferences<'t, 'i> {
    pub(super) configs: Vec<ReferenceConfig>,
    tables: Vec<Table<'t, 'i>>,
    /// Whether the key is there at all.
    is_written: bool,
}

pub(super) fn references<'t, 'i>(
    root: &Table<'t, 'i>,
    kinds: &ParsedKinds,
) -> ParsedReferences<'t, 'i> {
    let tables = root.tables("reference", "[[reference]]", &REFERENCE_KEYS);
    let configs = tables.iter().filter_map(|table| reference(table, kinds)).collect();
    let is_written = root.value("reference").is_some();
    let references = ParsedReferences { configs, tables, is_written };
    references.check_distinct();
    references
}

fn reference(table: &Table<'_, '_>, kinds: &ParsedKinds) -> Option<ReferenceConfig> {
    let kind = kind_named(table, "roundel", kinds);
    let position = table.required_numbers::<3>("position_m", "[0.0, 0.0, 0.0]");
    let is_turned = TURN_KEYS.iter().any(|key| table.value(key).is_some());
    let orientation = if is_turned { Some(geometry::rotation(table, "the world")?) } else { None };
    let allowed = NumberRange::PositiveUpTo(MAX_UNCERTAINTY_MM);
    let deviation_m = table.number("uncertainty_mm", allowed, DEFAULT_UNCERTAINTY_MM) * 1e-3;
    let kind = kind?;
    let code = if table.value("code").is_some() { code(table, kind, kinds)? } else { None };
    let position_m = Vector3::from(position?);
    Some(ReferenceConfig { kind, code, position_m, deviation_m, orientation })
}

impl ParsedReferences<'_, '_> {
    pub(super) fn are_missing(&self) -> bool {
        !self.is_written
    }

    /// Each of them could be read: only then they are judged together.
    fn are_complete(&self) -> bool {
        self.configs.len() == self.tables.len()
    }

    fn places(&self) -> Vec<Vector3<f64>> {
        self.configs.iter().map(|reference| reference.position_m).collect()
    }

    /// Whether a camera in motion can find itself from them, as far as they could be read.
    pub(super) fn localize(&self) -> bool {
        let says_all = |it: &ReferenceConfig| it.code.is_some() && it.orientation.is_some();
        let broken = self.is_written && !self.are_complete();
        broken || self.configs.iter().any(says_all) || !geometry::collinear(&self.places())
    }

    fn check_distinct(&self) {
        if !self.are_complete() {
            return;
        }
        if let Some((first, second)) = geometry::coincident_points(&self.places()) {
            self.tables[second].fail(
                &self.tables[second].span_of("position_m"),
                format!("references {} and {} have the same place", first + 1, second + 1),
            );
        }
        for (second, it) in self.configs.iter().enumerate() {
            let is_same = |other: &ReferenceConfig| {
                it.code.is_some() && (other.kind, other.code) == (it.kind, it.code)
            };
            let Some(first) = self.configs[..second].iter().position(is_same) else { continue };
            let number = it.code.map_or(0, |code| code.number);
            self.tables[second].fail_with_help(
                &self.tables[second].span_of("code"),
                format!("references {} and {} carry code {number}", first + 1, second + 1),
                "a code is on one print: give the other one its own",
            );
        }
    }

    /// Reports what keeps a camera that stands from finding its place.
    pub(super) fn check_sufficient_for_localization(&self) {
        let Some(last) = self.tables.last().filter(|_| self.are_complete()) else { return };
        let places = self.places();
        let span: Range<usize> = last.span().clone();
        if places.len() < 3 {
            last.fail_with_help(
                &span,
                format!("expected at least 3 reference roundels, found {}", places.len()),
                "add [[reference]] tables until there are three that are not in one line",
            );
        } else if geometry::coincident_points(&places).is_none() && geometry::collinear(&places) {
            last.fail_with_help(
                &span,
                "all reference roundels lie in one line",
                "a camera's place does not follow from points in one line: move one of them aside",
            );
        }
    }
}

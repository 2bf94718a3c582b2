//! `[[reference]]`: roundels at known positions, with which cameras are localized.

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{id::KindId, marker::Code};

use super::{
    geometry,
    object::code,
    reader::{NumberRange, Table},
    roundel::ParsedKinds,
};

const REFERENCE_KEYS: [&str; 7] =
    ["roundel", "code", "position_m", "uncertainty_mm", "yaw_deg", "right", "top"];
/// Accuracy of a survey by hand.
const DEFAULT_UNCERTAINTY_MM: f64 = 1.0;
const MAX_UNCERTAINTY_MM: f64 = 1000.0;

/// `[[reference]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceConfig {
    pub kind: KindId,
    pub code: Option<Code>,
    /// Its centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each coordinate, metres.
    pub deviation_m: f64,
    /// world_from_roundel, if known.
    pub orientation: Option<UnitQuaternion<f64>>,
}

pub(super) struct ParsedReferences<'t, 'i> {
    /// The readable references.
    pub(super) configs: Vec<ReferenceConfig>,
    tables: Vec<Table<'t, 'i>>,
    is_written: bool,
}

pub(super) fn references<'t, 'i>(
    root: &Table<'t, 'i>,
    kinds: &ParsedKinds,
) -> ParsedReferences<'t, 'i> {
    let tables = root.tables("reference", "[[reference]]", &REFERENCE_KEYS);
    let configs = tables.iter().filter_map(|table| reference(table, kinds)).collect();
    let references = ParsedReferences { configs, tables, is_written: root.has("reference") };
    references.check_distinct();
    references
}

fn reference(table: &Table<'_, '_>, kinds: &ParsedKinds) -> Option<ReferenceConfig> {
    let kind = kinds.named(table, "roundel");
    let position = table.required_numbers::<3>("position_m", "[0.0, 0.0, 0.0]");
    let is_turned = ["yaw_deg", "right", "top"].iter().any(|key| table.has(key));
    let orientation = if is_turned { Some(geometry::rotation(table, "the world")?) } else { None };
    let allowed = NumberRange::PositiveUpTo(MAX_UNCERTAINTY_MM);
    let deviation_m = table.number("uncertainty_mm", allowed, DEFAULT_UNCERTAINTY_MM) * 1e-3;
    let kind = kind?;
    let code = if table.has("code") { code(table, kind, kinds)? } else { None };
    let position_m = Vector3::from(position?);
    Some(ReferenceConfig { kind, code, position_m, deviation_m, orientation })
}

impl ParsedReferences<'_, '_> {
    pub(super) fn are_missing(&self) -> bool {
        !self.is_written
    }

    /// Whether all are readable; otherwise they are not checked together.
    fn are_complete(&self) -> bool {
        self.configs.len() == self.tables.len()
    }

    fn places(&self) -> Vec<Vector3<f64>> {
        self.configs.iter().map(|reference| reference.position_m).collect()
    }

    /// Whether a moving camera can localize itself with them, as far as they are readable.
    pub(super) fn localize(&self) -> bool {
        let is_full = |it: &ReferenceConfig| it.code.is_some() && it.orientation.is_some();
        let broken = self.is_written && !self.are_complete();
        broken || self.configs.iter().any(is_full) || !geometry::collinear(&self.places())
    }

    fn check_distinct(&self) {
        if !self.are_complete() {
            return;
        }
        if let Some((first, second)) = geometry::coincident_points(&self.places()) {
            let message =
                format!("references {} and {} have the same place", first + 1, second + 1);
            self.tables[second].fail("position_m", message, "");
        }
        for (second, it) in self.configs.iter().enumerate() {
            let Some(code) = it.code else { continue };
            let is_same = |other: &ReferenceConfig| (other.kind, other.code) == (it.kind, it.code);
            let Some(first) = self.configs[..second].iter().position(is_same) else { continue };
            let (first, number) = (first + 1, code.number);
            let message = format!("references {first} and {} carry code {number}", second + 1);
            let help = "a code is on one print: give the other one its own";
            self.tables[second].fail("code", message, help);
        }
    }

    /// Reports references that do not suffice to localize a fixed camera.
    pub(super) fn check_sufficient_for_localization(&self) {
        let Some(last) = self.tables.last().filter(|_| self.are_complete()) else { return };
        let places = self.places();
        let (message, help) = if places.len() < 3 {
            (
                format!("expected at least 3 reference roundels, found {}", places.len()),
                "add [[reference]] tables until there are three that are not in one line",
            )
        } else if geometry::coincident_points(&places).is_none() && geometry::collinear(&places) {
            (
                "all reference roundels lie in one line".to_owned(),
                "a camera's place does not follow from points in one line: move one of them aside",
            )
        } else {
            return;
        };
        last.fail("", message, help);
    }
}

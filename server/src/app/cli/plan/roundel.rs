//! The planned roundel as text and as JSON.

use roundel_core::marker::{CodeLayout, Kind, Pattern};
use serde_json::{Value, json};

pub(super) fn is_coded(kind: &Kind) -> bool {
    matches!(kind.pattern, Pattern::Coded(_))
}

/// Diameters and code.
pub(super) fn words(kind: &Kind) -> String {
    let [outer_mm, inner_mm] = [kind.outer_diameter_m, kind.inner_diameter_m].map(|it| it * 1e3);
    let pattern = match kind.pattern {
        Pattern::Plain => " mm".to_owned(),
        Pattern::Elliptical { minor_diameter_m } => format!(" x {:.1} mm", minor_diameter_m * 1e3),
        Pattern::Coded(CodeLayout { bits, min_distance }) => {
            format!(" mm, codes of {bits} bits at distance {min_distance}")
        }
    };
    format!("{outer_mm:.1} mm, disc {inner_mm:.1}{pattern}")
}

/// The layout of its code; null for a plain roundel.
pub(super) fn code(kind: &Kind) -> Value {
    match kind.pattern {
        Pattern::Coded(CodeLayout { bits, min_distance }) => {
            json!({"bits": bits, "min_distance": min_distance})
        }
        Pattern::Plain | Pattern::Elliptical { .. } => Value::Null,
    }
}

//! Parts of the reports of several plans.

use roundel_core::{
    camera::{Camera, Intrinsics, PixelPoint},
    marker::{CodeLayout, Kind, Pattern},
};
use serde_json::{Value, json};

use super::PlanArgs;
use crate::lab::plan::timing::{FRAMES, FrameTimes};

/// Horizontal and vertical field of view, degrees; `None` where the lens model does not reach the picture's edge.
pub(super) fn fields_deg(camera: &Camera) -> [Option<f64>; 2] {
    let Intrinsics { width, height, cx_px, cy_px, .. } = *camera.intrinsics();
    let at = |u: f64, v: f64| camera.bearing(PixelPoint { u, v }).ok();
    let edges = [
        at(-0.5, cy_px).zip(at(width as f64 - 0.5, cy_px)),
        at(cx_px, -0.5).zip(at(cx_px, height as f64 - 0.5)),
    ];
    edges.map(|edges| edges.map(|(from, to)| from.angle(&to).to_degrees()))
}

/// Diameters and code of a roundel.
pub(super) fn roundel(kind: &Kind) -> String {
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

/// The layout of its code; null without a code.
pub(super) fn code(kind: &Kind) -> Value {
    match kind.pattern {
        Pattern::Coded(CodeLayout { bits, min_distance }) => {
            json!({"bits": bits, "min_distance": min_distance})
        }
        Pattern::Plain | Pattern::Elliptical { .. } => Value::Null,
    }
}

/// How the times were measured.
pub(super) fn times_source(arguments: &PlanArgs, times: &FrameTimes) -> String {
    format!(
        "measured now on one core of this computer, on {FRAMES} simulated frames with {} of {} roundels tracked",
        times.followed,
        arguments.count()
    )
}

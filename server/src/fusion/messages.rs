//! Texts of the events that fusion publishes.

use std::ops::Range;

use roundel_core::{
    marker::Code,
    world::{self, Event, KindPrintSize, PrintSizeState, WrongHeight},
};

use crate::model::hub::{EventKind, Installation};

/// `name`: the object's configured name, or empty.
pub(super) fn object_event(event: &Event, name: &str, code: Option<Code>) -> (EventKind, String) {
    let name = match (name, code) {
        ("", None) => format!("Object {}", event.object),
        ("", Some(code)) => format!("Object {} (code {})", event.object, code.number),
        (name, _) => format!("Object {} ({name})", event.object),
    };
    let (kind, what) = match event.kind {
        world::EventKind::Appeared => (EventKind::ObjectAppeared, "has appeared"),
        world::EventKind::Predicted => {
            (EventKind::ObjectPredicted, "is not seen by any camera; its pose is predicted")
        }
        world::EventKind::Recovered => (EventKind::ObjectRecovered, "is seen again"),
        world::EventKind::Lost => (EventKind::ObjectLost, "is lost"),
    };
    (kind, format!("{name} {what}."))
}

pub(super) fn clock_step(camera: &str) -> String {
    format!(
        "The clock of camera {camera} was set, or counts from another epoch: its offset from the server's clock is \
         estimated again."
    )
}

pub(super) fn height_mismatch(installation: &Installation, wrong: &WrongHeight) -> String {
    let what = match wrong.body {
        Some(_) => format!("\"{}\"", installation.object_name(wrong.kind, wrong.body)),
        None => format!("Roundels \"{}\"", installation.kind_name(wrong.kind)),
    };
    let cameras: Vec<&str> = wrong.cameras.iter().map(|&id| installation.camera_name(id)).collect();
    format!(
        "{what}: seen at a height of {:.2} m by {}, and `height_m` says {:.2}. Correct it, or the diameters \
         or the cameras' poses; until then positions are wrong, and false objects may appear.",
        wrong.measured_m,
        cameras.join(", "),
        wrong.configured_m
    )
}

/// Factors by which printers and viewers scale a page to fit.
const FIT_TO_PAGE: Range<f64> = 0.92..0.985;

pub(super) fn wrong_print_size(installation: &Installation, wrong: &KindPrintSize) -> String {
    let KindPrintSize { kind, size, state, cameras } = wrong;
    let is_used = *state == PrintSizeState::Measured;
    let name = installation.kind_name(Some(*kind));
    let percent = (size.factor - 1.0) * 100.0;
    let compared = if percent < 0.0 { "smaller" } else { "larger" };
    let cameras: Vec<&str> = cameras.iter().map(|&id| installation.camera_name(id)).collect();
    let advice = match (is_used, FIT_TO_PAGE.contains(&size.factor)) {
        (true, true) => {
            "They may have been printed with \"fit to page\". Positions are corrected for it; measure the prints and \
             correct `outer_mm` and `inner_mm`."
        }
        (true, false) => {
            "Positions are corrected for it; measure the prints and correct `outer_mm` and `inner_mm`."
        }
        (false, _) => {
            "A print cannot be that far off: correct `outer_mm` and `inner_mm`, or the cameras' poses. Until then \
             positions are wrong, and moved cameras are not detected by these roundels."
        }
    };
    format!(
        "Roundels \"{name}\" are {:.1} % {compared} than configured, as seen by {}. {advice}",
        percent.abs(),
        cameras.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use roundel_core::{id::ObjectId, time::Timestamp};

    use super::*;

    #[test]
    fn an_object_without_a_name_is_identified_by_its_code() {
        let (time, object) = (Timestamp::default(), ObjectId(3));
        let event = Event { time, object, kind: world::EventKind::Lost };
        let code = Some(Code { bits: 8, number: 12 });
        let message = |name, code| object_event(&event, name, code).1;
        assert_eq!(message("", None), "Object 3 is lost.");
        assert_eq!(message("", code), "Object 3 (code 12) is lost.");
        assert_eq!(message("carrier", code), "Object 3 (carrier) is lost.");
    }
}

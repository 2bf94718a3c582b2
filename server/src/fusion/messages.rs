//! What fusion tells people, in words.

use roundel_core::{
    id::{BodyId, KindId},
    marker::Code,
    world::{Event, EventKind, WrongHeight},
};

use crate::model::hub::Installation;

/// Kind, body and code of an object.
pub(super) type ObjectIdentity = (Option<KindId>, Option<BodyId>, Option<Code>);

pub(super) fn object_event(
    installation: &Installation,
    event: &Event,
    (kind, body, code): ObjectIdentity,
) -> String {
    let name = match (installation.object_name(kind, body), code) {
        ("", None) => format!("Object {}", event.object),
        ("", Some(code)) => format!("Object {} (code {})", event.object, code.number),
        (name, _) => format!("Object {} ({name})", event.object),
    };
    match event.kind {
        EventKind::Appeared => format!("{name} has appeared."),
        EventKind::Predicted => format!("{name} is not seen by any camera; its pose is predicted."),
        EventKind::Recovered => format!("{name} is seen again."),
        EventKind::Lost => format!("{name} is lost."),
    }
}

/// A camera's clock was set.
pub(super) fn clock_step(camera: &str) -> String {
    format!(
        "The clock of camera {camera} was set, or counts from another epoch: its times are brought to \
         the server's, and what is left of the difference is found from what it sees."
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
         or the cameras' poses; until then places are wrong, and objects may appear that are not there.",
        wrong.seen_m,
        cameras.join(", "),
        wrong.said_m
    )
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use roundel_core::{id::ObjectId, time::Timestamp};

    use super::*;

    #[test]
    fn who_has_no_name_is_told_by_its_code() {
        let installation = Installation {
            name: "lab".into(),
            source_id: "s".into(),
            started: Timestamp::default(),
            snapshot_rate_hz: 100.0,
            cameras: BTreeMap::new(),
            kinds: vec!["robot".into()],
            object_names: BTreeMap::new(),
            body_names: vec!["carrier".into()],
        };
        let told = |body, code| {
            let event =
                Event { time: Timestamp::default(), object: ObjectId(3), kind: EventKind::Lost };
            object_event(&installation, &event, (Some(KindId(0)), body, code))
        };
        assert_eq!(told(None, None), "Object 3 is lost.");
        let code = Some(Code { bits: 8, number: 12 });
        assert_eq!(told(None, code), "Object 3 (code 12) is lost.");
        assert_eq!(told(Some(BodyId(0)), code), "Object 3 (carrier) is lost.");
    }
}

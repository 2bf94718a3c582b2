//! `pose` of a `[[camera]]`: fixed, unknown, or on a moving object.
//!
//! The pose of a mounted camera follows from that of its object, which must therefore be observable: by a fixed
//! camera, or by a camera on it that localizes itself with the reference roundels.

use roundel_core::{
    marker::Pattern,
    rigid::Rigid,
    world::{Body, CameraPlacement},
};

use super::{
    CameraConfig, ObjectRoundels, geometry, object::ParsedObjects, reader::Table,
    reference::ParsedReferences, roundel::ParsedKinds,
};
use crate::model::suggestion::{did_you_mean, list};

const POSE_KEYS: [&str; 4] = ["position_m", "orientation_xyzw", "object", "localizes"];
const POSE_HELP: &str = "write { position_m = [x, y, z], orientation_xyzw = [x, y, z, w] }, with \
                         `object = \"NAME\"` if it rides on one, or \"unknown\" to have it found from \
                         the reference roundels";

#[derive(Clone, Debug, PartialEq)]
pub enum PoseConfig {
    /// world_from_camera.
    Known(Rigid),
    /// From the calibration file, in place of the configured pose.
    Calibrated(Box<CameraPlacement>),
    /// Estimated from the reference roundels.
    Unknown,
    Mounted(MountConfig),
}

/// A camera mounted on an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountConfig {
    /// Index in [`super::Config::objects`] of a [`ObjectRoundels::Body`] whose orientation is observable.
    pub object: usize,
    pub object_from_camera: Rigid,
    /// Whether it localizes the object with the reference roundels.
    pub localizes: bool,
}

/// `None` if absent or wrong.
pub(super) fn pose(
    camera: &Table<'_, '_>,
    is_required: bool,
    objects: &ParsedObjects<'_, '_>,
    kinds: &ParsedKinds,
) -> Option<PoseConfig> {
    if is_required {
        camera.require("pose", "\"unknown\"");
    }
    let value = camera.value("pose")?.get_ref();
    if value.as_str() == Some("unknown") {
        return Some(PoseConfig::Unknown);
    }
    if value.as_table().is_none() {
        let found = value.as_str().map(|text| format!(", found the text \"{text}\""));
        let found = found.unwrap_or_default();
        let message = format!("`pose` must be a table or \"unknown\"{found}");
        return camera.reject("pose", message, POSE_HELP);
    }
    let table = camera.table("pose", "pose", &POSE_KEYS)?;
    let place = geometry::pose(&table);
    let localizes = table.flag("localizes");
    if table.has("object") {
        let object = object_by_name(&table, objects);
        let object = object.filter(|&object| reveals_orientation(&table, object, objects, kinds));
        let (object, object_from_camera) = (object?, place?);
        let localizes = localizes.unwrap_or(false);
        return Some(PoseConfig::Mounted(MountConfig { object, object_from_camera, localizes }));
    }
    if localizes == Some(true) {
        table.fail(
            "localizes",
            "`localizes` is for a camera that rides on an object, and `object` is missing",
            "add `object = \"NAME\"`; a camera that stands finds its place with pose = \"unknown\"",
        );
    }
    place.map(PoseConfig::Known)
}

/// Index of the object that `object` names among the readable ones.
fn object_by_name(table: &Table<'_, '_>, objects: &ParsedObjects<'_, '_>) -> Option<usize> {
    let name = table.required_text("object", "\"drone\"")?;
    let place = objects.configs.iter().position(|object| object.name == name);
    // Problems of an unreadable object are reported there.
    if place.is_some() || objects.names.contains(&name) {
        return place;
    }
    if table.is_full() {
        return table.reject("object", "", "");
    }
    let names = || objects.names.iter().copied();
    let help = match objects.names[..] {
        [] => "add [[object]] with its `name`, and with the `roundel` that it carries".to_owned(),
        _ => format!("configured: {}", list(names())),
    };
    let meant = did_you_mean(name, names());
    table.reject("object", format!("no [[object]] is named \"{name}\"{meant}"), help)
}

/// Reports an object whose orientation is not observable.
fn reveals_orientation(
    table: &Table<'_, '_>,
    object: usize,
    objects: &ParsedObjects<'_, '_>,
    kinds: &ParsedKinds,
) -> bool {
    let object = &objects.configs[object];
    let why = match &object.carries {
        ObjectRoundels::Kind { kind, .. } => match kinds.pattern(*kind) {
            Pattern::Plain => "its plain roundel looks the same however it is turned",
            Pattern::Coded(_) => "it is known by a whole kind of roundel, whatever their codes",
            Pattern::Elliptical { .. } => "its elliptical disc looks the same after half a turn",
        },
        ObjectRoundels::Body(Body { mounts, .. })
            if mounts.is_empty()
                || mounts.iter().any(|mount| mount.code.is_some())
                || geometry::determine_orientation(mounts) =>
        {
            return true;
        }
        ObjectRoundels::Body(Body { mounts, .. }) => match kinds.pattern(mounts[0].kind) {
            Pattern::Elliptical { .. } => "its elliptical disc looks the same after half a turn",
            _ => "its roundels look the same when it turns about their normal",
        },
    };
    table.fail(
        "object",
        format!("object \"{}\" does not say which way its camera looks: {why}", object.name),
        "give it a roundel with a `code`, or list several side by side in its `roundel = [ … ]`",
    );
    false
}

/// Reports cameras and objects that nothing can localize.
pub(super) fn check(
    tables: &[Table<'_, '_>],
    cameras: &[CameraConfig],
    objects: &ParsedObjects<'_, '_>,
) {
    let rides = || {
        let ride = |camera: &CameraConfig| match camera.pose {
            PoseConfig::Mounted(ride) => Some(ride),
            PoseConfig::Known(_) | PoseConfig::Calibrated(_) | PoseConfig::Unknown => None,
        };
        cameras.iter().map(ride)
    };
    let one_stands = rides().any(|ride| ride.is_none());
    let is_localized =
        |object: usize| rides().flatten().any(|ride| ride.localizes && ride.object == object);
    let bare: Vec<usize> = objects.without_roundels().collect();
    for (table, ride) in tables.iter().zip(rides()) {
        let Some(ride) = ride.filter(|ride| !is_localized(ride.object)) else { continue };
        if one_stands || bare.contains(&ride.object) {
            continue;
        }
        let name = &objects.configs[ride.object].name;
        table.fail(
            "pose",
            format!("no camera can say where \"{name}\" is, which this one rides on: all cameras ride"),
            "add a camera that stands, or write `localizes = true` to have this one find itself from \
             reference roundels",
        );
    }
    for object in bare.into_iter().filter(|&object| !is_localized(object)) {
        let carries_camera = rides().flatten().any(|ride| ride.object == object);
        objects.report_unobservable(object, carries_camera);
    }
}

/// Reports cameras that need more reference roundels than configured.
pub(super) fn check_references(
    tables: &[Table<'_, '_>],
    cameras: &[Option<CameraConfig>],
    references: &ParsedReferences<'_, '_>,
) {
    let mut places_some = false;
    for (table, camera) in tables.iter().zip(cameras) {
        let Some(camera) = camera else { continue };
        let (wanted, missing) = match camera.pose {
            PoseConfig::Unknown => {
                places_some = true;
                let help = "add at least three [[reference]] tables, or give the camera's pose";
                ("pose = \"unknown\"", references.are_missing().then_some(help))
            }
            PoseConfig::Mounted(MountConfig { localizes: true, .. }) => {
                let help = "add [[reference]] with its `position_m`, a `code`, and how it is turned \
                            (`yaw_deg`, or `right` and `top`), or three of them not in one line";
                ("localizes = true", (!references.localize()).then_some(help))
            }
            _ => continue,
        };
        let Some(help) = missing else { continue };
        let found = if references.are_missing() {
            "none are configured"
        } else {
            "those configured do not say enough: none has both a `code` and its orientation"
        };
        let message = format!("`{wanted}` needs reference roundels, and {found}");
        table.fail("pose", message, help);
    }
    if places_some {
        references.check_sufficient_for_localization();
    }
}

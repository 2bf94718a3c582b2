//! `[[camera]]`: where frames come from, what they show of the world, and how they are searched.

use std::{collections::HashMap, path::Path};

use roundel_core::{
    camera::{Camera, PixelPoint},
    marker::Mode,
    plan::precision::LensDoubt,
    rigid::Rigid,
};

use super::{
    Lenses, PoseConfig, camera_pose,
    mask::mask,
    object::ParsedObjects,
    reader::{NumberRange, Table},
    reference::ParsedReferences,
    roundel::ParsedKinds,
};
use crate::model::{
    address::{SourceAddress, without_credentials},
    camera_file,
    simulated::simulated_camera,
};

/// A key of a `[[camera]]`.
pub struct CameraKey {
    /// In TOML, and as a field of `v1::CameraSetup`.
    pub name: &'static str,
    pub label: &'static str,
    /// What the difference between two versions of a camera requires, if there is one.
    pub effect: fn(&CameraConfig, &CameraConfig) -> Option<Effect>,
}

/// What a changed key requires of a running server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    Restart,
    /// Restarts the worker under another name.
    Rename,
    /// Restarts the worker and the estimate of its clock.
    Source,
    /// Gives the worker lens and pose between two frames, so that no track is lost, and drops their calibration.
    Pose,
    /// Restarts the worker, and drops the calibration of lens and pose.
    Resize,
    /// Restarts the estimate of the clock.
    Clock,
}

/// All keys. `camera` reads and checks them; writing, and the conversion to and from `v1::CameraSetup`, need no code.
pub const CAMERA_SCHEMA: [CameraKey; 9] = [
    key("name", "name", |a, b| (a.name != b.name).then_some(Effect::Rename)),
    key("source", "source", |a, b| (a.address != b.address).then_some(Effect::Source)),
    key("calibration", "lens", |a, b| {
        let (a, b) = (&a.calibration, &b.calibration);
        if (a.width(), a.height()) != (b.width(), b.height()) {
            return Some(Effect::Resize);
        }
        (a.intrinsics() != b.intrinsics()).then_some(Effect::Pose)
    }),
    key("pose", "pose", |a, b| (a.pose != b.pose).then_some(Effect::Pose)),
    key("line_time_us", "line time", |a, b| {
        (a.line_time_s != b.line_time_s).then_some(Effect::Restart)
    }),
    key("clock_uncertainty_ms", "clock uncertainty", |a, b| {
        (a.clock_uncertainty_s != b.clock_uncertainty_s).then_some(Effect::Clock)
    }),
    key("rate_hz", "rate", |a, b| (a.rate_hz != b.rate_hz).then_some(Effect::Restart)),
    key("mode", "mode", |a, b| (a.mode != b.mode).then_some(Effect::Restart)),
    key("mask", "mask", |a, b| (a.mask != b.mask).then_some(Effect::Restart)),
];

const fn key(
    name: &'static str,
    label: &'static str,
    effect: fn(&CameraConfig, &CameraConfig) -> Option<Effect>,
) -> CameraKey {
    CameraKey { name, label, effect }
}

pub const CAMERA_KEYS: [&str; CAMERA_SCHEMA.len()] = {
    let mut names = [""; CAMERA_SCHEMA.len()];
    let mut index = 0;
    while index < names.len() {
        names[index] = CAMERA_SCHEMA[index].name;
        index += 1;
    }
    names
};

/// `[[camera]]`.
#[derive(Clone, Debug)]
pub struct CameraConfig {
    pub name: String,
    /// As written, without user and password.
    pub source: String,
    /// The source, with user and password.
    pub address: SourceAddress,
    /// From the camera file, or a simulated camera's own.
    pub calibration: Camera,
    /// Uncertainty of the lens according to the camera file, if it has any.
    pub lens_uncertainty: Option<LensDoubt>,
    /// From the configuration, until a calibration replaces it.
    pub pose: PoseConfig,
    /// Time from one image row's exposure to the next, seconds.
    pub line_time_s: f64,
    /// Standard deviation of the time stamps' offset; by default that of the kind of source. 0: no offset is estimated.
    pub clock_uncertainty_s: f64,
    /// Frame rate that the camera is set to; a warning reports a different measured one.
    pub rate_hz: Option<f64>,
    /// The camera's own mode, or that of `[detection]`.
    pub mode: Mode,
    /// Polygons, raw pixels, in which no roundels are searched. Each has at least three corners and covers a pixel of
    /// the frame; together they leave one.
    pub mask: Vec<Vec<PixelPoint>>,
}

const MAX_LINE_TIME_US: f64 = 10_000.0;
const MAX_CLOCK_UNCERTAINTY_MS: f64 = 10_000.0;
const MAX_RATE_HZ: f64 = 1000.0;

pub const MODES: [(&str, Mode); 2] = [("precise", Mode::Precise), ("fast", Mode::Fast)];

/// What cameras are told of the rest of the configuration.
pub(super) struct CameraContext<'a, 't, 'i> {
    pub(super) kinds: &'a ParsedKinds,
    pub(super) references: &'a ParsedReferences<'t, 'i>,
    pub(super) objects: &'a ParsedObjects<'t, 'i>,
    /// Lenses in place of those in files, by camera.
    pub(super) lenses: Option<&'a Lenses>,
    /// Whether they are a node's, of which nobody asks where they stand.
    pub(super) is_node: bool,
}

/// The cameras; `mode` is for those that do not say theirs.
pub(super) fn cameras(
    root: &Table<'_, '_>,
    folder: &Path,
    known: &CameraContext<'_, '_, '_>,
    mode: Mode,
) -> Vec<CameraConfig> {
    let tables = root.tables("camera", "[[camera]]", &CAMERA_KEYS);
    if root.value("camera").is_none() {
        root.fail_with_help(
            &root.span().clone(),
            "no camera is configured",
            "add [[camera]] with `name`, `source`, `calibration` and `pose`",
        );
    }
    let mut names: HashMap<&str, usize> = HashMap::new();
    let mut cameras = Vec::new();
    for (index, table) in tables.iter().enumerate() {
        let name = table.required_text("name", "\"north\"");
        if let Some(first) = name.and_then(|name| names.insert(name, index)) {
            table.fail_with_help(
                &table.span_of("name"),
                format!(
                    "cameras {} and {} are both named \"{}\"",
                    first + 1,
                    index + 1,
                    name.unwrap_or_default()
                ),
                "give each camera its own name",
            );
        }
        cameras.push(camera(table, name, folder, (known, mode)));
    }
    camera_pose::check_references(&tables, &cameras, known.references);
    let is_whole = cameras.iter().all(Option::is_some);
    let cameras: Vec<CameraConfig> = cameras.into_iter().flatten().collect();
    // What a camera that could not be read sees, nobody knows.
    if is_whole {
        camera_pose::check(&tables, &cameras, known.objects);
    }
    cameras
}

fn camera(
    table: &Table<'_, '_>,
    name: Option<&str>,
    folder: &Path,
    (known, mode): (&CameraContext<'_, '_, '_>, Mode),
) -> Option<CameraConfig> {
    let source = table.required_text("source", "\"images:frames/*.png?fps=30\"");
    let report = |message: String| table.fail(&table.span_of("source"), message);
    let address = source.and_then(|source| {
        SourceAddress::parse(source, folder).map_err(|error| report(error.to_string())).ok()
    });
    let simulated = match &address {
        Some(SourceAddress::Sim(sim)) => {
            simulated_camera(sim).map_err(|error| report(error.to_string())).ok()
        }
        _ => None,
    };
    // What a simulated camera does not know better must be written.
    let required = simulated.is_none() && address.is_some();
    let recorded = known.lenses.zip(name).map(|(lenses, name)| lenses.get(name).cloned());
    let (calibration, lens_uncertainty) = match (table.value("calibration"), &simulated) {
        _ if recorded.is_some() => (recorded_lens(table, recorded.flatten()), None),
        (None, Some(simulated)) => (Some(simulated.camera.clone()), None),
        _ => calibration(table, folder, required).unzip(),
    };
    let pose = match (table.value("pose"), &simulated) {
        (None, Some(simulated)) => Some(PoseConfig::Known(simulated.world_from_camera)),
        (None, None) if known.is_node => Some(PoseConfig::Known(Rigid::identity())),
        _ => camera_pose::pose(table, required, known.objects, known.kinds),
    };
    let line_time_s = match (table.value("line_time_us"), &simulated) {
        (None, Some(simulated)) => simulated.line_time_s,
        _ => table.number("line_time_us", NumberRange::ZeroUpTo(MAX_LINE_TIME_US), 0.0) * 1e-6,
    };
    let uncertainty = NumberRange::ZeroUpTo(MAX_CLOCK_UNCERTAINTY_MS);
    // Of a camera of which nothing is said, its source knows how far its times may be off.
    let usual_s = address.as_ref().map_or(0.0, |it| it.capture_clock().deviation_s);
    let clock_uncertainty_s =
        table.number("clock_uncertainty_ms", uncertainty, usual_s * 1e3) * 1e-3;
    let rate_hz = table
        .value("rate_hz")
        .is_some()
        .then(|| table.number("rate_hz", NumberRange::PositiveUpTo(MAX_RATE_HZ), 0.0));
    let mode = table.choice("mode", &MODES).unwrap_or(mode);
    let mask = calibration.as_ref().map(|camera| mask(table, camera));
    if table.is_broken() {
        return None;
    }
    Some(CameraConfig {
        name: name?.to_owned(),
        source: without_credentials(source?),
        address: address?,
        calibration: calibration?,
        lens_uncertainty: lens_uncertainty.flatten(),
        pose: pose?,
        line_time_s,
        clock_uncertainty_s,
        rate_hz,
        mode,
        mask: mask?,
    })
}

/// A camera that the recording does not know has no frames in it, either.
fn recorded_lens(table: &Table<'_, '_>, lens: Option<Camera>) -> Option<Camera> {
    if lens.is_none() {
        table.fail(&table.span_of("name"), "the recording says nothing of the lens of this camera");
    }
    lens
}

/// The lens, and how well it is known.
fn calibration(
    table: &Table<'_, '_>,
    folder: &Path,
    required: bool,
) -> Option<(Camera, Option<LensDoubt>)> {
    let file = if required {
        table.required_text("calibration", "\"north.yaml\"")
    } else {
        table.text("calibration")
    }?;
    match camera_file::load_with_uncertainty(&folder.join(file)) {
        Ok(lens) => Some(lens),
        Err(error) => {
            table.fail(&table.span_of("calibration"), error.to_string());
            None
        }
    }
}

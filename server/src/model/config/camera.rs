//! `[[camera]]`: source, lens, pose, clock and search of a camera.

use std::{
    cell::RefCell,
    collections::HashMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use roundel_core::{
    camera::{Camera, PixelPoint},
    marker::Mode,
    plan::precision::LensUncertainty,
    rigid::Rigid,
    sim::SimCamera,
};

use super::{
    Lenses, PoseConfig, camera_pose,
    mask::mask,
    object::ParsedObjects,
    reader::{NumberRange, Table},
    reference::ParsedReferences,
    request::RequestScope,
    roundel::ParsedKinds,
};
use crate::model::{
    address::{SimAddress, SourceAddress},
    camera_file,
    redact::redact,
    simulated::{camera_of_world, simulated_scenario},
    source_rules::SourceRules,
};

/// A key of a `[[camera]]`.
pub struct CameraKey {
    /// In TOML, and as a field of `v1::CameraSetup`.
    pub name: &'static str,
    pub label: &'static str,
    /// What a difference between two versions of a camera requires.
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
    /// Sends lens and pose to the worker, which keeps its tracks, and drops their calibration.
    Pose,
    /// Restarts the worker, and drops the calibration of lens and pose.
    Resize,
    /// Restarts the estimate of the clock.
    Clock,
}

/// All keys. `camera` parses them; writing, and the conversion to and from `v1::CameraSetup`, follow from the names.
pub const CAMERA_SCHEMA: [CameraKey; 10] = [
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
    key("trust", "trust", |a, b| (a.trust != b.trust).then_some(Effect::Restart)),
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
    /// Rules that bind the source; `None` for one of the configuration file.
    pub source_rules: Option<Arc<SourceRules>>,
    pub calibration_file: Option<PathBuf>,
    /// From the camera file, or a simulated camera's own.
    pub calibration: Camera,
    /// Uncertainty of the lens according to the camera file.
    pub lens_uncertainty: Option<LensUncertainty>,
    /// From the configuration, until a calibration replaces it.
    pub pose: PoseConfig,
    /// Time from one image row's exposure to the next, seconds.
    pub line_time_s: f64,
    /// Standard deviation of the time stamps' offset; 0: no offset is estimated. The default depends on the source.
    pub clock_uncertainty_s: f64,
    /// Frame rate that the camera is set to; a warning reports a different measured one.
    pub rate_hz: Option<f64>,
    /// The camera's own mode, or that of `[detection]`.
    pub mode: Mode,
    /// Polygons, raw pixels, that are not searched. Each covers a pixel of the frame, and together they leave one.
    pub mask: Vec<Vec<PixelPoint>>,
    /// Rank among the cameras: its detections are not used for an object that a camera of a higher rank sees.
    pub trust: u8,
}

/// Rank of cameras that the operator does not vouch for.
pub const UNTRUSTED: u8 = 0;
const DEFAULT_TRUST: u8 = 1;
const MAX_TRUST: usize = 9;
const MAX_LINE_TIME_US: f64 = 10_000.0;
const MAX_CLOCK_UNCERTAINTY_MS: f64 = 10_000.0;
const MAX_RATE_HZ: f64 = 1000.0;
/// Cameras of one installation see the same simulated world.
const MAX_WORLDS: usize = 32;

pub const MODES: [(&str, Mode); 2] = [("precise", Mode::Precise), ("fast", Mode::Fast)];

/// The parts of the configuration that cameras refer to.
pub(super) struct CameraContext<'a, 't, 'i> {
    pub(super) kinds: &'a ParsedKinds,
    pub(super) references: &'a ParsedReferences<'t, 'i>,
    pub(super) objects: &'a ParsedObjects<'t, 'i>,
    /// Lenses by camera, in place of camera files.
    pub(super) lenses: Option<&'a Lenses>,
    /// A node's cameras need no poses.
    pub(super) is_node: bool,
    /// Mode of cameras without a mode of their own.
    pub(super) mode: Mode,
    /// Relative paths begin here.
    pub(super) folder: &'a Path,
    /// `None`: the file is the operator's.
    pub(super) request: Option<RequestScope<'a>>,
    /// Each file is read once, however many cameras have it.
    pub(super) camera_files: RefCell<HashMap<PathBuf, ParsedCameraFile>>,
    /// Each world is laid out once, which takes milliseconds.
    pub(super) worlds: RefCell<Vec<SimulatedWorld>>,
}

/// A world, as the address of its first camera, and its cameras, or the error.
type SimulatedWorld = (SimAddress, Result<Vec<SimCamera>, String>);

/// Lens and uncertainty, or the error.
type ParsedCameraFile = Result<(Camera, Option<LensUncertainty>), String>;

impl CameraContext<'_, '_, '_> {
    /// The rules that bind a source; `None` for one of the operator's file.
    fn source_rules(
        &self,
        table: &Table<'_, '_>,
        address: &SourceAddress,
    ) -> Option<Arc<SourceRules>> {
        let admitted = self.request?.admit_source(address);
        admitted.map_err(|error| table.fail("source", error.to_string(), "")).ok().flatten()
    }

    fn simulated_camera(&self, address: &SimAddress) -> Result<SimCamera, String> {
        let world = SimAddress { camera: 0, ..address.clone() };
        let mut worlds = self.worlds.borrow_mut();
        if !worlds.iter().any(|(known, _)| *known == world) {
            if worlds.len() >= MAX_WORLDS {
                return Err(format!(
                    "expected at most {MAX_WORLDS} simulated worlds, found another `preset`, `seed` or `robots`"
                ));
            }
            let cameras = simulated_scenario(&world).map(|scenario| scenario.cameras().to_vec());
            worlds.push((world.clone(), cameras.map_err(|error| error.to_string())));
        }
        let found = worlds.iter().find(|(known, _)| *known == world);
        let cameras = found.map_or(Ok(&[][..]), |(_, cameras)| {
            cameras.as_ref().map(Vec::as_slice).map_err(Clone::clone)
        })?;
        camera_of_world(cameras, address).map_err(|error| error.to_string())
    }

    fn camera_file(&self, path: &Path) -> ParsedCameraFile {
        let mut files = self.camera_files.borrow_mut();
        let read = || {
            let Some(request) = &self.request else {
                return camera_file::load_with_uncertainty(path).map_err(|error| error.to_string());
            };
            request.admit_file(path).map_err(|error| error.to_string())?;
            camera_file::load_with_uncertainty(path).map_err(|error| error.without_content())
        };
        files.entry(path.to_owned()).or_insert_with(read).clone()
    }
}

pub(super) fn cameras(
    root: &Table<'_, '_>,
    context: &CameraContext<'_, '_, '_>,
) -> Vec<CameraConfig> {
    let tables = root.tables("camera", "[[camera]]", &CAMERA_KEYS);
    if !root.has("camera") {
        let help = "add [[camera]] with `name`, `source`, `calibration` and `pose`";
        root.fail("camera", "no camera is configured", help);
    }
    let mut names: HashMap<&str, usize> = HashMap::new();
    let mut cameras = Vec::new();
    for (table, number) in tables.iter().zip(1..) {
        let name = table.required_text("name", "\"north\"");
        if let Some(name) = name
            && let Some(first) = names.insert(name, number)
        {
            let message = format!("cameras {first} and {number} are both named \"{name}\"");
            table.fail("name", message, "give each camera its own name");
        }
        cameras.push(camera(table, name, context));
    }
    camera_pose::check_references(&tables, &cameras, context.references);
    let is_whole = cameras.iter().all(Option::is_some);
    let cameras: Vec<CameraConfig> = cameras.into_iter().flatten().collect();
    // An unreadable camera might see the others' objects.
    if is_whole {
        camera_pose::check(&tables, &cameras, context.objects);
    }
    cameras
}

fn camera(
    table: &Table<'_, '_>,
    name: Option<&str>,
    context: &CameraContext<'_, '_, '_>,
) -> Option<CameraConfig> {
    let source = table.required_text("source", "\"images:frames/*.png?fps=30\"");
    let address = source.and_then(|source| {
        let address = SourceAddress::parse(source, context.folder);
        address.map_err(|error| table.fail("source", error.to_string(), "")).ok()
    });
    let source_rules = address.as_ref().and_then(|address| context.source_rules(table, address));
    let simulated = match &address {
        Some(SourceAddress::Sim(sim)) => {
            let camera = context.simulated_camera(sim);
            camera.map_err(|error| table.fail("source", error, "")).ok()
        }
        _ => None,
    };
    let calibration_file = table.text("calibration").map(|file| context.folder.join(file));
    let is_required = simulated.is_none() && address.is_some();
    let (calibration, lens_uncertainty) = match (table.value("calibration"), &simulated) {
        _ if context.lenses.is_some() && name.is_some() => {
            let lens = context.lenses.zip(name).and_then(|(lenses, name)| lenses.get(name));
            let message = "the recording says nothing of the lens of this camera";
            (lens.cloned().or_else(|| table.reject("name", message, "")), None)
        }
        (None, Some(simulated)) => (Some(simulated.camera.clone()), None),
        _ => {
            if is_required {
                table.require("calibration", "\"north.yaml\"");
            }
            let lens = calibration_file.as_ref().and_then(|file| {
                let lens = context.camera_file(file);
                lens.map_err(|error| table.fail("calibration", error, "")).ok()
            });
            lens.unzip()
        }
    };
    let pose = match (table.value("pose"), &simulated) {
        (None, Some(simulated)) => Some(PoseConfig::Known(simulated.world_from_camera)),
        (None, None) if context.is_node => Some(PoseConfig::Known(Rigid::identity())),
        _ => camera_pose::pose(table, is_required, context.objects, context.kinds),
    };
    let line_time_us =
        table.optional_number("line_time_us", NumberRange::ZeroUpTo(MAX_LINE_TIME_US));
    let line_time_s = match (line_time_us, &simulated) {
        (None, Some(simulated)) => simulated.line_time_s,
        _ => line_time_us.unwrap_or(0.0) * 1e-6,
    };
    let uncertainty = NumberRange::ZeroUpTo(MAX_CLOCK_UNCERTAINTY_MS);
    let default_s = address.as_ref().map_or(0.0, |it| it.capture_clock().deviation_s);
    let clock_uncertainty_s =
        table.number("clock_uncertainty_ms", uncertainty, default_s * 1e3) * 1e-3;
    let rate_hz = table.optional_number("rate_hz", NumberRange::PositiveUpTo(MAX_RATE_HZ));
    let mode = table.choice("mode", &MODES).unwrap_or(context.mode);
    let mask = calibration.as_ref().map(|camera| mask(table, camera));
    let is_pushed = matches!(address, Some(SourceAddress::Push(_)));
    let default_trust = if is_pushed { UNTRUSTED } else { DEFAULT_TRUST };
    let trust = table.whole("trust", 0..=MAX_TRUST).map_or(default_trust, |trust| trust as u8);
    if table.is_broken() {
        return None;
    }
    Some(CameraConfig {
        name: name?.to_owned(),
        source: redact(source?),
        address: address?,
        source_rules,
        calibration_file,
        calibration: calibration?,
        lens_uncertainty: lens_uncertainty.flatten(),
        pose: pose?,
        line_time_s,
        clock_uncertainty_s,
        rate_hz,
        mode,
        mask: mask?,
        trust,
    })
}

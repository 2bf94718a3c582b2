//! From a TOML document to a checked [`Config`].

use std::{collections::HashMap, net::SocketAddr, ops::Range, path::Path};

use nalgebra::Vector3;
use roundel_core::{camera::Camera, id::KindId, marker::Kind};
use toml::{Spanned, de::DeTable};

use super::{
    CameraConfig, CameraPose, Config, FusionConfig, LimitsConfig, ObjectConfig, ReferenceConfig,
    ServerConfig,
    error::Problem,
    geometry,
    reader::{Allowed, Problems, Table},
};
use crate::{
    camera_file,
    source::{SourceAddress, simulated_camera},
    suggestion::{list, nearest},
};

const ROOT_KEYS: [&str; 8] =
    ["name", "server", "roundel", "camera", "reference", "object", "fusion", "limits"];
const SERVER_KEYS: [&str; 2] = ["listen", "snapshot_rate_hz"];
const ROUNDEL_KEYS: [&str; 3] = ["name", "outer_mm", "inner_mm"];
const CAMERA_KEYS: [&str; 5] = ["name", "source", "calibration", "pose", "line_time_us"];
const REFERENCE_KEYS: [&str; 2] = ["roundel", "position_m"];
const OBJECT_KEYS: [&str; 3] = ["name", "roundel", "offset_m"];
const FUSION_KEYS: [&str; 4] =
    ["acceleration_m_s2", "late_window_ms", "predicted_after_ms", "lost_after_ms"];
const LIMITS_KEYS: [&str; 3] = ["max_objects", "max_roundels_per_camera", "max_clients"];

/// Kinds whose ratios of diameters differ by less than this, relatively, are mixed up.
const LEAST_RATIO_DIFFERENCE: f64 = 0.1;
const DEFAULT_LISTEN: &str = "127.0.0.1:7670";
const DEFAULT_RATE_HZ: f64 = 60.0;
const MAX_RATE_HZ: f64 = 1000.0;
const MAX_DIAMETER_MM: f64 = 100_000.0;
const MAX_LINE_TIME_US: f64 = 10_000.0;
const MAX_DURATION_MS: f64 = 3_600_000.0;

/// A kind with the place of its name, for messages about others.
struct NamedKinds {
    kinds: Vec<Kind>,
    complete: bool,
}

pub(super) fn parse(text: &str, folder: &Path) -> Result<Config, Vec<Problem>> {
    let problems = Problems::new(text);
    let (document, errors) = DeTable::parse_recoverable(text);
    for error in &errors {
        let span = error.span().unwrap_or(0..0);
        problems.add_with_help(
            &span,
            format!("not valid TOML: {}", error.message()),
            "the format is described at https://toml.io",
        );
    }
    let config = if errors.is_empty() { Some(root(&document, folder, &problems)) } else { None };
    match config {
        Some(Some(config)) if !problems.any() => Ok(config),
        _ => Err(problems.into_sorted()),
    }
}

fn root(document: &Spanned<DeTable<'_>>, folder: &Path, problems: &Problems<'_>) -> Option<Config> {
    // What concerns the whole file points to its first line.
    let root = Table::new("", 0..0, document.get_ref(), &ROOT_KEYS, problems);
    let name = root.text("name").unwrap_or("roundel").to_owned();
    let server = server(&root);
    let kinds = kinds(&root);
    let references = references(&root, &kinds);
    let cameras = cameras(&root, folder, references.is_empty());
    let objects = objects(&root, &kinds);
    let fusion = fusion(&root);
    let limits = limits(&root);
    Some(Config {
        name,
        server: server?,
        kinds: kinds.kinds,
        cameras,
        references,
        objects,
        fusion,
        limits,
    })
}

fn server(root: &Table<'_, '_>) -> Option<ServerConfig> {
    let table = root.table("server", "[server]", &SERVER_KEYS);
    let table = table.as_ref();
    let listen = table.and_then(|table| table.text("listen")).unwrap_or(DEFAULT_LISTEN);
    let snapshot_rate_hz = table.map_or(DEFAULT_RATE_HZ, |table| {
        table.number("snapshot_rate_hz", Allowed::PositiveUpTo(MAX_RATE_HZ), DEFAULT_RATE_HZ)
    });
    match listen.parse::<SocketAddr>() {
        Ok(listen) => Some(ServerConfig { listen, snapshot_rate_hz }),
        Err(_) => {
            root.fail_with_help(
                &table.map_or(0..0, |table| table.span_of("listen")),
                format!("`listen` must be an IP address with a port, found \"{listen}\""),
                "write \"127.0.0.1:7670\" for this machine only, \"0.0.0.0:7670\" for every network",
            );
            None
        }
    }
}

fn kinds(root: &Table<'_, '_>) -> NamedKinds {
    let tables = root.tables("roundel", "[[roundel]]", &ROUNDEL_KEYS);
    if root.value("roundel").is_none() {
        root.fail_with_help(
            &root.span().clone(),
            "no kind of roundel is configured",
            "add [[roundel]] with `name`, `outer_mm` and `inner_mm` as measured on the print",
        );
    }
    let mut read: Vec<(Kind, Range<usize>)> = Vec::new();
    let mut complete = true;
    for table in &tables {
        match kind(table, &read) {
            Some(kind) => read.push((kind, table.span_of("inner_mm"))),
            None => complete = false,
        }
    }
    NamedKinds { kinds: read.into_iter().map(|(kind, _)| kind).collect(), complete }
}

fn kind(table: &Table<'_, '_>, earlier: &[(Kind, Range<usize>)]) -> Option<Kind> {
    let size = Allowed::PositiveUpTo(MAX_DIAMETER_MM);
    let name = table.required_text("name", "\"robot\"");
    let outer_mm = table.required_number("outer_mm", size, "160.0");
    let inner_mm = table.required_number("inner_mm", size, "64.0");
    let (name, outer_mm, inner_mm) = (name?, outer_mm?, inner_mm?);
    if inner_mm >= outer_mm {
        table.fail(
            &table.span_of("inner_mm"),
            format!("`inner_mm` must be below `outer_mm` = {outer_mm}, found {inner_mm}"),
        );
        return None;
    }
    let ratio = inner_mm / outer_mm;
    for (other, _) in earlier {
        if other.name == name {
            let message = format!("two kinds of roundel are named \"{name}\"");
            table.fail_with_help(&table.span_of("name"), message, "give each its own name");
            return None;
        }
        let other_ratio = other.inner_diameter_m / other.outer_diameter_m;
        if (ratio - other_ratio).abs() < LEAST_RATIO_DIFFERENCE * ratio.max(other_ratio) {
            table.fail_with_help(
                &table.span_of("inner_mm"),
                format!(
                    "roundels \"{}\" and \"{name}\" cannot be told apart: inner to outer diameter \
                     {other_ratio:.3} and {ratio:.3}",
                    other.name
                ),
                "kinds are told apart by this ratio: make them differ by a tenth at least",
            );
            return None;
        }
    }
    Some(Kind::plain(name, outer_mm * 1e-3, inner_mm * 1e-3))
}

/// The kind that `roundel = …` names.
fn kind_named(table: &Table<'_, '_>, kinds: &NamedKinds) -> Option<KindId> {
    let name = table.required_text("roundel", "\"robot\"")?;
    let place = kinds.kinds.iter().position(|kind| kind.name == name);
    // A kind that is itself wrong is reported where it stands, not at each of its uses.
    if place.is_none() && kinds.complete {
        let names = || kinds.kinds.iter().map(|kind| kind.name.as_str());
        let meant = nearest(name, names())
            .map(|meant| format!("; did you mean \"{meant}\"?"))
            .unwrap_or_default();
        table.fail_with_help(
            &table.span_of("roundel"),
            format!("no [[roundel]] is named \"{name}\"{meant}"),
            format!("configured: {}", list(names())),
        );
    }
    place.and_then(|place| u16::try_from(place).ok()).map(KindId)
}

fn references(root: &Table<'_, '_>, kinds: &NamedKinds) -> Vec<ReferenceConfig> {
    let tables = root.tables("reference", "[[reference]]", &REFERENCE_KEYS);
    let references: Vec<ReferenceConfig> = tables
        .iter()
        .filter_map(|table| {
            let kind = kind_named(table, kinds);
            let position = table.required_numbers::<3>("position_m", "[0.0, 0.0, 0.0]");
            Some(ReferenceConfig { kind: kind?, position_m: Vector3::from(position?) })
        })
        .collect();
    // Judged only when each of them could be read.
    let Some(last) = tables.last().filter(|_| references.len() == tables.len()) else {
        return references;
    };
    let places: Vec<Vector3<f64>> = references.iter().map(|r| r.position_m).collect();
    let span = last.span().clone();
    if places.len() < 3 {
        root.fail_with_help(
            &span,
            format!("expected at least 3 reference roundels, found {}", places.len()),
            "add [[reference]] tables until there are three that are not in one line",
        );
    } else if let Some((first, second)) = geometry::same_place(&places) {
        root.fail(
            &tables[second].span_of("position_m"),
            format!("references {} and {} have the same place", first + 1, second + 1),
        );
    } else if geometry::collinear(&places) {
        root.fail_with_help(
            &span,
            "all reference roundels lie in one line",
            "a camera's place does not follow from points in one line: move one of them aside",
        );
    }
    references
}

fn cameras(root: &Table<'_, '_>, folder: &Path, no_references: bool) -> Vec<CameraConfig> {
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
        cameras.extend(camera(table, name, folder));
        let unknown = cameras.last().is_some_and(|camera| camera.pose == CameraPose::Unknown);
        if unknown && no_references && root.value("reference").is_none() {
            table.fail_with_help(
                &table.span_of("pose"),
                "`pose = \"unknown\"` needs reference roundels, and none are configured",
                "add at least three [[reference]] tables, or give the camera's pose",
            );
        }
    }
    cameras
}

fn camera(table: &Table<'_, '_>, name: Option<&str>, folder: &Path) -> Option<CameraConfig> {
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
    let calibration = match (table.value("calibration"), &simulated) {
        (None, Some(simulated)) => Some(simulated.camera.clone()),
        _ => calibration(table, folder, required),
    };
    let pose = match (table.value("pose"), &simulated) {
        (None, Some(simulated)) => Some(CameraPose::Known(simulated.world_from_camera)),
        _ => camera_pose(table, required),
    };
    let line_time_s = match (table.value("line_time_us"), &simulated) {
        (None, Some(simulated)) => simulated.line_time_s,
        _ => table.number("line_time_us", Allowed::ZeroUpTo(MAX_LINE_TIME_US), 0.0) * 1e-6,
    };
    if table.is_broken() {
        return None;
    }
    Some(CameraConfig {
        name: name?.to_owned(),
        source: source?.to_owned(),
        address: address?,
        calibration: calibration?,
        pose: pose?,
        line_time_s,
    })
}

fn calibration(table: &Table<'_, '_>, folder: &Path, required: bool) -> Option<Camera> {
    let file = if required {
        table.required_text("calibration", "\"north.yaml\"")
    } else {
        table.text("calibration")
    }?;
    match camera_file::load(&folder.join(file)) {
        Ok(camera) => Some(camera),
        Err(error) => {
            table.fail(&table.span_of("calibration"), error.to_string());
            None
        }
    }
}

fn camera_pose(table: &Table<'_, '_>, required: bool) -> Option<CameraPose> {
    const POSE_HELP: &str = "write { position_m = [x, y, z], orientation_xyzw = [x, y, z, w] }, or \
                             \"unknown\" to have it found from the reference roundels";
    let Some(value) = table.value("pose") else {
        if required {
            table.report_missing("pose", "\"unknown\"");
        }
        return None;
    };
    if let Some(text) = value.get_ref().as_str() {
        if text == "unknown" {
            return Some(CameraPose::Unknown);
        }
        let message = format!("`pose` must be a table or \"unknown\", found the text \"{text}\"");
        table.fail_with_help(&value.span(), message, POSE_HELP);
        return None;
    }
    geometry::pose(table, POSE_HELP).map(CameraPose::Known)
}

fn objects(root: &Table<'_, '_>, kinds: &NamedKinds) -> Vec<ObjectConfig> {
    let tables = root.tables("object", "[[object]]", &OBJECT_KEYS);
    let mut objects: Vec<ObjectConfig> = Vec::new();
    for table in &tables {
        let name = table.required_text("name", "\"robot one\"");
        let kind = kind_named(table, kinds);
        let offset = match table.value("offset_m") {
            Some(_) => table.numbers::<3>("offset_m"),
            None => Some([0.0; 3]),
        };
        let (Some(name), Some(kind), Some(offset)) = (name, kind, offset) else { continue };
        if let Some(other) = objects.iter().find(|object| object.kind == kind) {
            table.fail_with_help(
                &table.span_of("roundel"),
                format!(
                    "objects \"{}\" and \"{name}\" carry the same kind of roundel",
                    other.name
                ),
                "plain roundels of one kind cannot be told apart: print another ratio for one of them",
            );
        } else if objects.iter().any(|object| object.name == name) {
            let message = format!("two objects are named \"{name}\"");
            table.fail_with_help(&table.span_of("name"), message, "give each its own name");
        }
        objects.push(ObjectConfig { name: name.to_owned(), kind, offset_m: Vector3::from(offset) });
    }
    objects
}

fn fusion(root: &Table<'_, '_>) -> FusionConfig {
    let default = FusionConfig::default();
    let Some(table) = root.table("fusion", "[fusion]", &FUSION_KEYS) else { return default };
    let seconds = |key, default_s: f64| {
        table.number(key, Allowed::PositiveUpTo(MAX_DURATION_MS), default_s * 1e3) * 1e-3
    };
    let fusion = FusionConfig {
        acceleration_m_s2: table.number(
            "acceleration_m_s2",
            Allowed::PositiveUpTo(1e4),
            default.acceleration_m_s2,
        ),
        late_window_s: table.number(
            "late_window_ms",
            Allowed::ZeroUpTo(MAX_DURATION_MS),
            default.late_window_s * 1e3,
        ) * 1e-3,
        predicted_after_s: seconds("predicted_after_ms", default.predicted_after_s),
        lost_after_s: seconds("lost_after_ms", default.lost_after_s),
    };
    if fusion.lost_after_s <= fusion.predicted_after_s {
        table.fail(
            &table.span_of("lost_after_ms"),
            format!(
                "`lost_after_ms` must be above `predicted_after_ms` = {}, found {}",
                fusion.predicted_after_s * 1e3,
                fusion.lost_after_s * 1e3
            ),
        );
    }
    fusion
}

fn limits(root: &Table<'_, '_>) -> LimitsConfig {
    let default = LimitsConfig::default();
    let Some(table) = root.table("limits", "[limits]", &LIMITS_KEYS) else { return default };
    LimitsConfig {
        max_objects: table.count("max_objects", 100_000, default.max_objects),
        max_roundels_per_camera: table.count(
            "max_roundels_per_camera",
            10_000,
            default.max_roundels_per_camera,
        ),
        max_clients: table.count("max_clients", 15_000, default.max_clients),
    }
}

//! From a TOML document to a checked [`Config`].

use std::{net::SocketAddr, path::Path};

use roundel_core::marker::Mode;
use toml::{Spanned, de::DeTable};

use super::{
    Config, ConfigFile, FusionConfig, Lenses, LimitsConfig, ServerConfig,
    allow_origins::allow_origins,
    camera::{CameraContext, MODES, cameras},
    error::Problem,
    history::history,
    object::objects,
    reader::{NumberRange, Problems, Table},
    recording::recording,
    reference::references,
    roundel::kinds,
};

const ROOT_KEYS: [&str; 12] = [
    "name",
    "server",
    "detection",
    "roundel",
    "camera",
    "reference",
    "object",
    "fusion",
    "limits",
    "recording",
    "history",
    "node",
];
const NODE_KEYS: [&str; 1] = ["server"];
const DETECTION_KEYS: [&str; 1] = ["mode"];
const SERVER_KEYS: [&str; 7] =
    ["listen", "snapshot_rate_hz", "prompt", "calibration", "watch", "setup", "allow_origins"];
const FUSION_KEYS: [&str; 4] =
    ["acceleration_m_s2", "late_window_ms", "predicted_after_ms", "lost_after_ms"];
const LIMITS_KEYS: [&str; 3] = ["max_objects", "max_roundels_per_camera", "max_clients"];

const DEFAULT_LISTEN: &str = "127.0.0.1:7670";
const DEFAULT_RATE_HZ: f64 = 60.0;
const MAX_RATE_HZ: f64 = 1000.0;
const MAX_DURATION_MS: f64 = 3_600_000.0;

/// What a text is read for.
#[derive(Clone, Copy, Default)]
pub(super) struct ParseOptions<'a> {
    /// A node's cameras need no poses.
    pub(super) is_node: bool,
    /// Lenses in place of those in files.
    pub(super) lenses: Option<&'a Lenses>,
    /// For what is carried alone: cameras are not read.
    pub(super) is_without_cameras: bool,
}

pub(super) fn parse(
    text: &str,
    folder: &Path,
    options: ParseOptions<'_>,
) -> Result<Config, Vec<Problem>> {
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
    let config = if errors.is_empty() {
        Some(root(&document, (text, folder), &problems, options))
    } else {
        None
    };
    match config {
        Some(Some(config)) if !problems.any() => Ok(config),
        _ => Err(problems.into_sorted()),
    }
}

fn root(
    document: &Spanned<DeTable<'_>>,
    (text, folder): (&str, &Path),
    problems: &Problems<'_>,
    ParseOptions { is_node, lenses, is_without_cameras }: ParseOptions<'_>,
) -> Option<Config> {
    // What concerns the whole file points to its first line.
    let root = Table::new("", 0..0, document.get_ref(), &ROOT_KEYS, problems);
    let name = root.text("name").unwrap_or("roundel").to_owned();
    let server = server(&root, folder);
    let kinds = kinds(&root);
    let references = references(&root, &kinds);
    let objects = objects(&root, &kinds, &references.configs);
    let node = node(&root);
    let is_node = is_node || node.is_some();
    let mode = mode(&root);
    let known = CameraContext {
        kinds: &kinds,
        references: &references,
        objects: &objects,
        lenses,
        is_node,
    };
    let cameras =
        if is_without_cameras { Vec::new() } else { cameras(&root, folder, &known, mode) };
    let fusion = fusion(&root);
    let limits = limits(&root);
    Some(Config {
        file: ConfigFile::new(None, text.to_owned()),
        folder: folder.to_owned(),
        name,
        server: server?,
        mode,
        kinds: kinds.kinds,
        motions: kinds.motions,
        cameras,
        references: references.configs,
        objects: objects.configs,
        fusion,
        limits,
        recording: recording(&root, folder),
        history: history(&root, folder),
        node,
    })
}

fn server(root: &Table<'_, '_>, folder: &Path) -> Option<ServerConfig> {
    let table = root.table("server", "[server]", &SERVER_KEYS);
    let table = table.as_ref();
    let listen = table.and_then(|table| table.text("listen")).unwrap_or(DEFAULT_LISTEN);
    let snapshot_rate_hz = table.map_or(DEFAULT_RATE_HZ, |table| {
        table.number("snapshot_rate_hz", NumberRange::PositiveUpTo(MAX_RATE_HZ), DEFAULT_RATE_HZ)
    });
    let publishes_per_frame = table.and_then(|table| table.flag("prompt")).unwrap_or(false);
    let calibration = table.and_then(|table| table.text("calibration"));
    let calibration = calibration.map(|file| folder.join(file));
    let monitors_cameras = table.and_then(|table| table.flag("watch")).unwrap_or(true);
    let setup = table.and_then(|table| table.flag("setup"));
    let allow_origins = table.map(allow_origins).unwrap_or_default();
    match listen.parse::<SocketAddr>() {
        Ok(listen) => {
            // Only this machine's own users reach a port of the loopback.
            let setup = setup.unwrap_or(listen.ip().is_loopback());
            Some(ServerConfig {
                listen,
                snapshot_rate_hz,
                publishes_per_frame,
                calibration,
                monitors_cameras,
                setup,
                allow_origins,
            })
        }
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

/// `[node]`: where the server is. That there is one is what makes the file a node's.
fn node(root: &Table<'_, '_>) -> Option<String> {
    let table = root.table("node", "[node]", &NODE_KEYS)?;
    table.required_text("server", "\"http://10.0.0.1:7670\"").map(str::to_owned)
}

/// `[detection]`.
fn mode(root: &Table<'_, '_>) -> Mode {
    let table = root.table("detection", "[detection]", &DETECTION_KEYS);
    table.and_then(|table| table.choice("mode", &MODES)).unwrap_or_default()
}

fn fusion(root: &Table<'_, '_>) -> FusionConfig {
    let default = FusionConfig::default();
    let Some(table) = root.table("fusion", "[fusion]", &FUSION_KEYS) else { return default };
    let seconds = |key, default_s: f64| {
        table.number(key, NumberRange::PositiveUpTo(MAX_DURATION_MS), default_s * 1e3) * 1e-3
    };
    let fusion = FusionConfig {
        acceleration_m_s2: table.number(
            "acceleration_m_s2",
            NumberRange::PositiveUpTo(1e4),
            default.acceleration_m_s2,
        ),
        late_window_s: table.number(
            "late_window_ms",
            NumberRange::ZeroUpTo(MAX_DURATION_MS),
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

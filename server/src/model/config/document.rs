//! From a TOML document to a checked [`Config`].

use std::{cell::RefCell, net::SocketAddr, path::Path};

use toml::de::DeTable;

use super::{
    Config, ConfigFile, FusionConfig, Lenses, LimitsConfig, ServerConfig,
    access::access,
    allow_origins::allow_origins,
    camera::{CameraContext, MODES, cameras},
    error::Problem,
    history::history,
    node::node,
    object::objects,
    reader::{NumberRange, Problems, Table},
    recording::recording,
    reference::references,
    request::RequestScope,
    roundel::kinds,
    source_rules::source_rules,
    tls::tls,
};

const ROOT_KEYS: [&str; 13] = [
    "name",
    "server",
    "access",
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
const SERVER_KEYS: [&str; 13] = [
    "listen",
    "snapshot_rate_hz",
    "prompt",
    "calibration",
    "watch",
    "setup",
    "allow_origins",
    "allow_hosts",
    "trusted_proxies",
    "insecure",
    "tls",
    "source_folders",
    "source_networks",
];
const FUSION_KEYS: [&str; 5] = [
    "acceleration_m_s2",
    "focal_deviation",
    "late_window_ms",
    "predicted_after_ms",
    "lost_after_ms",
];
const LIMITS_KEYS: [&str; 4] =
    ["max_objects", "max_roundels_per_camera", "max_clients", "max_connections_per_peer"];

const DEFAULT_LISTEN: &str = "127.0.0.1:7670";
const DEFAULT_RATE_HZ: f64 = 60.0;
/// Share of the interval between frames.
const DEFAULT_TIME_BUDGET: f64 = 0.6;
const MAX_RATE_HZ: f64 = 1000.0;
const MAX_DURATION_MS: f64 = 3_600_000.0;

/// The purpose of parsing.
#[derive(Clone, Copy, Default)]
pub(super) struct ParseOptions<'a> {
    /// A node's cameras need no poses.
    pub(super) is_node: bool,
    /// Lenses in place of camera files.
    pub(super) lenses: Option<&'a Lenses>,
    /// Cameras are not parsed.
    pub(super) is_without_cameras: bool,
    /// Limits what the text may name; `None` for the operator's own file.
    pub(super) request: Option<RequestScope<'a>>,
}

pub(super) fn parse(
    text: &str,
    folder: &Path,
    options: ParseOptions<'_>,
) -> Result<Config, Vec<Problem>> {
    let problems = Problems::new(text);
    let (document, errors) = DeTable::parse_recoverable(text);
    for error in &errors {
        let message = format!("not valid TOML: {}", error.message());
        let help = "the format is described at https://toml.io";
        problems.add(&error.span().unwrap_or(0..0), message, help);
    }
    let is_valid = errors.is_empty();
    let config = is_valid.then(|| root(document.get_ref(), (text, folder), &problems, options));
    match config.flatten() {
        Some(config) if !problems.any() => Ok(config),
        _ => Err(problems.into_sorted()),
    }
}

fn root(
    document: &DeTable<'_>,
    (text, folder): (&str, &Path),
    problems: &Problems<'_>,
    ParseOptions { is_node, lenses, is_without_cameras, request }: ParseOptions<'_>,
) -> Option<Config> {
    // Problems of the whole file are located in its first line.
    let root = Table::new("", 0..0, Some(document), &ROOT_KEYS, problems);
    let name = root.text("name").unwrap_or("roundel").to_owned();
    let server_table = root.section("server", "[server]", &SERVER_KEYS);
    let kinds = kinds(&root);
    let references = references(&root, &kinds);
    let objects = objects(&root, &kinds, &references.configs);
    let node = node(&root, folder);
    let detection = root.section("detection", "[detection]", &["mode", "time_budget"]);
    let mode = detection.choice("mode", &MODES).unwrap_or_default();
    let range = NumberRange::PositiveUpTo(1.0);
    let time_budget = detection.number("time_budget", range, DEFAULT_TIME_BUDGET);
    let cameras = if is_without_cameras {
        Vec::new()
    } else {
        let context = CameraContext {
            kinds: &kinds,
            references: &references,
            objects: &objects,
            lenses,
            is_node: is_node || node.is_some(),
            mode,
            folder,
            request,
            camera_files: RefCell::default(),
            worlds: RefCell::default(),
        };
        cameras(&root, &context)
    };
    let fusion = fusion(&root);
    let limits = limits(&root);
    let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    let access = access(&root, &server_table, (!is_without_cameras).then_some(&names));
    Some(Config {
        file: ConfigFile::new(None, text.to_owned()),
        folder: folder.to_owned(),
        name,
        server: server(&server_table, folder, !access.entries.is_empty())?,
        access,
        mode,
        time_budget,
        kinds: kinds.kinds,
        motions: kinds.motions,
        tolerances: kinds.tolerances,
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

fn server(table: &Table<'_, '_>, folder: &Path, has_access: bool) -> Option<ServerConfig> {
    let listen = table.text("listen").unwrap_or(DEFAULT_LISTEN);
    let rates = NumberRange::PositiveUpTo(MAX_RATE_HZ);
    let snapshot_rate_hz = table.number("snapshot_rate_hz", rates, DEFAULT_RATE_HZ);
    let publishes_per_frame = table.flag("prompt").unwrap_or(false);
    let calibration = table.text("calibration").map(|file| folder.join(file));
    let monitors_cameras = table.flag("watch").unwrap_or(true);
    let setup = table.flag("setup");
    let allow_origins = allow_origins(table);
    let tls = tls(table, folder);
    let source_rules = source_rules(table, folder);
    let Ok(listen) = listen.parse::<SocketAddr>() else {
        return table.reject(
            "listen",
            format!("`listen` must be an IP address with a port, found \"{listen}\""),
            "write \"127.0.0.1:7670\" for this machine only, \"0.0.0.0:7670\" for every network",
        );
    };
    Some(ServerConfig {
        listen,
        snapshot_rate_hz,
        publishes_per_frame,
        calibration,
        monitors_cameras,
        // Only users of this machine reach a loopback port; with `[[access]]`, roles decide.
        setup: setup.unwrap_or(has_access || listen.ip().is_loopback()),
        allow_origins,
        tls,
        source_rules,
    })
}

fn fusion(root: &Table<'_, '_>) -> FusionConfig {
    let default = FusionConfig::default();
    let table = root.section("fusion", "[fusion]", &FUSION_KEYS);
    let positive_ms = NumberRange::PositiveUpTo(MAX_DURATION_MS);
    let seconds = |key, range, default_s: f64| table.number(key, range, default_s * 1e3) * 1e-3;
    let fusion = FusionConfig {
        acceleration_m_s2: table.number(
            "acceleration_m_s2",
            NumberRange::PositiveUpTo(1e4),
            default.acceleration_m_s2,
        ),
        focal_deviation: table.number(
            "focal_deviation",
            NumberRange::ZeroUpTo(0.1),
            default.focal_deviation,
        ),
        late_window_s: seconds(
            "late_window_ms",
            NumberRange::ZeroUpTo(MAX_DURATION_MS),
            default.late_window_s,
        ),
        predicted_after_s: seconds("predicted_after_ms", positive_ms, default.predicted_after_s),
        lost_after_s: seconds("lost_after_ms", positive_ms, default.lost_after_s),
    };
    if fusion.lost_after_s <= fusion.predicted_after_s {
        let message = format!(
            "`lost_after_ms` must be above `predicted_after_ms` = {}, found {}",
            fusion.predicted_after_s * 1e3,
            fusion.lost_after_s * 1e3
        );
        table.fail("lost_after_ms", message, "");
    }
    fusion
}

fn limits(root: &Table<'_, '_>) -> LimitsConfig {
    let table = root.section("limits", "[limits]", &LIMITS_KEYS);
    let count = |key, most, default| table.whole(key, 1..=most).unwrap_or(default);
    let default = LimitsConfig::default();
    let max_clients = count("max_clients", 15_000, default.max_clients);
    // One address may be a whole laboratory behind a proxy.
    let max_per_peer = max_clients.div_ceil(2);
    LimitsConfig {
        max_objects: count("max_objects", 100_000, default.max_objects),
        max_roundels_per_camera: count(
            "max_roundels_per_camera",
            10_000,
            default.max_roundels_per_camera,
        ),
        max_clients,
        max_connections_per_peer: count("max_connections_per_peer", 15_000, max_per_peer),
    }
}

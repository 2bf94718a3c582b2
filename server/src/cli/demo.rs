//! `roundel demo`: a simulated arena through the whole server, compared with the truth.

use std::{
    io::{self, Write as _},
    net::SocketAddr,
    path::PathBuf,
    process::ExitCode,
    time::Duration,
};

use anyhow::Context;
use clap::{Args, ValueEnum};
use roundel_core::{
    marker::Mode,
    sim::{RobotTruth, Scenario},
};

use super::{
    serve::{Signals, announce, elapsed, seconds, shut_down},
    truth::Score,
};
use crate::{
    config::{
        CameraConfig, CameraPose, Config, FusionConfig, LimitsConfig, ReferenceConfig, ServerConfig,
    },
    hub::CameraState,
    serve::Server,
    source::{SimAddress, SimPreset, SourceAddress, simulated_scenario},
};

/// Time from the first tracked object in which tracks settle; it does not count.
const SETTLING_S: f64 = 2.0;
const REPORT_EVERY: Duration = Duration::from_secs(1);

/// Try it without a camera: four simulated cameras, 24 robots, the dashboard.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel demo --duration 20\n  \
    roundel demo --preset r4\n\n\
    Prints the dashboard's address, and once a second how far the poses are off the truth (root\n\
    mean square of the position's error).")]
pub struct DemoArgs {
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    /// How much is simulated
    #[arg(long, value_enum, default_value_t)]
    preset: PresetWord,
    /// Another seed is another world
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Robots in the arena [default: 24]
    #[arg(long, value_name = "N")]
    robots: Option<usize>,
    /// Where to listen; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7670")]
    listen: SocketAddr,
}

/// Words for simulated installations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum PresetWord {
    /// Four cameras of 1280x720 at 30 Hz, plain roundels
    #[default]
    #[value(name = "r4_lite")]
    R4Lite,
    /// Four cameras of 1920x1080 at 60 Hz, coded roundels: identities and headings; wants some cores
    R4,
    /// As r4_lite, with elliptical discs of three kinds: headings, but for half a turn
    #[value(name = "r4_elliptical")]
    R4Elliptical,
}

/// Runs the demo until a signal or the end of `--duration`.
pub(super) async fn run(arguments: DemoArgs) -> anyhow::Result<ExitCode> {
    let address = SimAddress {
        preset: match arguments.preset {
            PresetWord::R4Lite => SimPreset::R4Lite,
            PresetWord::R4 => SimPreset::R4,
            PresetWord::R4Elliptical => SimPreset::R4Elliptical,
        },
        seed: arguments.seed,
        robots: arguments.robots,
        camera: 0,
    };
    let scenario = simulated_scenario(&address).context("cannot simulate this arena")?;
    let config = config(&scenario, &address, arguments.listen);
    let mut signals = Signals::listen()?;
    let server = Server::start(config).await?;
    announce(&server)?;
    say(&format!("dashboard: http://{}/ (Ctrl-C ends the demo)", server.local_addr()))?;
    let mut total = Score::default();
    tokio::select! {
        () = signals.next() => {}
        () = elapsed(arguments.duration) => {}
        // Whoever read the lines has gone.
        _ = report(&server, &scenario, &mut total) => {}
    }
    let frames = frames(&server.hub().cameras());
    shut_down(server).await;
    // Nobody may be left to read it.
    let _ = say(&format!("in all: {}; {frames}", total.line()));
    Ok(ExitCode::SUCCESS)
}

fn say(line: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{line}")?;
    stdout.flush()
}

/// The scenario's cameras as an installation.
fn config(scenario: &Scenario, address: &SimAddress, listen: SocketAddr) -> Config {
    let cameras = scenario.cameras().iter().enumerate().map(|(index, camera)| {
        let address = SimAddress { camera: index, ..address.clone() };
        CameraConfig {
            name: camera.name.clone(),
            source: address.to_string(),
            address: SourceAddress::Sim(address),
            calibration: camera.camera.clone(),
            pose: CameraPose::Known(camera.world_from_camera),
            line_time_s: camera.line_time_s,
            clock_uncertainty_s: 0.0,
            rate_hz: None,
            mode: Mode::default(),
            mask: Vec::new(),
        }
    });
    Config {
        name: "demo".to_owned(),
        folder: PathBuf::new(),
        server: ServerConfig {
            listen,
            snapshot_rate_hz: 60.0,
            calibration: None,
            watches: true,
            setup: listen.ip().is_loopback(),
        },
        kinds: scenario.params().kinds.clone(),
        motions: Vec::new(),
        cameras: cameras.collect(),
        references: references(scenario),
        objects: Vec::new(),
        fusion: FusionConfig::default(),
        limits: LimitsConfig::default(),
        node: None,
    }
}

/// Robots with codes that never move, so that this arena can be calibrated.
fn references(scenario: &Scenario) -> Vec<ReferenceConfig> {
    let reference = |truth: RobotTruth| ReferenceConfig {
        kind: truth.kind,
        code: truth.code,
        position_m: truth.world_from_roundel.translation.vector,
        deviation_m: 1e-3,
        orientation: Some(truth.world_from_roundel.rotation),
    };
    let robots = scenario.truth(0.0).into_iter();
    robots.filter(|truth| truth.still && truth.code.is_some()).map(reference).collect()
}

/// Compares every snapshot with the truth and prints a line each second, until nobody reads them.
async fn report(server: &Server, scenario: &Scenario, total: &mut Score) -> io::Result<()> {
    let origin = server.playback().origin;
    let mut snapshots = server.hub().snapshots();
    let mut ticks = tokio::time::interval(REPORT_EVERY);
    ticks.tick().await;
    let mut second = Score::default();
    let mut settled_s = f64::INFINITY;
    loop {
        tokio::select! {
            changed = snapshots.changed() => {
                if changed.is_err() {
                    // The hub is gone: the caller is taking the server apart.
                    return std::future::pending().await;
                }
                let fused = snapshots.borrow_and_update().clone();
                let time_s = fused.snapshot.pose_time.seconds_since(origin);
                if settled_s.is_infinite() && !fused.snapshot.objects.is_empty() {
                    settled_s = time_s + SETTLING_S;
                }
                if time_s >= settled_s {
                    second.add(scenario, &fused.snapshot, time_s);
                }
            }
            _ = ticks.tick() => {
                let elapsed_s = server.clock().now().seconds_since(origin);
                let cameras = cameras(&server.hub().cameras());
                total.merge(&second);
                say(&format!("{elapsed_s:6.1} s  {}; {cameras}", second.line()))?;
                second = Score::default();
            }
        }
    }
}

/// The cameras' rates, and the worst of their times.
fn cameras(states: &[CameraState]) -> String {
    let rates: Vec<String> = states.iter().map(|state| format!("{:.1}", state.rate_hz)).collect();
    let worst = |value: fn(&CameraState) -> f64| states.iter().map(value).fold(0.0, f64::max);
    format!(
        "cameras {} Hz, detection {:.1} ms, latency {:.1} ms",
        rates.join(" "),
        worst(|state| state.detect_ms),
        worst(|state| state.latency_ms),
    )
}

fn frames(states: &[CameraState]) -> String {
    let sum = |value: fn(&CameraState) -> u64| states.iter().map(value).sum::<u64>();
    format!("{} frames, {} left out", sum(|state| state.frames), sum(|state| state.dropped))
}

//! `roundel demo`: a simulated arena through the whole server, compared with the truth.

use std::{collections::BTreeMap, net::SocketAddr, path::Path, process::ExitCode, time::Duration};

use anyhow::{Context, anyhow};
use clap::Args;
use nalgebra::Vector3;
use roundel_core::{
    id::CameraId,
    sim::{RobotTruth, Scenario},
};

use super::{
    ground_truth::Score,
    print,
    serve::{announce, seconds, serve_until},
    signals::ServerEnd,
    words,
};
use crate::{
    app::serve::Server,
    capture::source::fleet::Fleet,
    lab::print::config_lines,
    model::{
        address::{SimAddress, SimPreset},
        config::{Config, Problem, ReferenceConfig, ServerConfig},
        hub::CameraState,
        simulated::simulated_scenario,
    },
};

/// Time after the first tracked object that is not scored, so that tracks can settle.
const SETTLING_S: f64 = 2.0;
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Try it without a camera: four simulated cameras, 24 robots, the dashboard.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel demo --duration 20\n  \
    roundel demo --preset r4\n\n\
    Prints the dashboard's address, and once a second the root mean square error of the positions against the\n\
    ground truth.")]
pub struct DemoArgs {
    /// Stop after this many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    /// The simulated installation
    #[arg(long, default_value = "r4_lite", value_parser = words(&PRESETS))]
    preset: SimPreset,
    /// Seed of the simulated world
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Robots in the arena [default: 24]
    #[arg(long, value_name = "N")]
    robots: Option<usize>,
    /// Address to listen on; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7670")]
    listen: SocketAddr,
    /// Allow an address that other computers reach, without encryption and credentials
    #[arg(long)]
    insecure: bool,
}

const PRESETS: [(&str, SimPreset, &str); 3] = [
    ("r4_lite", SimPreset::R4Lite, "Four cameras of 1280x720 at 30 Hz, plain roundels"),
    (
        "r4",
        SimPreset::R4,
        "Four cameras of 1920x1080 at 60 Hz, coded roundels: identities and headings; needs several cores",
    ),
    (
        "r4_elliptical",
        SimPreset::R4Elliptical,
        "Like r4_lite, with elliptical discs of three kinds: headings are ambiguous by half a turn",
    ),
];

/// Runs the demo until a signal or the end of `--duration`.
pub(super) async fn run(arguments: DemoArgs) -> anyhow::Result<ExitCode> {
    let address = SimAddress {
        preset: arguments.preset,
        seed: arguments.seed,
        robots: arguments.robots,
        camera: 0,
    };
    let scenario = simulated_scenario(&address).context("cannot simulate this arena")?;
    let mut config = config(&scenario, &address, arguments.listen)?;
    config.access.insecure = arguments.insecure;
    let end = ServerEnd::listen(arguments.duration)?;
    let server = Server::start(config).await?;
    let fleet = server.fleets().of(&address, server.playback().origin)?;
    announce(&server)?;
    print(&format!("dashboard: http://{}/ (Ctrl-C ends the demo)\n", server.local_addr()))?;
    let mut total = Score::default();
    tokio::select! {
        () = end.wait() => {}
        () = server.failed() => {}
        // The reader of the output has gone.
        _ = report(&server, &fleet, &mut total) => {}
    }
    let states = server.hub().cameras();
    let sum = |value: fn(&CameraState) -> u64| states.values().map(value).sum::<u64>();
    let (frames, dropped) = (sum(|state| state.frames), sum(|state| state.dropped));
    end.begin();
    let code = serve_until(server, &end).await;
    let _ = print(&format!("in all: {}; {frames} frames, {dropped} dropped\n", total.line()));
    Ok(code)
}

/// The scenario's cameras as an installation, parsed from a text like any other so that its cameras can be changed.
/// Kinds and references are then replaced by the scenario's own, which are not rounded.
fn config(scenario: &Scenario, address: &SimAddress, listen: SocketAddr) -> anyhow::Result<Config> {
    let internal_error = |problems: Vec<Problem>| {
        let messages: Vec<String> = problems.into_iter().map(|problem| problem.message).collect();
        anyhow!("internal error, please report it: {}", messages.join("; "))
    };
    let parsed = Config::parse(&text(scenario, address), Path::new(""));
    let config = parsed.map_err(internal_error)?;
    let setup = listen.ip().is_loopback();
    Ok(Config {
        server: ServerConfig { listen, setup, ..config.server },
        kinds: scenario.params().kinds.clone(),
        references: references(scenario),
        ..config
    })
}

fn text(scenario: &Scenario, address: &SimAddress) -> String {
    // Simulated lenses are exact.
    let mut text = "name = \"demo\"\n\n[fusion]\nfocal_deviation = 0.0\n".to_owned();
    for kind in &scenario.params().kinds {
        text += &format!("\n{}\n", config_lines(kind).join("\n"));
    }
    for (index, camera) in scenario.cameras().iter().enumerate() {
        let source = SimAddress { camera: index, ..address.clone() };
        text += &format!("\n[[camera]]\nname = {:?}\nsource = \"{source}\"\n", camera.name);
    }
    for ReferenceConfig { kind, code, position_m, orientation, .. } in references(scenario) {
        let name = &scenario.params().kinds[usize::from(kind.0)].name;
        let number = code.map(|code| format!("code = {}\n", code.number)).unwrap_or_default();
        let turn = orientation.unwrap_or_default();
        let [right, top] = [Vector3::x(), Vector3::y()].map(|axis| turn * axis);
        text += &format!(
            "\n[[reference]]\nroundel = {name:?}\n{number}position_m = {:?}\nright = {:?}\ntop = {:?}\n",
            position_m.as_slice(),
            right.as_slice(),
            top.as_slice()
        );
    }
    text
}

/// The coded robots that never move. They serve as references for calibrating the arena.
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

/// Compares every snapshot with the truth and prints a line each second; ends only when printing fails.
async fn report(server: &Server, fleet: &Fleet, total: &mut Score) -> anyhow::Result<()> {
    let origin = server.playback().origin;
    let mut snapshots = server.hub().snapshots();
    let mut ticks = tokio::time::interval(REPORT_INTERVAL);
    ticks.tick().await;
    let mut second = Score::default();
    let mut settled_s = f64::INFINITY;
    loop {
        tokio::select! {
            changed = snapshots.changed() => {
                if changed.is_err() {
                    // The hub is gone: the caller is shutting the server down.
                    return std::future::pending().await;
                }
                let fused = snapshots.borrow_and_update().clone();
                let time_s = fused.snapshot.pose_time.seconds_since(origin);
                if settled_s.is_infinite() && !fused.snapshot.objects.is_empty() {
                    settled_s = time_s + SETTLING_S;
                }
                if time_s >= settled_s {
                    for score in [&mut second, &mut *total] {
                        score.add(&fleet.scenario(), &fused.snapshot, time_s);
                    }
                }
            }
            _ = ticks.tick() => {
                let elapsed_s = server.clock().now().seconds_since(origin);
                let cameras = describe(&server.hub().cameras());
                print(&format!("{elapsed_s:6.1} s  {}; {cameras}\n", second.line()))?;
                second = Score::default();
            }
        }
    }
}

/// The cameras' rates, and the longest of their times.
fn describe(states: &BTreeMap<CameraId, CameraState>) -> String {
    let rates: Vec<String> = states.values().map(|state| format!("{:.1}", state.rate_hz)).collect();
    let worst = |value: fn(&CameraState) -> f64| states.values().map(value).fold(0.0, f64::max);
    format!(
        "cameras {} Hz, detection {:.1} ms, latency {:.1} ms",
        rates.join(" "),
        worst(|state| state.detect_ms),
        worst(|state| state.latency_ms),
    )
}

//! `roundel demo`: a simulated arena through the whole server, compared with the truth.

use std::{
    collections::BTreeMap,
    io::{self, Write as _},
    net::SocketAddr,
    path::Path,
    process::ExitCode,
    time::Duration,
};

use anyhow::{Context, anyhow};
use clap::{Args, ValueEnum};
use nalgebra::Vector3;
use roundel_core::{
    id::CameraId,
    marker::{CodeLayout, Pattern},
    sim::{RobotTruth, Scenario},
};

use super::{
    ground_truth::Score,
    serve::{Signals, announce, elapsed, seconds, shut_down},
};
use crate::{
    app::serve::Server,
    capture::source::fleet::Fleet,
    model::{
        address::{SimAddress, SimPreset},
        config::{Config, Problem, ReferenceConfig, ServerConfig},
        hub::CameraState,
        simulated::simulated_scenario,
    },
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
    preset: PresetArg,
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
enum PresetArg {
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
            PresetArg::R4Lite => SimPreset::R4Lite,
            PresetArg::R4 => SimPreset::R4,
            PresetArg::R4Elliptical => SimPreset::R4Elliptical,
        },
        seed: arguments.seed,
        robots: arguments.robots,
        camera: 0,
    };
    let scenario = simulated_scenario(&address).context("cannot simulate this arena")?;
    let config = config(&scenario, &address, arguments.listen)?;
    let mut signals = Signals::listen()?;
    let server = Server::start(config).await?;
    let fleet = server.fleets().of(&address, server.playback().origin)?;
    announce(&server)?;
    say(&format!("dashboard: http://{}/ (Ctrl-C ends the demo)", server.local_addr()))?;
    let mut total = Score::default();
    tokio::select! {
        () = signals.next() => {}
        () = elapsed(arguments.duration) => {}
        // Whoever read the lines has gone.
        _ = report(&server, &fleet, &mut total) => {}
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

/// The scenario's cameras as an installation. It has a text like any other, so that its cameras can be changed; where
/// the scenario's numbers are more exact than text, they count.
fn config(scenario: &Scenario, address: &SimAddress, listen: SocketAddr) -> anyhow::Result<Config> {
    let parsed = Config::parse(&text(scenario, address), Path::new(""));
    let told = |problems: Vec<Problem>| {
        let messages: Vec<String> = problems.into_iter().map(|problem| problem.message).collect();
        anyhow!("internal error, please report it: {}", messages.join("; "))
    };
    let config = parsed.map_err(told)?;
    let setup = listen.ip().is_loopback();
    Ok(Config {
        server: ServerConfig { listen, setup, ..config.server },
        kinds: scenario.params().kinds.clone(),
        references: references(scenario),
        ..config
    })
}

fn text(scenario: &Scenario, address: &SimAddress) -> String {
    let mut text = "name = \"demo\"\n".to_owned();
    let mm = |metres: f64| (metres * 1e6).round() * 1e-3;
    for kind in &scenario.params().kinds {
        let inside = match &kind.pattern {
            Pattern::Plain => String::new(),
            Pattern::Coded(CodeLayout { bits, min_distance }) => {
                format!("code = {{ bits = {bits}, min_distance = {min_distance} }}\n")
            }
            Pattern::Elliptical { minor_diameter_m } => {
                format!("inner_minor_mm = {}\n", mm(*minor_diameter_m))
            }
        };
        let (outer_mm, inner_mm) = (mm(kind.outer_diameter_m), mm(kind.inner_diameter_m));
        text += &format!(
            "\n[[roundel]]\nname = {:?}\nouter_mm = {outer_mm}\ninner_mm = {inner_mm}\n{inside}",
            kind.name
        );
    }
    for (index, camera) in scenario.cameras().iter().enumerate() {
        let source = SimAddress { camera: index, ..address.clone() };
        text += &format!("\n[[camera]]\nname = {:?}\nsource = \"{source}\"\n", camera.name);
    }
    for ReferenceConfig { kind, code, position_m, orientation, .. } in references(scenario) {
        let name = &scenario.params().kinds[usize::from(kind.0)].name;
        let number = code.map(|code| format!("code = {}\n", code.number)).unwrap_or_default();
        let turned = orientation.map(|turn| {
            let way = |axis: Vector3<f64>| format!("{:?}", (turn * axis).as_slice());
            format!("right = {}\ntop = {}\n", way(Vector3::x()), way(Vector3::y()))
        });
        text += &format!(
            "\n[[reference]]\nroundel = {name:?}\n{number}position_m = {:?}\n{}",
            position_m.as_slice(),
            turned.unwrap_or_default()
        );
    }
    text
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
async fn report(server: &Server, fleet: &Fleet, total: &mut Score) -> io::Result<()> {
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
                    second.add(&fleet.scenario(), &fused.snapshot, time_s);
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
fn cameras(states: &BTreeMap<CameraId, CameraState>) -> String {
    let rates: Vec<String> = states.values().map(|state| format!("{:.1}", state.rate_hz)).collect();
    let worst = |value: fn(&CameraState) -> f64| states.values().map(value).fold(0.0, f64::max);
    format!(
        "cameras {} Hz, detection {:.1} ms, latency {:.1} ms",
        rates.join(" "),
        worst(|state| state.detect_ms),
        worst(|state| state.latency_ms),
    )
}

fn frames(states: &BTreeMap<CameraId, CameraState>) -> String {
    let sum = |value: fn(&CameraState) -> u64| states.values().map(value).sum::<u64>();
    format!("{} frames, {} left out", sum(|state| state.frames), sum(|state| state.dropped))
}

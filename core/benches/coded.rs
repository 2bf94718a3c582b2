//! Time per frame of tracking and locating coded roundels of R4: 50 moving robots with codes of 9 bits, 1920x1080 at
//! 60 Hz, in fast and in precise mode: `cargo bench -p roundel-core --bench coded [-- MODE]`.
//!
//! The frames of each camera are processed repeatedly; the first ones, in which everything is searched, do not count.
//! Prints minimum, median and 99th percentile of detection and of poses, and per frame the number of rings, of codes read
//! and of rejects. `--threads N` shares the fits of a frame among threads; `--pause MS` sleeps before each frame, as with
//! real cameras. `--once` processes the frames a single time, for `valgrind --tool=callgrind`; subtract the instructions of
//! a run with `--frames 0`, which only renders.

use std::time::{Duration, Instant};

use roundel_core::{
    frame::Frame,
    marker::{CodeLayout, Detector, Mode, Params, Pattern, Tracker},
    pose::Locator,
    sim::{Renderer, Scenario, ScenarioParams},
    time::Timestamp,
};

const ROBOTS: usize = 50;
const RATE_HZ: f64 = 60.0;
/// Frames per camera.
const FRAMES: usize = 20;
/// Frames until all rings are tracked.
const WARM_UP: usize = 4;
const ROUNDS: usize = 12;

/// Rendered frames of a camera.
struct Sequence {
    frames: Vec<Vec<u8>>,
    camera: usize,
}

/// Options of a run.
#[derive(Clone, Copy)]
struct RunOptions {
    mode: Mode,
    frames: usize,
    /// Pause before each frame.
    pause: Duration,
}

/// Statistics of all frames that count.
#[derive(Default)]
struct Statistics {
    detection_us: Vec<f64>,
    poses_us: Vec<f64>,
    rings: usize,
    read: usize,
    precise: usize,
    rejects: u32,
}

fn scenario() -> Scenario {
    let mut params = ScenarioParams::r4(1);
    params.kinds[0].pattern = Pattern::Coded(CodeLayout { bits: 9, min_distance: 1 });
    Scenario::new(ScenarioParams { robots: ROBOTS, ..params }).expect("valid parameters")
}

fn sequence(scenario: &Scenario, camera: usize) -> Sequence {
    let mut renderer = Renderer::new(scenario, camera).expect("a camera of the preset");
    let optics = &scenario.params().optics;
    let frame = |index: usize| {
        let mut pixels = vec![0; optics.width * optics.height];
        renderer.render(index as u64 + 30, &mut pixels).expect("a buffer of its size");
        pixels
    };
    Sequence { frames: (0..FRAMES).map(frame).collect(), camera }
}

fn run_sequence(
    scenario: &Scenario,
    sequence: &Sequence,
    options: RunOptions,
    statistics: &mut Statistics,
) {
    let RunOptions { mode, frames, pause } = options;
    let params = scenario.params();
    let (width, height) = (params.optics.width, params.optics.height);
    let detector = Detector::new(params.kinds.clone(), Params { mode, ..Params::default() });
    let mut tracker = Tracker::new(detector.expect("the preset's kinds"));
    let camera = scenario.cameras()[sequence.camera].camera.clone();
    let mut locator =
        Locator::new(camera, params.kinds.clone(), mode).with_line_time(params.optics.line_time_s);
    let mut located = Vec::new();
    for (index, pixels) in sequence.frames[..frames].iter().enumerate() {
        let frame = Frame::new(pixels, width, height, width).expect("as many pixels as it says");
        let time = Timestamp::default().plus_seconds(index as f64 / RATE_HZ);
        std::thread::sleep(pause);
        let start = Instant::now();
        let rings = tracker.process(&frame);
        let detected = start.elapsed();
        locator.locate_all_at(&frame, time, rings, &mut located);
        let all = start.elapsed();
        if index >= WARM_UP {
            statistics.detection_us.push(1e6 * detected.as_secs_f64());
            statistics.poses_us.push(1e6 * (all - detected).as_secs_f64());
            statistics.rings += rings.len();
            statistics.read += rings.iter().filter(|ring| ring.ring.code.is_some()).count();
            statistics.precise +=
                located.iter().flatten().filter(|one| one.by == Mode::Precise).count();
            statistics.rejects += tracker.rejects().total();
        }
    }
}

fn summary(mut times_us: Vec<f64>) -> String {
    times_us.sort_by(f64::total_cmp);
    let share = |share: f64| times_us[((times_us.len() - 1) as f64 * share) as usize];
    format!("{:.0} / {:.0} / {:.0} us", times_us[0], share(0.5), share(0.99))
}

fn main() {
    let (mut filter, mut rounds, mut frames) = (None, ROUNDS, FRAMES);
    let (mut threads, mut pause) = (1, Duration::ZERO);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--once" => rounds = 1,
            "--frames" => {
                let number = arguments.next().and_then(|number| number.parse().ok());
                frames = number.filter(|&number| number <= FRAMES).expect("--frames 0 to 20");
            }
            "--threads" => {
                let number = arguments.next().and_then(|number| number.parse().ok());
                threads = number.expect("--threads takes a number");
            }
            "--pause" => {
                let number = arguments.next().and_then(|number| number.parse().ok());
                pause = Duration::from_millis(number.expect("--pause takes milliseconds"));
            }
            // Passed by cargo.
            "--bench" => {}
            mode => filter = Some(mode.to_owned()),
        }
    }
    let scenario = scenario();
    let sequences: Vec<Sequence> =
        (0..scenario.cameras().len()).map(|camera| sequence(&scenario, camera)).collect();
    for (name, mode) in [("fast", Mode::Fast), ("precise", Mode::Precise)] {
        if filter.as_ref().is_some_and(|filter| filter != name) {
            continue;
        }
        let mut statistics = Statistics::default();
        let options = RunOptions { mode, frames, pause };
        let mut run = || {
            for sequence in (0..rounds).flat_map(|_| &sequences) {
                run_sequence(&scenario, sequence, options, &mut statistics);
            }
        };
        if threads > 1 {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads").install(run);
        } else {
            run();
        }
        let count = statistics.detection_us.len();
        if count == 0 {
            continue;
        }
        let per_frame = |number: usize| number as f64 / count as f64;
        println!(
            "{name}: detection {}, poses {} a frame; {:.1} rings a frame, {:.1} read, {:.1} precise; {:.2} rejects",
            summary(statistics.detection_us),
            summary(statistics.poses_us),
            per_frame(statistics.rings),
            per_frame(statistics.read),
            per_frame(statistics.precise),
            per_frame(statistics.rejects as usize),
        );
    }
}

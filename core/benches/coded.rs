//! Coded roundels followed as R4's cameras see them: 50 robots that move, with codes of 9 bits, 1920x1080 at 60 Hz, in
//! fast and in precise mode: `cargo bench -p roundel-core --bench coded [-- MODE]`.
//!
//! Each camera's frames are gone through again and again; the first ones, in which all rings are searched, do not
//! count. Told is a frame's time in detection and in its poses, least, median and 99th percentile, and how many rings it
//! has, how many of them are read, and why others are not found where they are expected. With `--threads N` the fits of a
//! frame are shared among so many threads; `--pause MS` lets the machine sleep before each frame, as it does where
//! cameras give them. For counts of instructions there
//! is `--once`, which goes through the frames a single time: `valgrind --tool=callgrind` with it, then without frames
//! (`--frames 0`), which is what drawing takes.

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
/// Of each camera.
const FRAMES: usize = 20;
/// Of these, until all rings are followed.
const WARM_UP: usize = 4;
const ROUNDS: usize = 12;

/// What a camera shows.
struct Film {
    frames: Vec<Vec<u8>>,
    camera: usize,
}

/// Which frames are gone through, and how.
#[derive(Clone, Copy)]
struct Way {
    mode: Mode,
    frames: usize,
    /// Before each frame.
    pause: Duration,
}

/// Of all frames that count.
#[derive(Default)]
struct Tally {
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
    Scenario::new(ScenarioParams { robots: ROBOTS, ..params }).expect("there is room for them")
}

fn film(scenario: &Scenario, camera: usize) -> Film {
    let mut renderer = Renderer::new(scenario, camera).expect("a camera of the preset");
    let optics = &scenario.params().optics;
    let frame = |index: usize| {
        let mut pixels = vec![0; optics.width * optics.height];
        renderer.render(index as u64 + 30, &mut pixels).expect("a buffer of its size");
        pixels
    };
    Film { frames: (0..FRAMES).map(frame).collect(), camera }
}

fn go_through(scenario: &Scenario, film: &Film, way: Way, tally: &mut Tally) {
    let Way { mode, frames, pause } = way;
    let params = scenario.params();
    let (width, height) = (params.optics.width, params.optics.height);
    let detector = Detector::new(params.kinds.clone(), Params { mode, ..Params::default() });
    let mut tracker = Tracker::new(detector.expect("the preset's kinds"));
    let camera = scenario.cameras()[film.camera].camera.clone();
    let mut locator =
        Locator::new(camera, params.kinds.clone(), mode).with_line_time(params.optics.line_time_s);
    let mut located = Vec::new();
    for (index, pixels) in film.frames[..frames].iter().enumerate() {
        let frame = Frame::new(pixels, width, height, width).expect("as many pixels as it says");
        let time = Timestamp::default().plus_seconds(index as f64 / RATE_HZ);
        std::thread::sleep(pause);
        let begun = Instant::now();
        let rings = tracker.process(&frame);
        let detected = begun.elapsed();
        locator.locate_all_at(&frame, time, rings, &mut located);
        let all = begun.elapsed();
        if index >= WARM_UP {
            tally.detection_us.push(1e6 * detected.as_secs_f64());
            tally.poses_us.push(1e6 * (all - detected).as_secs_f64());
            tally.rings += rings.len();
            tally.read += rings.iter().filter(|ring| ring.ring.code.is_some()).count();
            tally.precise += located.iter().flatten().filter(|one| one.by == Mode::Precise).count();
            tally.rejects += tracker.rejects().total();
        }
    }
}

fn told(mut times_us: Vec<f64>) -> String {
    times_us.sort_by(f64::total_cmp);
    let share = |share: f64| times_us[((times_us.len() - 1) as f64 * share) as usize];
    format!("{:.0} / {:.0} / {:.0} us", times_us[0], share(0.5), share(0.99))
}

fn main() {
    let (mut wanted, mut rounds, mut frames) = (None, ROUNDS, FRAMES);
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
            // Cargo's own.
            "--bench" => {}
            mode => wanted = Some(mode.to_owned()),
        }
    }
    let scenario = scenario();
    let films: Vec<Film> =
        (0..scenario.cameras().len()).map(|camera| film(&scenario, camera)).collect();
    for (name, mode) in [("fast", Mode::Fast), ("precise", Mode::Precise)] {
        if wanted.as_ref().is_some_and(|wanted| wanted != name) {
            continue;
        }
        let mut tally = Tally::default();
        let way = Way { mode, frames, pause };
        let mut go = || {
            for film in (0..rounds).flat_map(|_| &films) {
                go_through(&scenario, film, way, &mut tally);
            }
        };
        if threads > 1 {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads").install(go);
        } else {
            go();
        }
        let count = tally.detection_us.len();
        if count == 0 {
            continue;
        }
        let per_frame = |number: usize| number as f64 / count as f64;
        println!(
            "{name}: detection {}, poses {} a frame; {:.1} rings a frame, {:.1} read, {:.1} precise; {:.2} rejects",
            told(tally.detection_us),
            told(tally.poses_us),
            per_frame(tally.rings),
            per_frame(tally.read),
            per_frame(tally.precise),
            per_frame(tally.rejects as usize),
        );
    }
}

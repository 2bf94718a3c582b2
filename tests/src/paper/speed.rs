//! Figure 6 and tables 5 and 8: time per frame against image size, roundel size and number, on the datasets of
//! section 6.3.2, and compared with ArUco and SimpleBlobDetector.
//!
//! Everything runs on one thread. The minimum over several rounds counts, since other processes use the machine.
//! Times include poses. There is no model of time to compare with: the plan measures its times too. Once all roundels
//! are tracked, nothing is searched, so the image size does not matter for such frames.

use std::time::Instant;

use nalgebra::Vector2;
use roundel_core::{
    frame::Frame,
    marker::{Detector, Mode, Params, Tracker},
    plan::paper::Speed,
    pose::Locator,
};

use super::{
    Aim, Length, Row, Table,
    datasets::{Dataset, SIDE_M},
    opencv::{self, Job, OpenCv},
    scene::{PaperCamera, printed},
};
use crate::{
    other_markers::{disc, marker},
    pipeline::core_camera,
    precision::MODES,
    render::Image,
    timing::{Case, MOTION_PX, times},
};

/// The paper states for 400 roundels: more than a hundred frames per second.
const PAPER_400_S: f64 = 0.01;

fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Fast => "fast",
        Mode::Precise => "precise",
    }
}

/// Reason for which any time may be worse than the paper's.
const SLOWER: &str = "this machine is slower, or was used by others";

/// Name of the processor.
pub fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    name.map_or("a processor of unknown name".to_owned(), |(_, name)| name.trim().to_owned())
}

/// The paper's figure 6.
pub fn figure(length: Length) -> anyhow::Result<Table> {
    let usual = Case { width: 1920, height: 1080, count: 1, diameter_px: 30.0 };
    let images = [(640, 480), (1280, 720), (1920, 1080), (3840, 2160)].map(|(width, height)| {
        (format!("1 of 30 px in {width}x{height}"), Case { width, height, ..usual })
    });
    let sizes = [15.0, 60.0, 110.0].map(|diameter_px| {
        (format!("1 of {diameter_px} px in 1920x1080"), Case { diameter_px, ..usual })
    });
    let numbers = [10, 100, 400]
        .map(|count| (format!("{count} of 30 px in 1920x1080"), Case { count, ..usual }));
    let mut rows = Vec::new();
    let mut first: Option<[f64; 2]> = None;
    let mut of_images: [Vec<f64>; 2] = Default::default();
    for (name, case) in images.into_iter().chain(sizes).chain(numbers) {
        let rounds = (length.pick(20, 400) / case.count).max(length.pick(2, 10));
        let measured = times(&case, rounds);
        // A single roundel of 30 px, for comparison.
        let first_s = *first.get_or_insert([measured[0].track_s, measured[1].track_s]);
        for (index, mode) in MODES.into_iter().enumerate() {
            let track_s = measured[index].track_s;
            let papers_s = Speed::PAPER.frame_s(case.count, case.diameter_px, 0.0, 0.0);
            if case.count == 1 && case.diameter_px == usual.diameter_px {
                of_images[index].push(track_s);
            }
            let each = track_s / case.count as f64;
            let row = Row::new(format!("{name}, {}: ms", mode_name(mode)), 1e3 * track_s)
                .paper_model(1e3 * papers_s)
                .note(format!(
                    "{:.1} µs each, {:.2} of a single one of 30 px; {:.1} times less than the paper's model",
                    1e6 * each,
                    each / first_s[index],
                    papers_s / track_s
                ));
            rows.push(match case.count {
                400 => row.paper(1e3 * PAPER_400_S, Aim::Less).excuse(SLOWER),
                _ => row,
            });
        }
    }
    let spread = of_images.map(|times_s| {
        let min = times_s.iter().copied().fold(f64::MAX, f64::min);
        let max = times_s.iter().copied().fold(0.0, f64::max);
        100.0 * (max / min - 1.0)
    });
    let [first_mode, second_mode] = MODES.map(mode_name);
    let remarks = vec![
        format!(
            "Minimum time to track and locate all roundels of a frame, which move by {MOTION_PX} px, on one \
             thread of {}. The paper states one number for its curves: 400 roundels take less than 10 ms on an i5 \
             of 2.5 GHz. Its model is equation 20 with the constants of its example.",
            processor()
        ),
        format!(
            "Over a factor of 27 in image size, the time of one roundel varies by {:.0} % ({first_mode}) and \
             {:.0} % ({second_mode}). The last column compares one of many with one alone: several are processed \
             side by side in the lanes of vector instructions, which helps most where there is little to fit. \
             Small roundels, whose rims blur into each other, need a second pass, and large ones exceed a vector.",
            spread[0], spread[1]
        ),
    ];
    let title = "Figure 6: time against image size, roundel size and number".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}

/// Mean time of a dataset's images in seconds, with the minimum over rounds for each image, and the number of images
/// in which the roundel was found. The first image is searched before the measurement.
fn mean_s(
    dataset: Dataset,
    images: &[Image],
    mode: Mode,
    rounds: usize,
) -> anyhow::Result<(f64, usize)> {
    let optics = PaperCamera::logitech().optics;
    let (kind, _) = printed(SIDE_M);
    let params = Params { mode, max_roundels: 1, ..Params::default() };
    let mut min_s = vec![f64::MAX; images.len()];
    let mut found = 0;
    for _ in 0..rounds {
        let mut tracker = Tracker::new(Detector::new(vec![kind.clone()], params.clone())?);
        let mut locator = Locator::new(core_camera(&optics)?, vec![kind.clone()], mode);
        let mut located = Vec::new();
        found = 0;
        for (number, (image, min_s)) in images.iter().zip(&mut min_s).enumerate() {
            let frame = Frame::new(&image.pixels, image.width, image.height, image.width)?;
            let started = Instant::now();
            locator.locate_all(&frame, tracker.process(&frame), &mut located);
            *min_s = min_s.min(started.elapsed().as_secs_f64());
            let (middle, diameter_px) = dataset.place(&optics, number);
            let is_match = located.iter().flatten().any(|it| {
                let center = it.ring.outer.center;
                (Vector2::new(center.u, center.v) - middle).norm() < 0.1 * diameter_px
            });
            found += usize::from(is_match);
        }
    }
    let followed = &min_s[1..];
    Ok((followed.iter().sum::<f64>() / followed.len() as f64, found))
}

/// The datasets of table 5.
const DATASETS: [Dataset; 3] = [Dataset::Small, Dataset::Large, Dataset::Fast];

/// The paper's machines with their times for each dataset, milliseconds, measured and predicted. Ours is compared
/// with the first.
const PLATFORMS: [(&str, [f64; 3], [f64; 3]); 5] = [
    ("i5 2450M", [0.04, 0.10, 0.37], [0.04, 0.12, 0.35]),
    ("Atom N270", [0.30, 0.72, 3.25], [0.33, 0.89, 2.68]),
    ("Pentium M", [0.20, 0.45, 1.44], [0.17, 0.48, 1.45]),
    ("Odroid U2", [0.27, 0.89, 2.76], [0.29, 0.79, 2.86]),
    ("Raspberry Pi", [1.10, 4.00, 15.8], [1.34, 3.66, 11.0]),
];

/// The paper's table 5.
pub fn platforms(length: Length) -> anyhow::Result<Table> {
    let camera = PaperCamera::logitech();
    let (_, print) = printed(SIDE_M);
    let mut rows = Vec::new();
    let (own, own_ms, own_model_ms) = PLATFORMS[0];
    for (index, dataset) in DATASETS.into_iter().enumerate() {
        let images = dataset.pictures(&camera, &print, length);
        for mode in MODES {
            let (here_s, found) = mean_s(dataset, &images, mode, length.pick(2, 20))?;
            let case =
                format!("{}, {}, compared with the {own}: ms", dataset.name(), mode_name(mode));
            rows.push(
                Row::new(case, 1e3 * here_s)
                    .paper(own_ms[index], Aim::Less)
                    .paper_model(own_model_ms[index])
                    .excuse(SLOWER)
                    .note(format!("found in {found} of {}", images.len())),
            );
        }
    }
    for (name, measured_ms, predicted_ms) in &PLATFORMS[1..] {
        for (index, dataset) in DATASETS.into_iter().enumerate() {
            let slower = measured_ms[index] / own_ms[index];
            rows.push(
                Row::absent(format!("{}, {name}: ms", dataset.name()))
                    .paper(measured_ms[index], Aim::Neither)
                    .paper_model(predicted_ms[index])
                    .note(format!("not measured here; WhyCon took {slower:.1} times the {own}'s")),
            );
        }
    }
    let remarks = vec![
        format!(
            "Mean time of a cluttered image of 1024x768, including the pose, on one thread of {}, compared with \
             the paper's i5 2450M, which is ten years older.",
            processor()
        ),
        "The processor's share of the factor is unknown, since WhyCon's own code is not run here. After the jump \
         of the fast sequence the whole image is searched, which is included."
            .to_owned(),
    ];
    let title = "Table 5: image processing time".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}

/// Milliseconds for the fast and the slow dataset: ArUco, OpenCV's blobs, WhyCon. Ours is compared with the first
/// machine.
const OTHER_METHODS: [(&str, [[f64; 3]; 2]); 4] = [
    ("i5 2450M", [[19.0, 63.0, 0.35], [19.0, 62.0, 0.04]]),
    ("Pentium M", [[121.0, 329.0, 1.00], [119.0, 329.0, 0.18]]),
    ("Odroid U2", [[148.0, 371.0, 0.93], [149.0, 366.0, 0.28]]),
    ("Raspberry Pi", [[875.0, 1795.0, 6.59], [875.0, 1759.0, 1.21]]),
];
/// Its datasets, with its names.
const COMPARED: [(Dataset, &str); 2] = [(Dataset::Fast, "fast"), (Dataset::Small, "slow")];

/// The paper's table 8.
pub fn others(length: Length) -> anyhow::Result<Table> {
    let camera = PaperCamera::logitech();
    let (_, print) = printed(SIDE_M);
    let (others, skipped) = match OpenCv::ready() {
        Ok(others) => (Some(others), Vec::new()),
        Err(why) => (None, vec![format!("ArUco and SimpleBlobDetector: {why:#}")]),
    };
    let mut rows = Vec::new();
    let (own, own_ms) = OTHER_METHODS[0];
    for ((dataset, name), [aruco_ms, blob_ms, whycon_ms]) in COMPARED.into_iter().zip(own_ms) {
        let images = dataset.pictures(&camera, &print, length);
        let mut fast_ms = 0.0;
        for mode in MODES {
            let (here_s, found) = mean_s(dataset, &images, mode, length.pick(2, 20))?;
            fast_ms = if mode == Mode::Fast { 1e3 * here_s } else { fast_ms };
            rows.push(
                Row::new(format!("{name}, Roundel {}: ms", mode_name(mode)), 1e3 * here_s)
                    .paper(whycon_ms, Aim::Less)
                    .excuse(SLOWER)
                    .note(format!("found in {found} of {}", images.len())),
            );
        }
        let Some(others) = &others else { continue };
        let prints = [marker(&others.markers[0], SIDE_M), disc(SIDE_M)];
        let detectors = [opencv::Detector::Aruco, opencv::Detector::Blob];
        let mut jobs = Vec::new();
        for (detector, print) in detectors.into_iter().zip(&prints) {
            let every = length.pick(16, 2);
            let pictures = dataset.pictures(&camera, print, length);
            let write = |(number, image): (usize, &Image)| {
                others.write(&format!("{name}-{detector:?}-{number:03}"), image)
            };
            let images = pictures.iter().enumerate().step_by(every).map(write);
            let images = images.collect::<anyhow::Result<_>>()?;
            jobs.push(Job { detector, size_m: SIDE_M, camera: None, repetitions: 3, images });
        }
        let judged = others.judge(&jobs)?;
        for ((judged, method), paper_ms) in
            judged.iter().zip(["ArUco", "SimpleBlobDetector"]).zip([aruco_ms, blob_ms])
        {
            let ms = judged.iter().map(|image| image.ms).sum::<f64>() / judged.len() as f64;
            let row = Row::new(format!("{name}, {method}: ms"), ms).paper(paper_ms, Aim::Neither);
            rows.push(row.note(format!(
                "{:.0} times Roundel fast; the paper's {:.0} times WhyCon",
                ms / fast_ms,
                paper_ms / whycon_ms
            )));
        }
    }
    for (machine, figures) in &OTHER_METHODS[1..] {
        for ((_, name), [aruco_ms, blob_ms, whycon_ms]) in COMPARED.into_iter().zip(figures) {
            let methods =
                [("ArUco", aruco_ms), ("SimpleBlobDetector", blob_ms), ("WhyCon", whycon_ms)];
            rows.extend(methods.map(|(method, ms)| {
                Row::absent(format!("{name}, {method}, {machine}: ms"))
                    .paper(*ms, Aim::Neither)
                    .note(match method {
                        "WhyCon" => "not measured here".to_owned(),
                        _ => format!("not measured here; {:.0} times WhyCon there", ms / whycon_ms),
                    })
            }));
        }
    }
    let remarks = vec![
        format!(
            "The datasets of table 5 with each method's own markers at the same places, one thread each, on {}. \
             ArUco and SimpleBlobDetector are those of current OpenCV with default parameters, and search every \
             image from scratch.",
            processor()
        ),
        format!("\"better by\" compares Roundel here with WhyCon on the paper's {own}."),
    ];
    let title = "Table 8: image processing time compared with other detectors".to_owned();
    Ok(Table { title, rows, remarks, skipped })
}

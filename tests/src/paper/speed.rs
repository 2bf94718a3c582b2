//! Figure 6 and tables 5 and 8: time of a frame against the image's size, the roundels' size and number, on the
//! datasets of section 6.3.2, and beside ArUco and SimpleBlobDetector.
//!
//! Everything runs on one thread of this machine; the least of several rounds counts, since others use it too.
//! Times include poses. Constants of the model (equation 20) are measured here first.

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
    model::speed_between,
    others::{self, Job, Others},
    scene::{PaperCamera, printed},
};
use crate::{
    pipeline::core_camera,
    precision::MODES,
    render::Image,
    rival::{disc, marker},
    timing::{Case, Times, times},
};

/// The paper says of 400 roundels: more than a hundred times a second.
const PAPER_400_S: f64 = 0.01;

fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Fast => "fast",
        Mode::Precise => "precise",
    }
}

/// The model's constants in both modes: one roundel alone at 30 and at 90 px, and a search.
fn speeds(length: Length) -> [Speed; 2] {
    let alone = |diameter_px: f64| {
        let case = Case { width: 1024, height: 768, count: 1, diameter_px };
        times(&case, length.pick(20, 500))
    };
    let (small, large) = (alone(30.0), alone(90.0));
    [0, 1].map(|mode: usize| {
        let of = |times: &[Times; 2]| times[mode].follow_s;
        let searched_pixel_s = small[mode].search_s / (1024.0 * 768.0);
        speed_between([(30.0, of(&small)), (90.0, of(&large))], searched_pixel_s)
    })
}

fn machine() -> String {
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
    let speeds = speeds(length);
    let mut rows = Vec::new();
    for (name, case) in images.into_iter().chain(sizes).chain(numbers) {
        let rounds = (length.pick(20, 400) / case.count).max(length.pick(2, 10));
        let measured = times(&case, rounds);
        for (mode, (times, speed)) in MODES.into_iter().zip(measured.iter().zip(&speeds)) {
            let ms = |speed: &Speed| 1e3 * speed.frame_s(case.count, case.diameter_px, 0.0, 0.0);
            let row = Row::new(format!("{name}, {}: ms", mode_name(mode)), 1e3 * times.follow_s)
                .paper_model(ms(&Speed::PAPER))
                .model(ms(speed));
            rows.push(match case.count {
                400 => row.paper(1e3 * PAPER_400_S, Aim::Less),
                _ => row,
            });
        }
    }
    let remarks = vec![
        format!(
            "Least time to follow and locate all roundels of a frame, on one thread of {}. Of its curves the paper tells only \
             that 400 roundels take less than 10 ms, on an i5 of 2.5 GHz; its model is equation 20 with the constants of its \
             example. Our model's constants are measured on one roundel alone, of 30 and of 90 px.",
            machine()
        ),
        "As in the paper the image's size does not matter. Many roundels take less each than one alone, since they are \
         measured and located side by side, in the lanes of the processor; small ones, whose rims are blurred into each \
         other, take more than the model has it."
            .to_owned(),
    ];
    let title = "Figure 6: time against image size, roundel size and number".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}

/// Mean time of a dataset's images in seconds, the least of so many rounds for each, and in how many the roundel was
/// found. The first image is searched before the clock runs.
fn mean_s(
    dataset: Dataset,
    images: &[Image],
    mode: Mode,
    rounds: usize,
) -> anyhow::Result<(f64, usize)> {
    let optics = PaperCamera::logitech().optics;
    let (kind, _) = printed(SIDE_M);
    let params = Params { mode, max_roundels: 1, ..Params::default() };
    let mut least_s = vec![f64::MAX; images.len()];
    let mut found = 0;
    for _ in 0..rounds {
        let mut tracker = Tracker::new(Detector::new(vec![kind.clone()], params.clone())?);
        let mut locator = Locator::new(core_camera(&optics)?, vec![kind.clone()], mode);
        let mut located = Vec::new();
        found = 0;
        for (number, (image, least_s)) in images.iter().zip(&mut least_s).enumerate() {
            let frame = Frame::new(&image.pixels, image.width, image.height, image.width)?;
            let begun = Instant::now();
            locator.locate_all(&frame, tracker.process(&frame), &mut located);
            *least_s = least_s.min(begun.elapsed().as_secs_f64());
            let (middle, diameter_px) = dataset.place(&optics, number);
            let is_it = located.iter().flatten().any(|it| {
                let center = it.ring.outer.center;
                (Vector2::new(center.u, center.v) - middle).norm() < 0.1 * diameter_px
            });
            found += usize::from(is_it);
        }
    }
    let followed = &least_s[1..];
    Ok((followed.iter().sum::<f64>() / followed.len() as f64, found))
}

/// In milliseconds on the i5, measured and predicted.
const PLATFORM: [(Dataset, f64, f64); 3] =
    [(Dataset::Small, 0.04, 0.04), (Dataset::Large, 0.10, 0.12), (Dataset::Fast, 0.37, 0.35)];

/// The paper's table 5.
pub fn platforms(length: Length) -> anyhow::Result<Table> {
    let camera = PaperCamera::logitech();
    let (_, print) = printed(SIDE_M);
    let speeds = speeds(length);
    let image_px = (camera.optics.width * camera.optics.height) as f64;
    let mut rows = Vec::new();
    for (dataset, paper_ms, paper_model_ms) in PLATFORM {
        let images = dataset.pictures(&camera, &print, length);
        for (mode, speed) in MODES.into_iter().zip(&speeds) {
            let (here_s, found) = mean_s(dataset, &images, mode, length.pick(2, 20))?;
            let model_s = speed.frame_s(1, dataset.diameter_px(), dataset.lost(), image_px);
            let case = format!("{}, {}: ms", dataset.name(), mode_name(mode));
            rows.push(
                Row::new(case, 1e3 * here_s)
                    .paper(paper_ms, Aim::Less)
                    .paper_model(paper_model_ms)
                    .model(1e3 * model_s)
                    .note(format!("found in {found} of {}", images.len())),
            );
        }
    }
    let remarks = vec![
        format!(
            "Mean time of an image of 1024x768 with a lab's clutter, pose included, on one thread of {}; the paper's is that \
             of its i5 2450M, ten years older. Model: equation 20, of which a searched pixel's constant is measured \
             apart, since a pixel that is searched costs far less than one of a roundel.",
            machine()
        ),
        "How much of the factor is the processor's is not known: WhyCon's own code is not run here. After the jump of \
         the fast one the whole image is searched, which counts."
            .to_owned(),
    ];
    let skipped = vec![
        "the rows of Atom N270, Pentium M, Odroid U2 and Raspberry Pi: no such machine is here"
            .to_owned(),
    ];
    let title = "Table 5: image processing time".to_owned();
    Ok(Table { title, rows, remarks, skipped })
}

/// In milliseconds on the i5: ArUco's, OpenCV's blobs', WhyCon's.
const OTHERS: [(Dataset, [f64; 3]); 2] =
    [(Dataset::Fast, [19.0, 63.0, 0.35]), (Dataset::Small, [19.0, 62.0, 0.04])];

/// The paper's table 8.
pub fn others(length: Length) -> anyhow::Result<Table> {
    let camera = PaperCamera::logitech();
    let (_, print) = printed(SIDE_M);
    let (others, skipped) = match Others::ready() {
        Ok(others) => (Some(others), Vec::new()),
        Err(why) => (None, vec![format!("ArUco and SimpleBlobDetector: {why:#}")]),
    };
    let mut rows = Vec::new();
    for (dataset, [aruco_ms, blob_ms, whycon_ms]) in OTHERS {
        let name = if dataset == Dataset::Small { "slow" } else { dataset.name() };
        let images = dataset.pictures(&camera, &print, length);
        let mut fast_ms = 0.0;
        for mode in MODES {
            let (here_s, found) = mean_s(dataset, &images, mode, length.pick(2, 20))?;
            fast_ms = if mode == Mode::Fast { 1e3 * here_s } else { fast_ms };
            rows.push(
                Row::new(format!("{name}, Roundel {}: ms", mode_name(mode)), 1e3 * here_s)
                    .paper(whycon_ms, Aim::Less)
                    .note(format!("found in {found} of {}", images.len())),
            );
        }
        let Some(others) = &others else { continue };
        let prints = [marker(&others.markers[0], SIDE_M), disc(SIDE_M)];
        let detectors = [others::Detector::Aruco, others::Detector::Blob];
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
        for ((judged, rival), paper_ms) in
            judged.iter().zip(["ArUco", "SimpleBlobDetector"]).zip([aruco_ms, blob_ms])
        {
            let ms = judged.iter().map(|image| image.ms).sum::<f64>() / judged.len() as f64;
            let row = Row::new(format!("{name}, {rival}: ms"), ms).paper(paper_ms, Aim::Neither);
            rows.push(row.note(format!("{:.0} times Roundel fast", ms / fast_ms)));
        }
    }
    let remarks = vec![
        format!(
            "The datasets of table 5 with each method's own markers at the same places, one thread each, on {}; ArUco and \
             SimpleBlobDetector are OpenCV's of today with their defaults and go through every image anew.",
            machine()
        ),
        "\"better by\" compares Roundel here with WhyCon on the paper's i5; the last column's ratios are of this machine."
            .to_owned(),
    ];
    let title = "Table 8: image processing time beside others".to_owned();
    Ok(Table { title, rows, remarks, skipped })
}

//! What came out, judged.
//!
//! Reprojection errors are those of
//! roundels' centres in raw pixels; coverage is the share of an image's 8 × 6 fields in which roundels were
//! seen.

use super::{
    ArenaCamera,
    bundle::{Bundle, Outcome, is_outlier},
    finding::{Advice, Finding},
    gather::{Name, Recording},
    place_covariance,
    reference::Standing,
    start::{LEAST_SPREAD_M, Tie},
    station::WITHOUT_LENS,
    subject::Subject,
};
use crate::{
    camera::Camera,
    id::{CameraId, KindId},
    marker::Code,
    rigid::{Covariance6, Rigid},
};

/// Fields of an image, across and down.
const FIELDS: (usize, usize) = (8, 6);
/// A place known worse than this, rms over the axes, is weak: metres and radians.
const WEAK_M: f64 = 0.003;
const WEAK_RAD: f64 = 0.0005;
/// Sightings of one roundel by one camera of which this share is off are of another one.
const ELSEWHERE: f64 = 0.5;
/// A camera whose errors are larger than stated by this factor has another lens than was said.
const DOUBTFUL: f64 = 3.0;

/// All cameras' places.
#[derive(Clone, Debug)]
pub struct ArenaCalibration {
    /// In the order given, without those that nothing ties to the references.
    pub cameras: Vec<CalibratedCamera>,
    /// What a person should know, the gravest first.
    pub findings: Vec<Finding>,
    /// Sightings that were used.
    pub sightings: usize,
    /// Robots' roundels that two cameras saw or more.
    pub roundels: usize,
    /// Seconds of the recording.
    pub length_s: f64,
    /// Steps of the adjustment.
    pub steps: usize,
}

/// One camera's result.
#[derive(Clone, Debug)]
pub struct CalibratedCamera {
    /// Which.
    pub camera: CameraId,
    /// Where it stands.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation.
    pub covariance: Covariance6,
    /// What its stamps are ahead of the first camera's that sees references, at the recording's middle, seconds.
    pub clock_offset_s: f64,
    /// Standard deviation of that.
    pub clock_offset_deviation_s: f64,
    /// What it gains a second.
    pub clock_skew: f64,
    /// Standard deviation of that.
    pub clock_skew_deviation: f64,
    /// If it was asked for.
    pub lens: Option<RefinedLens>,
    /// Sightings that were used.
    pub sightings: usize,
    /// Root mean square distance between roundels' centres as seen and as explained, pixels.
    pub reprojection_rms_px: f64,
    /// Errors over what was stated, by their median: 1 if detections err as they say.
    pub error_ratio: f64,
    /// Share of the image's fields in which roundels were seen.
    pub coverage: f64,
    /// Cameras that saw the same roundels at the same times.
    pub neighbours: Vec<Neighbour>,
}

/// A lens as the arena shows it.
#[derive(Clone, Debug)]
pub struct RefinedLens {
    /// In place of the one that was given.
    pub camera: Camera,
    /// Standard deviations: of the focal length, relative, the principal point, pixels, and the first radial
    /// coefficient.
    pub deviations: [f64; 4],
}

/// How a camera is tied to another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Which.
    pub camera: CameraId,
    /// Sightings that both had at the same time, of those looked at.
    pub shared: usize,
    /// How far these spread, across, rms, metres.
    pub spread_m: f64,
}

/// What was known before the adjustment.
pub(super) struct Found<'a> {
    pub(super) recording: &'a Recording,
    pub(super) cameras: &'a [ArenaCamera],
    pub(super) standing: Standing,
    pub(super) ties: Vec<Tie>,
    /// Codes that a camera saw in two places at once.
    pub(super) twice: Vec<(CameraId, KindId, Code)>,
    /// Cameras that were adjusted.
    pub(super) kept: Vec<usize>,
}

pub(super) fn report(found: &Found<'_>, bundle: &Bundle, outcome: &Outcome) -> ArenaCalibration {
    let mut findings = before(found);
    let results: Vec<CalibratedCamera> = (0..found.kept.len())
        .map(|at| {
            let seen = seen(&found.cameras[found.kept[at]], at, (bundle, outcome));
            calibrated(found, at, seen, (bundle, outcome))
        })
        .collect();
    findings.extend(elsewhere(found, bundle, outcome));
    findings.extend(results.iter().filter_map(doubtful));
    findings.extend(results.iter().filter_map(weak));
    ArenaCalibration {
        sightings: results.iter().map(|camera| camera.sightings).sum(),
        cameras: results,
        findings,
        roundels: bundle.subjects.iter().filter(|subject| subject.stated.is_none()).count(),
        length_s: found.recording.length_s(),
        steps: outcome.steps,
    }
}

/// What is known before anything is adjusted.
fn before(found: &Found<'_>) -> Vec<Finding> {
    let Found { recording, cameras, standing, ties, twice, kept } = found;
    let id = |index: usize| cameras[index].id;
    let misplaced = standing.misplaced.iter().map(|&(reference, camera, off_m)| {
        Finding::Misplaced { reference, camera: id(camera), off_m }
    });
    let moved = standing.moved.iter().map(|&(reference, camera, moved_m)| Finding::Moved {
        reference,
        camera: id(camera),
        moved_m,
    });
    let unseen = standing.unseen.iter().map(|&reference| Finding::ReferenceUnseen { reference });
    let twice = twice.iter().map(|&(camera, kind, code)| Finding::Twice { camera, kind, code });
    let mut findings: Vec<Finding> = misplaced.chain(moved).chain(unseen).chain(twice).collect();
    for index in (0..cameras.len()).filter(|index| !kept.contains(index)) {
        let camera = id(index);
        let of = |tie: &&Tie| tie.one == index || tie.other == index;
        let best = ties.iter().filter(of).max_by(|a, b| a.spread_m.total_cmp(&b.spread_m));
        findings.push(match best {
            Some(tie) if !tie.holds() => {
                let other = id(if tie.one == index { tie.other } else { tie.one });
                Finding::TooLittleMotion { camera, other, spread_m: tie.spread_m }
            }
            None if !recording.names_any(camera) => {
                Finding::Unseen { camera, frames: recording.frames(camera) }
            }
            _ => Finding::Apart { camera },
        });
    }
    findings
}

/// One camera's sightings after the adjustment.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    used: usize,
    square_px: f64,
    ratio: f64,
    coverage: f64,
}

fn seen(camera: &ArenaCamera, at: usize, (bundle, outcome): (&Bundle, &Outcome)) -> Seen {
    let mut seen = Seen::default();
    let mut fields = vec![false; FIELDS.0 * FIELDS.1];
    let mut squares = Vec::new();
    for subject in &bundle.subjects {
        for (sight, square) in subject.sights.iter().zip(subject.squares(&bundle.stations)) {
            if sight.camera != at || is_outlier(square, outcome.excess) {
                continue;
            }
            squares.push(square);
            let station = &bundle.stations[at];
            let point_m = subject.course.at(station.time_s(sight.stamp_s)).position_m;
            let Some(explained_m) = station.sees(&point_m) else { continue };
            let pixels = [sight.place_m, explained_m].map(|place_m| camera.lens.project(&place_m));
            let [Ok(one), Ok(other)] = pixels else { continue };
            seen.used += 1;
            seen.square_px += (one.u - other.u).powi(2) + (one.v - other.v).powi(2);
            let field = |value: f64, size: usize, count: usize| {
                ((value / size as f64 * count as f64).max(0.0) as usize).min(count - 1)
            };
            let column = field(one.u, camera.lens.width(), FIELDS.0);
            fields[field(one.v, camera.lens.height(), FIELDS.1) * FIELDS.0 + column] = true;
        }
    }
    seen.ratio = median_ratio(&mut squares);
    seen.coverage = fields.iter().filter(|&&is_seen| is_seen).count() as f64 / fields.len() as f64;
    seen
}

/// By the median of χ² with 3 degrees of freedom.
fn median_ratio(squares: &mut [f64]) -> f64 {
    if squares.is_empty() {
        return 1.0;
    }
    let middle = squares.len() / 2;
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    (*median / 2.366).sqrt()
}

fn calibrated(
    found: &Found<'_>,
    at: usize,
    seen: Seen,
    (bundle, outcome): (&Bundle, &Outcome),
) -> CalibratedCamera {
    let (cameras, ties, index) = (found.cameras, &found.ties, found.kept[at]);
    let station = &bundle.stations[at];
    let first = at * outcome.width;
    let deviation = |number: usize| {
        let at = first + number;
        outcome.covariance[(at, at)].max(0.0).sqrt()
    };
    let lens = station.lens().map(|lens| RefinedLens {
        camera: lens.clone(),
        deviations: std::array::from_fn(|number| deviation(WITHOUT_LENS + number)),
    });
    let neighbours = ties.iter().filter(|tie| tie.one == index || tie.other == index);
    CalibratedCamera {
        camera: cameras[index].id,
        world_from_camera: station.world_from_camera,
        covariance: place_covariance(&outcome.covariance, first),
        clock_offset_s: station.offset_s,
        clock_offset_deviation_s: deviation(6),
        clock_skew: station.skew,
        clock_skew_deviation: deviation(7),
        lens,
        sightings: seen.used,
        reprojection_rms_px: (seen.square_px / seen.used.max(1) as f64).sqrt(),
        error_ratio: seen.ratio,
        coverage: seen.coverage,
        neighbours: neighbours
            .map(|tie| Neighbour {
                camera: cameras[if tie.one == index { tie.other } else { tie.one }].id,
                shared: tie.pairs,
                spread_m: tie.spread_m,
            })
            .collect(),
    }
}

/// Roundels that one camera sees where they are not.
fn elsewhere(found: &Found<'_>, bundle: &Bundle, outcome: &Outcome) -> Vec<Finding> {
    let share = |subject: &Subject, camera: usize| {
        let of = subject.sights.iter().zip(subject.squares(&bundle.stations));
        let (mut all, mut off) = (0, 0);
        for (_, square) in of.filter(|(sight, _)| sight.camera == camera) {
            all += 1;
            off += usize::from(is_outlier(square, outcome.excess));
        }
        (all, off as f64 / all.max(1) as f64)
    };
    let mut findings = Vec::new();
    for subject in &bundle.subjects {
        for &camera in subject.cameras.iter() {
            let (sightings, share) = share(subject, camera);
            let name = subject.name.filter(|_| share > ELSEWHERE);
            if let Some(Name::Coded(kind, code)) = name {
                let camera = found.cameras[found.kept[camera]].id;
                findings.push(Finding::Elsewhere { camera, kind, code, sightings, share });
            }
        }
    }
    findings
}

fn doubtful(camera: &CalibratedCamera) -> Option<Finding> {
    let (ratio, rms_px) = (camera.error_ratio, camera.reprojection_rms_px);
    (ratio > DOUBTFUL).then_some(Finding::Doubtful { camera: camera.camera, ratio, rms_px })
}

fn weak(camera: &CalibratedCamera) -> Option<Finding> {
    let rms = |first: usize| {
        (camera.covariance.fixed_view::<3, 3>(first, first).trace() / 3.0).max(0.0).sqrt()
    };
    let (deviation_m, deviation_rad) = (rms(0), rms(3));
    if deviation_m < WEAK_M && deviation_rad < WEAK_RAD {
        return None;
    }
    let thinnest = camera
        .neighbours
        .iter()
        .filter(|neighbour| neighbour.spread_m >= LEAST_SPREAD_M)
        .min_by_key(|neighbour| neighbour.shared);
    let advice = match thinnest {
        _ if camera.coverage < 0.3 => Advice::Cover(camera.coverage),
        Some(neighbour) => Advice::Overlap(neighbour.camera),
        None => Advice::References,
    };
    Some(Finding::Weak { camera: camera.camera, deviation_m, deviation_rad, advice })
}

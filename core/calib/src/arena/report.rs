//! What came out, judged.
//!
//! Reprojection errors are those of
//! roundels' centres in raw pixels; coverage is the share of an image's 8 × 6 fields in which roundels were
//! seen.

use super::{
    ArenaCamera,
    adjustment::{
        bundle::{Bundle, Outcome, excess_squared, is_outlier},
        camera_block::WITHOUT_LENS,
        track_block::{Sight, Subject},
    },
    finding::{Advice, Finding},
    image_coverage::Coverage,
    initial_poses::{LEAST_SPREAD_M, Tie},
    place_covariance,
    recording::{Name, Recording},
    references::Standing,
};
use roundel_vision::{
    camera::Camera,
    id::{CameraId, KindId},
    marker::Code,
    rigid::{Covariance6, Rigid},
};

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
    let (seen, elsewhere) = seen(found, bundle, outcome);
    let results: Vec<CalibratedCamera> = seen
        .into_iter()
        .enumerate()
        .map(|(at, seen)| calibrated(found, at, seen, (bundle, outcome)))
        .collect();
    findings.extend(elsewhere);
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
            None if !recording.has_seen(camera) => {
                Finding::Unseen { camera, frames: recording.frames(camera) }
            }
            _ => Finding::Apart { camera },
        });
    }
    findings
}

/// One camera's sightings after the adjustment.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// Squared errors of those that were used.
    squares: Vec<f64>,
    square_px: f64,
    coverage: Coverage,
}

/// What each camera saw, and who was seen elsewhere by one than by others.
fn seen(found: &Found<'_>, bundle: &Bundle, outcome: &Outcome) -> (Vec<Seen>, Vec<Finding>) {
    let mut seen = vec![Seen::default(); found.kept.len()];
    let mut findings = Vec::new();
    for subject in &bundle.subjects {
        // Sightings of each camera, and those that are off.
        let mut shares = vec![(0usize, 0usize); found.kept.len()];
        for (sight, square) in subject.sights.iter().zip(subject.squares(&bundle.stations)) {
            let is_off = is_outlier(square, outcome.excess);
            shares[sight.camera].0 += 1;
            shares[sight.camera].1 += usize::from(is_off);
            if !is_off {
                let lens = &found.cameras[found.kept[sight.camera]].lens;
                seen[sight.camera].add(sight, square, lens, (bundle, subject));
            }
        }
        for (camera, (sightings, off)) in shares.into_iter().enumerate() {
            let share = off as f64 / sightings.max(1) as f64;
            if let Some(Name::Coded(kind, code)) = subject.name.filter(|_| share > ELSEWHERE) {
                let off_m = apart_m(subject, camera, bundle);
                let camera = found.cameras[found.kept[camera]].id;
                findings.push(Finding::Elsewhere { camera, kind, code, sightings, share, off_m });
            }
        }
    }
    (seen, findings)
}

/// How far a camera sees a roundel from where others do, across the line of sight: median, metres.
fn apart_m(subject: &Subject, camera: usize, bundle: &Bundle) -> f64 {
    let station = &bundle.stations[camera];
    let own = subject.sights.iter().filter(|sight| sight.camera == camera);
    let mut apart_m: Vec<f64> = own
        .filter_map(|sight| {
            let point_m = subject.course.at(station.time_s(sight.stamp_s)).position_m;
            let sine = sight.place_m.normalize().cross(&station.sees(&point_m)?.normalize()).norm();
            Some(sine * sight.place_m.norm())
        })
        .collect();
    apart_m.sort_by(f64::total_cmp);
    apart_m.get(apart_m.len() / 2).copied().unwrap_or(f64::INFINITY)
}

impl Seen {
    fn add(
        &mut self,
        sight: &Sight,
        square: f64,
        lens: &Camera,
        (bundle, subject): (&Bundle, &Subject),
    ) {
        self.squares.push(square);
        let station = &bundle.stations[sight.camera];
        let point_m = subject.course.at(station.time_s(sight.stamp_s)).position_m;
        let Some(explained_m) = station.sees(&point_m) else { return };
        let pixels = [sight.place_m, explained_m].map(|place_m| lens.project(&place_m));
        let [Ok(one), Ok(other)] = pixels else { return };
        self.square_px += (one.u - other.u).powi(2) + (one.v - other.v).powi(2);
        self.coverage.add(lens, one);
    }
}

fn calibrated(
    found: &Found<'_>,
    at: usize,
    mut seen: Seen,
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
        sightings: seen.squares.len(),
        reprojection_rms_px: (seen.square_px / seen.squares.len().max(1) as f64).sqrt(),
        error_ratio: excess_squared(&mut seen.squares).sqrt(),
        coverage: seen.coverage.share(),
        neighbours: neighbours
            .map(|tie| Neighbour {
                camera: cameras[if tie.one == index { tie.other } else { tie.one }].id,
                shared: tie.pairs,
                spread_m: tie.spread_m,
            })
            .collect(),
    }
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

//! Assigns paths to robots: nested lanes that keep robots apart at all times and in view of a camera.
//!
//! Lanes are rounded rectangles, [`LANE_SPACING_M`] apart. Robots of a lane have the same mean rate, so their order and
//! their gaps never change. Parked robots stand halfway between two lanes. Flying robots have separate lanes. The outermost
//! lane is the largest one that is completely visible.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{
    jet::Wave,
    params::{ScenarioError, ScenarioParams},
    path::{LanePath, Path, lane_length_m, lane_point},
    sim_camera::SimCamera,
};

/// Distance of adjacent lanes.
const LANE_SPACING_M: f64 = 1.2;
/// Maximum lateral motion of a robot on its lane.
const WEAVE_M: f64 = 0.1;
/// Minimum semiaxis of a lane, so that its opposite sides stay apart.
const MIN_SEMIAXIS_M: f64 = 0.45;
/// Maximum deviation from the mean angle, as a share of the angle between two robots.
const MAX_STRAY_SHARE: f64 = 0.17;
/// Minimum distance of robots along a lane.
const GAP_M: f64 = 0.75;
/// Distance of the outermost lane from the arena's edge.
const EDGE_M: f64 = 0.4;
/// Minimum height of a flying robot's roundel.
pub(super) const FLYING_LOW_M: f64 = 1.0;
/// Margin of visible lanes, as a share of the image's height.
const BORDER_SHARE: f64 = 0.035;

/// Paths of all robots: parked ones first, flying ones last.
pub(super) fn lay_out(
    params: &ScenarioParams,
    cameras: &[SimCamera],
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Path>, ScenarioError> {
    let flying = params.flying();
    let driving = params.robots - flying - params.still;
    let mut paths = Vec::with_capacity(params.robots);
    if driving + params.still > 0 {
        let height_m = params.roundel_height_m;
        let lanes = nested_lanes(outer_lane(params, cameras, [height_m, height_m])?);
        paths.extend(park(params, &lanes, rng)?);
        for (&semiaxes_m, robots) in lanes.iter().zip(distribute("driving", &lanes, driving)?) {
            let style = Style { speed_m_s: 0.5, weave_m: WEAVE_M, flying: false };
            paths.extend(fill_lane(params, semiaxes_m, robots, style, rng));
        }
    }
    if flying > 0 {
        let heights_m = [FLYING_LOW_M, params.flying_top_m];
        let lanes = nested_lanes(outer_lane(params, cameras, heights_m)?);
        for (&semiaxes_m, robots) in lanes.iter().zip(distribute("flying", &lanes, flying)?) {
            let style = Style { speed_m_s: 0.8, weave_m: 2.0 * WEAVE_M, flying: true };
            paths.extend(fill_lane(params, semiaxes_m, robots, style, rng));
        }
    }
    Ok(paths)
}

/// Semiaxes of the largest lane whose whole interior is visible at both heights.
fn outer_lane(
    params: &ScenarioParams,
    cameras: &[SimCamera],
    heights_m: [f64; 2],
) -> Result<[f64; 2], ScenarioError> {
    const STEPS: usize = 20;
    let half = params.arena_m.map(|side| side / 2.0 - EDGE_M);
    let margin_px = BORDER_SHARE * params.optics.height as f64;
    let candidates = (1..=STEPS)
        .flat_map(|i| (1..=STEPS).map(move |j| [i, j]))
        .map(|steps| [0, 1].map(|axis| half[axis] * steps[axis] as f64 / STEPS as f64));
    let area = |lane: &[f64; 2]| lane[0] * lane[1];
    let mut best: Option<[f64; 2]> = None;
    for lane in candidates.filter(|lane| lane[0].min(lane[1]) >= MIN_SEMIAXIS_M) {
        let larger = best.is_none_or(|best| area(&lane) > area(&best));
        if larger && heights_m.iter().all(|&z| is_covered(cameras, lane, z, margin_px)) {
            best = Some(lane);
        }
    }
    let [low_m, high_m] = heights_m;
    best.ok_or(ScenarioError::Uncovered { low_m, high_m })
}

fn is_covered(cameras: &[SimCamera], lane: [f64; 2], height_m: f64, margin_px: f64) -> bool {
    const ANGLES: usize = 48;
    // From the outside in, since the border fails first.
    let widths = [2.0 * WEAVE_M, -0.25 * lane[0], -0.5 * lane[0], -0.75 * lane[0]];
    widths.iter().all(|&width| {
        let semiaxes = [lane[0] + width, lane[1] * (1.0 + width / lane[0])];
        (0..ANGLES).all(|i| {
            let [x, y] = lane_point(semiaxes, TAU * i as f64 / ANGLES as f64);
            let point = Point3::new(x, y, height_m);
            cameras.iter().any(|camera| camera.sees(&point, margin_px))
        })
    })
}

fn nested_lanes(outer: [f64; 2]) -> Vec<[f64; 2]> {
    (0..)
        .map(|i| outer.map(|semiaxis| semiaxis - LANE_SPACING_M * f64::from(i)))
        .take_while(|lane| lane[0].min(lane[1]) >= MIN_SEMIAXIS_M)
        .collect()
}

/// Maximum number of robots on a lane. The slowest point of the shape (a flat end, or a corner) decides.
fn capacity(lane: &[f64; 2]) -> usize {
    let slowest_m = (1.3 * lane[0].min(lane[1])).min(0.58 * lane[0].hypot(lane[1]));
    (TAU * (1.0 - 2.0 * MAX_STRAY_SHARE) * slowest_m / GAP_M) as usize
}

/// Distributes robots over lanes by length.
fn distribute(
    role: &'static str,
    lanes: &[[f64; 2]],
    robots: usize,
) -> Result<Vec<usize>, ScenarioError> {
    let max = lanes.iter().map(capacity).sum();
    if robots > max {
        return Err(ScenarioError::Crowded { role, max, found: robots });
    }
    let lengths: Vec<f64> = lanes.iter().map(|&lane| lane_length_m(lane)).collect();
    let mut counts = vec![0; lanes.len()];
    for _ in 0..robots {
        let spacing = |&i: &usize| lengths[i] / (counts[i] + 1) as f64;
        let emptiest = (0..lanes.len())
            .filter(|&i| counts[i] < capacity(&lanes[i]))
            .max_by(|a, b| spacing(a).total_cmp(&spacing(b)));
        if let Some(i) = emptiest {
            counts[i] += 1;
        }
    }
    Ok(counts)
}

/// Parked robots halfway between adjacent lanes, or within the innermost.
fn park(
    params: &ScenarioParams,
    lanes: &[[f64; 2]],
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Path>, ScenarioError> {
    let gaps = lanes.iter().map(|lane| lane.map(|semiaxis| semiaxis - LANE_SPACING_M / 2.0));
    let gaps: Vec<[f64; 2]> = gaps.filter(|gap| gap[0].min(gap[1]) >= MIN_SEMIAXIS_M).collect();
    let counts = distribute("parked", &gaps, params.still)?;
    let mut parked = Vec::with_capacity(params.still);
    for (gap, count) in gaps.into_iter().zip(counts) {
        let start_rad = rng.random_range(0.0..TAU);
        for i in 0..count {
            let [x, y] = lane_point(gap, start_rad + TAU * i as f64 / count as f64);
            let position_m = Vector3::new(x, y, params.roundel_height_m);
            parked.push(Path::Still { position_m, yaw_rad: rng.random_range(0.0..TAU) });
        }
    }
    Ok(parked)
}

/// Motion of the robots on a lane.
#[derive(Clone, Copy)]
struct Style {
    speed_m_s: f64,
    weave_m: f64,
    flying: bool,
}

fn fill_lane(
    params: &ScenarioParams,
    semiaxes_m: [f64; 2],
    robots: usize,
    style: Style,
    rng: &mut ChaCha8Rng,
) -> Vec<Path> {
    let pace = rng.random_range(0.85..1.15);
    let direction = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    let rate_rad_s = direction * pace * style.speed_m_s * TAU / lane_length_m(semiaxes_m);
    let start_rad = rng.random_range(0.0..TAU);
    let stray_rad = (MAX_STRAY_SHARE * TAU / robots.max(1) as f64).min(0.3);
    let draw = |i: usize, rng: &mut ChaCha8Rng| {
        let mut wave = |amplitude: f64, rates: std::ops::Range<f64>| Wave {
            amplitude,
            rate_rad_s: rng.random_range(rates),
            phase_rad: rng.random_range(0.0..TAU),
        };
        // At least 0.4 of the mean rate, so that headings stay smooth.
        let mut along_lane = wave(0.0, 0.3..0.7);
        along_lane.amplitude = stray_rad.min(0.6 * rate_rad_s.abs() / along_lane.rate_rad_s);
        let weave = wave(style.weave_m, if style.flying { 1.0..1.8 } else { 0.5..0.9 });
        let (height_m, climb) = if style.flying {
            let (low, top) = (FLYING_LOW_M, params.flying_top_m);
            let climb = wave(0.3 * (top - low).min(1.0), 0.3..0.8);
            (rng.random_range(low + climb.amplitude..top - climb.amplitude), climb)
        } else {
            (params.roundel_height_m, Wave::default())
        };
        LanePath {
            semiaxes_m,
            start_rad: start_rad + TAU * i as f64 / robots as f64,
            rate_rad_s,
            along_lane,
            weave,
            height_m,
            climb,
            heading: style
                .flying
                .then(|| [rng.random_range(0.0..TAU), rng.random_range(-0.4..0.4)]),
        }
    };
    let lane: Vec<LanePath> = (0..robots).map(|i| draw(i, rng)).collect();
    // All robots of a lane slow down alike, or they would collide.
    let max_acceleration = lane.iter().map(LanePath::acceleration_bound_m_s2).fold(0.0, f64::max);
    let pace = (params.acceleration_limit_m_s2 / max_acceleration.max(1e-9)).sqrt().min(1.0);
    lane.into_iter().map(|path| Path::Lane(path.with_pace(pace))).collect()
}

//! Measures the time per frame on this computer: the tracker and locator of a camera's worker on simulated frames.
//!
//! Input: the content of the frames ([`TimingCase`]). Output: times of frames whose roundels are tracked, and of frames that
//! are searched completely ([`FrameTimes`]). The times include poses and are measured on the caller's thread only.
//!
//! The simulator ([`roundel_core::sim`]) renders a grid of roundels on robots below one camera. All move with the same
//! velocity over the floor of a laboratory. Blur and noise are those of the camera; the exposure takes a quarter of the
//! frame interval.
//!
//! Limits: the lens has about 82° without distortion, and roundels face up. A white ring is rendered and searched as a black
//! one. Motion is limited to [`MAX_MOTION_PX`], and the number of roundels to those that fit into the picture and that the
//! tracker follows; [`FrameTimes::followed`] is the number that were. Other load on the computer increases the times.

use std::time::Instant;

use anyhow::Context;
use nalgebra::Vector3;
use roundel_core::{
    camera::{Camera, Lens},
    frame::Frame,
    marker::{Detector, Kind, Mode, Params, Pattern, Polarity, Tracker},
    plan::{Imaging, search::scaled},
    pose::Locator,
    sim::{CameraMount, ImageParams, Renderer, Scenario, ScenarioParams},
};

/// Frames until the tracker's state has settled, and timed frames after them: the period at which precise mode searches for
/// motion.
const SETTLING: usize = 7;
const COUNTED: usize = 9;
/// Frames of one case.
pub const FRAMES: usize = SETTLING + COUNTED;
/// Timed rounds over all frames, after a warm-up round.
const ROUNDS: usize = 6;
/// Maximum motion, pixels per frame. It is smaller in small pictures: roundels cross at most half of the shorter side.
pub const MAX_MOTION_PX: f64 = 12.0;
/// Share of frames that take no longer than [`FrameTimes::p95_s`].
const HIGH_SHARE: f64 = 0.95;

/// Outer diameter and height of the simulated roundels, metres. This is the largest diameter that the simulator's robots
/// carry, so roundels can be packed most densely.
const OUTER_M: f64 = 0.25;
const HEIGHT_M: f64 = 0.3;
/// Distance between roundels in outer diameters: the robots that carry them must not touch.
const SPACING: f64 = 1.45;
/// Focal length over the width of the picture, as in the reference installations.
const FOCAL_SHARE: f64 = 1100.0 / 1920.0;
/// Limits of the simulator: distance from camera to roundels, metres, and diameter, pixels.
const ABOVE_M: [f64; 2] = [2.3, 90.0];
const DIAMETERS_PX: [f64; 2] = [2.0, 1e4];
const RATE_HZ: f64 = 60.0;
const EXPOSURE_SHARE: f64 = 0.25;
/// Minimum side of the simulated arena, metres: its lanes must hold as many robots as a picture can show.
const MIN_ARENA_M: f64 = 40.0;

/// Content of the timed frames.
#[derive(Clone, Debug, PartialEq)]
pub struct TimingCase {
    /// Columns and rows.
    pub size: (usize, usize),
    pub kind: Kind,
    pub mode: Mode,
    pub imaging: Imaging,
    pub roundels: usize,
    /// Mean diameter of the roundels, pixels.
    pub diameter_px: f64,
    /// Motion from frame to frame, pixels.
    pub motion_px: f64,
}

/// Measured times of single frames, seconds.
#[derive(Clone, Debug, Default)]
pub struct FrameTimes {
    followed_s: Vec<f64>,
    searched_s: Vec<f64>,
    /// Number of roundels tracked in all timed frames.
    pub followed: usize,
}

impl FrameTimes {
    /// Weighted mean of the medians of tracked and searched frames, for this share of searched frames.
    pub fn median_s(&self, searched_share: f64) -> f64 {
        let median = |times_s: &[f64]| {
            let mut sorted = times_s.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted[sorted.len() / 2]
        };
        (1.0 - searched_share) * median(&self.followed_s)
            + searched_share * median(&self.searched_s)
    }

    /// 95th percentile, for this share of searched frames.
    pub fn p95_s(&self, searched_share: f64) -> f64 {
        let sorts = [(&self.followed_s, 1.0 - searched_share), (&self.searched_s, searched_share)];
        let mut weighted: Vec<(f64, f64)> = Vec::new();
        for (times_s, share) in sorts {
            weighted.extend(times_s.iter().map(|&time_s| (time_s, share / times_s.len() as f64)));
        }
        weighted.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut longer_share = 0.0;
        let is_within = |&(_, weight): &(f64, f64)| {
            longer_share += weight;
            longer_share > 1.0 - HIGH_SHARE
        };
        weighted.into_iter().find(is_within).map_or(f64::NAN, |(time_s, _)| time_s)
    }
}

impl TimingCase {
    /// Renders the frames and measures them.
    pub fn measure(&self) -> anyhow::Result<FrameTimes> {
        let kind = Kind { polarity: Polarity::BlackRing, ..self.kind.clone() };
        let case = Self { kind, ..self.clone() };
        let (camera, pictures) = case.draw().context("cannot simulate frames to time")?;
        case.measure_on(&camera, &pictures)
    }

    /// Measures [`FRAMES`] consecutive frames of a camera that show this case.
    pub fn measure_on(&self, camera: &Camera, pictures: &[Vec<u8>]) -> anyhow::Result<FrameTimes> {
        let kinds = vec![self.kind.clone()];
        let params = Params { mode: self.mode, ..Params::default() };
        let mut tracker = Tracker::new(Detector::new(kinds.clone(), params)?);
        let mut locator = Locator::new(camera.clone(), kinds, self.mode);
        let (width, height) = self.size;
        let mut pixels = vec![0; width * height];
        let mut located = Vec::new();
        let mut times = FrameTimes { followed: usize::MAX, ..FrameTimes::default() };
        for round in 0..=ROUNDS {
            tracker.reset();
            locator.reset();
            for (number, picture) in pictures.iter().enumerate() {
                // A camera's frame has just been written too, and is not completely in the first-level cache.
                pixels.copy_from_slice(picture);
                let frame = Frame::new(&pixels, width, height, width)?;
                let begun = Instant::now();
                let tracked = tracker.follow(&frame);
                locator.locate_all(&frame, tracked, &mut located);
                let followed = tracked.len();
                tracker.seek(&frame);
                let time_s = begun.elapsed().as_secs_f64();
                if round > 0 && number == 0 {
                    times.searched_s.push(time_s);
                } else if round > 0 && number >= SETTLING {
                    times.followed_s.push(time_s);
                    times.followed = times.followed.min(followed);
                }
            }
        }
        Ok(times)
    }

    fn draw(&self) -> anyhow::Result<(Camera, Vec<Vec<u8>>)> {
        let (width, height) = self.size;
        let mut renderer = Renderer::new(&self.scenario()?, 0)?;
        let mut pictures = vec![vec![0; width * height]; FRAMES];
        for (number, pixels) in (0..).zip(&mut pictures) {
            renderer.render(number, pixels)?;
        }
        Ok((renderer.camera().camera.clone(), pictures))
    }

    fn scenario(&self) -> anyhow::Result<Scenario> {
        let sides_px = [self.size.0 as f64, self.size.1 as f64];
        let most_px = 0.5 * sides_px[0].min(sides_px[1]) / FRAMES as f64;
        let motion_px = self.motion_px.min(MAX_MOTION_PX).min(most_px);
        let inner_px = sides_px.map(|side| side - motion_px * FRAMES as f64);
        let diameter_px = self.diameter_px.clamp(DIAMETERS_PX[0], DIAMETERS_PX[1]);
        let grid = inner_px.map(|side| (side / (SPACING * diameter_px)).floor().max(1.0));
        let fitting = ((grid[0] * grid[1]) as usize).min(Params::default().max_roundels);
        let count = self.roundels.min(fitting);

        let px_per_m = diameter_px / OUTER_M;
        // The distance for the nominal focal length, within the simulator's limits; the actual focal length follows from it.
        let above_m = (FOCAL_SHARE * sides_px[0] / px_per_m).clamp(ABOVE_M[0], ABOVE_M[1]);
        let mount = |z_m: f64| CameraMount { position_m: [0.0, 0.0, z_m], target_m: [0.0; 3] };
        let mut params = ScenarioParams::r4(1);
        params.arena_m = sides_px.map(|side| (side / px_per_m + 2.0).max(MIN_ARENA_M));
        (params.robots, params.still, params.flying_share, params.booms) = (count, 0, 0.0, 0);
        (params.roundel_height_m, params.flying_top_m) = (HEIGHT_M, 1.5);
        params.kinds = self.kinds(count)?;
        // Lanes are laid out where cameras see them: the second camera sees the whole arena.
        params.mounts = vec![mount(HEIGHT_M + above_m), mount(100.0)];
        (params.optics.width, params.optics.height) = self.size;
        params.optics.focal_px = px_per_m * above_m;
        params.optics.lens = Lens::PlumbBob([0.0; 5]);
        (params.optics.rate_hz, params.optics.exposure_s) = (RATE_HZ, EXPOSURE_SHARE / RATE_HZ);
        (params.optics.phase_range_s, params.optics.line_time_s) = (0.0, 0.0);
        params.image = ImageParams {
            blur_px: self.imaging.blur_px.min(3.0),
            noise_levels: self.imaging.noise.min(30.0),
            light: (self.imaging.white / 255.0).clamp(0.1, 1.0),
            light_gradient: 0.0,
        };

        let mut scenario = Scenario::new(params)?;
        // Not parallel to the rows or columns of pixels.
        let velocity_m_s = Vector3::new(0.8, 0.6, 0.0) * (motion_px * RATE_HZ / px_per_m);
        let half_s = 0.5 * FRAMES as f64 / RATE_HZ;
        let columns = (count as f64 * inner_px[0] / inner_px[1]).sqrt().ceil();
        let columns = columns.clamp((count as f64 / grid[1]).ceil(), grid[0]);
        let rows = (count as f64 / columns).ceil();
        for index in 0..count {
            let (column, row) = (index as f64 % columns, (index as f64 / columns).floor());
            let x_px = ((column + 0.5) / columns - 0.5) * inner_px[0];
            let y_px = ((row + 0.5) / rows - 0.5) * inner_px[1];
            let middle_m = Vector3::new(x_px, y_px, 0.0) / px_per_m;
            scenario.place(index, middle_m - velocity_m_s * half_s, velocity_m_s);
        }
        Ok(scenario)
    }

    /// The kind, repeated if there are fewer codes than roundels; some roundels then have equal codes.
    fn kinds(&self, count: usize) -> anyhow::Result<Vec<Kind>> {
        let codes = match self.kind.pattern {
            Pattern::Coded(layout) => layout.codes()?.len(),
            Pattern::Plain | Pattern::Elliptical { .. } => count,
        };
        Ok(vec![scaled(&self.kind, OUTER_M); count.div_ceil(codes.max(1)).max(1)])
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::marker::CodeLayout;

    use super::*;

    fn case(roundels: usize, diameter_px: f64, motion_px: f64) -> TimingCase {
        let (kind, imaging) = (Kind::plain("robot", 0.16, 0.064), Imaging::default());
        let (size, mode) = ((640, 480), Mode::Fast);
        TimingCase { size, kind, mode, imaging, roundels, diameter_px, motion_px }
    }

    #[test]
    fn the_requested_roundels_are_rendered_and_tracked() {
        let bits = |bits: u8| {
            let pattern = Pattern::Coded(CodeLayout { bits, min_distance: 1 });
            Kind { pattern, ..Kind::plain("robot", 0.16, 0.16 * CodeLayout::RATIO) }
        };
        for case in [
            case(10, 24.0, 0.0),
            case(12, 30.0, 3.0),
            case(1, 300.0, 1.0),
            case(60, 16.0, 1.0),
            TimingCase { mode: Mode::Precise, ..case(8, 24.0, 1.5) },
            // More roundels than codes of 5 bits.
            TimingCase { kind: bits(5), ..case(15, 60.0, 1.0) },
            TimingCase { kind: bits(8), mode: Mode::Precise, ..case(6, 70.0, 2.0) },
        ] {
            let times = case.measure().unwrap();
            assert_eq!(times.followed, case.roundels, "{case:?}");
            assert_eq!((times.followed_s.len(), times.searched_s.len()), (54, 6));
            // The size and the motion in the picture are those of the case.
            let (_, pictures) = case.draw().unwrap();
            let params = Params { mode: case.mode, ..Params::default() };
            let detector = Detector::new(vec![case.kind.clone()], params).unwrap();
            let mut tracker = Tracker::new(detector);
            let mut centers = Vec::new();
            for pixels in &pictures {
                let frame = Frame::new(pixels, 640, 480, 640).unwrap();
                let tracked = tracker.process(&frame);
                let diameters_px = tracked.iter().map(|it| 2.0 * it.ring.outer.mean_radius_px());
                let mean_px = diameters_px.sum::<f64>() / tracked.len() as f64;
                assert!((mean_px / case.diameter_px - 1.0).abs() < 0.15, "{mean_px} {case:?}");
                let center = tracked[0].ring.outer.center;
                centers.push([center.u, center.v]);
            }
            let [first, last] = [centers[0], centers[FRAMES - 1]];
            let moved_px = (last[0] - first[0]).hypot(last[1] - first[1]) / (FRAMES - 1) as f64;
            assert!((moved_px - case.motion_px).abs() < 0.1 + 0.05 * case.motion_px, "{moved_px}");
        }
    }

    #[test]
    fn roundels_that_do_not_fit_are_omitted() {
        let crowded = case(200, 60.0, 100.0);
        let drawn = crowded.scenario().unwrap().params().robots;
        assert_eq!(crowded.measure().unwrap().followed, drawn);
        assert!((6..20).contains(&drawn), "{drawn}");
        let wide = TimingCase { size: (900, 100), ..case(200, 50.0, 0.0) };
        assert_eq!(wide.measure().unwrap().followed, 12);
        assert_eq!(case(0, 60.0, 0.0).measure().unwrap().followed, 0);
        assert!(case(1, 2000.0, 0.0).measure().is_ok());
    }

    #[test]
    fn searched_frames_are_weighted_by_their_share() {
        let followed_s = (1..=20).map(f64::from).collect();
        let times = FrameTimes { followed_s, searched_s: vec![100.0, 200.0, 300.0], followed: 0 };
        assert_eq!((times.median_s(0.0), times.p95_s(0.0)), (11.0, 19.0));
        assert_eq!((times.median_s(1.0), times.p95_s(1.0)), (200.0, 300.0));
        assert_eq!((times.median_s(0.5), times.p95_s(0.1)), (105.5, 200.0));
    }
}

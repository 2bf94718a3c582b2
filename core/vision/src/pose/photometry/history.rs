//! State of the photometric fit of a tracked ring, from frame to frame, and the start of its next
//! fit.
//!
//! In: a fit, and the state before it. Out: the start of the fit in the next frame: blur, motion,
//! the normal that was right before, and whether motion within the exposure is fitted at all.
//!
//! **Motion.** The exposure time is unknown, so the displacement from frame to frame is only an
//! upper bound of the motion within one. A fit with free motion gives its square μ and the variance
//! v of either component: |μ|²/2v is 1 on average without motion. Where its mean over recent fits
//! is below [`STILL_RATIO`], and the ring moves hardly faster than in them, the next
//! [`MAX_HELD_FITS`] fits hold the motion at zero; what they can miss is about one standard
//! deviation of μ. Motion that appears without a larger displacement (camera vibration) is found by
//! the next fit with free motion, or earlier by the residual, and stays free while it lasts.
//!
//! **Teeth.** A coded ring that is not read in a frame keeps the teeth of the frame before, where
//! the track's code is certain, and continues its rotation. The fit rejects them where the pixels
//! contradict them or do not determine the yaw.
//!
//! **Margin, cells.** The width of the margin is measured in one of [`MARGIN_FITS`] fits, and
//! the robust fit continues with its cells (`robust::resume`).
//!
//! PERF: held motion saves a sixth of the time of a linearization (`model::motion`).

use std::f64::consts::{PI, TAU};

use nalgebra::{Vector2, Vector3};

use super::{DEFAULT_BLUR_PX, FitPath, Memory, Outcome, Start, Teeth};
use crate::{
    camera::PixelPoint,
    pose::{RoundelPose, yaw},
};

/// Motion that hardly changes the rims, pixels.
const NO_MOTION_PX: f64 = 0.8;

/// The margin is measured in every fit of this number.
const MARGIN_FITS: u8 = 16;

/// What the next fit of a tracked ring reuses; opaque to the rest of the crate.
#[derive(Clone, Copy, Debug)]
pub struct FitHistory {
    normal: Vector3<f64>,
    blur_px: f64,
    motion_px: Vector2<f64>,
    center: PixelPoint,
    motion_test: MotionTest,
    code: Option<TeethMotion>,
    path: FitPath,
    clear_px: f64,
    /// Fits since the margin was measured.
    margin_age: u8,
}

/// Rotation of a coded ring.
#[derive(Clone, Copy, Debug)]
struct TeethMotion {
    teeth: Teeth,
    yaw_rad: f64,
    /// Since the frame before.
    turned_rad: f64,
}

impl FitHistory {
    pub(super) fn new(outcome: &Outcome, moved_px: f64, before: Option<&Self>) -> Self {
        let fit = &outcome.fit;
        let mut motion_test = before.map_or(MotionTest::default(), |before| before.motion_test);
        let motion_px2 = fit.motion_px.norm_squared();
        motion_test.update(motion_px2, outcome.motion_variance_px4, moved_px);
        let code = outcome.teeth.zip(fit.pose.yaw_rad).map(|(teeth, yaw_rad)| {
            let turned_rad = before
                .and_then(|before| before.predicted_yaw(&fit.pose))
                .map_or(0.0, |(_, predicted_rad)| wrap_angle(yaw_rad - predicted_rad));
            TeethMotion { teeth, yaw_rad, turned_rad }
        });
        Self {
            normal: fit.pose.normal,
            blur_px: fit.blur_px,
            motion_px: fit.motion_px,
            center: fit.ring.outer.center,
            motion_test,
            code,
            path: outcome.path,
            clear_px: outcome.clear_px,
            margin_age: before.map_or(0, |before| (before.margin_age + 1) % MARGIN_FITS),
        }
    }

    pub(super) fn memory(&self) -> Memory {
        let is_measured = self.margin_age + 1 < MARGIN_FITS;
        Memory { path: self.path, clear_px: is_measured.then_some(self.clear_px) }
    }

    /// Whether the last fit found no motion within the exposure.
    pub fn shows_no_motion(&self) -> bool {
        self.motion_px.norm() < NO_MOTION_PX
    }

    pub fn without_teeth(self) -> Self {
        Self { code: None, ..self }
    }

    /// The teeth, and the yaw of a ring of this pose that has not rotated.
    fn predicted_yaw(&self, pose: &RoundelPose) -> Option<(TeethMotion, f64)> {
        let code = self.code?;
        let before = yaw::axes(&self.normal, code.yaw_rad);
        let axes = yaw::axes_with_normal(&before, &pose.position_m, &pose.normal);
        Some((code, yaw::from_axes_rad(&axes)))
    }
}

/// Into [-π, π).
fn wrap_angle(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

/// Start of a fit; of the two normals, the one nearer to that of the frame before.
pub(super) fn start(pose: &RoundelPose, center: &PixelPoint, before: Option<&FitHistory>) -> Start {
    let mut pose = pose.clone();
    let Some(before) = before else {
        return Start {
            pose,
            blur_px: DEFAULT_BLUR_PX,
            motion_px: Vector2::zeros(),
            moved_px: f64::INFINITY,
            is_still: false,
            teeth: None,
        };
    };
    if pose.other_normal.dot(&before.normal) > pose.normal.dot(&before.normal) {
        pose.yaw_rad = pose.other_yaw_rad();
        std::mem::swap(&mut pose.normal, &mut pose.other_normal);
    }
    let code = before.predicted_yaw(&pose);
    if let Some((TeethMotion { turned_rad, .. }, predicted_rad)) = code {
        pose.yaw_rad = Some(predicted_rad + turned_rad);
    }
    let moved_px = (center.u - before.center.u).hypot(center.v - before.center.v);
    Start {
        pose,
        blur_px: before.blur_px,
        motion_px: before.motion_px,
        moved_px,
        is_still: before.motion_test.may_hold_still(moved_px),
        teeth: code.map(|(code, _)| code.teeth),
    }
}

/// Mean of |μ|²/2v below which there is no motion.
const STILL_RATIO: f64 = 1.6;
/// Effective number of fits in that mean.
const MEAN_COUNT: u8 = 4;
/// Number of consecutive fits that may hold the motion.
const MAX_HELD_FITS: u8 = 8;
/// Motion that no fit would detect, pixels.
const INVISIBLE_PX: f64 = 0.3;
/// A ring counts as no faster than before up to this factor and [`INVISIBLE_PX`].
const SPEED_MARGIN: f64 = 1.25;

/// Evidence of motion within the exposure.
#[derive(Clone, Copy, Debug, Default)]
struct MotionTest {
    /// Mean of |μ|²/2v over fits with free motion.
    ratio: f64,
    /// Number of these fits, up to [`MEAN_COUNT`].
    fits: u8,
    /// Displacement from frame to frame in the last of them, pixels.
    moved_px: f64,
    /// Fits since then.
    held_fits: u8,
}

impl MotionTest {
    /// Whether a fit may hold the motion of a ring with this displacement.
    fn may_hold_still(&self, moved_px: f64) -> bool {
        self.fits > 0
            && self.ratio < STILL_RATIO
            && self.held_fits < MAX_HELD_FITS
            && moved_px < SPEED_MARGIN * self.moved_px + INVISIBLE_PX
    }

    /// `variance_px4` is `None` where the motion was held.
    fn update(&mut self, motion_px2: f64, variance_px4: Option<f64>, moved_px: f64) {
        let Some(variance_px4) = variance_px4 else {
            self.held_fits = self.held_fits.saturating_add(1);
            return;
        };
        let still_px4 = 2.0 * variance_px4 + INVISIBLE_PX.powi(4);
        self.fits = (self.fits + 1).min(MEAN_COUNT);
        let ratio = motion_px2 * motion_px2 / still_px4;
        self.ratio += (ratio - self.ratio) / f64::from(self.fits);
        self.moved_px = if moved_px.is_finite() { moved_px } else { 0.0 };
        self.held_fits = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring that moves by 2 px from frame to frame, with motion within the exposure from some
    /// frame on.
    #[test]
    fn motion_is_held_while_absent_and_free_once_present() {
        let (mut motion_test, variance_px4) = (MotionTest::default(), 0.04);
        let mut free_at = Vec::new();
        for frame in 0..60 {
            let is_free = !motion_test.may_hold_still(2.0);
            // Noise, and from the 40th frame on motion of 1 px as well.
            let motion_px2 = if frame < 40 { 0.25 } else { 1.0 };
            motion_test.update(motion_px2, is_free.then_some(variance_px4), 2.0);
            if is_free {
                free_at.push(frame);
            }
        }
        let before = free_at.iter().filter(|frame| **frame < 40).count();
        assert!(before < 8, "{free_at:?}");
        let noticed = free_at.iter().copied().find(|frame| *frame >= 40).unwrap();
        assert!(noticed <= 40 + i32::from(MAX_HELD_FITS), "{free_at:?}");
        assert!((noticed..60).all(|frame| free_at.contains(&frame)), "{free_at:?}");
    }

    #[test]
    fn faster_rings_have_free_motion() {
        let mut motion_test = MotionTest::default();
        assert!(!motion_test.may_hold_still(0.0));
        motion_test.update(0.0, Some(0.04), f64::INFINITY);
        assert!(motion_test.may_hold_still(0.2) && !motion_test.may_hold_still(0.5));
        motion_test.update(0.0, Some(0.04), 2.0);
        assert!(
            motion_test.may_hold_still(2.2)
                && !motion_test.may_hold_still(3.2)
                && !motion_test.may_hold_still(f64::NAN)
        );
    }
}

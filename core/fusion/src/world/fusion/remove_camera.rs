//! Removal of cameras, and changes of their source, at run time.

use super::Fusion;
use crate::world::lifecycle::DEFAULT_TRUST;
use roundel_vision::id::CameraId;

impl Fusion {
    /// Forgets a camera. Tracks keep its measurements until they leave the window. Later frames count as those of
    /// a new camera.
    pub fn remove_camera(&mut self, camera: CameraId) {
        self.set_camera(camera, None);
        self.set_mount(camera, None);
        self.set_hold_back_exempt(camera, false);
        self.set_trust(camera, DEFAULT_TRUST);
        self.forget_source(camera);
    }

    /// Notes that a camera's frames have a new source: forgets its stamps, numbers and clock, which is exact
    /// until [`Self::set_clock`]. Its pose is kept.
    pub fn forget_source(&mut self, camera: CameraId) {
        self.clocks.remove(camera);
        self.stamp_corrector.forget(camera);
        self.missing_frames.forget(camera);
        self.timeline.forget(camera);
    }
}

#[cfg(test)]
mod tests {
    use crate::world::{CameraPlacement, ClockPrior, FrameObservations, Fusion, FusionParams};
    use roundel_vision::{
        id::CameraId,
        rigid::{Covariance6, Rigid},
        time::Timestamp,
    };

    fn frame(camera: u32, number: u64, capture: Timestamp) -> FrameObservations {
        FrameObservations {
            camera: CameraId(camera),
            frame: number,
            capture_time: capture,
            received_time: capture,
            calibration_version: 0,
            detections: Vec::new(),
        }
    }

    fn placement() -> CameraPlacement {
        let (world_from_camera, covariance) = (Rigid::identity(), Covariance6::zeros());
        CameraPlacement { world_from_camera, covariance }
    }

    #[test]
    fn a_removed_camera_is_forgotten_and_the_others_continue() {
        let mut fusion = Fusion::new(FusionParams::default());
        for (camera, offset_s) in [(0, 0.001), (1, 0.02), (2, 0.003)] {
            fusion.set_camera(CameraId(camera), Some(placement()));
            fusion.set_clock(CameraId(camera), ClockPrior { offset_s, skew: 1e-5 });
        }
        let start = Timestamp::from_ns(1_700_000_000_000_000_000);
        for number in 1..50_u32 {
            let capture = start.plus_seconds(0.033 * f64::from(number));
            (0..3).for_each(|camera| {
                fusion.observe(&frame(camera, number.into(), capture.plus_ns(camera.into())));
            });
        }
        let before = [0, 2].map(|camera| fusion.clock(CameraId(camera)).unwrap());
        fusion.remove_camera(CameraId(1));
        assert_eq!(fusion.clock(CameraId(1)), None);
        assert!(fusion.camera_placement(CameraId(1), start).is_err());
        let after = [0, 2].map(|camera| fusion.clock(CameraId(camera)).unwrap());
        // Differences of offsets determine the deviations that remain.
        assert_eq!(before.map(|it| it.offset_s), after.map(|it| it.offset_s));
        assert!(after[0].deviation_s < before[0].deviation_s + 0.02, "{before:?} {after:?}");
        let counts = fusion.counts();
        for number in 50..60_u32 {
            let capture = start.plus_seconds(0.033 * f64::from(number));
            for camera in [0, 2] {
                fusion.observe(&frame(camera, number.into(), capture.plus_ns(camera.into())));
            }
        }
        assert_eq!(fusion.counts().frames, counts.frames + 20);
        assert_eq!(
            fusion.counts().missing_frames,
            counts.missing_frames,
            "its frames are not expected"
        );
    }

    #[test]
    fn a_new_source_causes_no_duplicates_and_no_clock_step() {
        let mut fusion = Fusion::new(FusionParams::default());
        let start = Timestamp::from_ns(1_700_000_000_000_000_000);
        for number in 1..20_u32 {
            fusion.observe(&frame(0, number.into(), start.plus_seconds(0.033 * f64::from(number))));
        }
        fusion.forget_source(CameraId(0));
        // Numbered from 1 again, with stamps of another epoch.
        for number in 1..20_u32 {
            let received = start.plus_seconds(0.7 + 0.033 * f64::from(number));
            let stamped = received.plus_seconds(-0.04);
            fusion.observe(&FrameObservations {
                received_time: received,
                ..frame(0, number.into(), stamped)
            });
        }
        let counts = fusion.counts();
        assert_eq!((counts.duplicate_frames, counts.clock_steps, counts.missing_frames), (0, 0, 0));
        assert_eq!(counts.frames, 38);
    }
}

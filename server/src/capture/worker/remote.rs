//! What a remote program has seen: nothing is searched here, the rest is as with frames.

use std::{sync::Arc, time::Instant};

use super::Worker;
use crate::capture::source::{RemoteDetections, push::RemoteStats};

impl Worker {
    /// Takes what was seen in a frame: counted, numbered, and handed to fusion.
    pub(super) fn process_remote(&mut self, remote: RemoteDetections) {
        let RemoteDetections { mut observations, clock, skipped, figures } = remote;
        if let Some(calibration_update) = self.parts.mailbox.take() {
            self.apply_calibration(calibration_update);
        }
        let now = self.parts.clock.now();
        self.frames += 1;
        self.dropped += skipped;
        observations.camera = self.parts.id;
        observations.frame = self.frames;
        self.rate.add(now);
        self.check_rate(now, 1);
        let figures = figures.unwrap_or_else(|| {
            let camera = self.parts.pipeline.camera();
            RemoteStats { width: camera.width(), height: camera.height(), ..RemoteStats::default() }
        });
        if self.running_since.is_none() {
            self.running_since = Some(Instant::now());
            self.report_running((figures.width, figures.height), now);
        }
        self.search_pose(&observations, now);
        let observations = Arc::new(observations);
        self.send_to_fusion(observations.clone());
        self.parts.hub.update_camera(self.parts.id, |state| {
            state.frames = self.frames;
            // What its sender left out, and what never came from there.
            state.dropped = self.dropped + figures.dropped;
            state.broken = self.broken + figures.broken;
            state.capture_clock = Some(clock);
            state.rate_hz = self.rate.hz();
            state.detections = observations.detections.len();
            (state.detect_ms, state.decode_ms) = (figures.detect_ms, figures.decode_ms);
            (state.blur_px, state.noise) = (figures.blur_px, figures.noise);
        });
        self.parts.hub.publish_observations(observations);
    }
}

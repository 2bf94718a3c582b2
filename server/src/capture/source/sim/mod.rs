//! `sim:` – one camera of a simulated arena, rendered in the worker's own thread.

pub mod fleet;

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use roundel_core::{
    frame::Frame,
    sim::{Renderer, Scenario, ScenarioError, SimCamera},
    time::Timestamp,
};

use self::fleet::{Fleet, Fleets};
use super::{FrameInfo, FrameSource, LentFrame, SourceError, SourceParts, bad_frame};
use crate::model::address::SimAddress;

/// Least and greatest time from the middle of the exposure until the worker has the frame.
pub const SIM_LATENCY_S: [f64; 2] = [0.015, 0.025];

/// Renders frames when they are due.
pub(super) struct SimSource {
    fleet: Arc<Fleet>,
    /// The scenario of the newest frame.
    scenario: Arc<Scenario>,
    renderer: Renderer,
    origin: Timestamp,
    parts: SourceParts,
    latency: ChaCha8Rng,
    next: Option<u64>,
    pixels: Vec<u8>,
}

impl SimSource {
    /// The scenario starts at `origin` for all of its cameras.
    pub(super) fn open(
        address: &SimAddress,
        fleets: &Fleets,
        origin: Timestamp,
        parts: SourceParts,
    ) -> Result<Self, SourceError> {
        let failed = |error: ScenarioError| SourceError::Failed(error.to_string());
        let fleet = fleets.of(address, origin).map_err(failed)?;
        let scenario = fleet.scenario();
        let renderer = Renderer::new(&scenario, address.camera).map_err(failed)?;
        let latency = ChaCha8Rng::seed_from_u64(address.seed ^ address.camera as u64);
        let (next, pixels) = (None, Vec::new());
        Ok(Self { fleet, scenario, renderer, origin, parts, latency, next, pixels })
    }
}

impl FrameSource for SimSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let SimCamera { camera, phase_s, rate_hz, .. } = self.renderer.camera();
        let (width, height) = (camera.width(), camera.height());
        // The newest frame whose capture time has passed; 0 before the first.
        let now_s = self.parts.clock.now().seconds_since(self.origin) - SIM_LATENCY_S[0];
        let newest = ((now_s - phase_s) * rate_hz).floor().max(0.0) as u64;
        let frame = self.next.map_or(newest, |next| next.max(newest));
        let skipped = self.next.map_or(0, |next| frame - next);
        let scenario = self.fleet.scenario();
        if !Arc::ptr_eq(&scenario, &self.scenario) {
            self.renderer.follow(&scenario);
            self.scenario = scenario;
        }
        self.pixels.resize(width * height, 0);
        let time_s = self
            .renderer
            .render(frame, &mut self.pixels)
            .map_err(|error| SourceError::Failed(error.to_string()))?;
        let capture_time = self.origin.plus_seconds(time_s);
        let latency_s = self.latency.random_range(SIM_LATENCY_S[0]..SIM_LATENCY_S[1]);
        if self.parts.stop.wait(self.parts.clock.until(capture_time.plus_seconds(latency_s))) {
            return Err(SourceError::Stopped);
        }
        self.next = Some(frame + 1);
        let info = FrameInfo { skipped, ..FrameInfo::at(capture_time) };
        let frame = Frame::new(&self.pixels, width, height, width).map_err(bad_frame)?;
        Ok(LentFrame { frame, info })
    }
}

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
use super::{FrameInfo, FrameSource, LentFrame, SourceError, bad_frame};
use crate::model::address::SimAddress;
use crate::model::{clock::Clock, stop::StopSignal};

/// From the middle of the exposure until the worker has the frame: at least and at most.
pub const SIM_LATENCY_S: [f64; 2] = [0.015, 0.025];

/// Renders frames when they are due.
pub(super) struct SimSource {
    fleet: Arc<Fleet>,
    /// As the robots move in the newest frame.
    scenario: Arc<Scenario>,
    renderer: Renderer,
    camera: SimCamera,
    origin: Timestamp,
    clock: Clock,
    stop: StopSignal,
    latency: ChaCha8Rng,
    next: Option<u64>,
    pixels: Vec<u8>,
}

impl SimSource {
    /// The scenario's start is at `origin`, for every camera of it.
    pub(super) fn open(
        address: &SimAddress,
        (fleets, origin): (&Fleets, Timestamp),
        clock: Clock,
        stop: StopSignal,
    ) -> Result<Self, SourceError> {
        let failed = |error: ScenarioError| SourceError::Failed(error.to_string());
        let fleet = fleets.of(address, origin).map_err(failed)?;
        let scenario = fleet.scenario();
        let renderer = Renderer::new(&scenario, address.camera).map_err(failed)?;
        let camera = renderer.camera().clone();
        let latency = ChaCha8Rng::seed_from_u64(address.seed ^ address.camera as u64);
        let (next, pixels) = (None, Vec::new());
        Ok(Self { fleet, scenario, renderer, camera, origin, clock, stop, latency, next, pixels })
    }

    /// The newest frame that was taken by now; 0 before the first.
    fn newest_taken(&self) -> u64 {
        let now_s = self.clock.now().seconds_since(self.origin) - SIM_LATENCY_S[0];
        ((now_s - self.camera.phase_s) * self.camera.rate_hz).floor().max(0.0) as u64
    }
}

impl FrameSource for SimSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let newest = self.newest_taken();
        let frame = self.next.map_or(newest, |next| next.max(newest));
        let skipped = self.next.map_or(0, |next| frame - next);
        let (width, height) = (self.camera.camera.width(), self.camera.camera.height());
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
        if self.stop.wait(self.clock.until(capture_time.plus_seconds(latency_s))) {
            return Err(SourceError::Stopped);
        }
        self.next = Some(frame + 1);
        let info = FrameInfo { skipped, ..FrameInfo::at(capture_time) };
        let frame = Frame::new(&self.pixels, width, height, width).map_err(bad_frame)?;
        Ok(LentFrame { frame, info })
    }
}

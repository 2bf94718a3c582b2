//! What one try of a source has given.

use roundel_proto::v1;

use crate::capture::source_probe::ProbeReport;
use crate::model::convert::{capture_clock, pixels};

pub fn trial(trial: &ProbeReport) -> v1::SourceTest {
    v1::SourceTest {
        error: trial.error.clone(),
        width: pixels(trial.width),
        height: pixels(trial.height),
        frames: trial.frames,
        broken: trial.broken,
        rate_hz: trial.rate_hz,
        promised_rate_hz: trial.promised_hz,
        capture_clock: trial.capture_clock.map(capture_clock),
        roundels: pixels(trial.roundels),
        decode_ms: trial.decode_ms,
        detect_ms: trial.detect_ms,
    }
}

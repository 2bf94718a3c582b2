//! Summary of a track in a few numbers, where the filters take kilobytes. It suffices to exclude most sightings
//! (`association::gate`) and most other tracks (`merge`).

use nalgebra::Vector3;

use crate::track::{BlockTraces, FilterState};
use roundel_vision::time::Timestamp;

/// Position, velocity and traces of the covariance of a track's agile filter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coarse {
    time: Timestamp,
    pub(crate) position_m: Vector3<f64>,
    pub(crate) velocity_m_s: Vector3<f64>,
    /// Traces of the covariance's blocks with clock errors: position, cross, velocity.
    pub(crate) traces: BlockTraces,
    /// Sum over the axes of the process noise's density, m²/s³.
    density_m2_s3: f64,
}

impl Coarse {
    pub(crate) fn from_state(state: &FilterState, density_m2_s3: &Vector3<f64>) -> Self {
        let filter = state.motion.agile();
        Self {
            time: state.time,
            position_m: filter.position_m,
            velocity_m_s: filter.kalman.rate,
            traces: filter.kalman.reported_traces(),
            density_m2_s3: density_m2_s3.sum(),
        }
    }

    /// Summary at another time; the traces equal those of the predicted covariance.
    pub(crate) fn predicted(&self, time: Timestamp) -> Self {
        let dt = time.seconds_since(self.time);
        let BlockTraces { value, cross, rate } = self.traces;
        let (span, grown) = (dt.abs(), self.density_m2_s3);
        let traces = BlockTraces {
            value: value + 2.0 * cross * dt + rate * dt * dt + grown * span * span * span / 3.0,
            cross: cross + rate * dt + grown * dt * span / 2.0,
            rate: rate + grown * span,
        };
        Self { time, position_m: self.position_m + self.velocity_m_s * dt, traces, ..*self }
    }

    /// Upper bound of the root of the position's trace, metres, up to `span_s` before or after.
    pub(crate) fn max_deviation_m(&self, span_s: f64) -> f64 {
        let BlockTraces { value, cross, rate } = self.traces;
        let span = span_s.abs();
        let grown = self.density_m2_s3 * span * span * span / 3.0;
        (value + 2.0 * cross.abs() * span + rate * span * span + grown).max(0.0).sqrt()
    }
}

//! Offset between the server's clock and this program's, measured with probes as in NTP (RFC 5905 §8).
//!
//! A probe leaves at t₁ (own clock), arrives at t₂ and is answered at t₃ (server's clock), and its answer arrives at t₄
//! (own clock). The error of offset = ((t₂ - t₁) + (t₃ - t₄)) / 2 is at most half the round trip (t₄ - t₁) - (t₃ - t₂). The
//! bound of a probe grows with its age by the drift of two quartz clocks; the newest probes are searched for the least
//! bound. For an error distributed uniformly within the bound, the standard deviation is bound / √3.

use std::collections::VecDeque;

use std::time::{SystemTime, UNIX_EPOCH};

use crate::{Client, Error, v1};

/// Number of probes kept.
const MAX_PROBES: usize = 64;
/// Maximum relative drift of two quartz clocks.
const MAX_DRIFT: f64 = 1e-4;

/// Number of probes of one measurement.
const PROBES: usize = 8;

/// Offset between the server's clock and this program's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOffset {
    /// Server's time minus this program's, ns.
    pub offset_ns: i64,
    /// Standard deviation, ns, from the unknown asymmetry of the round trip and from the drift since.
    pub deviation_ns: i64,
    /// Round trip of the probe that was used, ns.
    pub round_trip_ns: i64,
}

impl ClockOffset {
    /// Estimate of the server's current time, ns since the Unix epoch.
    pub fn server_now_ns(&self) -> i64 {
        own_now_ns().saturating_add(self.offset_ns)
    }
}

impl Client {
    /// How far the server's clock is ahead of this machine's Unix clock, from a few probes.
    ///
    /// # Errors
    /// [`Error::Server`] if no probe is plausible because a clock was set; and connection errors.
    pub async fn clock_offset(&self) -> Result<ClockOffset, Error> {
        let mut estimator = ClockEstimator::default();
        for _ in 0..PROBES {
            let request = v1::GetTimeRequest { sent_time_ns: own_now_ns() };
            let answer = self.service().get_time(request).await;
            let arrival_ns = own_now_ns();
            let time = answer.map_err(|status| self.error(&status))?.into_inner();
            estimator.add_probe(
                [time.sent_time_ns, arrival_ns],
                [time.received_time_ns, time.replied_time_ns],
            );
        }
        estimator.offset_at(own_now_ns()).ok_or_else(|| Error::Server {
            code: tonic::Code::Aborted,
            message: "no clock probe is plausible: a clock was set during the measurement"
                .to_owned(),
        })
    }
}

/// Time of this machine's Unix clock.
fn own_now_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

#[derive(Clone, Copy, Debug)]
struct Probe {
    /// By this program's clock.
    arrived_ns: i64,
    offset_ns: i64,
    round_trip_ns: i64,
}

impl Probe {
    fn bound_ns(&self, now_ns: i64) -> f64 {
        let age_ns = now_ns.saturating_sub(self.arrived_ns).max(0);
        0.5 * self.round_trip_ns as f64 + MAX_DRIFT * age_ns as f64
    }
}

/// Estimates the offset of the server's clock from probes.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClockEstimator {
    probes: VecDeque<Probe>,
    answer_count: u64,
}

impl ClockEstimator {
    /// Adds an answered probe: times of sending and of the answer by this program's clock, times of receipt and reply by
    /// the server's. Ignores it if times run backwards.
    pub(crate) fn add_probe(&mut self, [sent, arrival]: [i64; 2], [received, replied]: [i64; 2]) {
        self.answer_count += 1;
        let round_trip_ns =
            (i128::from(arrival) - i128::from(sent)) - (i128::from(replied) - i128::from(received));
        if arrival < sent || replied < received || round_trip_ns < 0 {
            return;
        }
        let outbound = i128::from(received) - i128::from(sent);
        let inbound = i128::from(replied) - i128::from(arrival);
        let (Ok(offset_ns), Ok(round_trip_ns)) =
            (i64::try_from((outbound + inbound) / 2), i64::try_from(round_trip_ns))
        else {
            return;
        };
        if self.probes.len() == MAX_PROBES {
            self.probes.pop_front();
        }
        self.probes.push_back(Probe { arrived_ns: arrival, offset_ns, round_trip_ns });
    }

    /// Drops all probes, since the next server may have another clock.
    pub(crate) fn reset(&mut self) {
        self.probes.clear();
    }

    /// Answers so far, plausible or not.
    pub(crate) fn probes_answered(&self) -> u64 {
        self.answer_count
    }

    /// The offset with the least bound at this time of this program's clock.
    pub(crate) fn offset_at(&self, now_ns: i64) -> Option<ClockOffset> {
        let by_bound =
            |one: &&Probe, other: &&Probe| one.bound_ns(now_ns).total_cmp(&other.bound_ns(now_ns));
        let best = self.probes.iter().min_by(by_bound)?;
        Some(ClockOffset {
            offset_ns: best.offset_ns,
            deviation_ns: (best.bound_ns(now_ns) / 3_f64.sqrt()) as i64,
            round_trip_ns: best.round_trip_ns,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Adds a probe of a server whose clock is `ahead`, with these durations of the two directions.
    fn probe(estimator: &mut ClockEstimator, at: i64, ahead: i64, outbound: i64, inbound: i64) {
        let received = at + outbound + ahead;
        let replied = received + MS;
        estimator.add_probe([at, at + outbound + MS + inbound], [received, replied]);
    }

    #[test]
    fn the_probe_with_the_least_bound_is_used_and_the_bound_holds() {
        let mut estimator = ClockEstimator::default();
        assert_eq!(estimator.offset_at(0), None);
        let ahead = 7_000 * MS;
        for (index, (outbound, inbound)) in
            [(9, 1), (1, 1), (30, 1), (1, 40)].into_iter().enumerate()
        {
            probe(&mut estimator, index as i64 * 1000 * MS, ahead, outbound * MS, inbound * MS);
            let offset = estimator.offset_at(index as i64 * 1000 * MS).unwrap();
            let bound = offset.deviation_ns as f64 * 3_f64.sqrt();
            assert!((offset.offset_ns - ahead).abs() as f64 <= bound, "{offset:?}");
        }
        let offset = estimator.offset_at(4000 * MS).unwrap();
        assert_eq!((offset.offset_ns, offset.round_trip_ns), (ahead, 2 * MS));
        // Ten seconds without an answer add a millisecond of drift.
        let later = estimator.offset_at(13_000 * MS).unwrap();
        assert!(later.deviation_ns > offset.deviation_ns + MS / 2, "{later:?}");
    }

    #[test]
    fn a_drifting_clock_stays_within_the_bound() {
        let mut estimator = ClockEstimator::default();
        for second in 0..600_i64 {
            let ahead = 5 * MS + second * 50_000;
            probe(
                &mut estimator,
                second * 1000 * MS,
                ahead,
                MS / 2,
                MS / 2 + (second * 7 % 5) * MS,
            );
            let offset = estimator.offset_at(second * 1000 * MS + 2 * MS).unwrap();
            let bound = offset.deviation_ns as f64 * 3_f64.sqrt();
            assert!(((offset.offset_ns - ahead).abs() as f64) <= bound, "{second}: {offset:?}");
        }
    }

    #[test]
    fn implausible_answers_are_ignored() {
        let mut estimator = ClockEstimator::default();
        estimator.add_probe([10, 5], [0, 0]);
        estimator.add_probe([0, 10], [20, 10]);
        estimator.add_probe([0, 10], [0, 100]);
        estimator.add_probe([i64::MIN, i64::MAX], [i64::MAX, i64::MAX]);
        assert_eq!(estimator.offset_at(0), None);
        assert_eq!(estimator.probes_answered(), 4);
    }
}

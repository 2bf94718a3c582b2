//! The server's clock against this program's, from probes (as NTP does, RFC 5905 §8).
//!
//! A probe leaves at t₁ (own clock), arrives at t₂ and is answered at t₃ (server's), and its answer is here at t₄
//! (own). offset = ((t₂ - t₁) + (t₃ - t₄)) / 2 is off by at most half of the round trip (t₄ - t₁) - (t₃ - t₂), which
//! is reached when one way takes all of it. Of the newest probes the one with the least bound counts, the bound
//! growing with age by what two quartz clocks may drift apart. Taking the error as even within the bound, its
//! standard deviation is bound / √3.

use std::collections::VecDeque;

use std::time::{SystemTime, UNIX_EPOCH};

use crate::{Client, Error, v1};

/// Probes that are looked at.
const KEPT: usize = 64;
/// Two clocks' quartz drift apart by at most so much.
const DRIFT: f64 = 1e-4;

/// Probes that measure an offset when it is asked for once.
const PROBES: usize = 8;

/// The server's clock against this program's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOffset {
    /// Server's less this program's, ns.
    pub offset_ns: i64,
    /// Standard deviation, ns: that of the share of the round trip that nobody knows, and what quartz may have
    /// drifted since.
    pub deviation_ns: i64,
    /// The round trip that it comes from, ns.
    pub round_trip_ns: i64,
}

impl ClockOffset {
    /// The server's time now, ns since the Unix epoch, as far as this is known.
    pub fn server_now_ns(&self) -> i64 {
        own_now_ns().saturating_add(self.offset_ns)
    }
}

impl Client {
    /// By how much the server's clock is ahead of this machine's Unix clock, from a few probes.
    ///
    /// # Errors
    /// [`Error::Server`] if no probe made sense, since a clock was set meanwhile; and those of the connection.
    pub async fn clock_offset(&self) -> Result<ClockOffset, Error> {
        let mut clock = ServerClock::default();
        for _ in 0..PROBES {
            let request = v1::GetTimeRequest { sent_time_ns: own_now_ns() };
            let answer = self.service().get_time(request).await;
            let back_ns = own_now_ns();
            let time = answer.map_err(|status| self.error(&status))?.into_inner();
            clock
                .learn([time.sent_time_ns, back_ns], [time.received_time_ns, time.replied_time_ns]);
        }
        clock.offset_at(own_now_ns()).ok_or_else(|| Error::Server {
            code: tonic::Code::Aborted,
            message: "no probe of its clock made sense; a clock was set meanwhile".to_owned(),
        })
    }
}

/// This machine's Unix clock.
fn own_now_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

#[derive(Clone, Copy, Debug)]
struct Probe {
    /// Own clock.
    arrived_ns: i64,
    offset_ns: i64,
    round_trip_ns: i64,
}

impl Probe {
    fn bound_ns(&self, now_ns: i64) -> f64 {
        let age_ns = now_ns.saturating_sub(self.arrived_ns).max(0);
        0.5 * self.round_trip_ns as f64 + DRIFT * age_ns as f64
    }
}

/// What is known of the server's clock.
#[derive(Clone, Debug, Default)]
pub(crate) struct ServerClock {
    probes: VecDeque<Probe>,
    answered: u64,
}

impl ServerClock {
    /// Takes in the answer to a probe: when it was sent and came back (own clock), when it arrived and was
    /// answered (server's). Times that run backwards are no answer.
    pub(crate) fn learn(&mut self, [sent, back]: [i64; 2], [received, replied]: [i64; 2]) {
        self.answered += 1;
        let round_trip_ns =
            (i128::from(back) - i128::from(sent)) - (i128::from(replied) - i128::from(received));
        if back < sent || replied < received || round_trip_ns < 0 {
            return;
        }
        let there = i128::from(received) - i128::from(sent);
        let here = i128::from(replied) - i128::from(back);
        let (Ok(offset_ns), Ok(round_trip_ns)) =
            (i64::try_from((there + here) / 2), i64::try_from(round_trip_ns))
        else {
            return;
        };
        if self.probes.len() == KEPT {
            self.probes.pop_front();
        }
        self.probes.push_back(Probe { arrived_ns: back, offset_ns, round_trip_ns });
    }

    /// Forgets all: another server has another clock.
    pub(crate) fn forget(&mut self) {
        self.probes.clear();
    }

    /// Probes that came back so far.
    pub(crate) fn probes_answered(&self) -> u64 {
        self.answered
    }

    /// The difference as far as it is known at that time, own clock.
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

    /// A probe of a server that is `ahead` before this clock, ways of so long there and back.
    fn probe(clock: &mut ServerClock, at: i64, ahead: i64, there: i64, back: i64) {
        let received = at + there + ahead;
        let replied = received + MS;
        clock.learn([at, at + there + MS + back], [received, replied]);
    }

    #[test]
    fn the_quickest_probe_counts_and_its_bound_holds() {
        let mut clock = ServerClock::default();
        assert_eq!(clock.offset_at(0), None);
        let ahead = 7_000 * MS;
        for (index, (there, back)) in [(9, 1), (1, 1), (30, 1), (1, 40)].into_iter().enumerate() {
            probe(&mut clock, index as i64 * 1000 * MS, ahead, there * MS, back * MS);
            let known = clock.offset_at(index as i64 * 1000 * MS).unwrap();
            let bound = known.deviation_ns as f64 * 3_f64.sqrt();
            assert!((known.offset_ns - ahead).abs() as f64 <= bound, "{known:?}");
        }
        let known = clock.offset_at(4000 * MS).unwrap();
        assert_eq!((known.offset_ns, known.round_trip_ns), (ahead, 2 * MS));
        // Ten seconds without an answer: a millisecond more may have been drifted.
        let later = clock.offset_at(13_000 * MS).unwrap();
        assert!(later.deviation_ns > known.deviation_ns + MS / 2, "{later:?}");
    }

    #[test]
    fn clocks_that_drift_are_followed() {
        let mut clock = ServerClock::default();
        for second in 0..600_i64 {
            let ahead = 5 * MS + second * 50_000;
            probe(&mut clock, second * 1000 * MS, ahead, MS / 2, MS / 2 + (second * 7 % 5) * MS);
            let known = clock.offset_at(second * 1000 * MS + 2 * MS).unwrap();
            let bound = known.deviation_ns as f64 * 3_f64.sqrt();
            assert!(((known.offset_ns - ahead).abs() as f64) <= bound, "{second}: {known:?}");
        }
    }

    #[test]
    fn answers_without_sense_are_left_out() {
        let mut clock = ServerClock::default();
        clock.learn([10, 5], [0, 0]);
        clock.learn([0, 10], [20, 10]);
        clock.learn([0, 10], [0, 100]);
        clock.learn([i64::MIN, i64::MAX], [i64::MAX, i64::MAX]);
        assert_eq!(clock.offset_at(0), None);
        assert_eq!(clock.probes_answered(), 4);
    }
}

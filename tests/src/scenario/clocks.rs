//! Cameras with clocks that are not synchronized.
//!
//! The remaining clock errors are measured from outside. After 20 s, each camera alone feeds a copy of the fusion
//! state for some seconds. If its clock is still ahead by o, the poses at the stated time are those of o earlier, e =
//! -o v, and o is the least-squares solution over all states ([`Score::delay_s`](crate::score::Score::delay_s)). A
//! delay that all cameras share is not a clock error, so the mean is subtracted. The same measurement with correct
//! clocks shows its accuracy.

use super::{
    Length, Row,
    run::{Run, Ticks},
    swarm::PRECISE,
};
use crate::{
    arena::Arena,
    sensor::{Sensing, Stream},
};

const TICKS: Ticks = Ticks { rate_hz: 60.0, judged_from_s: 1.0 };
/// Clocks must be known after this time.
const LEARNED_S: f64 = 20.0;
/// Duration of the measurement. The filter forgets the other cameras in the first second.
const MEASURED_S: f64 = 8.0;
const FORGET_S: f64 = 1.0;
/// Largest remaining clock error.
const BAR_MS: f64 = 0.1;

/// Estimated clock error of each camera relative to their mean, ms, and the run until then.
fn remaining_ms(arena: &Arena, learned_s: f64, measured_s: f64) -> (Vec<f64>, Run<'_>) {
    let sensing = Sensing { dropout: 0.0, ..PRECISE };
    let end_ns = arena.start_ns + (learned_s * 1e9) as i64;
    let mut run = Run::new(arena, TICKS);
    let mut after = Vec::new();
    for frame in Stream::new(arena, sensing, learned_s + measured_s) {
        if frame.received_time.as_ns() <= end_ns {
            run.take(&frame);
        } else {
            after.push(frame);
        }
    }
    let ahead_ms: Vec<f64> = (0..arena.sites.len() as u32)
        .map(|camera| {
            let own = after.iter().filter(|frame| frame.camera.0 == camera).cloned();
            run.continued(learned_s + FORGET_S).take_all(own).finish().score.delay_s() * 1e3
        })
        .collect();
    let mean = ahead_ms.iter().sum::<f64>() / ahead_ms.len() as f64;
    (ahead_ms.iter().map(|ahead| ahead - mean).collect(), run)
}

fn max(numbers: &[f64]) -> f64 {
    numbers.iter().fold(0.0, |max: f64, number| max.max(number.abs()))
}

/// R4 with offsets to 40 ms and skews to 50 ppm.
pub fn unset(length: Length) -> Vec<Row> {
    let (learned_s, measured_s) = (length.seconds(LEARNED_S, 3.0), length.seconds(MEASURED_S, 3.0));
    let (right, unset) = (Arena::r4(21), Arena::r4(21).with_unsynchronized_clocks());
    let (floor_ms, _) = remaining_ms(&right, learned_s, measured_s);
    let (left_ms, run) = remaining_ms(&unset, learned_s, measured_s);
    let true_ms: Vec<f64> = {
        let at_s = learned_s + FORGET_S + 0.5 * (measured_s - FORGET_S);
        let ahead = unset.sites.iter().map(|site| site.clock.ahead_s + site.clock.skew * at_s);
        let ahead: Vec<f64> = ahead.collect();
        let mean = ahead.iter().sum::<f64>() / ahead.len() as f64;
        ahead.iter().map(|ahead| (ahead - mean) * 1e3).collect()
    };
    let list = |numbers: &[f64]| {
        numbers.iter().map(|number| format!("{number:+.2}")).collect::<Vec<_>>().join(" ")
    };
    let score = run.finish().score;
    let row = Row::new("R4, clock offsets and skews unknown", "estimated to 0.1 ms within 20 s");
    let row = row
        .check(
            format!(
                "{:.2} ms off after {learned_s:.0} s: {} of {}",
                max(&left_ms),
                list(&left_ms),
                list(&true_ms)
            ),
            max(&left_ms) <= BAR_MS,
        )
        .note(format!("measured to {:.2} ms", max(&floor_ms)))
        .check_identities(24, &score)
        .note_errors(&score);
    vec![row.scored(score)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correct_clocks_have_no_remaining_error() {
        let (left_ms, _) = remaining_ms(&Arena::r4(22), 1.0, 3.0);
        assert!(max(&left_ms) < 0.3, "{left_ms:?}");
    }

    /// A tenth of a second is not enough to learn the clocks.
    #[test]
    fn clocks_that_are_not_learned_yet_show_their_errors() {
        let mut arena = Arena::r4(22);
        for (site, ahead_s) in arena.sites.iter_mut().zip([0.03, -0.01, 0.0, -0.02]) {
            site.clock.ahead_s = ahead_s;
        }
        let (left_ms, _) = remaining_ms(&arena, 0.1, 3.0);
        for (left_ms, true_ms) in left_ms.iter().zip([30.0, -10.0, 0.0, -20.0]) {
            assert!((left_ms - true_ms).abs() < 0.5, "{left_ms} {true_ms}");
        }
    }
}

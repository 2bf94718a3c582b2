//! The identity of a track, from the readings of its frames.
//!
//! A reading of confidence c adds the log-odds ln(c / (1 - c)) to its code, and subtracts them from all
//! others. The code with the largest sum wins. The contribution of one frame is limited, since a scratch or a shadow
//! misleads many frames alike. The sum is limited too, so that a track whose roundel has been exchanged adapts: an
//! established code gives way after [`MAX_LOG_ODDS`] / 2 / [`MAX_FRAME_LOG_ODDS`] frames that agree on another one, and
//! never to a single frame.

use crate::marker::code::{Code, CodeReading};

/// Largest log-odds of one frame: a likelihood of 0.998.
const MAX_FRAME_LOG_ODDS: f64 = 6.0;
/// Largest log-odds of a code.
const MAX_LOG_ODDS: f64 = 36.0;
/// Number of codes that a track keeps.
const RIVALS: usize = 3;

/// The code of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VotedCode {
    /// The identity.
    pub code: Code,
    /// Likelihood against all others that the track has read, 0 to 1.
    pub confidence: f64,
}

/// The votes of a track.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Vote {
    /// Codes with their log-odds, the likeliest first.
    rivals: [Option<(Code, f64)>; RIVALS],
}

impl Vote {
    /// Adds a frame's reading.
    pub fn add(&mut self, reading: &CodeReading) {
        let doubt = (1.0 - reading.confidence).max(f64::MIN_POSITIVE);
        let log_odds = (reading.confidence / doubt).ln().clamp(0.0, MAX_FRAME_LOG_ODDS);
        let mut is_rival = false;
        for (code, sum) in self.rivals.iter_mut().flatten() {
            if *code == reading.code {
                *sum = (*sum + log_odds).min(MAX_LOG_ODDS);
                is_rival = true;
            } else {
                *sum -= log_odds;
            }
        }
        for rival in &mut self.rivals {
            *rival = rival.filter(|(_, sum)| *sum > 0.0);
        }
        if !is_rival && log_odds > 0.0 {
            // Sorted, with free slots last.
            self.rivals[RIVALS - 1] = Some((reading.code, log_odds));
        }
        let sum = |rival: &Option<(Code, f64)>| rival.map_or(0.0, |(_, sum)| sum);
        // Stable: of two equal ones, the earlier one stays.
        self.rivals.sort_by(|one, other| sum(other).total_cmp(&sum(one)));
    }

    /// The likeliest code; `None` before the first reading.
    pub fn code(&self) -> Option<VotedCode> {
        let (code, sum) = self.rivals[0]?;
        let next = self.rivals[1].map_or(0.0, |(_, sum)| sum);
        Some(VotedCode { code, confidence: 1.0 / (1.0 + (next - sum).exp()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;

    fn reading(number: u16, confidence: f64) -> CodeReading {
        let code = Code { bits: 8, number };
        CodeReading { confidence, ..CodeReading::certain(code, PixelPoint::default()) }
    }

    fn voted(votes: &Vote) -> Option<u16> {
        votes.code().map(|voted| voted.code.number)
    }

    #[test]
    fn a_single_frame_does_not_change_an_established_code() {
        let mut vote = Vote::default();
        assert_eq!(vote.code(), None);
        vote.add(&reading(7, 0.999));
        vote.add(&reading(7, 0.999));
        assert!(vote.code().unwrap().confidence > 0.9999);
        for number in [3, 9, 4] {
            vote.add(&reading(number, 1.0));
            assert_eq!(voted(&vote), Some(7));
            vote.add(&reading(7, 1.0));
            vote.add(&reading(7, 1.0));
        }
    }

    #[test]
    fn an_exchanged_roundel_is_recognized_in_a_few_frames() {
        let mut vote = Vote::default();
        for _ in 0..1_000 {
            vote.add(&reading(7, 1.0));
        }
        let frames = (1..100).find(|_| {
            vote.add(&reading(12, 1.0));
            voted(&vote) == Some(12)
        });
        assert_eq!(frames, Some(4));
    }

    #[test]
    fn doubtful_frames_weigh_less() {
        let mut vote = Vote::default();
        vote.add(&reading(7, 0.999));
        vote.add(&reading(5, 0.6));
        vote.add(&reading(5, 0.6));
        assert_eq!(voted(&vote), Some(7));
        // Even odds change nothing.
        let mut vote = Vote::default();
        vote.add(&reading(7, 0.5));
        assert_eq!(vote.code(), None);
    }

    #[test]
    fn the_likeliest_of_many_codes_wins() {
        let mut vote = Vote::default();
        for number in [1, 2, 3, 4, 5, 6, 2, 7, 2, 8, 2] {
            vote.add(&reading(number, 0.99));
        }
        assert_eq!(voted(&vote), Some(2));
    }
}

//! Majority vote over the code readings of one object. It keeps one candidate and its lead (Boyer, Moore, *MJRTY*,
//! 1981), so its cost does not grow with the number of misread codes.
//!
//! The lead is bounded, so that a track with a wrong code loses it within about a second. A settled code also decides
//! which track a detection belongs to (`association`) and which object a track is (`lifecycle`).

use roundel_vision::marker::Code;

/// Largest lead; this many readings of another code, net, replace the candidate.
const MAX_LEAD: u32 = 60;

/// Lead from which a code is settled.
const SETTLED_LEAD: u32 = 3;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct CodeVote {
    candidate: Option<Code>,
    lead: u32,
    /// Readings of other codes since the candidate was read last.
    contradictions: u32,
}

impl CodeVote {
    /// Adds a reading.
    pub(crate) fn add(&mut self, code: Code) {
        if self.candidate == Some(code) {
            self.lead = (self.lead + 1).min(MAX_LEAD);
            self.contradictions = 0;
        } else if self.lead > 0 {
            self.lead -= 1;
            self.contradictions += 1;
        } else {
            *self = Self { candidate: Some(code), lead: 1, contradictions: 0 };
        }
    }

    /// Sets a code that is settled elsewhere.
    pub(crate) fn set(&mut self, code: Code) {
        *self = Self { candidate: Some(code), lead: SETTLED_LEAD, contradictions: 0 };
    }

    /// Adds the votes of another track of the same object.
    pub(crate) fn merge(&mut self, other: &Self) {
        if self.candidate == other.candidate {
            self.lead = (self.lead + other.lead).min(MAX_LEAD);
        } else if self.lead < other.lead {
            *self = Self { lead: other.lead - self.lead, ..*other };
        } else {
            self.lead -= other.lead;
        }
    }

    /// Whether a reading matches; `None` while that is undecided.
    pub(crate) fn agrees(&self, read: Code) -> Option<bool> {
        if self.candidate == Some(read) {
            return Some(true);
        }
        self.settled().map(|_| false)
    }

    /// Readings of other codes since the candidate was read last: one is a misreading, several are another
    /// object.
    pub(crate) fn contradictions(&self) -> u32 {
        self.contradictions
    }

    /// The candidate, if it is settled.
    pub(crate) fn settled(&self) -> Option<Code> {
        self.candidate.filter(|_| self.lead >= SETTLED_LEAD)
    }

    /// The candidate; `None` before the first reading.
    pub(crate) fn leader(&self) -> Option<Code> {
        self.candidate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vote(numbers: impl IntoIterator<Item = u16>) -> CodeVote {
        let mut vote = CodeVote::default();
        for number in numbers {
            vote.add(Code { bits: 8, number });
        }
        vote
    }

    fn leader(vote: &CodeVote) -> Option<u16> {
        vote.leader().map(|code| code.number)
    }

    #[test]
    fn the_most_frequent_reading_leads() {
        assert_eq!(leader(&vote([])), None);
        assert_eq!(leader(&vote([7])), Some(7));
        assert_eq!(leader(&vote([9, 7, 7, 3, 7, 7, 9])), Some(7));
    }

    #[test]
    fn a_code_is_replaced_after_enough_other_readings() {
        let long = [7; 1000].into_iter();
        assert_eq!(leader(&vote(long.clone().chain([9; 60]))), Some(7));
        assert_eq!(leader(&vote(long.chain([9; 61]))), Some(9));
    }

    #[test]
    fn contradictions_reset_with_the_next_agreeing_reading() {
        assert_eq!(vote([7, 7, 7, 9, 9]).contradictions(), 2);
        assert_eq!(vote([7, 7, 7, 9, 9, 7]).contradictions(), 0);
    }

    #[test]
    fn merged_votes_keep_the_larger_lead() {
        let merge = |a: &[u16], b: &[u16]| {
            let mut joined = vote(a.iter().copied());
            joined.merge(&vote(b.iter().copied()));
            leader(&joined)
        };
        assert_eq!(merge(&[], &[7]), Some(7));
        assert_eq!(merge(&[7], &[]), Some(7));
        assert_eq!(merge(&[7], &[9, 9, 9]), Some(9));
        assert_eq!(merge(&[7, 7], &[9]), Some(7));
    }
}

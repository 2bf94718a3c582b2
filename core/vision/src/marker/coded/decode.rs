//! From a profile to a word: where bits begin, and their values.
//!
//! A bit whose pair of slots begins at sample j follows from D_j, the second slot's sum minus the first
//! one's: positive for a 0, whose tooth comes first. For bits beginning at φ, φ + 2q, … (q samples per
//! slot), Σ|D| is the correlation of the profile with the likeliest word, so the phase is the one of 2q
//! that maximizes it.
//!
//! If that word is not an identity, the bits with the smallest |D| are flipped in the cheapest way that makes it one, up
//! to as many as the minimum distance of the identities can correct as erasures.

use crate::marker::{
    code::{Code, Dictionary},
    coded::profile::{MAX_SAMPLES, Profile},
};

const MAX_BITS: usize = 16;
/// Only this many of the weakest bits are flipped.
const WEAKEST: usize = 4;

/// The identity decoded from a profile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DecodedWord {
    pub code: Code,
    /// The word, from its first bit in the profile on.
    pub word: u16,
    /// Number of bits by which the word is rotated to the left.
    pub shift: u8,
    /// The sample where its first slot begins.
    pub phase: usize,
    /// Correlation with the profile.
    pub score: f32,
    /// Number of flipped bits.
    pub corrected: u8,
    /// Upper bound of the correlation of any other identity, rotation or phase.
    pub rival: f32,
}

/// The likeliest identity; `None` if there is none near the likeliest word.
pub(crate) fn decode(
    profile: &Profile,
    dictionary: &Dictionary,
    own_distances: &[u8],
) -> Option<DecodedWord> {
    let bits = usize::from(dictionary.layout().bits);
    let per_slot = profile.len / (2 * bits);
    let differences = differences(profile, per_slot);
    let scores = |phase: usize| -> f32 {
        (0..bits).map(|bit| differences[phase + 2 * per_slot * bit].abs()).sum()
    };
    let mut by_phase = [0.0f32; MAX_SAMPLES];
    let by_phase = &mut by_phase[..2 * per_slot];
    for (phase, score) in by_phase.iter_mut().enumerate() {
        *score = scores(phase);
    }
    let (phase, &total) = by_phase.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let mut evidence = [0.0f32; MAX_BITS];
    for (bit, value) in evidence[..bits].iter_mut().enumerate() {
        *value = differences[phase + 2 * per_slot * bit];
    }
    let mut found = nearest(&evidence[..bits], dictionary)?;
    found.phase = phase;
    found.score += total;
    // Another identity differs in at least this many bits, at best the weakest ones; bits already
    // flipped would be flipped back.
    let number = usize::from(found.code.number);
    let apart = dictionary.layout().min_distance.min(own_distances[number - 1]);
    found.rival = found.score - 2.0 * min_change(&evidence[..bits], found.word, apart);
    let turn = 2 * per_slot;
    for (other, &score) in by_phase.iter().enumerate() {
        let apart = (other + turn - phase) % turn;
        if apart.min(turn - apart) * 2 >= per_slot {
            found.rival = found.rival.max(score);
        }
    }
    Some(found)
}

/// D_j for all samples.
fn differences(profile: &Profile, per_slot: usize) -> [f32; MAX_SAMPLES] {
    let len = profile.len;
    let white = &profile.white[..len];
    let mut differences = [0.0; MAX_SAMPLES];
    // Running sums, one step for each sample.
    let mut first: f32 = white[..per_slot].iter().sum();
    let mut second: f32 = white[per_slot..2 * per_slot].iter().sum();
    for (index, difference) in differences[..len].iter_mut().enumerate() {
        *difference = second - first;
        let wrapped = |index: usize| if index >= len { index - len } else { index };
        let (middle, end) = (white[wrapped(index + per_slot)], wrapped(index + 2 * per_slot));
        first += middle - white[index];
        second += white[end] - middle;
    }
    differences
}

/// The identity that requires the least evidence to be flipped; its score is the cost.
fn nearest(evidence: &[f32], dictionary: &Dictionary) -> Option<DecodedWord> {
    let bits = evidence.len();
    let max = dictionary.layout().min_distance.saturating_sub(1).into();
    let word = evidence.iter().fold(0u16, |word, &d| word << 1 | u16::from(d < 0.0));
    let of = |code, word, shift, cost: f32, corrected| {
        Some(DecodedWord { code, word, shift, phase: 0, score: -2.0 * cost, corrected, rival: 0.0 })
    };
    if let Some((code, shift)) = dictionary.find(word) {
        return of(code, word, shift, 0.0, 0);
    }
    let weakest = weakest(evidence);
    let mut best: Option<(f32, u16, u8)> = None;
    for choice in 1u16..1 << WEAKEST.min(bits) {
        if choice.count_ones() > max {
            continue;
        }
        let (mut cost, mut turned) = (0.0, word);
        for (place, &bit) in weakest.iter().enumerate() {
            if choice >> place & 1 == 1 {
                cost += evidence[bit].abs();
                turned ^= 1 << (bits - 1 - bit);
            }
        }
        let is_cheaper = best.is_none_or(|(min, ..)| cost < min);
        if is_cheaper && dictionary.find(turned).is_some() {
            best = Some((cost, turned, choice.count_ones() as u8));
        }
    }
    let (cost, word, corrected) = best?;
    let (code, shift) = dictionary.find(word)?;
    of(code, word, shift, cost, corrected)
}

/// The bits with the smallest evidence, the weakest first.
fn weakest(evidence: &[f32]) -> [usize; WEAKEST] {
    let mut places = [0; WEAKEST];
    let mut used = 0;
    for bit in 0..evidence.len() {
        let after = places[..used]
            .iter()
            .position(|&other| evidence[bit].abs() < evidence[other].abs())
            .unwrap_or(used);
        if after < WEAKEST {
            used = (used + 1).min(WEAKEST);
            places[after..used].rotate_right(1);
            places[after] = bit;
        }
    }
    places
}

/// Smallest cost of flipping `count` bits of the word, in evidence.
fn min_change(evidence: &[f32], word: u16, count: u8) -> f32 {
    let bits = evidence.len();
    let mut costs = [0.0f32; MAX_BITS];
    for (bit, (cost, &d)) in costs.iter_mut().zip(evidence).enumerate() {
        let is_one = word >> (bits - 1 - bit) & 1 == 1;
        *cost = if is_one { -d } else { d };
    }
    let costs = &mut costs[..bits];
    costs.sort_unstable_by(f32::total_cmp);
    costs[..usize::from(count).min(bits)].iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::code::CodeLayout;

    fn profile(word: u16, bits: usize, per_slot: usize, phase: usize) -> Profile {
        let len = 2 * bits * per_slot;
        let mut profile = Profile { white: [0.0; MAX_SAMPLES], spread: [1.0; MAX_SAMPLES], len };
        for index in 0..len {
            let slot = index / per_slot;
            let is_one = usize::from(word >> (bits - 1 - slot / 2) & 1);
            let white = if slot % 2 == is_one { -1.0 } else { 1.0 };
            profile.white[(index + phase) % len] = white;
        }
        profile
    }

    #[test]
    fn every_identity_is_found_at_every_phase() {
        for (bits, min_distance) in [(2, 1), (3, 1), (4, 2), (5, 1), (8, 2), (12, 3)] {
            let dictionary = CodeLayout { bits, min_distance }.codes().unwrap();
            let own: Vec<u8> = dictionary
                .iter()
                .map(|(code, _)| dictionary.own_distance(code.number).unwrap())
                .collect();
            for (code, word) in dictionary.iter() {
                for phase in 0..8 * usize::from(bits) {
                    let profile = profile(word, bits.into(), 4, phase);
                    let found = decode(&profile, &dictionary, &own).unwrap();
                    assert_eq!((found.code, found.corrected), (code, 0));
                    let zero =
                        (found.phase + profile.len - 8 * usize::from(found.shift)) % profile.len;
                    assert_eq!(zero, phase);
                    assert_eq!(found.score, profile.len as f32);
                    assert!(found.rival < 0.9 * found.score);
                }
            }
        }
    }

    #[test]
    fn a_weak_bit_is_corrected_as_far_as_the_distance_allows() {
        let dictionary = CodeLayout { bits: 12, min_distance: 3 }.codes().unwrap();
        let (code, word) = dictionary.iter().nth(5).unwrap();
        let mut profile = profile(word, 12, 4, 0);
        // The third bit's slots become equal, slightly in favour of the wrong value.
        for (index, white) in profile.white[16..24].iter_mut().enumerate() {
            *white *= if index == 0 { -1.0 } else { -0.1 };
        }
        let own = vec![4; dictionary.len()];
        let found = decode(&profile, &dictionary, &own).unwrap();
        assert_eq!((found.code, found.corrected, found.word), (code, 1, word));
        assert!(found.rival < found.score);
    }

    #[test]
    fn the_weakest_bits_come_first() {
        let evidence = [3.0, -0.5, 2.0, -0.1, 0.3, 9.0];
        assert_eq!(weakest(&evidence), [3, 4, 1, 2]);
    }
}

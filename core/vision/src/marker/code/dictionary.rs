//! The identities of a layout.
//!
//! A word read from a roundel may begin at any bit, so an identity is a necklace: all rotations of a
//! word, named by the smallest. Periodic words are excluded, since their yaw would be ambiguous. The
//! others are taken in ascending order if they have the minimum distance from every rotation
//! of every word taken before, and numbered from 1. This is WhyCode's order, so the numbers agree with its prints.

use crate::marker::code::{
    Code, CodeError,
    layout::{CodeLayout, Tooth},
    necklace::{is_periodic, necklaces, rotated, rotation_distance},
};

/// All identities of a layout, and a lookup table from words to identities.
#[derive(Clone, Debug, PartialEq)]
pub struct Dictionary {
    layout: CodeLayout,
    /// Smallest rotations, by number.
    words: Vec<u16>,
    /// By word: number (0: none), and the number of bits by which the word is rotated to the left.
    table: Vec<(u16, u8)>,
}

impl CodeLayout {
    /// All identities of this layout.
    pub fn codes(&self) -> Result<Dictionary, CodeError> {
        self.check()?;
        Ok(Dictionary::new(*self))
    }
}

impl Dictionary {
    /// The layout must have passed its check.
    fn new(layout: CodeLayout) -> Self {
        let bits = layout.bits;
        let mut near = Excluded::new(bits, layout.min_distance);
        let mut words = Vec::new();
        let mut table = vec![(0, 0); 1 << bits];
        for word in necklaces(bits).filter(|&word| !is_periodic(word, bits)) {
            if near.contains(word) {
                continue;
            }
            words.push(word);
            for shift in 0..bits {
                let turned = rotated(word, shift, bits);
                table[usize::from(turned)] = (words.len() as u16, shift);
                near.exclude_round(turned);
            }
        }
        Self { layout, words, table }
    }

    /// The layout of its codes.
    pub fn layout(&self) -> CodeLayout {
        self.layout
    }

    /// Number of identities, which are numbered from 1 to this.
    pub fn len(&self) -> usize {
        self.words.len()
    }

    /// Whether there are no identities; never for a valid layout.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// All identities with their words as printed, the first bit the most significant.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (Code, u16)> + '_ {
        let bits = self.layout.bits;
        let code = move |index| Code { bits, number: index as u16 + 1 };
        self.words.iter().enumerate().map(move |(index, &word)| (code(index), word))
    }

    /// The word of an identity as printed; `None` if the number is unknown.
    pub fn word(&self, number: u16) -> Option<u16> {
        self.words.get(usize::from(number).checked_sub(1)?).copied()
    }

    /// The teeth of an identity as printed; `None` if the number is unknown.
    pub fn teeth(&self, number: u16) -> Option<Vec<Tooth>> {
        Some(self.layout.teeth(self.word(number)?))
    }

    /// The identity of a word, and the number of leading bits of the identity's word that were
    /// moved to its end.
    pub fn find(&self, word: u16) -> Option<(Code, u8)> {
        let &(number, shift) = self.table.get(usize::from(word))?;
        (number > 0).then_some((Code { bits: self.layout.bits, number }, shift))
    }

    /// Smallest Hamming distance of an identity to any other, over all rotations; `None` if the
    /// number is unknown, or there is no other.
    pub fn distance(&self, number: u16) -> Option<u8> {
        let word = self.word(number)?;
        let others = self.words.iter().filter(|&&other| other != word);
        others.map(|&other| rotation_distance(word, other, self.layout.bits)).min()
    }

    /// Smallest Hamming distance of an identity to its own rotations: the bit errors that give a
    /// wrong yaw. `None` if the number is unknown.
    pub fn own_distance(&self, number: u16) -> Option<u8> {
        let (word, bits) = (self.word(number)?, self.layout.bits);
        (1..bits).map(|shift| (word ^ rotated(word, shift, bits)).count_ones() as u8).min()
    }
}

/// Words too close to an identity.
struct Excluded {
    is_near: Vec<bool>,
    /// Words with fewer ones than the minimum distance.
    ball: Vec<u16>,
}

impl Excluded {
    fn new(bits: u8, min_distance: u8) -> Self {
        let last = ((1u32 << bits) - 1) as u16;
        let near = |word: &u16| word.count_ones() < u32::from(min_distance);
        Self { is_near: vec![false; 1 << bits], ball: (0..=last).filter(near).collect() }
    }

    fn contains(&self, word: u16) -> bool {
        self.is_near[usize::from(word)]
    }

    fn exclude_round(&mut self, word: u16) {
        for difference in &self.ball {
            self.is_near[usize::from(word ^ difference)] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn codes(bits: u8, min_distance: u8) -> Result<Dictionary, CodeError> {
        CodeLayout { bits, min_distance }.codes()
    }

    #[test]
    fn numbers_are_those_of_existing_prints() {
        let words = |bits, distance| codes(bits, distance).unwrap().words;
        assert_eq!(words(5, 1), [1, 3, 5, 7, 11, 15]);
        assert_eq!(words(7, 2), [1, 7, 11, 13, 19, 21, 31, 47, 55]);
    }

    #[test]
    fn every_rotation_of_a_word_finds_its_identity() {
        let dictionary = codes(10, 2).unwrap();
        for (code, word) in dictionary.iter() {
            for shift in 0..10 {
                let turned = rotated(word, shift, 10);
                assert_eq!(dictionary.find(turned), Some((code, shift)));
            }
        }
        let named = (0..1u16 << 10).filter(|&word| dictionary.find(word).is_some()).count();
        assert_eq!(named, 10 * dictionary.len());
        assert_eq!(dictionary.find(u16::MAX), None);
        assert_eq!((dictionary.word(0), dictionary.word(9_999)), (None, None));
    }

    #[test]
    fn distances_hold_and_no_further_code_would_fit() {
        for (bits, min_distance) in [(8, 1), (8, 2), (9, 3), (11, 4)] {
            let dictionary = codes(bits, min_distance).unwrap();
            let min = (1..=dictionary.len() as u16).map(|n| dictionary.distance(n).unwrap());
            assert!(min.min().unwrap() >= min_distance, "{bits} {min_distance}");
            for word in necklaces(bits).filter(|&word| !is_periodic(word, bits)) {
                let near = |&other: &u16| rotation_distance(word, other, bits) < min_distance;
                let taken = dictionary.words.contains(&word);
                assert!(taken || dictionary.words.iter().any(near), "{bits} {min_distance} {word}");
            }
        }
    }

    #[test]
    fn sizes_are_known() {
        // Aperiodic necklaces of N bits: (1/N) Σ μ(d) 2^(N/d) over the divisors d of N.
        for (bits, count) in
            [(2, 1), (3, 2), (4, 3), (5, 6), (6, 9), (7, 18), (8, 30), (12, 335), (16, 4080)]
        {
            assert_eq!(codes(bits, 1).unwrap().len(), count);
        }
    }

    #[test]
    fn an_own_rotation_differs_by_an_even_number_of_bits() {
        let dictionary = codes(8, 2).unwrap();
        for (code, _) in dictionary.iter() {
            let own = dictionary.own_distance(code.number).unwrap();
            assert!(own >= 2 && own.is_multiple_of(2));
        }
        assert_eq!(dictionary.own_distance(0), None);
    }
}

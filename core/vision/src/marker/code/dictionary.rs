//! The identities of a layout.
//!
//! A word read from a roundel may begin at any bit, so an identity is a necklace: all rotations of a
//! word, named by the smallest. Periodic words are none, since their yaw would be ambiguous. Of the
//! others, in rising order, each is taken that is at the least distance or further from every rotation
//! of every one before, and numbered from 1; this is WhyCode's order, so numbers agree with its prints.

use crate::marker::code::{
    Code, CodeError,
    layout::{CodeLayout, Tooth},
    necklace::{is_periodic, necklaces, rotated, rotation_distance},
};

/// All identities of a layout, and a table from words to identities.
#[derive(Clone, Debug, PartialEq)]
pub struct Dictionary {
    layout: CodeLayout,
    /// Smallest rotations, by number.
    words: Vec<u16>,
    /// By word: number (0: none), and how many bits the word is rotated to the left.
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
    /// The identities of a layout that has passed its check.
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

    /// How its codes are printed.
    pub fn layout(&self) -> CodeLayout {
        self.layout
    }

    /// How many identities there are; they are numbered from 1 to this.
    pub fn len(&self) -> usize {
        self.words.len()
    }

    /// Whether there is no identity; never, for a valid layout.
    pub fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// All identities with their words as printed, the first bit the most significant.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (Code, u16)> + '_ {
        let bits = self.layout.bits;
        let code = move |index| Code { bits, number: index as u16 + 1 };
        self.words.iter().enumerate().map(move |(index, &word)| (code(index), word))
    }

    /// The word of an identity as printed; `None` if there is none of that number.
    pub fn word(&self, number: u16) -> Option<u16> {
        self.words.get(usize::from(number).checked_sub(1)?).copied()
    }

    /// The teeth of an identity as printed; `None` if there is none of that number.
    pub fn teeth(&self, number: u16) -> Option<Vec<Tooth>> {
        Some(self.layout.teeth(self.word(number)?))
    }

    /// The identity whose word, its first `shift` bits moved to the end, is `word`.
    pub fn find(&self, word: u16) -> Option<(Code, u8)> {
        let &(number, shift) = self.table.get(usize::from(word))?;
        (number > 0).then_some((Code { bits: self.layout.bits, number }, shift))
    }

    /// Least Hamming distance of an identity to any other, over all rotations; `None` if there is none
    /// of that number, or no other.
    pub fn distance(&self, number: u16) -> Option<u8> {
        let word = self.word(number)?;
        let others = self.words.iter().filter(|&&other| other != word);
        others.map(|&other| rotation_distance(word, other, self.layout.bits)).min()
    }

    /// Bits in which an identity differs from its own rotations, at least: what a wrong yaw costs.
    /// `None` if there is none of that number.
    pub fn own_distance(&self, number: u16) -> Option<u8> {
        let (word, bits) = (self.word(number)?, self.layout.bits);
        (1..bits).map(|shift| (word ^ rotated(word, shift, bits)).count_ones() as u8).min()
    }
}

/// Words that are too near to an identity.
struct Excluded {
    is_near: Vec<bool>,
    /// Words with fewer ones than the least distance.
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
    fn every_word_of_an_identity_leads_back_to_it() {
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
        for (bits, count) in [(5, 6), (6, 9), (7, 18), (8, 30), (12, 335), (16, 4080)] {
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

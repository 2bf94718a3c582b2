//! Where the teeth of a code are printed.
//!
//! In units of the print: a black disc of radius 700, a white disc of 420 in it, black teeth that
//! extend from its rim down to a white core of 240. A code of N bits has 2N slots of π/N each, counted
//! counter-clockwise from the print's right; each bit has two of them, the most significant bit first,
//! and one tooth: in the first slot if it is 0, in the second if it is 1. So every code has as much
//! black as white, and no tooth is wider than two slots.

use std::f64::consts::PI;

use thiserror::Error;

use crate::marker::code::necklace::max_distance;

/// Layout of a coded kind: WhyCode's Manchester code of `bits` bits, whose rotation-minimal words
/// are the identities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CodeLayout {
    /// Bits, 2 to 16; twice as many slots.
    pub bits: u8,
    /// Smallest Hamming distance of any two identities, over all rotations; 1 or more.
    pub min_distance: u8,
}

/// Why a layout is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum CodeError {
    /// Too few bits to distinguish codes, or too many for a print.
    #[error(
        "expected codes of {} to {} bits, found {found}",
        CodeLayout::BITS.0,
        CodeLayout::BITS.1
    )]
    Bits {
        /// Requested bits.
        found: u8,
    },
    /// No two codes have this distance.
    #[error("expected a Hamming distance of 1 to {max} for codes of {bits} bits, found {found}")]
    Distance {
        /// The code's bits.
        bits: u8,
        /// Requested distance.
        found: u8,
        /// The largest distance with at least two identities, or 1.
        max: u8,
    },
}

/// A tooth as printed: angles counter-clockwise from the print's right, radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tooth {
    /// Where it begins, 0 or more.
    pub from_rad: f64,
    /// Where it ends, up to 2π.
    pub to_rad: f64,
}

impl CodeLayout {
    /// Smallest and largest number of bits. 2 bits have one identity, 3 bits two; a code of one bit has no rotation that
    /// differs from the other code.
    pub const BITS: (u8, u8) = (2, 16);
    /// Inner over outer diameter of a print.
    pub const RATIO: f64 = 420.0 / 700.0;
    /// Radius of the white core over that of the white disc between the teeth.
    pub const CORE_SHARE: f64 = 240.0 / 420.0;

    /// Whether there are such codes.
    pub fn check(&self) -> Result<(), CodeError> {
        let Self { bits, min_distance } = *self;
        if bits < Self::BITS.0 || bits > Self::BITS.1 {
            return Err(CodeError::Bits { found: bits });
        }
        let max = max_distance(bits);
        if min_distance == 0 || min_distance > max {
            return Err(CodeError::Distance { bits, found: min_distance, max });
        }
        Ok(())
    }

    /// The teeth of a word of this layout, in order; adjacent ones are merged.
    pub fn teeth(&self, word: u16) -> Vec<Tooth> {
        let bits = u32::from(self.bits);
        let slot_rad = PI / f64::from(bits);
        let mut teeth: Vec<Tooth> = Vec::with_capacity(bits as usize);
        for bit in 0..bits {
            let is_one = word >> (bits - 1 - bit) & 1;
            let slot = 2 * bit + u32::from(is_one);
            let from_rad = f64::from(slot) * slot_rad;
            let to_rad = f64::from(slot + 1) * slot_rad;
            match teeth.last_mut() {
                Some(last) if last.to_rad == from_rad => last.to_rad = to_rad,
                _ => teeth.push(Tooth { from_rad, to_rad }),
            }
        }
        teeth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layout(bits: u8, min_distance: u8) -> CodeLayout {
        CodeLayout { bits, min_distance }
    }

    #[test]
    fn half_of_the_annulus_is_teeth() {
        for bits in 2..=16 {
            let word = 0b1011_0111_0010_1101 >> (16 - bits);
            let teeth = layout(bits, 1).teeth(word);
            let black: f64 = teeth.iter().map(|tooth| tooth.to_rad - tooth.from_rad).sum();
            assert!((black - PI).abs() < 1e-12);
            assert!(teeth.windows(2).all(|pair| pair[0].to_rad < pair[1].from_rad));
        }
    }

    #[test]
    fn teeth_follow_the_bits() {
        // 00001: four teeth in first slots, the last in the tenth slot.
        let teeth = layout(5, 1).teeth(1);
        let slots: Vec<_> =
            teeth.iter().map(|tooth| (tooth.from_rad * 5.0 / PI).round() as u32).collect();
        assert_eq!(slots, [0, 2, 4, 6, 9]);
        // 10000: the first bit's tooth touches the second's.
        let teeth = layout(5, 1).teeth(16);
        assert_eq!(teeth.len(), 4);
        assert!((teeth[0].to_rad - 0.6 * PI).abs() < 1e-12);
    }

    #[test]
    fn errors_of_invalid_layouts_name_the_limits() {
        assert_eq!(layout(1, 1).check(), Err(CodeError::Bits { found: 1 }));
        assert_eq!(
            layout(17, 1).check().unwrap_err().to_string(),
            "expected codes of 2 to 16 bits, found 17"
        );
        for bits in 2..=16 {
            let Err(CodeError::Distance { max, .. }) = layout(bits, 200).check() else {
                panic!("{bits} bits at a distance of 200");
            };
            let least = if bits == 2 { 1 } else { 2 };
            assert!(layout(bits, max).codes().unwrap().len() >= least);
            assert!(layout(bits, max + 1).codes().is_err());
            assert!(layout(bits, 0).codes().is_err());
        }
    }
}

//! Identities in the teeth round a coded roundel's disc.

use crate::camera::PixelPoint;

/// How codes of a kind are printed: WhyCode's Manchester code of `bits` bits, whose rotation-minimal
/// numbers are the identities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CodeLayout {
    /// Bits, 5 to 16; twice as many slots.
    pub bits: u8,
    /// Least Hamming distance of any two identities, over all rotations; 1 or more.
    pub min_distance: u8,
}

/// An identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Code {
    /// Bits of its layout.
    pub bits: u8,
    /// Its number, counted from 1 in the order of the smallest rotations.
    pub number: u16,
}

/// What the teeth of one roundel in one frame say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CodeReading {
    /// The identity.
    pub code: Code,
    /// Where the print's x axis leaves the white disc, raw pixels: the code's zero.
    pub zero: PixelPoint,
    /// Likelihood of this reading against all others, 0 to 1.
    pub confidence: f64,
    /// Bits that were corrected.
    pub corrected: u8,
}

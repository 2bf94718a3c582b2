//! Identities in the teeth around a coded roundel's disc, as printed by WhyCode.
//!
//! | module | content |
//! | --- | --- |
//! | `layout` | where teeth are printed |
//! | `necklace` | words up to rotation |
//! | `dictionary` | which words are identities |
//! | `vote` | the identity of a track, from the readings of its frames |
//!
//! [`crate::marker::CodeReader`] reads them.

mod dictionary;
mod layout;
mod necklace;
mod vote;

pub use dictionary::Dictionary;
pub use layout::{CodeError, CodeLayout, Tooth};
pub(crate) use vote::Vote;
pub use vote::VotedCode;

use crate::camera::PixelPoint;

/// An identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Code {
    /// Bits of its layout.
    pub bits: u8,
    /// Its number, from 1 in the order of the smallest rotations.
    pub number: u16,
}

/// The decoded teeth of one roundel in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CodeReading {
    /// The identity.
    pub code: Code,
    /// Its word as printed, the first bit the most significant; `None` if the teeth were not seen.
    pub word: Option<u16>,
    /// Where the print's x axis leaves the white disc, raw pixels: the code's zero.
    pub zero: PixelPoint,
    /// The point opposite of it: an error of the centre turns the two by opposite angles.
    pub opposite: PixelPoint,
    /// Standard deviation of the angle about the normal, radians.
    pub yaw_deviation_rad: f64,
    /// Likelihood of this reading against all others, 0 to 1.
    pub confidence: f64,
    /// Number of corrected bits.
    pub corrected: u8,
}

impl CodeReading {
    /// A reading with certainty, its opposite unknown.
    pub fn certain(code: Code, zero: PixelPoint) -> Self {
        Self {
            code,
            word: None,
            zero,
            opposite: zero,
            yaw_deviation_rad: 0.0,
            confidence: 1.0,
            corrected: 0,
        }
    }
}

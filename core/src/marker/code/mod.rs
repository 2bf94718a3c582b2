//! Identities and yaw in the teeth round a coded roundel's disc, as WhyCode prints them.
//!
//! | what | module |
//! | --- | --- |
//! | where teeth are printed | `layout` |
//! | which words are identities | `dictionary` |

mod dictionary;
mod layout;

pub use dictionary::Dictionary;
pub use layout::{CodeError, CodeLayout, Tooth};

use crate::camera::PixelPoint;

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

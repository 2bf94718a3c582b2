//! Identities and yaw in the teeth round a coded roundel's disc, as WhyCode prints them.
//!
//! | what | module |
//! | --- | --- |
//! | where teeth are printed | `layout` |
//! | which words are identities | `dictionary` |
//! | from a roundel's plane to the image | `chart` |
//! | grey levels round the teeth | `profile` |
//! | from them to a word | `word` |
//! | a reading, with its confidence and its zero | `reader` |
//! | a track's readings together | `vote` |
//! | grey levels between pixels | `light` |
//! | a coded roundel's outline and rims | `spoke`, `contour`, `points`, `gaps`, `measure` |

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
    /// Its number, counted from 1 in the order of the smallest rotations.
    pub number: u16,
}

/// What the teeth of one roundel in one frame say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CodeReading {
    /// The identity.
    pub code: Code,
    /// Its word as printed, the first bit the most significant; `None` where the teeth were not seen.
    pub word: Option<u16>,
    /// Where the print's x axis leaves the white disc, raw pixels: the code's zero.
    pub zero: PixelPoint,
    /// Where its opposite does: an error of the centre turns the two by opposite angles.
    pub opposite: PixelPoint,
    /// Standard deviation of the angle about the normal, radians.
    pub yaw_deviation_rad: f64,
    /// Likelihood of this reading against all others, 0 to 1.
    pub confidence: f64,
    /// Bits that were corrected.
    pub corrected: u8,
}

impl CodeReading {
    /// A reading beyond doubt, its opposite unknown.
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

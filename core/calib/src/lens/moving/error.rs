//! Errors of the calibration from moving roundels.

use std::fmt;

use thiserror::Error;

use super::{MIN_PLACES, MIN_SIGHTINGS};
use crate::lens::{list, views::coverage::zone_name};

/// An observation that would help.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Missing {
    /// Roundels in this zone of the picture: 0 to 2 from the left, and from the top.
    Zone(usize, usize),
    /// Roundels at other distances from the camera.
    Depth {
        /// Largest over smallest distance.
        ratio: f64,
    },
}

impl fmt::Display for Missing {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Zone(column, row) => write!(out, "roundels {}", zone_name(column, row)),
            Self::Depth { ratio } => write!(
                out,
                "roundels nearer to the camera or farther from it: their distances differ by {:.0} %, and a longer \
                 lens from farther away sees nearly the same (raise some, or have the camera look at a slant)",
                100.0 * (ratio - 1.0)
            ),
        }
    }
}

/// Why a calibration from moving roundels failed.
#[derive(Clone, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum MovingLensError {
    /// Size of the picture out of range.
    #[error("expected pictures of 16 to 16384 pixels a side, found {width} x {height}")]
    Size { width: usize, height: usize },
    /// Too few usable observations, or too few distinct image positions, at least a fiftieth of the picture's diagonal
    /// apart.
    #[error(
        "expected at least {MIN_SIGHTINGS} sightings in {MIN_PLACES} places of the picture of coded roundels that other \
         cameras saw at the same time, found {found} in {places}; record for longer, with robots that drive all over what \
         this camera sees{}", also(.missing)
    )]
    TooFew { found: usize, places: usize, missing: Vec<Missing> },
    /// No camera fits more than `agreeing` of the usable observations.
    #[error(
        "no lens explains what the camera saw: {agreeing} of {found} sightings agree with one; are the other cameras \
         calibrated (`roundel calibrate arena`), did this one stand still, and is each code there only once?"
    )]
    Unexplained { found: usize, agreeing: usize },
    /// The observations do not determine the focal length: its relative standard deviation, and what would help most.
    #[error(
        "the roundels do not determine the focal length: it is known to {:.1} % only; still missing: {}",
        100.0 * .deviation, list(.missing)
    )]
    Undetermined { deviation: f64, missing: Vec<Missing> },
}

fn also(missing: &[Missing]) -> String {
    if missing.is_empty() { String::new() } else { format!("; missing: {}", list(missing)) }
}

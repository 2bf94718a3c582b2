//! Why moving roundels tell no lens, and what would help.

use std::fmt;

use thiserror::Error;

use super::{LEAST_PLACES, LEAST_SIGHTINGS};

/// What would help.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Missing {
    /// Roundels in this zone of the picture: 0 to 2 from the left, and from the top.
    Zone(usize, usize),
    /// Roundels at other distances from the camera.
    Depth {
        /// The farthest ones' over the nearest ones'.
        ratio: f64,
    },
}

impl fmt::Display for Missing {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Zone(column, row) => {
                let across = ["left", "middle", "right"][column.min(2)];
                let down = ["top", "middle", "bottom"][row.min(2)];
                match (down, across) {
                    ("middle", "middle") => write!(out, "roundels in the middle of the picture"),
                    ("middle", side) | (side, "middle") => {
                        write!(out, "roundels at the {side} edge of the picture")
                    }
                    _ => write!(out, "roundels in the {down} {across} corner of the picture"),
                }
            }
            Self::Depth { ratio } => write!(
                out,
                "roundels nearer to the camera or farther from it: their distances differ by {:.0} %, and a longer \
                 lens from farther away sees nearly the same (raise some, or have the camera look at a slant)",
                100.0 * (ratio - 1.0)
            ),
        }
    }
}

/// Why there is no lens.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MovingLensError {
    /// The picture has no such size.
    #[error("expected pictures of 16 to 16384 pixels a side, found {width} x {height}")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Not enough to tell anything.
    #[error(
        "expected at least {LEAST_SIGHTINGS} sightings in {LEAST_PLACES} places of the picture of coded roundels that other \
         cameras saw at the same time, found {found} in {places}; record for longer, with robots that drive all over what \
         this camera sees{}", also(.missing)
    )]
    TooFew {
        /// Sightings that could be used.
        found: usize,
        /// Places of the picture, apart by a fiftieth of its diagonal or more.
        places: usize,
        /// What would help.
        missing: Vec<Missing>,
    },
    /// No camera sees what was seen.
    #[error(
        "no lens explains what the camera saw: {agreeing} of {found} sightings agree with one; are the other cameras \
         calibrated (`roundel calibrate arena`), did this one stand still, and is each code there only once?"
    )]
    Unexplained {
        /// Sightings that could be used.
        found: usize,
        /// Of these, those that the best lens explains.
        agreeing: usize,
    },
    /// The focal length is not told.
    #[error(
        "the roundels do not tell the focal length: it is known to {:.1} % only; still missing: {}",
        100.0 * .deviation, list(.missing)
    )]
    Undetermined {
        /// Relative deviation of the focal length.
        deviation: f64,
        /// What would help most.
        missing: Vec<Missing>,
    },
}

fn list(missing: &[Missing]) -> String {
    missing.iter().map(Missing::to_string).collect::<Vec<_>>().join("; ")
}

fn also(missing: &[Missing]) -> String {
    if missing.is_empty() { String::new() } else { format!("; missing: {}", list(missing)) }
}

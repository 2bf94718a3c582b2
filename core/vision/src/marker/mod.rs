//! Rings found in a frame, and followed from frame to frame.
//!
//! | step | module | paper |
//! | --- | --- | --- |
//! | rows with black, white, black | `edge`, `scan` | 3.1, 3.6 |
//! | chords through the centre | `cross`, `chord` | 3.1 |
//! | threshold at each place | `threshold` | 3.2, eq. (3) |
//! | one ring, wherever it is thought to be | `measure` | 3.1, 3.3 |
//! | its pixels as words of bits | `patch` | 3.2 |
//! | disc and black, followed by runs | `segments`, `spans` | 3.1, algorithm 1 |
//! | the pixels near its rims | `band`, `levels` | – |
//! | the same of a ring that is followed | `follow`, `oval` | – |
//! | several of these, side by side | `abreast` | – |
//! | rims to a fraction of a pixel | `weigh`, `blur`, `normal` | eqs. (4), (6) |
//! | areas, roundness, shapes | `examine`, `outline` | 3.1, 3.3, eqs. (1), (2), (5) |
//! | kind by ratio of diameters | `kind` | 3.4 |
//! | elliptical discs, by their axes | `elliptical` | 7.2, 7.4 |
//! | rims that are ellipses, a disc white to its middle, no letter | `harmonic`, `middle`, `stroke` | – |
//! | compensation of the rims | [`rim`] | 3.5, eqs. (7), (8) |
//! | all rings of a frame | `detector` | 3.6 |
//! | from frame to frame | `tracker` | 3, 3.6 |
//!
//! ```
//! use roundel_vision::{frame::Frame, marker::{Detector, Kind, Params, Scratch, Tracker}};
//!
//! let kind = Kind::plain("robot", 0.16, 0.064);
//! let detector = Detector::new(vec![kind], Params::default())?;
//! let pixels = vec![200u8; 640 * 480];
//! let frame = Frame::new(&pixels, 640, 480, 640)?;
//! assert!(detector.detect(&frame, &mut Scratch::default()).is_empty());
//!
//! let mut tracker = Tracker::new(detector);
//! for tracked in tracker.process(&frame) {
//!     println!("{}: {:?}", tracked.track, tracked.ring.outer.center);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod batch;
mod classify;
mod code;
mod coded;
mod detector;
mod kind;
mod mask;
mod params;
mod reject;
mod ring;
mod search;
mod track;
mod validate;

pub use classify::compensation::{compensated, rim_shift_px};
pub use code::{Code, CodeError, CodeLayout, CodeReading, Dictionary, Tooth, VotedCode};
pub use coded::reader::CodeReader;
pub use detector::{Detector, Scratch};
pub use kind::{
    AXIS_RATIO_LIMIT, Kind, Pattern, Polarity, RATIO_LIMITS, is_measurable, shows_heading,
};
pub use mask::{Mask, MaskError};
pub use params::{DetectorError, Mode, Params};
pub use reject::{MAX_REJECTED, Reject, RejectCounts, Rejected};
pub use ring::pixels::edge_band::WIDE_PX;
pub use search::threshold::BinarySearch;
pub use track::Tracker;

use crate::{
    ellipse::Ellipse,
    id::{KindId, TrackNumber},
};

/// One roundel as imaged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Black ring's outer rim.
    pub outer: Ellipse,
    /// White disc's rim.
    pub inner: Ellipse,
    /// The kind whose ratio of diameters it has; `None` if no kinds are configured.
    pub kind: Option<KindId>,
    /// Grey level that parted black from white; the next frame's start.
    pub threshold: u8,
    /// Grey level of the black ring.
    pub black: f64,
    /// Mean grey level of the white disc.
    pub white: f64,
    /// How far the grey levels along the outer rim stray from those of a whole rim: rms, as a share
    /// of the contrast. Noise alone gives two thirds of its own share; a cover gives more.
    pub unevenness: f64,
    /// Which of ring and disc is black.
    pub polarity: Polarity,
    /// What the teeth say; `None` if there are none, or they cannot be read.
    pub code: Option<CodeReading>,
}

impl Ring {
    /// A whole ring, black 20 on white 220, of no known kind.
    pub fn of_rims(outer: Ellipse, inner: Ellipse) -> Self {
        Self {
            outer,
            inner,
            kind: None,
            threshold: 120,
            black: 20.0,
            white: 220.0,
            unevenness: 0.0,
            polarity: Polarity::BlackRing,
            code: None,
        }
    }

    /// What was measured of a black ring in a picture with its levels turned over, if that was done.
    #[inline(always)]
    fn with_polarity(self, polarity: Polarity) -> Self {
        match polarity {
            Polarity::BlackRing => self,
            Polarity::WhiteRing => Self {
                threshold: 0u8.wrapping_sub(self.threshold),
                black: 255.0 - self.white,
                white: 255.0 - self.black,
                polarity: Polarity::WhiteRing,
                ..self
            },
        }
    }
}

/// A ring with the number of the track that it continues or begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedRing {
    /// This tracker's number for the roundel.
    pub track: TrackNumber,
    /// Where it is now.
    pub ring: Ring,
    /// What all frames of the track say of its code; `None` if none was read yet.
    pub code: Option<VotedCode>,
}

//! Detection of rings in a frame, and tracking from frame to frame.
//!
//! | stage | module | paper |
//! | --- | --- | --- |
//! | candidates: rows with black, white, black; chords through the centre; local threshold | `search` | 3.1, 3.2, 3.6, eq. (3) |
//! | one ring: its pixels, tests, both rims to a fraction of a pixel | `ring` | 3.1 to 3.3, algorithms 1 and 2, eqs. (1) to (6) |
//! | outer rim where the paper ends close to it | `paper_edge` | – |
//! | several tracked rings at once, one per vector lane | `batch` | – |
//! | kind by the ratio of diameters, compensation of the rims | `classify` | 3.4, 3.5, 7.2, eqs. (7), (8) |
//! | further tests of new rings: rims are ellipses, disc white to its centre, not a letter | `validate` | – |
//! | identities: layouts, dictionaries, votes of a track | `code` | – |
//! | rings with teeth: rims, code, yaw | `coded` | – |
//! | all rings of a frame | `detector` | 3.6 |
//! | from frame to frame | `track` | 3, 3.6 |
//!
//! `kind`, `params`, `mask` and `reject` hold the types that describe roundels, limits, masked regions and rejected
//! candidates. The order of imports is: `reject`, `mask`, `code`, `kind`, `params`, `classify`, `paper_edge`, `ring`, then `search`,
//! `validate`, `batch` and `coded`, then `detector`, `track`.
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
mod paper_edge;
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
pub(crate) use paper_edge::{CODED_SHARE, PaperEdge};
pub use params::{DetectorError, Mode, Params};
pub use reject::{MAX_REJECTED, Reject, RejectCounts, Rejected};
pub use ring::pixels::edge_band::WIDE_PX;
pub use track::Tracker;

use crate::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{KindId, TrackNumber},
};

/// One roundel as imaged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Outer rim of the ring.
    pub outer: Ellipse,
    /// Rim of the disc.
    pub inner: Ellipse,
    /// The kind with this ratio of diameters; `None` if no kinds are configured.
    pub kind: Option<KindId>,
    /// Grey level that separates black from white; the initial threshold in the next frame.
    pub threshold: u8,
    /// Grey level of black.
    pub black: f64,
    /// Mean grey level of white.
    pub white: f64,
    /// Deviation of the grey levels along the outer rim from their mean: rms, as a share of the
    /// contrast. Noise alone gives two thirds of its own share; partial cover gives more.
    pub unevenness: f64,
    /// Error of both rims where the edge of a shadow crosses them, pixels: of each harmonic, after the light was evened
    /// out. 0 in even light.
    pub shadow_px: f64,
    /// Error of the outer rim where the white margin is hardly wider than the blur, pixels: of each harmonic. 0 with a wide
    /// margin.
    pub margin_px: f64,
    /// Compensation of both rims for the kind's ratio of diameters: how far the outer rim was moved
    /// outwards and that of the disc inwards, pixels. The rims as they appear follow from it.
    pub shift_px: f64,
    /// Which of ring and disc is black.
    pub polarity: Polarity,
    /// The decoded teeth; `None` for a ring without teeth or with unreadable ones.
    pub code: Option<CodeReading>,
}

impl Ring {
    /// A complete ring, black 20 on white 220, of unknown kind.
    pub fn of_rims(outer: Ellipse, inner: Ellipse) -> Self {
        Self {
            outer,
            inner,
            kind: None,
            threshold: 120,
            black: 20.0,
            white: 220.0,
            unevenness: 0.0,
            shadow_px: 0.0,
            margin_px: 0.0,
            shift_px: 0.0,
            polarity: Polarity::BlackRing,
            code: None,
        }
    }

    /// Moved by `du` and `dv`.
    fn moved(mut self, du: f64, dv: f64) -> Self {
        let move_point = |point: &mut PixelPoint| {
            point.u += du;
            point.v += dv;
        };
        move_point(&mut self.outer.center);
        move_point(&mut self.inner.center);
        if let Some(code) = &mut self.code {
            move_point(&mut code.zero);
            move_point(&mut code.opposite);
        }
        self
    }

    /// Undoes the inversion of grey levels under which a white ring is measured as a black one.
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

/// A ring with the number of its track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedRing {
    /// The tracker's number for the roundel.
    pub track: TrackNumber,
    /// The ring in the newest frame.
    pub ring: Ring,
    /// The code by the vote of all frames of the track; `None` before the first reading.
    pub code: Option<VotedCode>,
}

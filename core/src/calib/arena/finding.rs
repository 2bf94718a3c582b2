//! What a person should know of a calibration: each finding says which camera or reference is meant and what
//! to do. Indices count from 0 in the order given; the server says names instead.

use std::fmt;

use thiserror::Error;

use crate::{
    id::{CameraId, KindId},
    marker::Code,
};

/// Something that a person should know.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Finding {
    /// A camera saw no roundel.
    #[error("camera {} saw no roundel of known identity in {frames} frames: check its picture, its lens file and the roundels' sizes", camera.0)]
    Unseen {
        /// Which.
        camera: CameraId,
        /// Frames that it gave.
        frames: u64,
    },
    /// A camera shares roundels with none that is placed.
    #[error("camera {} saw no roundel together with any placed camera, so its place is unknown: let robots drive where its view overlaps another's", camera.0)]
    Apart {
        /// Which.
        camera: CameraId,
    },
    /// What a camera shares with others moved too little.
    #[error("camera {} and camera {} shared roundels within {:.2} m only, so how they stand to one another is unknown: let robots drive across the whole overlap", camera.0, other.0, spread_m)]
    TooLittleMotion {
        /// Which.
        camera: CameraId,
        /// The one that it shares most with.
        other: CameraId,
        /// Spread across two directions, rms, metres.
        spread_m: f64,
    },
    /// A reference stands elsewhere than was said.
    #[error("reference {reference} appears {:.1} mm from where it was said to be, seen from camera {}; it was left out: measure it again", off_m * 1e3, camera.0)]
    Misplaced {
        /// In the order given, from 0.
        reference: usize,
        /// Which camera sees it.
        camera: CameraId,
        /// By how much, metres.
        off_m: f64,
    },
    /// A reference was moved meanwhile.
    #[error("reference {reference} moved by {:.1} mm while camera {} watched; it was left out: fix it and record again", moved_m * 1e3, camera.0)]
    Moved {
        /// In the order given, from 0.
        reference: usize,
        /// Which camera saw it.
        camera: CameraId,
        /// By how much, metres.
        moved_m: f64,
    },
    /// No camera saw a reference.
    #[error("reference {reference} was seen by no camera: check its place and its code")]
    ReferenceUnseen {
        /// In the order given, from 0.
        reference: usize,
    },
    /// A camera saw two roundels of one code at once.
    #[error("camera {} saw code {} of kind {} in two places at once, so it was left out: print each code once", camera.0, code.number, kind.0)]
    Twice {
        /// Which.
        camera: CameraId,
        /// Of the roundels.
        kind: KindId,
        /// Of both.
        code: Code,
    },
    /// A camera saw a roundel where no other did.
    #[error("camera {} saw code {} of kind {} elsewhere than others did in {:.0} % of {sightings} sightings: look for two roundels with this code", camera.0, code.number, kind.0, share * 100.0)]
    Elsewhere {
        /// Which.
        camera: CameraId,
        /// Of the roundel.
        kind: KindId,
        /// Of the roundel.
        code: Code,
        /// Of how many.
        sightings: usize,
        /// Share that is off.
        share: f64,
    },
    /// A camera's errors are larger than detections can be.
    #[error("camera {}: errors are {ratio:.1} times what its detections state ({rms_px:.2} px): its lens file or the roundels' diameters may be wrong", camera.0)]
    Doubtful {
        /// Which.
        camera: CameraId,
        /// Errors over stated deviations.
        ratio: f64,
        /// Reprojection error, pixels.
        rms_px: f64,
    },
    /// A camera's place is known badly.
    #[error("camera {} is weakly tied: its place is known to {:.1} mm and {:.3}°: {advice}", camera.0, deviation_m * 1e3, deviation_rad.to_degrees())]
    Weak {
        /// Which.
        camera: CameraId,
        /// Rms over the axes, metres.
        deviation_m: f64,
        /// The same of its rotation, radians.
        deviation_rad: f64,
        /// What would help most.
        advice: Advice,
    },
}

/// What ties a camera better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Advice {
    /// Let robots drive where it overlaps this one.
    Overlap(CameraId),
    /// Roundels were seen in so little of its image.
    Cover(f64),
    /// The references are its only tie.
    References,
}

impl fmt::Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Overlap(other) => {
                write!(f, "let robots drive longer where it overlaps camera {}", other.0)
            }
            Self::Cover(share) => write!(
                f,
                "roundels were seen in {:.0} % of its image: let robots drive through the rest",
                share * 100.0
            ),
            Self::References => f.write_str("spread the references further over its view"),
        }
    }
}

/// "camera 0 sees 2, camera 1 sees 0".
pub(super) fn seen_references(seen: &[(CameraId, usize)]) -> String {
    let say = |(camera, count): &(CameraId, usize)| format!("camera {} sees {count}", camera.0);
    seen.iter().map(say).collect::<Vec<_>>().join(", ")
}

/// "reference 2 is 34.0 mm off".
pub(super) fn offs(offs_m: &[(usize, f64)]) -> String {
    let say =
        |(index, off_m): &(usize, f64)| format!("reference {index} is {:.1} mm off", off_m * 1e3);
    offs_m.iter().map(say).collect::<Vec<_>>().join(", ")
}

//! What a person should know of a calibration: each finding says which camera or reference is meant and what
//! to do, by the [`Names`] that the installation has for them.

use std::fmt;

use roundel_vision::{
    id::{CameraId, KindId},
    marker::Code,
};

/// Centres of two roundels are further apart than this, metres.
const LEAST_APART_M: f64 = 0.02;

/// What an installation calls its things, as parts of a sentence.
pub trait Names {
    /// "camera north".
    fn camera(&self, id: CameraId) -> String;
    /// "reference 2"; the index counts from 0 in the order given.
    fn reference(&self, index: usize) -> String;
    /// "kind robot".
    fn kind(&self, id: KindId) -> String;
}

/// Names by number, all from 0, for who has no others.
#[derive(Clone, Copy, Debug)]
pub struct Numbers;

impl Names for Numbers {
    fn camera(&self, id: CameraId) -> String {
        format!("camera {}", id.0)
    }

    fn reference(&self, index: usize) -> String {
        format!("reference {index}")
    }

    fn kind(&self, id: KindId) -> String {
        format!("kind {}", id.0)
    }
}

/// Something that a person should know.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// A camera saw no roundel.
    Unseen {
        /// Which.
        camera: CameraId,
        /// Frames that it gave.
        frames: u64,
    },
    /// A camera shares roundels with none that is placed.
    Apart {
        /// Which.
        camera: CameraId,
    },
    /// What a camera shares with others moved too little.
    TooLittleMotion {
        /// Which.
        camera: CameraId,
        /// The one that it shares most with.
        other: CameraId,
        /// Spread across two directions, rms, metres.
        spread_m: f64,
    },
    /// A reference stands elsewhere than was said.
    Misplaced {
        /// In the order given, from 0.
        reference: usize,
        /// Which camera sees it.
        camera: CameraId,
        /// By how much, metres.
        off_m: f64,
    },
    /// A reference was moved meanwhile.
    Moved {
        /// In the order given, from 0.
        reference: usize,
        /// Which camera saw it.
        camera: CameraId,
        /// By how much, metres.
        moved_m: f64,
    },
    /// No camera saw a reference.
    ReferenceUnseen {
        /// In the order given, from 0.
        reference: usize,
    },
    /// A camera saw two roundels of one code at once.
    Twice {
        /// Which.
        camera: CameraId,
        /// Of the roundels.
        kind: KindId,
        /// Of both.
        code: Code,
    },
    /// A camera saw a roundel where no other did.
    Elsewhere {
        /// Which.
        camera: CameraId,
        /// Of the roundel.
        kind: KindId,
        /// Of the roundel.
        code: Code,
        /// Of how many.
        sightings: usize,
        /// Share that is off …
        share: f64,
        /// … and by how much across the line of sight, median, metres.
        off_m: f64,
    },
    /// A camera's errors are larger than detections can be.
    Doubtful {
        /// Which.
        camera: CameraId,
        /// Errors over stated deviations.
        ratio: f64,
        /// Reprojection error, pixels.
        rms_px: f64,
    },
    /// A camera's place is known badly.
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

impl Finding {
    /// Whether the result should not be used before somebody has looked at it.
    pub fn is_grave(&self) -> bool {
        matches!(self, Self::Misplaced { .. } | Self::Doubtful { .. })
    }

    /// In a sentence.
    pub fn message(&self, names: &dyn Names) -> String {
        let camera = |id: &CameraId| names.camera(*id);
        match self {
            Self::Unseen { camera: id, frames } => format!(
                "{} saw no roundel in {frames} frames: check its picture, its lens file and the roundels' sizes",
                camera(id)
            ),
            Self::Apart { camera: id } => format!(
                "{} saw no roundel together with any placed camera, so its place is unknown: let robots \
                 drive where its view overlaps another's, near enough for codes to be read; those without codes \
                 must not all move alike",
                camera(id)
            ),
            Self::TooLittleMotion { camera: id, other, spread_m } => format!(
                "{} and {} shared roundels within {spread_m:.2} m only, so how they stand to one another is \
                 unknown: let robots drive across the whole overlap",
                camera(id),
                camera(other)
            ),
            Self::Misplaced { reference, camera: id, off_m } => format!(
                "{} appears {:.1} mm from where it was said to be, seen from {}; it was left out: measure it \
                 again",
                names.reference(*reference),
                off_m * 1e3,
                camera(id)
            ),
            Self::Moved { reference, camera: id, moved_m } => format!(
                "{} moved by {:.1} mm while {} watched; it was left out: fix it and record again",
                names.reference(*reference),
                moved_m * 1e3,
                camera(id)
            ),
            Self::ReferenceUnseen { reference } => format!(
                "{} was seen by no camera: check its place and its code",
                names.reference(*reference)
            ),
            Self::Twice { camera: id, kind, code } => format!(
                "{} saw code {} of {} in two places at once, so it was left out: print each code once",
                camera(id),
                code.number,
                names.kind(*kind)
            ),
            Self::Elsewhere { camera: id, kind, code, sightings, share, off_m } => format!(
                "{} saw code {} of {} {:.1} mm from where others did in {:.0} % of {sightings} sightings: {}",
                camera(id),
                code.number,
                names.kind(*kind),
                off_m * 1e3,
                share * 100.0,
                if *off_m < LEAST_APART_M {
                    "a lens file may be off there: have the lenses refined"
                } else {
                    "look for two roundels with this code, or for one that is misread there"
                }
            ),
            Self::Doubtful { camera: id, ratio, rms_px } => format!(
                "{}: errors are {ratio:.1} times what its detections state ({rms_px:.2} px): its lens file or \
                 the roundels' diameters may be wrong",
                camera(id)
            ),
            Self::Weak { camera: id, deviation_m, deviation_rad, advice } => format!(
                "{} is weakly constrained: its pose is known to {:.1} mm and {:.3}°: {}",
                camera(id),
                deviation_m * 1e3,
                deviation_rad.to_degrees(),
                advice.message(names)
            ),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message(&Numbers))
    }
}

impl Advice {
    fn message(&self, names: &dyn Names) -> String {
        match self {
            Self::Overlap(other) => {
                format!("let robots drive longer where it overlaps {}", names.camera(*other))
            }
            Self::Cover(share) => format!(
                "roundels were seen in {:.0} % of its image: let robots drive through the rest",
                share * 100.0
            ),
            Self::References => "spread the references further over its view".to_owned(),
        }
    }
}

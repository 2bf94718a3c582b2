//! Findings about a calibration: what is wrong, with which camera or reference, and what to do. [`Names`] provides the
//! installation's names.

use std::fmt;

use roundel_vision::{
    id::{CameraId, KindId},
    marker::Code,
};

/// Minimum distance of the centres of two different roundels, metres.
const MIN_APART_M: f64 = 0.02;

/// Names of an installation, as parts of a sentence.
pub trait Names {
    /// Such as "camera north".
    fn camera(&self, id: CameraId) -> String;
    /// Such as "reference 2". The index counts from 0 in the given order.
    fn reference(&self, index: usize) -> String;
    /// Such as "kind robot".
    fn kind(&self, id: KindId) -> String;
}

/// Names by number, counted from 0.
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

/// A problem or hint for the operator. References are counted in the given order, from 0.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum Finding {
    /// A camera saw no roundel in all its frames.
    Unseen { camera: CameraId, frames: u64 },
    /// A camera shares no roundels with any located camera.
    Apart { camera: CameraId },
    /// The roundels that a camera shares with others, mostly with `other`, moved too little: by this rms spread in two
    /// directions.
    TooLittleMotion { camera: CameraId, other: CameraId, spread_m: f64 },
    /// A camera sees a reference this far from its stated position.
    Misplaced { reference: usize, camera: CameraId, off_m: f64 },
    /// A camera saw how a reference was moved during the recording.
    Moved { reference: usize, camera: CameraId, moved_m: f64 },
    /// No camera saw a reference.
    ReferenceUnseen { reference: usize },
    /// A camera saw two roundels with the same code at once.
    Twice { camera: CameraId, kind: KindId, code: Code },
    /// A camera saw a roundel at another position than the other cameras in a share of its sightings, by this median
    /// offset across the line of sight.
    Elsewhere {
        camera: CameraId,
        kind: KindId,
        code: Code,
        sightings: usize,
        share: f64,
        off_m: f64,
    },
    /// A camera's errors exceed by `ratio` those that its detections state; `rms_px` is the reprojection error.
    Doubtful { camera: CameraId, ratio: f64, rms_px: f64 },
    /// The pose of a camera is imprecise: the deviations are rms over the axes of position and rotation.
    Weak { camera: CameraId, deviation_m: f64, deviation_rad: f64, advice: Advice },
}

/// How to improve the pose of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Advice {
    /// Robots should drive where its view overlaps that of this camera.
    Overlap(CameraId),
    /// Robots should cover more of its image; the value is the covered share.
    Cover(f64),
    /// References should be spread over its view, as they alone determine its pose.
    References,
}

impl Finding {
    /// Whether the result must be reviewed before use.
    pub fn is_grave(&self) -> bool {
        matches!(self, Self::Misplaced { .. } | Self::Doubtful { .. })
    }

    /// The finding as a sentence.
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
                "{} appears {:.1} mm from its stated position, seen from {}; it was left out: measure it \
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
                if *off_m < MIN_APART_M {
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

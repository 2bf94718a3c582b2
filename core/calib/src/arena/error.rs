//! Why there is no calibration.

use std::{error::Error, fmt};

use super::finding::{Names, Numbers};
use roundel_fusion::world::reference::ReferenceError;
use roundel_vision::id::CameraId;

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq)]
pub enum ArenaError {
    /// No cameras, or the same twice.
    Cameras {
        /// Those given.
        found: Vec<CameraId>,
    },
    /// No camera sees enough of the references.
    References {
        /// How many each camera sees.
        seen: Vec<(CameraId, usize)>,
    },
    /// The references contradict one another as a camera sees them.
    Placing {
        /// Which camera.
        camera: CameraId,
        /// Why.
        source: ReferenceError,
    },
    /// One reference or more is not where it was said to be, and which cannot be told.
    Misplaced {
        /// Which camera sees it.
        camera: CameraId,
        /// Each reference and how far off it appears, metres.
        offs_m: Vec<(usize, f64)>,
    },
    /// Nothing ties any other camera to the ones that see references.
    Undetermined,
    /// The caller wanted no more of it.
    Cancelled,
}

impl ArenaError {
    /// In a sentence.
    pub fn message(&self, names: &dyn Names) -> String {
        match self {
            Self::Cameras { found } => format!("expected each camera once, found {found:?}"),
            Self::References { seen } => {
                let say =
                    |(id, count): &(CameraId, usize)| format!("{} sees {count}", names.camera(*id));
                let seen: Vec<String> = seen.iter().map(say).collect();
                format!("no camera sees three references: {}", seen.join(", "))
            }
            Self::Placing { camera, source } => format!("{}: {source}", names.camera(*camera)),
            Self::Misplaced { camera, offs_m } => {
                let say = |(index, off_m): &(usize, f64)| {
                    format!("{} is {:.1} mm off", names.reference(*index), off_m * 1e3)
                };
                let offs: Vec<String> = offs_m.iter().map(say).collect();
                format!(
                    "{}: the references are not where they were said to be: {}; measure their places and \
                     diameters again, or say that the lens is not exact",
                    names.camera(*camera),
                    offs.join(", ")
                )
            }
            Self::Undetermined => {
                "sightings do not determine the cameras' places; let robots drive where \
                                   cameras overlap, for longer"
                    .to_owned()
            }
            Self::Cancelled => "stopped on request".to_owned(),
        }
    }
}

impl fmt::Display for ArenaError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message(&Numbers))
    }
}

impl Error for ArenaError {}

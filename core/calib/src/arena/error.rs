//! Errors of the arena calibration.

use std::{error::Error, fmt};

use super::finding::{Names, Numbers};
use roundel_fusion::world::reference::ReferenceError;
use roundel_vision::id::CameraId;

/// Why an arena calibration failed.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum ArenaError {
    /// There are no cameras, or one is listed twice.
    Cameras { found: Vec<CameraId> },
    /// No camera sees three references; the number that each sees.
    References { seen: Vec<(CameraId, usize)> },
    /// A camera's view of the references is inconsistent.
    Placing { camera: CameraId, source: ReferenceError },
    /// At least one reference that a camera sees is not at its stated position, and it is ambiguous which: their
    /// indices and distances from the stated positions.
    Misplaced { camera: CameraId, offs_m: Vec<(usize, f64)> },
    /// The observations do not determine the poses of all cameras.
    Undetermined,
    /// Cancelled by the caller.
    Cancelled,
}

impl ArenaError {
    /// The error as a sentence.
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
                    "{}: the references are not at their stated positions: {}; measure their places and \
                     diameters again, or have the lens refined",
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

//! Why a camera or an object is not added, changed or removed, and which of its keys is to blame.

use std::{io, path::PathBuf};

use roundel_core::marker::{DetectorError, MaskError};
use thiserror::Error;

use crate::model::config::{
    ConfigFileError, Problem,
    edit::{self, Message},
};

/// Why a camera or an object is not added, changed or removed; everything is as it was then.
#[derive(Debug, Error)]
pub enum CameraManagerError {
    /// With it the configuration would be wrong.
    #[error("{message}")]
    Invalid {
        /// Which key of the camera or object, if it is one's fault; else which of both it is.
        key: &'static str,
        /// What was expected, what was found, and what to do.
        message: String,
    },
    /// It is no configuration.
    #[error("{}", message_of(.0))]
    Problems(Vec<Problem>),
    /// It is one for another start.
    #[error(
        "what differs in {} takes a start of the server: write it into the configuration's file, and start the server \
         anew; nothing was changed", .0.join(", ")
    )]
    NeedsRestart(Vec<String>),
    /// It was made from one that is in force no more.
    #[error("the configuration was changed since that version was read: read it again")]
    Stale,
    /// There is no such camera, or there is no more.
    #[error("there is no camera \"{0}\"")]
    NoCamera(String),
    /// There is no such object, or there is no more.
    #[error("the configuration has no object \"{0}\"")]
    NoObject(String),
    #[error("no object {0} was seen within the last minute")]
    NotSeen(u64),
    /// It is not known by which code.
    #[error("the code of object {0} was not read yet: it has to be seen larger, or less tilted")]
    CodeNotRead(u64),
    #[error(
        "object {object} carries a plain roundel \"{kind}\" as others do, and nothing tells it from them: give it a \
         roundel with a code, or one of a kind of its own"
    )]
    Ambiguous { object: u64, kind: String },
    #[error("it is the only camera, and an installation has at least one: add another one first")]
    LastCamera,
    /// What a calibration records has to hold until its end.
    #[error(
        "a calibration of the arena is running, which cameras have to stand still for: wait for it, or cancel it"
    )]
    Calibrating,
    #[error("the server is shutting down")]
    ShuttingDown,
    /// The configuration cannot be written.
    #[error(transparent)]
    File(#[from] ConfigFileError),
    /// There is no place beside it.
    #[error(
        "this server was started without a configuration file, so there is no place beside it for a lens file: download \
         the file, and name it as the camera's `calibration`"
    )]
    NoFolder,
    /// A lens file cannot be written.
    #[error("cannot write the lens file {}: {source}; make its folder writable for the server, or download the file", .path.display())]
    Lens { path: PathBuf, source: io::Error },
    /// The system gives no thread.
    #[error("cannot start the thread `{name}`: {source}")]
    Thread { name: String, source: io::Error },
    /// The kinds of roundel cannot be searched for.
    #[error("kinds of roundel: {0}")]
    Detector(#[from] DetectorError),
    /// The mask is none.
    #[error(transparent)]
    Mask(#[from] MaskError),
}

impl From<edit::EditError> for CameraManagerError {
    fn from(error: edit::EditError) -> Self {
        match error {
            edit::EditError::Missing { what: "object", name } => Self::NoObject(name),
            edit::EditError::Missing { name, .. } => Self::NoCamera(name),
            error @ edit::EditError::Text(_) => {
                Self::Invalid { key: "configuration", message: error.to_string() }
            }
        }
    }
}

/// What is wrong with a configuration since the camera or object at `index` is as it is: the first key that is to blame,
/// and everything that is to be said.
pub(super) fn invalid<M: Message>(
    text: &str,
    index: usize,
    problems: &[Problem],
) -> CameraManagerError {
    let key_of = |problem: &Problem| {
        let at = problem.place.as_ref()?.offset(text);
        match edit::key_at::<M>(text, at) {
            Some((place, key)) if place == index => Some(key),
            // Of two with one name the second is to blame there, which another one may be.
            Some((_, "name")) => Some("name"),
            _ => edit::key_named::<M>(&problem.message),
        }
    };
    let key = problems.iter().find_map(key_of).unwrap_or(M::SECTION);
    CameraManagerError::Invalid { key, message: sentences(problems, |_| String::new()) }
}

/// All that is wrong with a whole text.
fn message_of(problems: &[Problem]) -> String {
    let place = |problem: &Problem| {
        let place = problem.place.as_ref();
        place.map_or_else(String::new, |place| {
            format!("line {}, column {}: ", place.line, place.column)
        })
    };
    sentences(problems, place)
}

fn sentences(problems: &[Problem], place: impl Fn(&Problem) -> String) -> String {
    let said = problems.iter().map(|problem| match &problem.help {
        Some(help) => format!("{}{}; {help}", place(problem), problem.message),
        None => format!("{}{}", place(problem), problem.message),
    });
    said.collect::<Vec<_>>().join(". ")
}

//! Errors of changes, and the key that causes them.

use std::{io, path::PathBuf};

use roundel_core::marker::{DetectorError, MaskError};
use thiserror::Error;

use crate::model::config::{
    ConfigFileError, Problem,
    edit::{self, Message},
};

/// The configuration and the cameras stay unchanged.
#[derive(Debug, Error)]
pub enum CameraManagerError {
    /// The changed configuration would be invalid.
    #[error("{message}")]
    Invalid {
        /// The key of the camera or object that causes it, or `camera` or `object`.
        key: &'static str,
        message: String,
    },
    /// Not a valid configuration.
    #[error("{}", message_of(.0))]
    Problems(Vec<Problem>),
    #[error(
        "the differences in {} need a restart: write them into the configuration's file, and restart the server; nothing \
         was changed", .0.join(", ")
    )]
    NeedsRestart(Vec<String>),
    /// The text was edited from an older version.
    #[error("the configuration was changed since that version was read: read it again")]
    Stale,
    #[error("there is no camera \"{0}\"")]
    NoCamera(String),
    #[error("the configuration has no object \"{0}\"")]
    NoObject(String),
    #[error("no object {0} was seen within the last minute")]
    NotSeen(u64),
    #[error("the code of object {0} has not been read yet: it must appear larger, or less tilted")]
    CodeNotRead(u64),
    #[error(
        "object {object} carries a plain roundel \"{kind}\" like others, and nothing tells it from them: give it a roundel \
         with a code, or with a kind of its own"
    )]
    Ambiguous { object: u64, kind: String },
    #[error("it is the only camera, and an installation has at least one: add another one first")]
    LastCamera,
    #[error(
        "a calibration of the arena is running, during which cameras cannot be changed: wait for it, or cancel it"
    )]
    Calibrating,
    #[error(
        "another change of the configuration has been running for seconds, perhaps because a disk does not answer: try again"
    )]
    Busy,
    #[error("the server is shutting down")]
    ShuttingDown,
    #[error(transparent)]
    File(#[from] ConfigFileError),
    #[error(
        "this server was started without a configuration file, beside which lens files are stored: download the file, and \
         name it as the camera's `calibration`"
    )]
    NoFolder,
    #[error("cannot write the lens file {}: {source}; make its folder writable for the server, or download the file", .path.display())]
    Lens { path: PathBuf, source: io::Error },
    #[error("cannot start the thread `{name}`: {source}")]
    Thread { name: String, source: io::Error },
    #[error("kinds of roundel: {0}")]
    Detector(#[from] DetectorError),
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

/// Attributes the problems of an edited text to a key of the camera or object at `index`, if possible.
pub(super) fn invalid<M: Message>(
    text: &str,
    index: usize,
    problems: &[Problem],
) -> CameraManagerError {
    let key_of = |problem: &Problem| {
        let at = problem.place.as_ref()?.offset(text);
        match edit::key_at::<M>(text, at) {
            Some((place, key)) if place == index => Some(key),
            // If two have the same name, the second is reported, which may be another one.
            Some((_, "name")) => Some("name"),
            _ => edit::key_named::<M>(&problem.message),
        }
    };
    let key = problems.iter().find_map(key_of).unwrap_or(M::SECTION);
    CameraManagerError::Invalid { key, message: sentences(problems, |_| String::new()) }
}

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

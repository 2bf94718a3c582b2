//! Why a camera is not added, changed or removed, and which of its keys is to blame.

use std::io;

use roundel_core::marker::{DetectorError, MaskError};
use thiserror::Error;

use crate::config::{ConfigFileError, Problem, edit};

/// Why a camera is not added, changed or removed; everything is as it was then.
#[derive(Debug, Error)]
pub enum RosterError {
    /// With it the configuration would be wrong.
    #[error("{message}")]
    Wrong {
        /// Which key of the camera, if it is one's fault.
        key: Option<&'static str>,
        /// What was expected, what was found, and what to do.
        message: String,
    },
    /// There is no such camera, or there is no more.
    #[error("there is no camera \"{0}\"")]
    NoCamera(String),
    /// An installation has cameras.
    #[error("it is the only camera, and an installation has at least one: add another one first")]
    Last,
    /// What a calibration records has to hold until its end.
    #[error(
        "a calibration of the arena is running, which cameras have to stand still for: wait for it, or cancel it"
    )]
    Calibrating,
    /// The server goes down.
    #[error("the server is shutting down")]
    Ending,
    /// The configuration cannot be written.
    #[error(transparent)]
    File(#[from] ConfigFileError),
    /// The system gives no thread.
    #[error("cannot start the thread `{name}`: {source}")]
    Thread {
        /// Which thread.
        name: String,
        /// What the system says.
        source: io::Error,
    },
    /// The kinds of roundel cannot be searched for.
    #[error("kinds of roundel: {0}")]
    Detector(#[from] DetectorError),
    /// The mask is none.
    #[error(transparent)]
    Mask(#[from] MaskError),
}

impl From<edit::EditError> for RosterError {
    fn from(error: edit::EditError) -> Self {
        match error {
            edit::EditError::NoCamera(name) => Self::NoCamera(name),
            error @ edit::EditError::Text(_) => {
                Self::Wrong { key: None, message: error.to_string() }
            }
        }
    }
}

/// What is wrong with a configuration since the camera at `index` is as it is: the first key that is to blame, and
/// everything that is to be said.
pub(super) fn wrong(text: &str, index: usize, problems: &[Problem]) -> RosterError {
    let key_of = |problem: &Problem| {
        let at = problem.place.as_ref()?.offset(text);
        match edit::key_at(text, at) {
            Some((place, key)) if place == index => Some(key),
            // Of two cameras with one name the second is to blame there, which another one may be.
            Some((_, "name")) => Some("name"),
            _ => edit::key_named(&problem.message),
        }
    };
    let said: Vec<String> = problems
        .iter()
        .map(|problem| match &problem.help {
            Some(help) => format!("{}; {help}", problem.message),
            None => problem.message.clone(),
        })
        .collect();
    RosterError::Wrong { key: problems.iter().find_map(key_of), message: said.join(". ") }
}

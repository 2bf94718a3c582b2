//! Status of services as messages of the API.

mod calibration;
mod configuration;
mod recording;
mod source_probe;

pub use self::{
    calibration::calibration,
    configuration::{configuration, configuration_check},
    recording::{history, recording, recordings, replay},
    source_probe::trial,
};
pub use crate::model::convert::*;

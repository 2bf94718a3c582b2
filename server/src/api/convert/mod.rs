//! Status of services as messages of the API.

mod calibration;
mod configuration;
mod recording;
mod trial;

pub use self::{
    calibration::calibration,
    configuration::{configuration, configuration_check},
    recording::{history, recording, recordings, replay},
    trial::trial,
};
pub use crate::model::convert::*;

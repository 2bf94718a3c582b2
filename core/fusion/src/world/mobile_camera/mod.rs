//! Cameras fixed to tracked objects.

mod landmark;
mod localize;
mod mobile_cameras;
mod mount;

pub use landmark::{Landmark, TURN_SIGMA_RAD};
pub(super) use localize::LocalizationInput;
pub(super) use mobile_cameras::MobileCameras;
pub(super) use mount::CarrierState;
pub use mount::{CameraMount, Carrier, Unplaced};

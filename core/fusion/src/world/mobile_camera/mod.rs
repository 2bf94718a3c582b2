//! Cameras fixed to tracked objects.
//!
//! `mount` derives the pose of such a camera from its carrier's track. `localize` does the reverse: it measures the
//! carrier by `landmark`s that the camera detects. `mobile_cameras` holds all of them.

mod landmark;
mod localize;
mod mobile_cameras;
mod mount;

pub use landmark::{Landmark, TURN_SIGMA_RAD};
pub(super) use localize::LocalizationInput;
pub(super) use mobile_cameras::MobileCameras;
pub(super) use mount::CarrierState;
pub use mount::{CameraMount, Carrier, Unplaced};

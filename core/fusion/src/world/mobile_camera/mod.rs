//! Cameras fixed to tracked objects.

mod landmark;
mod localize;
mod mount;
mod riders;

pub use landmark::{Landmark, TURN_SIGMA_RAD};
pub(super) use localize::View;
pub(super) use mount::Ride;
pub use mount::{CameraMount, Carrier, Unplaced};
pub(super) use riders::Riders;

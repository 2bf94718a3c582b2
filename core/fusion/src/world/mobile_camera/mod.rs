//! Cameras fixed to tracked objects.

pub(super) mod landmark;
pub(super) mod localize;
pub(super) mod mount;

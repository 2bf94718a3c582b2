//! Fit of a camera model to views of a target: initial estimate, bundle adjustment, selection of the distortion model.

pub(super) mod bundle;
pub(super) mod center_noise;
pub(super) mod diameter_check;
pub(super) mod distortion_model;
pub(super) mod initial;
pub(super) mod model_selection;
pub(super) mod parameters;
pub(super) mod rim;

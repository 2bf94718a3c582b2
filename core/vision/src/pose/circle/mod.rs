//! The circle in space whose image a pair of rims is.

pub mod closed_form;
pub mod cone;
pub mod elliptical_disc;
pub mod frontal;
pub mod jacobian;
pub mod motion_blur;
pub mod refine;
pub mod tilt_posterior;

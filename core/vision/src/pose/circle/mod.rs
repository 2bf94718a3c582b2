//! The circle in space whose image a pair of rims is, in closed form.
//!
//! In: both rims with their errors ([`super::rim`]). Out: one or two circles with covariance and
//! likelihood.
//!
//! 1. [`cone`]: two circles from the outer rim's ellipse.
//! 2. [`refine`]: one Gauss-Newton step on both rims, with [`jacobian`] and [`motion_blur`].
//! 3. [`frontal`]: instead of step 2 where the roundel nearly faces the camera, by the posterior of
//!    [`tilt_posterior`].
//! 4. [`closed_form`]: the whole chain, for one ring or for eight in the lanes of a vector.
//!
//! [`elliptical_disc`] adapts the chain to roundels with an elliptical disc.

pub mod closed_form;
pub mod cone;
pub mod elliptical_disc;
pub mod frontal;
pub mod jacobian;
pub mod motion_blur;
pub mod refine;
pub mod tilt_posterior;

//! What stays constant during a fit.

use crate::{
    marker::Kind,
    pose::photometry::model::{local_lens::LocalLens, teeth::Teeth},
};

/// Constants of one fit.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    pub kind: &'a Kind,
    /// Teeth of a coded print.
    pub teeth: Option<Teeth>,
    /// Whether the teeth are those of earlier frames.
    pub teeth_are_predicted: bool,
    pub radius_m: f64,
    pub lens: &'a LocalLens,
    /// Variance of μ besides its own size, px⁴.
    pub motion_prior: f64,
    /// Whether the motion is held at zero.
    pub is_still: bool,
}

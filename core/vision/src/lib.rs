//! Finds printed roundels in grey images: from pixels to poses in the camera frame.
//!
//! | module | content |
//! | --- | --- |
//! | [`time`], [`id`], [`rigid`] | instants, identifiers, rigid transforms with covariance |
//! | `simd` | numeric code generic over one value or one value per vector lane |
//! | `parallel`, `scratch` | per-thread memory, buffers reserved in advance |
//! | [`normal_distribution`] | φ, Φ and tails, also fast enough to evaluate per pixel |
//! | [`camera`] | lens models |
//! | [`frame`] | view of an 8-bit grey image, and windows of it |
//! | [`ellipse`] | ellipses from moments |
//! | [`marker`] | detection of rings in a frame, tracking from frame to frame |
//! | [`pose`] | pose of a ring in the camera frame, with covariance |
//!
//! A module imports only those above it. Frames, units and signs: [`conventions`].

#[doc = include_str!("../../docs/conventions.md")]
pub mod conventions {}
#[doc = include_str!("../../docs/errata.md")]
pub mod errata {}

pub mod camera;
pub mod ellipse;
pub mod frame;
pub mod id;
pub mod marker;
pub mod normal_distribution;
mod parallel;
pub mod pose;
pub mod rigid;
mod scratch;
mod simd;
pub mod time;

/// Runs the example of the crate's README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

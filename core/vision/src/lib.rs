//! Finds printed roundels in grey pictures: from pixels to poses in the camera frame.
//!
//! | module | content |
//! | --- | --- |
//! | [`time`], [`id`], [`rigid`] | instants, names, rigid transforms with covariance |
//! | `simd` | numbers side by side, one case in each lane of a vector |
//! | `parallel` | work on a frame's rings, shared among threads |
//! | [`camera`] | lens models |
//! | [`frame`] | a view of 8-bit grey pixels |
//! | [`segment`] | windows, and moments of runs of pixels |
//! | [`ellipse`] | rims from moments |
//! | [`marker`] | rings found in a frame, and followed from frame to frame |
//! | [`pose`] | where a ring is in the camera frame, with covariance |
//!
//! A module uses only those above it. Frames, units and signs: [`conventions`].

#[doc = include_str!("../../docs/conventions.md")]
pub mod conventions {}
#[doc = include_str!("../../docs/errata.md")]
pub mod errata {}

pub mod camera;
pub mod ellipse;
pub mod frame;
pub mod id;
pub mod marker;
pub mod normal;
mod parallel;
pub mod pose;
pub mod rigid;
mod scratch;
pub mod segment;
mod simd;
pub mod time;

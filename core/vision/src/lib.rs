//! Finds printed roundels in grey pictures: from pixels to poses in the camera frame.
//!
//! | module | content |
//! | --- | --- |
//! | [`time`], [`id`], [`rigid`] | instants, names, rigid transforms with covariance |
//! | `lanes` | numbers side by side, one case in each lane of a vector |
//! | [`normal_distribution`] | φ, Φ and its tail |
//! | `share` | work on a frame's rings, shared among threads |
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
mod lanes;
pub mod marker;
pub mod normal_distribution;
pub mod pose;
pub mod rigid;
mod room;
pub mod segment;
mod share;
pub mod time;

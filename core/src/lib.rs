//! All of Roundel's algorithms, from pixels to world poses.
//!
//! Pure: no input or output, no async, no clock, no logging, no randomness of its own. Callers pass
//! frames, times, seeds and scratch memory. Data flows down this list, and a module uses only what
//! stands above it (held by a test):
//!
//! | module | makes |
//! | --- | --- |
//! | [`time`], [`id`], [`rigid`] | instants, names, rigid transforms with covariance |
//! | `lanes` | numbers side by side, one case in each lane of a vector |
//! | `share` | work on a frame's rings, shared among threads |
//! | [`camera`] | lens models |
//! | [`frame`] | a view of 8-bit grey pixels |
//! | [`segment`] | windows, and moments of runs of pixels |
//! | [`ellipse`] | rims from moments |
//! | [`marker`] | rings found in a frame, and followed from frame to frame |
//! | [`pose`] | where a ring is in the camera frame, with covariance |
//! | [`track`] | one object's motion over time |
//! | [`world`] | all objects in the world frame, from all cameras |
//! | [`calib`] | where the cameras stand, found once |
//! | [`plan`] | what cameras and roundels would reach, before they are bought |
//! | [`sim`] | simulated scenarios, rendered to pixels |
//!
//! Frames, units and signs: `docs/conventions.md`, shown at [`conventions`].

#[doc = include_str!("../docs/conventions.md")]
pub mod conventions {}
#[doc = include_str!("../docs/errata.md")]
pub mod errata {}

pub mod calib;
pub mod camera;
pub mod ellipse;
pub mod frame;
pub mod id;
mod lanes;
pub mod marker;
pub mod plan;
pub mod pose;
pub mod rigid;
mod room;
pub mod segment;
mod share;
pub mod sim;
pub mod time;
pub mod track;
pub mod world;

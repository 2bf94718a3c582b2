//! All of Roundel's algorithms, from pixels to world poses.
//!
//! Pure: no input or output, no async, no clock, no logging, no randomness of its own. Callers pass frames, times, seeds
//! and scratch memory. This crate only collects the modules of others, each of which uses only those above it:
//!
//! | crate | modules | content |
//! | --- | --- | --- |
//! | [`roundel_vision`] | [`time`], [`id`], [`rigid`], [`normal_distribution`], [`camera`], [`frame`], [`ellipse`], [`marker`], [`pose`] | from pixels to poses in the camera frame |
//! | [`roundel_fusion`] | [`track`], [`world`] | all objects in the world frame, from all cameras |
//! | [`roundel_calib`] | [`calib`] | calibration of lenses and camera poses, and its supervision |
//! | [`roundel_sim`] | [`sim`] | simulated scenarios, rendered to pixels |
//! | [`roundel_plan`] | [`plan`] | range, precision and coverage of cameras and roundels |
//!
//! Frames, units and signs: `docs/conventions.md`, shown at [`conventions`].

pub use roundel_calib as calib;
pub use roundel_fusion::{track, world};
pub use roundel_plan as plan;
pub use roundel_sim as sim;
pub use roundel_vision::{
    camera, conventions, ellipse, errata, frame, id, marker, normal_distribution, pose, rigid, time,
};

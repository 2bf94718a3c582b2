//! Predicts accuracy, coverage and time per frame of an installation, with [`roundel_core::plan`]. Used by `roundel plan` and
//! over REST.
//!
//! | module | purpose |
//! | --- | --- |
//! | [`planned_camera`] | inputs of a plan from a configuration or a running server |
//! | [`plan_map`] | a map as numbers (JSON) |
//! | [`map_drawing`] | a map as SVG and PNG |
//! | `color_scale` | the colour scale of a map |
//! | [`timing`] | time per frame on this machine, measured on simulated frames |

mod color_scale;
pub mod map_drawing;
pub mod plan_map;
pub mod planned_camera;
pub mod timing;

/// Approximate number of spots of a map without an explicit step.
pub const DEFAULT_SPOTS: usize = 2400;

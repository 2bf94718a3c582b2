//! What an installation would reach: maps and figures of [`roundel_core::plan`], for `roundel plan` and over REST.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`planned_camera`] | cameras of a configuration or of a running server, as the plan takes them |
//! | [`plan_map`] | a map as numbers (JSON) |
//! | [`map_drawing`] | a map as SVG and PNG |
//! | [`machine_timings`] | what a machine takes for a frame: measured, kept in a file, read again |
//! | [`timing`] | the frames that it is measured with, and the clock |
//! | `rows` | robots of such a frame in rows |
//! | [`contention`] | whether the machine was used by others meanwhile |

mod color_scale;
pub mod contention;
pub mod machine_timings;
pub mod map_drawing;
pub mod plan_map;
pub mod planned_camera;
mod robot_rows;
pub mod timing;

/// About so many spots a map has, if nobody says how far apart they are.
pub const DEFAULT_SPOTS: usize = 2400;

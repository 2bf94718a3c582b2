//! What an installation would reach: maps and figures of [`roundel_core::plan`], for `roundel plan` and over REST.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`station`] | cameras of a configuration or of a running server, as the plan takes them |
//! | [`report`] | a map as numbers (JSON) |
//! | [`picture`] | a map as SVG and PNG |
//! | [`machine`] | what a machine takes for a frame: measured, kept in a file, read again |
//! | [`trial`] | the frames that it is measured with, and the clock |
//! | `rows` | robots of such a frame in rows |
//! | [`quiet`] | whether the machine was used by others meanwhile |

pub mod machine;
pub mod picture;
pub mod quiet;
pub mod report;
mod rows;
mod scale;
pub mod station;
pub mod trial;

/// About so many spots a map has, if nobody says how far apart they are.
pub const SPOTS: usize = 2400;

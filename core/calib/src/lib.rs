//! Calibration: lenses, camera poses, and the supervision of camera poses.
//!
//! | module | input | output |
//! | --- | --- | --- |
//! | [`lens`] | views of a [`board`] or [`checkerboard`], or moving roundels | camera parameters with covariance |
//! | [`arena`] | a recording of moving roundels, reference roundels | pose and clock of every camera |
//! | [`watch`] | live detections of all cameras | cameras that were moved or drift |

pub mod arena;
pub mod board;
pub mod checkerboard;
mod image_cells;
mod least_squares;
pub mod lens;
mod robust;
#[cfg(test)]
mod test_world;
pub mod watch;

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

use roundel_core::plan::map::MapArea;

/// Approximate number of spots of a map without an explicit step.
const DEFAULT_SPOTS: usize = 2400;

/// The area between two corners, with spots at this distance.
pub fn map_area(corners_m: [[f64; 2]; 2], height_m: f64, step_m: Option<f64>) -> MapArea {
    let area = MapArea::with_spots(corners_m, height_m, DEFAULT_SPOTS);
    MapArea { step_m: step_m.unwrap_or(area.step_m), ..area }
}

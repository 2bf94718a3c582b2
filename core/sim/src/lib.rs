//! Simulated scenarios, rendered to pixels: for the demo, and as ground truth for tests.
//!
//! [`ScenarioParams`] → [`Scenario`] (cameras, and each robot's pose at any time) → [`Renderer`] (8-bit frames of one
//! camera). Everything depends on the parameters, their seed, and commands to robots ([`Scenario::drive`]) only, so frames
//! can be rendered in any order and on any thread.
//!
//! Precision is judged by another renderer in the workspace's `tests/`, since this one shares the lens model with the
//! detector.
//!
//! ```
//! use roundel_sim::{Renderer, Scenario};
//!
//! let scenario = Scenario::r4_lite(1);
//! let mut renderer = Renderer::new(&scenario, 0)?;
//! let mut pixels = vec![0; 1280 * 720];
//! let time_s = renderer.render(30, &mut pixels)?;
//! let robots = scenario.truth(time_s);
//! assert_eq!(robots.len(), 24);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod albedo;
mod canvas;
#[cfg(test)]
mod contour;
mod driven_path;
mod floor;
mod jet;
mod layout;
mod light;
mod noise;
mod params;
mod patch;
mod path;
mod ray;
mod render;
mod scenario;
mod sim_camera;

pub use driven_path::Drive;
pub use params::{CameraMount, ImageParams, Optics, ScenarioError, ScenarioParams};
pub use render::{BufferError, Renderer};
pub use scenario::{RobotTruth, Scenario};
pub use sim_camera::{SimCamera, look_at};

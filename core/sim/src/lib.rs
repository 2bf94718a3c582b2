//! Simulated scenarios, rendered to pixels: the demo's world, and a truth to test against.
//!
//! [`ScenarioParams`] → [`Scenario`] (cameras, and each robot's pose at any time) → [`Renderer`] (one
//! camera's 8-bit frames). Everything follows from the parameters, their seed, and what robots were told since
//! ([`Scenario::drive`]); nothing is stored from frame to frame, so frames can be painted in any order and on any thread.
//!
//! What judges Roundel's precision is another renderer, in the workspace's `tests/`: this one shares
//! its lens model with the detector that it feeds.
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
mod course;
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
mod rig;
mod scenario;
mod teeth;

pub use course::Drive;
pub use params::{CameraMount, ImageParams, Optics, ScenarioError, ScenarioParams};
pub use render::{BufferError, Renderer};
pub use rig::{SimCamera, look_at};
pub use scenario::{RobotTruth, Scenario};

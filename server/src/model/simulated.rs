//! The simulated world and cameras of a `sim:` address.

use roundel_core::sim::{Scenario, ScenarioError, ScenarioParams, SimCamera};

use super::address::{SimAddress, SimPreset};

pub fn simulated_scenario(address: &SimAddress) -> Result<Scenario, ScenarioError> {
    let mut params = match address.preset {
        SimPreset::R4Lite => ScenarioParams::r4_lite(address.seed),
        SimPreset::R4 => ScenarioParams::r4(address.seed),
        SimPreset::R4Elliptical => ScenarioParams::r4_elliptical(address.seed),
    };
    if let Some(robots) = address.robots {
        // The same share of robots stands still as in the preset.
        params.still = (params.still * robots).div_ceil(params.robots.max(1)).min(params.still);
        params.robots = robots;
        params.still = params.still.min(robots - params.flying().min(robots));
    }
    Scenario::new(params)
}

pub fn simulated_camera(address: &SimAddress) -> Result<SimCamera, ScenarioError> {
    camera_of_world(simulated_scenario(address)?.cameras(), address)
}

/// The camera of an address among those of its world.
pub fn camera_of_world(
    cameras: &[SimCamera],
    address: &SimAddress,
) -> Result<SimCamera, ScenarioError> {
    cameras.get(address.camera).cloned().ok_or(ScenarioError::NoSuchCamera {
        last: cameras.len().saturating_sub(1),
        found: address.camera,
    })
}

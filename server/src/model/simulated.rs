//! The simulated world and cameras that a `sim:` address names.

use roundel_core::sim::{Scenario, ScenarioError, ScenarioParams, SimCamera};

use super::address::{SimAddress, SimPreset};

/// The simulated world of an address.
pub fn simulated_scenario(address: &SimAddress) -> Result<Scenario, ScenarioError> {
    let mut params = match address.preset {
        SimPreset::R4Lite => ScenarioParams::r4_lite(address.seed),
        SimPreset::R4 => ScenarioParams::r4(address.seed),
        SimPreset::R4Elliptical => ScenarioParams::r4_elliptical(address.seed),
    };
    if let Some(robots) = address.robots {
        // As many of the fewer stand still as of the preset's.
        params.still = (params.still * robots).div_ceil(params.robots.max(1)).min(params.still);
        params.robots = robots;
        params.still = params.still.min(robots - params.flying().min(robots));
    }
    Scenario::new(params)
}

/// The simulated camera of an address: its lens, place and timing.
pub fn simulated_camera(address: &SimAddress) -> Result<SimCamera, ScenarioError> {
    let scenario = simulated_scenario(address)?;
    let cameras = scenario.cameras();
    cameras.get(address.camera).cloned().ok_or(ScenarioError::NoSuchCamera {
        last: cameras.len().saturating_sub(1),
        found: address.camera,
    })
}

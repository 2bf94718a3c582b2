//! Sets up fusion from the configuration.

use roundel_core::{
    id::KindId,
    pose::flatness_m,
    world::{BodyError, Fusion, FusionParams, Landmark},
};
use thiserror::Error;

use crate::model::config::{Config, ObjectConfig, ObjectRoundels, ReferenceConfig};

/// A configured object that fusion cannot track.
#[derive(Debug, Error)]
#[error("object \"{name}\": {source}")]
pub struct ObjectError {
    pub name: String,
    pub source: BodyError,
}

/// Fusion with the configured objects, motions and landmarks. Bodies have the numbers of [`BodyTable`](crate::fusion::camera_manager::bodies::BodyTable).
pub fn fusion_machine(config: &Config) -> Result<Fusion, ObjectError> {
    let mut fusion = Fusion::new(fusion_params(config));
    for (index, class) in config.motions.iter().enumerate() {
        fusion.set_motion(KindId(u16::try_from(index).unwrap_or(u16::MAX)), *class);
    }
    for (index, (kind, tolerance)) in config.kinds.iter().zip(&config.tolerances).enumerate() {
        let id = KindId(u16::try_from(index).unwrap_or(u16::MAX));
        fusion.set_print_tolerance(id, *tolerance, flatness_m(kind));
    }
    for ObjectConfig { name, carries } in &config.objects {
        match carries {
            ObjectRoundels::Kind { kind, offset_m, motion } => {
                fusion.set_offset(*kind, *offset_m);
                if let Some(class) = motion {
                    fusion.set_motion(*kind, *class);
                }
            }
            ObjectRoundels::Body(body) => {
                let named = |source| ObjectError { name: name.clone(), source };
                fusion.add_body(body.clone()).map_err(named)?;
            }
        }
    }
    fusion.set_landmarks(landmarks(config));
    Ok(fusion)
}

pub fn fusion_params(config: &Config) -> FusionParams {
    let ns = |seconds: f64| (seconds * 1e9).round() as i64;
    let defaults = FusionParams::default();
    FusionParams {
        acceleration_m_s2: config.fusion.acceleration_m_s2,
        focal_deviation: config.fusion.focal_deviation,
        late_window_ns: ns(config.fusion.late_window_s),
        predicted_after_ns: ns(config.fusion.predicted_after_s),
        lost_after_ns: ns(config.fusion.lost_after_s),
        max_objects: config.limits.max_objects,
        // Without the camera monitor, nothing releases a camera that is held back.
        held_back_ns: if config.server.monitors_cameras { defaults.held_back_ns } else { 0 },
        ..defaults
    }
}

/// The reference roundels, in the order of the configuration.
pub fn landmarks(config: &Config) -> Vec<Landmark> {
    let landmark = |reference: &ReferenceConfig| Landmark {
        orientation: reference.orientation,
        position_deviation_m: reference.deviation_m,
        ..Landmark::new(reference.kind, reference.code, reference.position_m)
    };
    config.references.iter().map(landmark).collect()
}

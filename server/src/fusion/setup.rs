//! From the configuration to what the parts of a server are told of all but cameras: fusion, the hub.

use roundel_core::{
    id::KindId,
    time::Timestamp,
    world::{BodyError, Fusion, FusionParams, Landmark},
};

use thiserror::Error;

use crate::{
    fusion::camera_manager::{bodies::BodyTable, kind_names, setup::camera_info},
    model::{
        config::{Config, ObjectConfig, ObjectRoundels, ReferenceConfig},
        hub::Installation,
    },
};

/// A configured object that fusion cannot track.
#[derive(Debug, Error)]
#[error("object \"{name}\": {source}")]
pub struct ObjectError {
    pub name: String,
    pub source: BodyError,
}

/// What the hub says of the installation.
pub fn installation(config: &Config, started: Timestamp) -> Installation {
    let unique = started.as_ns() as u64 ^ (u64::from(std::process::id()) << 32).rotate_left(16);
    Installation {
        name: config.name.clone(),
        source_id: format!("{}-{unique:016x}", config.name),
        started,
        snapshot_rate_hz: config.server.snapshot_rate_hz,
        cameras: Installation::number_cameras(
            config.cameras.iter().map(|camera| camera_info(camera, config)),
        ),
        kinds: config.kinds.iter().map(|kind| kind.name.clone()).collect(),
        object_names: kind_names(&config.objects),
        body_names: BodyTable::of(&config.objects).names,
    }
}

/// A fusion machine as it is at a start: it knows objects, whose bodies it numbers as [`BodyTable`] does, motions and
/// landmarks.
pub fn fusion_machine(config: &Config) -> Result<Fusion, ObjectError> {
    let ns = |seconds: f64| (seconds * 1e9).round() as i64;
    let defaults = FusionParams::default();
    let mut fusion = Fusion::new(FusionParams {
        acceleration_m_s2: config.fusion.acceleration_m_s2,
        late_window_ns: ns(config.fusion.late_window_s),
        predicted_after_ns: ns(config.fusion.predicted_after_s),
        lost_after_ns: ns(config.fusion.lost_after_s),
        max_objects: config.limits.max_objects,
        // Nobody would judge who is held back.
        held_back_ns: if config.server.monitors_cameras { defaults.held_back_ns } else { 0 },
        ..defaults
    });
    for (index, class) in config.motions.iter().enumerate() {
        fusion.set_motion(KindId(u16::try_from(index).unwrap_or(u16::MAX)), *class);
    }
    for ObjectConfig { name, carries } in &config.objects {
        match carries {
            ObjectRoundels::Kind { kind, offset_m, motion } => {
                fusion.set_offset(*kind, *offset_m);
                motion.iter().for_each(|class| fusion.set_motion(*kind, *class));
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

/// The reference roundels, in the order of the configuration.
pub fn landmarks(config: &Config) -> Vec<Landmark> {
    let landmark = |reference: &ReferenceConfig| Landmark {
        orientation: reference.orientation,
        position_deviation_m: reference.deviation_m,
        ..Landmark::new(reference.kind, reference.code, reference.position_m)
    };
    config.references.iter().map(landmark).collect()
}

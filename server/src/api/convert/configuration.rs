//! The whole configuration.

use roundel_core::{
    id::KindId,
    marker::{Kind, Pattern},
    world::MotionClass,
};
use roundel_proto::v1;

use crate::model::convert::{quaternion, vector};
use crate::{
    fusion::camera_manager::{ActiveConfig, ApplyPlan},
    model::config::{
        Config, MODES, POLARITIES, Problem, ReferenceConfig,
        edit::{EditError, read_all},
        word,
    },
};

pub fn configuration(in_force: ActiveConfig) -> Result<v1::Configuration, EditError> {
    let ActiveConfig { text, config } = in_force;
    let (cameras, objects) = (read_all(&text)?, read_all(&text)?);
    let motion = |index: usize| config.motions.get(index).copied().unwrap_or_default();
    let kinds = config.kinds.iter().enumerate();
    let millis = |seconds: f64| (seconds * 1e9).round() * 1e-6;
    Ok(v1::Configuration {
        toml: text,
        version: config.file.version(),
        kept: config.file.kept(),
        name: config.name.clone(),
        cameras,
        objects,
        roundels: kinds.map(|(index, kind)| roundel(kind, motion(index))).collect(),
        references: config.references.iter().map(|it| reference(it, &config)).collect(),
        server: Some(v1::ServerSetup {
            listen: config.server.listen.to_string(),
            snapshot_rate_hz: config.server.snapshot_rate_hz,
            calibration: config
                .server
                .calibration
                .as_ref()
                .map(|path| path.display().to_string())
                .unwrap_or_default(),
            watch: config.server.monitors_cameras,
            setup: config.server.setup,
            allow_origins: config.server.allow_origins.clone(),
            prompt: config.server.publishes_per_frame,
        }),
        detection: Some(v1::DetectionSetup { mode: word(&MODES, config.mode).to_owned() }),
        fusion: Some(v1::FusionSetup {
            acceleration_m_s2: config.fusion.acceleration_m_s2,
            late_window_ms: millis(config.fusion.late_window_s),
            predicted_after_ms: millis(config.fusion.predicted_after_s),
            lost_after_ms: millis(config.fusion.lost_after_s),
        }),
        limits: Some(v1::LimitsSetup {
            max_objects: count(config.limits.max_objects),
            max_roundels_per_camera: count(config.limits.max_roundels_per_camera),
            max_clients: count(config.limits.max_clients),
        }),
    })
}

pub fn configuration_check(found: Result<ApplyPlan, Vec<Problem>>) -> v1::ConfigurationCheck {
    match found {
        Ok(ApplyPlan { changes, needs_restart }) => {
            v1::ConfigurationCheck { problems: Vec::new(), changes, needs_restart }
        }
        Err(problems) => v1::ConfigurationCheck {
            problems: problems.into_iter().map(problem).collect(),
            ..v1::ConfigurationCheck::default()
        },
    }
}

fn problem(problem: Problem) -> v1::ConfigurationProblem {
    let Problem { message, help, place } = problem;
    let (line, column, width) =
        place.as_ref().map_or((0, 0, 0), |place| (place.line, place.column, place.width));
    v1::ConfigurationProblem {
        message,
        help: help.unwrap_or_default(),
        line: count(line),
        column: count(column),
        text: place.map(|place| place.text).unwrap_or_default(),
        width: count(width),
    }
}

fn roundel(kind: &Kind, motion: MotionClass) -> v1::RoundelSetup {
    let mm = |metres: f64| (metres * 1e9).round() * 1e-6;
    let (layout, minor_m) = match kind.pattern {
        Pattern::Plain => (None, None),
        Pattern::Coded(layout) => (Some(layout), None),
        Pattern::Elliptical { minor_diameter_m } => (None, Some(minor_diameter_m)),
    };
    let (motion, height_m) = match motion {
        MotionClass::Free => ("free", None),
        MotionClass::Ground { height_m } => ("ground", height_m),
    };
    v1::RoundelSetup {
        name: kind.name.clone(),
        outer_mm: mm(kind.outer_diameter_m),
        inner_mm: mm(kind.inner_diameter_m),
        inner_minor_mm: minor_m.map(mm),
        code_bits: layout.map(|layout| u32::from(layout.bits)),
        code_min_distance: layout.map(|layout| u32::from(layout.min_distance)),
        polarity: word(&POLARITIES, kind.polarity).to_owned(),
        motion: motion.to_owned(),
        height_m,
    }
}

fn reference(reference: &ReferenceConfig, config: &Config) -> v1::ReferenceSetup {
    let KindId(kind) = reference.kind;
    let kind = config.kinds.get(usize::from(kind));
    v1::ReferenceSetup {
        roundel: kind.map(|kind| kind.name.clone()).unwrap_or_default(),
        code: reference.code.map(|code| code.number.into()),
        position_m: Some(vector(&reference.position_m)),
        uncertainty_mm: (reference.deviation_m * 1e9).round() * 1e-6,
        orientation: reference.orientation.as_ref().map(quaternion),
    }
}

fn count(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

//! A lens from a recording: one camera's sightings of coded roundels, matched to trajectories from the other cameras.

use std::{fmt::Write as _, path::Path, process::ExitCode, time::Duration};

use anyhow::Context;
use roundel_core::calib::lens::moving::{MovingInput, MovingLens, calibrate};
use serde_json::json;

use super::lens::{self, LensArgs};
use crate::{
    app::cli::{Format, progress_bar},
    archive::replay::correspondences::{Correspondences, correspondences},
};

pub(super) fn run(arguments: &LensArgs, file: &Path, camera: &str) -> anyhow::Result<ExitCode> {
    let bar = progress_bar(None, "{spinner} {msg}")?;
    let correspondences = correspondences(file, camera, |seconds| {
        bar.set_message(format!("fusing the other cameras' observations: {seconds:.1} s"));
        bar.tick();
    })?;
    let Correspondences { size, trajectories, observations, clock, damage, .. } = &correspondences;
    for sentence in damage {
        bar.suspend(|| eprintln!("{}: damaged: {sentence}", file.display()));
    }
    bar.set_message(format!("solving: {} sightings", observations.len()));
    bar.enable_steady_tick(Duration::from_millis(200));
    let input = MovingInput { size: *size, trajectories, observations, clock: *clock };
    let found = calibrate(&input, arguments.model);
    bar.finish_and_clear();
    let found = found
        .with_context(|| format!("no lens was found: {}", summary(camera, &correspondences)))?;
    let text = match arguments.format {
        Format::Json => format!("{}\n", report(&found, &correspondences)),
        Format::Table => table(&found, &summary(camera, &correspondences))?,
    };
    lens::write_results(arguments, &found.lens, camera, &text)?;
    Ok(ExitCode::SUCCESS)
}

fn summary(camera: &str, correspondences: &Correspondences) -> String {
    let Correspondences { trajectories, observations, frames, unmatched, .. } = correspondences;
    format!(
        "{frames} frames of \"{camera}\", {} sightings of {} roundels that other cameras saw, {unmatched} of other roundels",
        observations.len(),
        trajectories.len()
    )
}

fn report(found: &MovingLens, correspondences: &Correspondences) -> serde_json::Value {
    let mut report = lens::report(&found.lens);
    let place = found.world_from_camera;
    let deviations: Vec<f64> =
        found.pose_covariance.diagonal().iter().map(|it| it.max(0.0).sqrt()).collect();
    let more = json!({
        "frames": correspondences.frames,
        "sightings": found.sightings,
        "unwitnessed": correspondences.unmatched,
        "roundels": correspondences.trajectories.len(),
        "coverage": found.coverage(),
        "depths_m": found.depths_m,
        "position_m": place.translation.vector.as_slice(),
        "orientation_xyzw": place.rotation.coords.as_slice(),
        "pose_deviations": deviations,
        "clock_late_s": {"value": found.offset_s.0, "deviation": found.offset_s.1},
        "rim_deviation_px": found.estimated_noise.0,
        "stamp_deviation_s": found.estimated_noise.1,
        "missing": found.missing.iter().map(ToString::to_string).collect::<Vec<_>>(),
    });
    if let (Some(report), serde_json::Value::Object(more)) = (report.as_object_mut(), more) {
        report.extend(more);
    }
    report
}

fn table(found: &MovingLens, summary: &str) -> anyhow::Result<String> {
    let mut text = String::new();
    let [nearest_m, farthest_m] = found.depths_m;
    writeln!(text, "{summary}")?;
    writeln!(
        text,
        "{} sightings used, {} left out, {nearest_m:.2} to {farthest_m:.2} m from the camera; rms {:.3} px; {} % of the \
         picture covered",
        found.sightings,
        found.lens.outliers,
        found.lens.rms_px,
        (found.coverage() * 100.0).round()
    )?;
    lens::write_parameters(&mut text, &found.lens)?;
    lens::write_evidence(&mut text, &found.lens)?;
    let place = found.world_from_camera.translation.vector;
    let deviation = |first: usize| {
        let variances = found.pose_covariance.diagonal();
        (variances.rows(first, 3).sum().max(0.0) / 3.0).sqrt()
    };
    writeln!(
        text,
        "position ({:.4}, {:.4}, {:.4}) m ± {:.1} mm, rotation ± {:.3}°; time stamps {:.2} ± {:.2} ms late",
        place.x,
        place.y,
        place.z,
        deviation(0) * 1e3,
        deviation(3).to_degrees(),
        found.offset_s.0 * 1e3,
        found.offset_s.1 * 1e3
    )?;
    lens::write_missing(&mut text, &found.missing)?;
    Ok(text)
}

//! Report and progress of an arena calibration as text.

use std::fmt::{self, Write as _};

use roundel_proto::v1;

/// A line for each camera, the findings, and whether the result is in use.
pub(super) fn table(
    calibration: &v1::Calibration,
    report: &v1::CalibrationReport,
) -> Result<String, fmt::Error> {
    let mut out = String::new();
    let v1::CalibrationReport { sightings, roundels, length_s, steps, solve_s, .. } = report;
    writeln!(
        out,
        "{sightings} sightings of {roundels} roundels in {length_s:.0} s; {steps} steps in {solve_s:.1} s\n"
    )?;
    let width = report.cameras.iter().map(|it| it.camera.chars().count()).max().unwrap_or(0).max(6);
    writeln!(
        out,
        "{:width$} {:>28} {:>20} {:>19} {:>8} {:>6} {:>5} {:>10}",
        "camera", "position m", "moved", "deviation", "error px", "ratio", "seen", "clock ms"
    )?;
    for camera in &report.cameras {
        let place = camera.pose.and_then(|pose| pose.position).unwrap_or_default();
        let place = format!("{:.4} {:.4} {:.4}", place.x, place.y, place.z);
        let moved = match (camera.moved_m, camera.turned_rad) {
            (Some(moved_m), Some(turned_rad)) => {
                format!("{:.1} mm {:.3}°", moved_m * 1e3, turned_rad.to_degrees())
            }
            _ => "was unknown".to_owned(),
        };
        let deviation = format!(
            "{:.2} mm {:.4}°",
            camera.position_deviation_m * 1e3,
            camera.rotation_deviation_rad.to_degrees()
        );
        writeln!(
            out,
            "{:width$} {place:>28} {moved:>20} {deviation:>19} {:>8.2} {:>6.2} {:>4.0}% {:>10.2}",
            camera.camera,
            camera.reprojection_px,
            camera.error_ratio,
            camera.coverage * 1e2,
            camera.clock_offset_ms,
        )?;
    }
    if !report.findings.is_empty() {
        writeln!(out)?;
    }
    for finding in &report.findings {
        let sign = if finding.grave { "!!" } else { " -" };
        writeln!(out, "{sign} {}", finding.message)?;
    }
    let outcome = match calibration.applied_version {
        0 if report.sound => "Not applied (`--apply never`)".to_owned(),
        0 => "Not applied, because of the findings marked !!. Fix them and calibrate again, or apply the result \
              anyway with `--apply always` or in the dashboard."
            .to_owned(),
        version => format!("Applied as version {version}."),
    };
    writeln!(out, "\n{outcome}")?;
    Ok(out)
}

/// Recorded time, and the most urgent problem of the recording.
pub(super) fn recorded(calibration: &v1::Calibration) -> String {
    let seconds = format!("{:.0} of {:.0} s", calibration.recorded_s, calibration.seconds);
    let alone = calibration.recorded.iter().find(|camera| camera.together.is_empty());
    match alone {
        None if calibration.recorded.is_empty() => seconds,
        None => format!("{seconds}, every camera shares robots with another"),
        Some(camera) if camera.frames == 0 => {
            format!("{seconds}, {} delivers no frames", camera.camera)
        }
        // Roundels without codes are matched only after the recording.
        Some(_) if calibration.recorded.iter().all(|camera| camera.codes == 0) => seconds,
        Some(camera) => {
            format!("{seconds}, {} shares no code with another camera yet", camera.camera)
        }
    }
}

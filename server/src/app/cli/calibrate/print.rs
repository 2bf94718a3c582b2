//! A calibration in words and columns.

use std::io::{self, Write};

use roundel_proto::v1;

/// The answer as REST gives it, one line.
pub(super) fn json(out: &mut impl Write, calibration: &v1::Calibration) -> io::Result<()> {
    serde_json::to_writer(&mut *out, calibration)?;
    writeln!(out)
}

/// A line for each camera, then what a person should know.
pub(super) fn table(
    out: &mut impl Write,
    calibration: &v1::Calibration,
    report: &v1::CalibrationReport,
) -> io::Result<()> {
    let v1::CalibrationReport { sightings, roundels, length_s, steps, solve_s, .. } = report;
    writeln!(
        out,
        "{sightings} sightings of {roundels} roundels in {length_s:.0} s; {steps} steps in {solve_s:.1} s\n"
    )?;
    let width = report.cameras.iter().map(|it| it.camera.chars().count()).max().unwrap_or(0).max(6);
    writeln!(
        out,
        "{:width$} {:>28} {:>20} {:>19} {:>8} {:>6} {:>5} {:>10}",
        "camera", "place m", "moved", "deviation", "error px", "ratio", "seen", "clock ms"
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
    writeln!(out, "\n{}", outcome(calibration, report))
}

fn outcome(calibration: &v1::Calibration, report: &v1::CalibrationReport) -> String {
    match calibration.applied_version {
        0 if report.sound => "The cameras stay as they were: nobody asked them to change.".to_owned(),
        0 => "The cameras stay as they were, because of the findings marked !!. Mend them and calibrate again, \
              or let the cameras take this over with `--apply always`, or by the dashboard."
            .to_owned(),
        version => format!("In use as version {version}."),
    }
}

/// What has been recorded, and what is missing most.
pub(super) fn recorded(calibration: &v1::Calibration) -> String {
    let seconds = format!("{:.0} of {:.0} s", calibration.recorded_s, calibration.seconds);
    let alone = calibration.recorded.iter().find(|camera| camera.together.is_empty());
    match alone {
        None if calibration.recorded.is_empty() => seconds,
        None => format!("{seconds}, every camera shares robots with another"),
        Some(camera) if camera.frames == 0 => {
            format!("{seconds}, {} gives no frames", camera.camera)
        }
        // Those without codes are told apart once all is recorded.
        Some(_) if calibration.recorded.iter().all(|camera| camera.codes == 0) => seconds,
        Some(camera) => format!("{seconds}, {} shares no code with any other yet", camera.camera),
    }
}

/// A line for a log.
pub(super) fn stage(calibration: &v1::Calibration) {
    match calibration.stage() {
        v1::CalibrationStage::Recording => {
            eprintln!("recording for {:.0} s: let robots drive", calibration.seconds);
        }
        v1::CalibrationStage::Solving => eprintln!("solving; {}", recorded(calibration)),
        _ => {}
    }
}

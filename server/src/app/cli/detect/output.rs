//! The output formats of `roundel detect`.

use std::{
    io::{self, Write},
    path::Path,
};

use roundel_core::{
    ellipse::Ellipse,
    marker::{RejectCounts, Rejected},
    rigid::upper_triangle,
};
use serde_json::{Value, json};

use super::search::{ImageDetections, Roundel};
use crate::{app::cli::error_chain, model::reason};

/// One line for each image, including those that failed.
pub(super) fn json(
    out: &mut impl Write,
    path: &Path,
    outcome: &anyhow::Result<ImageDetections>,
    explain: bool,
) -> io::Result<()> {
    let found = outcome.as_ref().ok();
    let mut line = json!({
        "image": path.to_string_lossy(),
        "width": found.map(|found| found.image.width),
        "height": found.map(|found| found.image.height),
        "elapsed_us": found.map(|found| (found.elapsed_us * 10.0).round() / 10.0),
        "detections": found.map_or(Vec::new(), |it| it.roundels.iter().map(roundel).collect()),
    });
    match outcome {
        Err(error) => line["error"] = json!(error_chain(error)),
        Ok(found) if explain => {
            line["rejects"] = rejects(&found.rejects);
            line["rejected"] = found.rejected.iter().map(rejected).collect();
        }
        Ok(_) => {}
    }
    writeln!(out, "{line}")
}

fn roundel(roundel: &Roundel) -> Value {
    let ring = &roundel.ring;
    let pose = roundel.pose.as_ref();
    json!({
        "id": ring.code.map(|reading| reading.code.number),
        "center_px": [ring.outer.center.u, ring.outer.center.v],
        "outer": rim(&ring.outer),
        "inner": rim(&ring.inner),
        "position_m": pose.map(|pose| pose.position_m.as_slice().to_vec()),
        "normal": pose.map(|pose| pose.normal.as_slice().to_vec()),
        "normal_likelihood": pose.map(|pose| pose.normal_likelihood),
        "other_normal": pose.map(|pose| pose.other_normal.as_slice().to_vec()),
        "yaw_rad": pose.and_then(|pose| pose.yaw_rad),
        "yaw_symmetry": pose.and_then(|pose| pose.yaw_rad.map(|_| pose.yaw_symmetry)),
        "covariance": pose.map(|pose| upper_triangle(&pose.covariance)),
        "threshold": ring.threshold,
        "track": roundel.track.map(|track| track.0),
    })
}

fn rim(ellipse: &Ellipse) -> Value {
    json!({
        "semi_major_px": ellipse.semi_major_px,
        "semi_minor_px": ellipse.semi_minor_px,
        "angle_rad": ellipse.angle_rad,
    })
}

/// Numbers of rejected candidates by reason, in the order of the stages.
fn rejects(counts: &RejectCounts) -> Value {
    let counts = counts.iter().filter(|(_, count)| *count > 0);
    counts.map(|(reject, count)| (reject.reason(), count)).collect()
}

fn rejected(rejected: &Rejected) -> Value {
    json!({
        "reason": rejected.reject.reason(),
        "center_px": [rejected.center.u, rejected.center.v],
        "half_box_px": [rejected.half_box_px.0, rejected.half_box_px.1],
    })
}

/// A heading for each image and a row for each roundel; the error of a failed image goes to stderr.
pub(super) fn table(
    out: &mut impl Write,
    path: &Path,
    outcome: &anyhow::Result<ImageDetections>,
    explain: bool,
) -> io::Result<()> {
    let Ok(found) = outcome else { return writeln!(out, "{}: failed", path.display()) };
    writeln!(
        out,
        "{}: {} x {}, {} found in {:.0} µs",
        path.display(),
        found.image.width,
        found.image.height,
        found.roundels.len(),
        found.elapsed_us,
    )?;
    if !found.roundels.is_empty() {
        writeln!(
            out,
            "  {:>5} {:>5} {:>17} {:>15} {:>15} {:>26} {:>23}",
            "track", "id", "centre px", "outer px", "inner px", "position m", "normal"
        )?;
    }
    let semiaxes = |rim: &Ellipse| format!("{:.2} x {:.2}", rim.semi_major_px, rim.semi_minor_px);
    for Roundel { track, ring, pose } in &found.roundels {
        let track = track.map_or("–".to_owned(), |track| track.to_string());
        let id = ring.code.map_or("–".to_owned(), |reading| reading.code.number.to_string());
        let (center, outer, inner) =
            (ring.outer.center, semiaxes(&ring.outer), semiaxes(&ring.inner));
        let (mut position, mut normal) = ("–".to_owned(), "–".to_owned());
        if let Some(pose) = pose {
            let (p, n) = (&pose.position_m, &pose.normal);
            position = format!("{:>8.4} {:>8.4} {:>8.4}", p.x, p.y, p.z);
            normal = format!("{:>7.3} {:>7.3} {:>7.3}", n.x, n.y, n.z);
        }
        writeln!(
            out,
            "  {track:>5} {id:>5} {:>8.2} {:>8.2} {outer:>15} {inner:>15} {position:>26} {normal:>23}",
            center.u, center.v
        )?;
    }
    if explain {
        writeln!(out, "  rejected candidates: {}", found.rejects.total())?;
        for (reject, count) in found.rejects.iter().filter(|(_, count)| *count > 0) {
            let word = reason::reject_name(reject, ' ');
            writeln!(out, "  {count:>7}  {word:15} {}", reject.reason())?;
        }
    }
    Ok(())
}

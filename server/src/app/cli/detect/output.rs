//! How `roundel detect` prints.

use std::{
    io::{self, Write},
    path::Path,
};

use roundel_core::{
    ellipse::Ellipse,
    marker::{RejectCounts, Rejected},
    rigid::upper_triangle,
};
use serde_json::{Map, Value, json};

use super::search::{ImageDetections, Roundel};
use crate::{app::cli::error_chain, model::reason};

/// One line, whatever became of the image.
pub(super) fn json(
    out: &mut impl Write,
    path: &Path,
    outcome: &anyhow::Result<ImageDetections>,
    explain: bool,
) -> io::Result<()> {
    let mut line = match outcome {
        Ok(found) => json!({
            "image": path.to_string_lossy(),
            "width": found.image.width,
            "height": found.image.height,
            "elapsed_us": round_us(found.elapsed_us),
            "detections": found.roundels.iter().map(roundel).collect::<Vec<_>>(),
        }),
        Err(error) => json!({
            "image": path.to_string_lossy(),
            "width": null,
            "height": null,
            "elapsed_us": null,
            "detections": [],
            "error": error_chain(error),
        }),
    };
    if let (Some(line), Ok(found), true) = (line.as_object_mut(), outcome, explain) {
        line.insert("rejects".to_owned(), rejects(&found.rejects));
        line.insert("rejected".to_owned(), found.rejected.iter().map(rejected).collect());
    }
    writeln!(out, "{line}")
}

fn round_us(microseconds: f64) -> f64 {
    (microseconds * 10.0).round() / 10.0
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

/// Refused candidates by reason, in the order of the stages.
fn rejects(counts: &RejectCounts) -> Value {
    let counted: Map<String, Value> = counts
        .iter()
        .filter(|(_, count)| *count > 0)
        .map(|(reject, count)| (reject.reason().to_owned(), count.into()))
        .collect();
    counted.into()
}

/// Where a candidate was, how large it was thought to be, and why it died.
fn rejected(rejected: &Rejected) -> Value {
    json!({
        "reason": rejected.reject.reason(),
        "center_px": [rejected.center.u, rejected.center.v],
        "half_box_px": [rejected.half_box_px.0, rejected.half_box_px.1],
    })
}

/// A heading for each image, and a row for each roundel.
pub(super) fn table(
    out: &mut impl Write,
    path: &Path,
    outcome: &anyhow::Result<ImageDetections>,
    explain: bool,
) -> io::Result<()> {
    // The error stands on stderr.
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
    for roundel in &found.roundels {
        row(out, roundel)?;
    }
    if explain {
        writeln!(out, "  refused candidates: {}", found.rejects.total())?;
        for (reject, count) in found.rejects.iter().filter(|(_, count)| *count > 0) {
            let word = reason::reject_name(reject, ' ');
            writeln!(out, "  {count:>7}  {word:15} {}", reject.reason())?;
        }
    }
    Ok(())
}

fn row(out: &mut impl Write, roundel: &Roundel) -> io::Result<()> {
    let track = roundel.track.map_or_else(|| "–".to_owned(), |track| track.to_string());
    let id = roundel.ring.code.map_or("–".to_owned(), |reading| reading.code.number.to_string());
    let center = roundel.ring.outer.center;
    let semiaxes = |rim: &Ellipse| format!("{:.2} x {:.2}", rim.semi_major_px, rim.semi_minor_px);
    write!(
        out,
        "  {track:>5} {id:>5} {:>8.2} {:>8.2} {:>15} {:>15}",
        center.u,
        center.v,
        semiaxes(&roundel.ring.outer),
        semiaxes(&roundel.ring.inner),
    )?;
    match &roundel.pose {
        Some(pose) => {
            let (p, n) = (&pose.position_m, &pose.normal);
            writeln!(
                out,
                " {:>8.4} {:>8.4} {:>8.4} {:>7.3} {:>7.3} {:>7.3}",
                p.x, p.y, p.z, n.x, n.y, n.z
            )
        }
        None => writeln!(out, " {:>26} {:>23}", "–", "–"),
    }
}

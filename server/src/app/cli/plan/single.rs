//! One camera and one kind of roundel: range, accuracy and time with the paper's prediction, or the smallest roundel that
//! meets a required accuracy.

use anyhow::Context;
use roundel_core::{
    camera::{Intrinsics, Lens, NormalizedPoint},
    marker::Kind,
    plan::{
        Sensor,
        paper::{self, Pinhole},
        precision::predict,
        range::{detection_range, pose_in_front},
        search::{scaled, smallest_diameter_m},
    },
};
use serde_json::{Value, json};

use super::{
    PlanArgs,
    inputs::{self, timing_case},
    report::{self, fields_deg, times_source},
};
use crate::model::config::{MODES, word};

pub(super) fn run(arguments: &PlanArgs) -> anyhow::Result<()> {
    let (sensor, name) = inputs::sensor(arguments)?;
    let mut kind = arguments.kind()?;
    let tilt_rad = arguments.tilt().to_radians();
    let was_searched = arguments.precision.is_some() && arguments.marker.is_none();
    if was_searched {
        let distance_m = arguments.distance.context(
            "--precision: the required roundel depends on its distance: add --distance M",
        )?;
        let most_m = arguments.most_m();
        kind = scaled(&kind, smallest_diameter_m(&sensor, &kind, distance_m, tilt_rad, most_m)?);
    }
    let range = detection_range(&sensor, &kind, tilt_rad)?;
    let distance_m = arguments.distance.unwrap_or(0.5 * (range.min_m + range.max_m));
    let pose = pose_in_front(NormalizedPoint::default(), distance_m, tilt_rad);
    let expected = predict(&sensor, &kind, &pose).with_context(|| {
        format!(
            "--distance: a roundel of {:.0} mm tilted by {:.0}° is detected from {:.2} to {:.2} m, not at {distance_m} m",
            kind.outer_diameter_m * 1e3,
            tilt_rad.to_degrees(),
            range.min_m,
            range.unread.map_or(range.max_m, |ring| ring.max_m)
        )
    })?;
    let ring = &expected.image.ring.outer;
    // Tilt does not change the longer diameter.
    let per_m = 2.0 * ring.semi_major_px / kind.outer_diameter_m;
    let diameter_px = 2.0 * ring.mean_radius_px();
    let case = timing_case(arguments, &sensor, &kind, diameter_px, per_m)?;
    let times = case.measure()?;
    let (frame_s, frame_p95_s) = (times.median_s(arguments.lost()), times.p95_s(arguments.lost()));
    let report = json!({
        "outer_m": kind.outer_diameter_m,
        "inner_m": kind.inner_diameter_m,
        "code": report::code(&kind),
        "outer_was_searched": was_searched,
        "tilt_deg": arguments.tilt(),
        "least_distance_m": range.min_m,
        "most_distance_m": range.max_m,
        "most_corner_distance_m": range.max_corner_m,
        "base_m": range.base_m,
        "least_minor_px": range.min_minor_px,
        "code_unread": range.unread.map(|ring| {
            json!({"most_distance_m": ring.max_m, "least_minor_px": ring.min_minor_px})
        }),
        "distance_m": distance_m,
        "minor_px": expected.image.minor_px,
        "code_is_read": range.unread.map(|_| expected.is_readable),
        "depth_deviation_m": expected.depth_m(),
        "across_deviation_m": expected.across_m(),
        "position_deviation_m": expected.position_m(),
        "normal_deviation_deg": expected.normal_rad().to_degrees(),
        "motion_px": case.motion_px,
        "frame_s": frame_s,
        "frame_p95_s": frame_p95_s,
        "frames_per_s": 1.0 / frame_s,
        "roundels_timed": times.followed,
        "times": times_source(arguments, &times),
        "lens_uncertainty_known": sensor.lens_uncertainty.is_some(),
        "paper": paper(&sensor, &kind, tilt_rad, distance_m),
    });
    let at_least = if was_searched { "at least " } else { "" };
    let [wide, high] = fields_deg(&sensor.camera)
        .map(|deg| deg.map_or("?".to_owned(), |deg| format!("{deg:.1}°")));
    let heading = format!(
        "camera     {name}, {} x {} px, {wide} x {high}, noise {} levels, blur {} px, {} mode\n\
         roundel    {at_least}{}, tilted by {}°\n",
        sensor.camera.width(),
        sensor.camera.height(),
        sensor.imaging.noise,
        sensor.imaging.blur_px,
        word(&MODES, sensor.mode),
        report::roundel(&kind),
        arguments.tilt()
    );
    arguments.format.print(&report, |report| heading + &table(arguments, report))
}

/// Predictions for the same camera in the paper's model.
fn paper(sensor: &Sensor, kind: &Kind, tilt_rad: f64, distance_m: f64) -> Value {
    let Intrinsics { width, height, fx_px, fy_px, cx_px, cy_px, lens } = sensor.camera.intrinsics();
    let shrink = match lens {
        Lens::PlumbBob(coefficients) => {
            paper::shrink(*coefficients, [cx_px / fx_px, cy_px / fy_px])
        }
        _ => [1.0; 2],
    };
    let pinhole = Pinhole {
        size_px: [*width as f64, *height as f64],
        focal_px: [*fx_px, *fy_px],
        outer_m: kind.outer_diameter_m,
        tilt_rad: [tilt_rad, 0.0],
        min_px: paper::MIN_DIAMETER_PX,
        shrink,
    };
    // Equation (19) with the paper's Δe₀ and an exact lens.
    let untilted = Pinhole { tilt_rad: [0.0; 2], ..pinhole };
    let semi_major_px = 0.5 * untilted.pattern_px(distance_m)[0];
    let depth_share = paper::range_share(0.0, paper::AXIS_ERROR_PX, semi_major_px, 0.0);
    json!({
        "least_distance_m": pinhole.min_distance_m(),
        "most_distance_m": pinhole.max_distance_m(),
        "most_corner_distance_m": pinhole.max_corner_distance_m(),
        "base_m": pinhole.base_m(),
        "least_minor_px": pinhole.min_px,
        "depth_deviation_m": depth_share * distance_m,
    })
}

/// Label, places of the values of plan and paper in the report, and their format.
type Row<'a> = (&'a str, &'a str, &'a str, fn(&Value) -> String);

/// A line for each value that the report has, with the paper's prediction beside it.
fn table(arguments: &PlanArgs, report: &Value) -> String {
    let is_coded = !report["code_unread"].is_null();
    let farthest = if is_coded { "maximum distance, code read" } else { "maximum distance" };
    let [on_axis, corners] = ["on axis", "corners"].map(|place| format!("{farthest}, {place}"));
    let found_px = if is_coded { "/code_unread/least_minor_px" } else { "/least_minor_px" };
    let read_px = if is_coded { "/least_minor_px" } else { "" };
    let place = format!("diameter at {}", metres(&report["distance_m"]));
    let time = format!("time per frame, {} roundels", arguments.count());
    let rows: [Row; 17] = [
        ("minimum distance, any rotation", "/least_distance_m", "/paper/least_distance_m", metres),
        (&on_axis, "/most_distance_m", "/paper/most_distance_m", metres),
        (&corners, "/most_corner_distance_m", "/paper/most_corner_distance_m", metres),
        ("  width x height covered there", "/base_m", "/paper/base_m", sides),
        ("maximum distance, code not read", "/code_unread/most_distance_m", "", metres),
        ("minimum diameter, code read", read_px, "", pixels),
        ("minimum diameter, detected", found_px, "/paper/least_minor_px", pixels),
        (&place, "/minor_px", "", pixels),
        ("  code", "/code_is_read", "", |read| {
            if *read == true { "read" } else { "not read" }.into()
        }),
        ("  rms error, distance", "/depth_deviation_m", "/paper/depth_deviation_m", millimetres),
        ("  rms error, across (2D)", "/across_deviation_m", "", millimetres),
        ("  rms error, position (3D)", "/position_deviation_m", "", millimetres),
        ("  rms error, normal", "/normal_deviation_deg", "", |deg| format!("{:.2}°", number(deg))),
        (&time, "/frame_s", "", milliseconds),
        ("  95th percentile", "/frame_p95_s", "", milliseconds),
        ("  motion per frame", "/motion_px", "", pixels),
        ("  frames per second, one core", "/frames_per_s", "", |rate| {
            format!("{:.0}", number(rate))
        }),
    ];
    let mut text = format!("\n{:36} {:>12} {:>12}\n", "", "plan", "paper");
    for (what, plan, paper, words) in rows {
        let value =
            |at: &str| Some(report.pointer(at)?).filter(|it| !at.is_empty() && !it.is_null());
        if let Some(plan) = value(plan) {
            let paper = value(paper).map(words).unwrap_or_default();
            text += &format!("{what:36} {:>12} {paper:>12}\n", words(plan));
        }
    }
    let lens = if report["lens_uncertainty_known"] == true {
        "The errors include the uncertainty of the lens."
    } else {
        "The lens is assumed to be exact: the camera file has no uncertainty."
    };
    text + &format!("\nTimes are {}.\n{lens}\n", report["times"].as_str().unwrap_or_default())
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn metres(length_m: &Value) -> String {
    format!("{:.2} m", number(length_m))
}

fn millimetres(length_m: &Value) -> String {
    format!("{:.3} mm", number(length_m) * 1e3)
}

fn milliseconds(time_s: &Value) -> String {
    format!("{:.3} ms", number(time_s) * 1e3)
}

fn pixels(length_px: &Value) -> String {
    format!("{:.1} px", number(length_px))
}

fn sides(sides_m: &Value) -> String {
    let [wide, high] = [0, 1].map(|axis| number(&sides_m[axis]).max(0.0));
    format!("{wide:.1} x {high:.1} m")
}

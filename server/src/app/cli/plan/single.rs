//! One camera and one kind of roundel: range, accuracy and time with the paper's prediction, or the smallest roundel that
//! meets a required accuracy.

use anyhow::{Context, bail};
use roundel_core::{
    camera::{Intrinsics, Lens, NormalizedPoint},
    marker::Kind,
    plan::{
        Sensor, paper,
        precision::{Prediction, predict},
        range::{DetectionRange, detection_range, pose_in_front},
        search::{scaled, smallest_diameter_m},
    },
};
use serde_json::{Value, json};

use super::{
    Format, PlanArgs, optics, roundel,
    timing::{times_source, timing_case},
};
use crate::{
    lab::plan::timing::FrameTimes,
    model::config::{MODES, word},
};

struct PlanResult {
    name: String,
    sensor: Sensor,
    kind: Kind,
    was_searched: bool,
    range: DetectionRange,
    distance_m: f64,
    expected: Prediction,
    motion_px: f64,
    times: FrameTimes,
    paper: paper::Pinhole,
}

pub(super) fn run(arguments: &PlanArgs) -> anyhow::Result<String> {
    let result = plan_camera(arguments)?;
    Ok(match arguments.format {
        Format::Table => result.table(arguments),
        Format::Json => format!("{:#}\n", result.json(arguments)),
    })
}

fn plan_camera(arguments: &PlanArgs) -> anyhow::Result<PlanResult> {
    let (sensor, name) = optics::sensor(arguments)?;
    let mut kind = arguments.kind()?;
    let tilt_rad = arguments.tilt().to_radians();
    let was_searched = arguments.precision.is_some() && arguments.marker.is_none();
    if was_searched {
        let Some(distance_m) = arguments.distance else {
            bail!("--precision: the required roundel depends on its distance: add --distance M");
        };
        let most_m = arguments.most_m();
        let outer_m = smallest_diameter_m(&sensor, &kind, distance_m, tilt_rad, most_m)?;
        kind = scaled(&kind, outer_m);
    }
    let range = detection_range(&sensor, &kind, tilt_rad)?;
    let distance_m = arguments.distance.unwrap_or(0.5 * (range.min_m + range.max_m));
    if !(distance_m > 0.0 && distance_m.is_finite()) {
        bail!("--distance: expected metres above 0, found {distance_m}");
    }
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
    Ok(PlanResult {
        paper: paper_pinhole(&sensor, &kind, tilt_rad),
        name,
        sensor,
        kind,
        was_searched,
        range,
        distance_m,
        expected,
        motion_px: case.motion_px,
        times: case.measure()?,
    })
}

/// The same camera in the paper's model.
fn paper_pinhole(sensor: &Sensor, kind: &Kind, tilt_rad: f64) -> paper::Pinhole {
    let Intrinsics { width, height, fx_px, fy_px, cx_px, cy_px, lens } = sensor.camera.intrinsics();
    let shrink = match lens {
        Lens::PlumbBob(coefficients) => {
            paper::shrink(*coefficients, [cx_px / fx_px, cy_px / fy_px])
        }
        _ => [1.0; 2],
    };
    paper::Pinhole {
        size_px: [*width as f64, *height as f64],
        focal_px: [*fx_px, *fy_px],
        outer_m: kind.outer_diameter_m,
        tilt_rad: [tilt_rad, 0.0],
        min_px: paper::MIN_DIAMETER_PX,
        shrink,
    }
}

impl PlanResult {
    /// Equation (19) with the paper's Δe₀ and an exact lens, metres.
    fn paper_depth_error_m(&self) -> f64 {
        let untilted = paper::Pinhole { tilt_rad: [0.0; 2], ..self.paper };
        let semi_major_px = 0.5 * untilted.pattern_px(self.distance_m)[0];
        paper::range_share(0.0, paper::AXIS_ERROR_PX, semi_major_px, 0.0) * self.distance_m
    }

    fn table(&self, arguments: &PlanArgs) -> String {
        let Self { sensor, kind, range, expected, paper, .. } = self;
        let camera = &sensor.camera;
        let field = |deg: Option<f64>| deg.map_or("?".to_owned(), |deg| format!("{deg:.1}°"));
        let [wide, high] = optics::fields_deg(camera).map(field);
        let mut lines = vec![
            format!(
                "camera     {}, {} x {} px, {wide} x {high}, noise {} levels, blur {} px, {} mode",
                self.name,
                camera.width(),
                camera.height(),
                sensor.imaging.noise,
                sensor.imaging.blur_px,
                word(&MODES, sensor.mode)
            ),
            format!(
                "roundel    {}{}, tilted by {}°",
                if self.was_searched { "at least " } else { "" },
                roundel::words(kind),
                arguments.tilt()
            ),
            String::new(),
            format!("{:36} {:>12} {:>12}", "", "plan", "paper"),
        ];
        let metres = |length: f64| format!("{length:.2} m");
        let pixels = |length: f64| format!("{length:.1} px");
        let millimetres = |length: f64| format!("{:.3} mm", length * 1e3);
        let milliseconds = |time_s: f64| format!("{:.3} ms", time_s * 1e3);
        let sides =
            |[wide, high]: [f64; 2]| format!("{:.1} x {:.1} m", wide.max(0.0), high.max(0.0));
        let mut row = |what: &str, plan: String, paper: Option<String>| {
            lines.push(format!("{what:36} {plan:>12} {:>12}", paper.unwrap_or_default()));
        };
        let (least, most) = (paper.min_distance_m(), paper.max_distance_m());
        row("minimum distance, any rotation", metres(range.min_m), Some(metres(least)));
        let farthest =
            if range.unread.is_some() { "maximum distance, code read" } else { "maximum distance" };
        row(&format!("{farthest}, on axis"), metres(range.max_m), Some(metres(most)));
        let papers_corner = metres(paper.max_corner_distance_m());
        row(&format!("{farthest}, corners"), metres(range.max_corner_m), Some(papers_corner));
        row("  width x height covered there", sides(range.base_m), Some(sides(paper.base_m())));
        if let Some(ring) = range.unread {
            row("maximum distance, code not read", metres(ring.max_m), None);
            row("minimum diameter, code read", pixels(range.min_minor_px), None);
        }
        let found_px = range.unread.map_or(range.min_minor_px, |ring| ring.min_minor_px);
        row("minimum diameter, detected", pixels(found_px), Some(pixels(paper.min_px)));
        row(
            &format!("diameter at {:.2} m", self.distance_m),
            pixels(expected.image.minor_px),
            None,
        );
        if range.unread.is_some() {
            let read = if expected.is_readable { "read" } else { "not read" };
            row("  code", read.to_owned(), None);
        }
        let papers_depth = millimetres(self.paper_depth_error_m());
        row("  rms error, distance", millimetres(expected.depth_m()), Some(papers_depth));
        row("  rms error, across (2D)", millimetres(expected.across_m()), None);
        row("  rms error, position (3D)", millimetres(expected.position_m()), None);
        row("  rms error, normal", format!("{:.2}°", expected.normal_rad().to_degrees()), None);
        let lost = arguments.lost();
        let (frame_s, p95_s) = (self.times.median_s(lost), self.times.p95_s(lost));
        row(
            &format!("time per frame, {} roundels", arguments.count()),
            milliseconds(frame_s),
            None,
        );
        row("  95th percentile", milliseconds(p95_s), None);
        row("  motion per frame", pixels(self.motion_px), None);
        row("  frames per second, one core", format!("{:.0}", 1.0 / frame_s), None);
        lines.push(String::new());
        lines.push(format!("Times are {}.", times_source(arguments, &self.times)));
        lines.push(if sensor.lens_uncertainty.is_some() {
            "The errors include the uncertainty of the lens.".to_owned()
        } else {
            "The lens is assumed to be exact: the camera file has no uncertainty.".to_owned()
        });
        lines.push(String::new());
        lines.join("\n")
    }

    fn json(&self, arguments: &PlanArgs) -> Value {
        let Self { range, expected, paper, kind, .. } = self;
        let frame_s = self.times.median_s(arguments.lost());
        json!({
            "outer_m": kind.outer_diameter_m,
            "inner_m": kind.inner_diameter_m,
            "code": roundel::code(kind),
            "outer_was_searched": self.was_searched,
            "tilt_deg": arguments.tilt(),
            "least_distance_m": range.min_m,
            "most_distance_m": range.max_m,
            "most_corner_distance_m": range.max_corner_m,
            "base_m": range.base_m,
            "least_minor_px": range.min_minor_px,
            "code_unread": range.unread.map(|ring| {
                json!({"most_distance_m": ring.max_m, "least_minor_px": ring.min_minor_px})
            }),
            "distance_m": self.distance_m,
            "minor_px": expected.image.minor_px,
            "code_is_read": range.unread.map(|_| expected.is_readable),
            "depth_deviation_m": expected.depth_m(),
            "across_deviation_m": expected.across_m(),
            "position_deviation_m": expected.position_m(),
            "normal_deviation_deg": expected.normal_rad().to_degrees(),
            "motion_px": self.motion_px,
            "frame_s": frame_s,
            "frame_p95_s": self.times.p95_s(arguments.lost()),
            "frames_per_s": 1.0 / frame_s,
            "roundels_timed": self.times.followed,
            "times": times_source(arguments, &self.times),
            "lens_uncertainty_known": self.sensor.lens_uncertainty.is_some(),
            "paper": {
                "least_distance_m": paper.min_distance_m(),
                "most_distance_m": paper.max_distance_m(),
                "most_corner_distance_m": paper.max_corner_distance_m(),
                "base_m": paper.base_m(),
                "least_minor_px": paper.min_px,
                "depth_deviation_m": self.paper_depth_error_m(),
            },
        })
    }
}

//! One camera and one kind of roundel: range, precision and time, beside the paper's figures; or the smallest roundel
//! that does it.

use std::io::Write as _;

use anyhow::{Context, bail};
use roundel_core::{
    camera::{Intrinsics, Lens, NormalizedPoint},
    marker::Kind,
    plan::{
        Sensor, paper,
        precision::{Expected, LensDoubt, expect},
        reach::{Reach, before, reach},
        search::{scaled, smallest_m},
    },
};
use serde_json::{Value, json};

use super::{
    Format, PlanArgs,
    load::{ApparentSize, load},
    optics, roundel,
};
use crate::model::config::{MODES, word};

/// Everything that is told.
struct PlanResult {
    name: String,
    sensor: Sensor,
    kind: Kind,
    /// Whether its size was searched for.
    was_searched: bool,
    reach: Reach,
    distance_m: f64,
    expected: Expected,
    has_doubt: bool,
    motion_px: f64,
    frame_s: f64,
    machine: String,
    paper: paper::Pinhole,
}

pub(super) fn run(arguments: &PlanArgs) -> anyhow::Result<()> {
    let result = plan_camera(arguments)?;
    let text = match arguments.format {
        Format::Table => result.table(arguments),
        Format::Json => format!("{:#}\n", result.json(arguments)),
    };
    std::io::stdout().write_all(text.as_bytes()).context("cannot write to the standard output")
}

fn plan_camera(arguments: &PlanArgs) -> anyhow::Result<PlanResult> {
    let (sensor, doubt, name) = optics::sensor(arguments)?;
    let mut kind = arguments.kind()?;
    let tilt_rad = arguments.tilt().to_radians();
    let was_searched = arguments.precision.is_some() && arguments.marker.is_none();
    if was_searched {
        let Some(distance_m) = arguments.distance else {
            bail!("which roundel is located so exactly depends on how far it is: say --distance M");
        };
        let most_m = arguments.most_m();
        let at = (distance_m, tilt_rad);
        kind = scaled(&kind, smallest_m(&sensor, doubt.as_ref(), &kind, at, most_m)?);
    }
    let reach = reach(&sensor, &kind, tilt_rad)?;
    let distance_m = arguments.distance.unwrap_or(0.5 * (reach.least_m + reach.most_m));
    let expected = expected(&sensor, doubt.as_ref(), &kind, (distance_m, tilt_rad), &reach)?;
    let ring = &expected.sighting.ring.outer;
    // The longer diameter is the one that tilt leaves.
    let per_m = 2.0 * ring.semi_major_px / kind.outer_diameter_m;
    let seen = ApparentSize { diameter_px: 2.0 * ring.mean_radius_px(), per_m };
    let load = load(arguments, &sensor, &kind, seen)?;
    let (machine, from) = arguments.machine()?;
    let frame_s = machine.of(sensor.mode).frame_s(&load);
    let paper = paper_pinhole(&sensor, &kind, tilt_rad);
    let has_doubt = doubt.is_some();
    Ok(PlanResult {
        name,
        sensor,
        kind,
        was_searched,
        reach,
        distance_m,
        expected,
        has_doubt,
        motion_px: load.motion_px,
        frame_s,
        machine: from,
        paper,
    })
}

fn expected(
    sensor: &Sensor,
    doubt: Option<&LensDoubt>,
    kind: &Kind,
    (distance_m, tilt_rad): (f64, f64),
    reach: &Reach,
) -> anyhow::Result<Expected> {
    if !(distance_m > 0.0 && distance_m.is_finite()) {
        bail!("--distance: expected metres above 0, found {distance_m}");
    }
    let pose = before(NormalizedPoint::default(), distance_m, tilt_rad);
    expect(sensor, doubt, kind, &pose).with_context(|| {
        format!(
            "--distance: a roundel of {:.0} mm tilted by {:.0}° is found from {:.2} to {:.2} m, not at {distance_m} m",
            kind.outer_diameter_m * 1e3,
            tilt_rad.to_degrees(),
            reach.least_m,
            reach.unread.map_or(reach.most_m, |ring| ring.most_m)
        )
    })
}

/// What the paper's model is told of the same camera.
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
        least_px: paper::LEAST_DIAMETER_PX,
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
        let Self { sensor, kind, reach, expected, paper, .. } = self;
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
        let mut row = |what: &str, plan: String, paper: String| {
            lines.push(format!("{what:36} {plan:>12} {paper:>12}"));
        };
        let metres = |length: f64| format!("{length:.2} m");
        row(
            "nearest, however it is turned",
            metres(reach.least_m),
            metres(paper.least_distance_m()),
        );
        let farthest = if reach.unread.is_some() { "farthest, code read" } else { "farthest" };
        row(
            &format!("{farthest}, on the axis"),
            metres(reach.most_m),
            metres(paper.most_distance_m()),
        );
        row(
            &format!("{farthest}, in every corner"),
            metres(reach.most_corner_m),
            metres(paper.most_corner_distance_m()),
        );
        let [base, papers_base] = [reach.base_m, paper.base_m()]
            .map(|[wide, high]| format!("{:.1} x {:.1} m", wide.max(0.0), high.max(0.0)));
        row("wide and high there", base, papers_base);
        let pixels = |length: f64| format!("{length:.1} px");
        if let Some(ring) = reach.unread {
            row("farthest, ring found, code unread", metres(ring.most_m), String::new());
            row("smallest whose code is read", pixels(reach.least_minor_px), String::new());
        }
        let found_px = reach.unread.map_or(reach.least_minor_px, |ring| ring.least_minor_px);
        row("smallest that is found", pixels(found_px), pixels(paper.least_px));
        let millimetres = |length: f64| format!("{:.3} mm", length * 1e3);
        row(
            &format!("at {:.2} m it is", self.distance_m),
            pixels(expected.sighting.minor_px),
            String::new(),
        );
        if reach.unread.is_some() {
            let read = if expected.is_read { "read" } else { "not read" };
            row("  its code is", read.to_owned(), String::new());
        }
        row(
            "  its distance is known to",
            millimetres(expected.depth_m()),
            millimetres(self.paper_depth_error_m()),
        );
        row("  its place across to (2D)", millimetres(expected.across_m()), String::new());
        row("  its place in all to (3D)", millimetres(expected.position_m()), String::new());
        let normal_deg = expected.normal_rad().to_degrees();
        row("  its normal to", format!("{normal_deg:.2}°"), String::new());
        let time = format!("{:.3} ms", self.frame_s * 1e3);
        row(&format!("a frame with {} of them", arguments.count()), time, String::new());
        row("  each moving by", format!("{:.1} px", self.motion_px), String::new());
        row("  frames a second, one core", format!("{:.0}", 1.0 / self.frame_s), String::new());
        lines.push(String::new());
        lines.push(format!("Times are {}.", self.machine));
        lines.push(if self.has_doubt {
            "The lens' own uncertainty is in the figures.".to_owned()
        } else {
            "The lens is taken as exactly known: the camera file says nothing of its uncertainty."
                .to_owned()
        });
        lines.push(String::new());
        lines.join("\n")
    }

    fn json(&self, arguments: &PlanArgs) -> Value {
        let Self { reach, expected, paper, kind, .. } = self;
        json!({
            "outer_m": kind.outer_diameter_m,
            "inner_m": kind.inner_diameter_m,
            "code": roundel::code(kind),
            "outer_was_searched": self.was_searched,
            "tilt_deg": arguments.tilt(),
            "least_distance_m": reach.least_m,
            "most_distance_m": reach.most_m,
            "most_corner_distance_m": reach.most_corner_m,
            "base_m": reach.base_m,
            "least_minor_px": reach.least_minor_px,
            "code_unread": reach.unread.map(|ring| {
                json!({"most_distance_m": ring.most_m, "least_minor_px": ring.least_minor_px})
            }),
            "distance_m": self.distance_m,
            "minor_px": expected.sighting.minor_px,
            "code_is_read": reach.unread.map(|_| expected.is_read),
            "depth_deviation_m": expected.depth_m(),
            "across_deviation_m": expected.across_m(),
            "position_deviation_m": expected.position_m(),
            "normal_deviation_deg": expected.normal_rad().to_degrees(),
            "motion_px": self.motion_px,
            "frame_s": self.frame_s,
            "frames_per_s": 1.0 / self.frame_s,
            "times": self.machine,
            "lens_uncertainty_known": self.has_doubt,
            "paper": {
                "least_distance_m": paper.least_distance_m(),
                "most_distance_m": paper.most_distance_m(),
                "most_corner_distance_m": paper.most_corner_distance_m(),
                "base_m": paper.base_m(),
                "least_minor_px": paper.least_px,
                "depth_deviation_m": self.paper_depth_error_m(),
            },
        })
    }
}

//! Errors of depth and normal, beside the Cramér-Rao bound.

use roundel_tests::precision::{RATIO, Range, Summary, WIDE_MARGIN, trials};

use super::plot::{Curve, Panel, Style};

/// Conditions that a panel does not vary.
const BASE: Range = Range {
    motion_px: (0.0, 0.0),
    diameter_px: (30.0, 30.0),
    tilt_deg: (40.0, 40.0),
    blur_px: (0.7, 0.7),
    noise: (2.0, 2.0),
    margin: WIDE_MARGIN,
    ratio: RATIO,
};

/// Errors against size, tilt, blur and noise.
pub fn panels(count: usize) -> Vec<Panel> {
    let sizes = [12.0, 15.0, 20.0, 30.0, 45.0, 70.0, 110.0];
    let by_size = sweep(&sizes, count, |size| Range { diameter_px: (size, size), ..BASE });
    let tilts = [2.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0];
    let by_tilt = sweep(&tilts, count, |tilt| Range { tilt_deg: (tilt, tilt), ..BASE });
    let blurs = [0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1];
    let by_blur = sweep(&blurs, count, |blur| Range { blur_px: (blur, blur), ..BASE });
    let noises = [1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0];
    let by_noise = sweep(&noises, count, |noise| Range { noise: (noise, noise), ..BASE });
    vec![
        depth("40° of tilt, blur 0.7 px, noise 2", "outer diameter, px", true, &by_size),
        normal("40° of tilt, blur 0.7 px, noise 2", "outer diameter, px", true, &by_size),
        depth("30 px, blur 0.7 px, noise 2", "tilt, degrees", false, &by_tilt),
        normal("30 px, blur 0.7 px, noise 2", "tilt, degrees", false, &by_tilt),
        depth("30 px, 40° of tilt, noise 2", "blur, px", false, &by_blur),
        depth("30 px, 40° of tilt, blur 0.7 px", "noise, grey levels", false, &by_noise),
    ]
}

/// Value on the axis, and the errors of both modes.
type Point = (f64, [Summary; 2]);

fn sweep(values: &[f64], count: usize, range: impl Fn(f64) -> Range) -> Vec<Point> {
    let point = |&value: &f64| {
        let trials = trials(&range(value), count, value.to_bits());
        let summary = |mode| Summary::of(trials.iter().flat_map(|trial| &trial.frames), mode);
        (value, [summary(0), summary(1)])
    };
    values.iter().map(point).collect()
}

fn curves(points: &[Point], value: fn(&Summary) -> f64, bound: fn(&Summary) -> f64) -> Vec<Curve> {
    let curve = |style, value: &dyn Fn(&Point) -> f64| Curve {
        style,
        points: points.iter().map(|point| (point.0, value(point))).collect(),
    };
    vec![
        curve(Style::Fast, &|point| value(&point.1[0])),
        curve(Style::Precise, &|point| value(&point.1[1])),
        curve(Style::Bound, &|point| bound(&point.1[1])),
    ]
}

fn depth(case: &str, x_name: &'static str, log_x: bool, points: &[Point]) -> Panel {
    let curves =
        curves(points, |errors| 100.0 * errors.depth_rms(), |errors| 100.0 * errors.depth_bound());
    Panel { title: case.to_owned(), x_name, y_name: "depth error, rms, %", log_x, curves }
}

fn normal(case: &str, x_name: &'static str, log_x: bool, points: &[Point]) -> Panel {
    let curves = curves(points, Summary::closer_rms_deg, Summary::normal_bound_deg);
    let y_name = "normal error (closer one), rms, degrees";
    Panel { title: case.to_owned(), x_name, y_name, log_x, curves }
}

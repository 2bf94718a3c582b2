//! Times of tracking and searching against the number of roundels, their size and the image size, which the paper's
//! Fig. 6 varies.

use roundel_tests::timing::{Case, Times, times};

use super::plot::{Curve, Panel, Style};

const BASE: Case = Case { width: 1920, height: 1080, count: 100, diameter_px: 30.0 };

pub fn panels(quick: bool) -> Vec<Panel> {
    let rounds = if quick { 10 } else { 60 };
    let counts = [1, 3, 10, 30, 100, 200, 400].map(|count| Case { count, ..BASE });
    let sizes = [12.0, 15.0, 20.0, 30.0, 45.0, 60.0, 80.0, 110.0].map(|diameter_px| Case {
        count: 1,
        diameter_px,
        ..BASE
    });
    let images = [(640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160)]
        .map(|(width, height)| Case { width, height, count: 50, ..BASE });
    let by_count = measure(&counts, |case| case.count as f64, rounds);
    let by_size = measure(&sizes, |case| case.diameter_px, 20 * rounds);
    let by_image = measure(&images, |case| (case.width * case.height) as f64 / 1e6, rounds);
    let ms = |times: &Times| 1e3 * times.track_s;
    let us = |times: &Times| 1e6 * times.track_s;
    let search_ms = |times: &Times| 1e3 * times.search_s;
    let (count, size, image) = ("roundels", "outer diameter, px", "image, megapixels");
    vec![
        panel("tracked: 30 px, 1920x1080", [count, "ms a frame"], true, &by_count, ms),
        panel("tracked: one in 1920x1080", [size, "µs"], true, &by_size, us),
        panel("tracked: 50 of 30 px", [image, "ms a frame"], false, &by_image, ms),
        panel("first search: 50 of 30 px", [image, "ms a frame"], false, &by_image, search_ms),
    ]
}

/// Value on the axis, and the times of both modes.
type Point = (f64, [Times; 2]);

fn measure(cases: &[Case], value: fn(&Case) -> f64, rounds: usize) -> Vec<Point> {
    cases.iter().map(|case| (value(case), times(case, rounds))).collect()
}

fn panel(
    title: &str,
    [x_name, y_name]: [&'static str; 2],
    log_x: bool,
    points: &[Point],
    value: fn(&Times) -> f64,
) -> Panel {
    let curve = |style, mode: usize| Curve {
        style,
        points: points.iter().map(|(x, times)| (*x, value(&times[mode]))).collect(),
    };
    let curves = vec![curve(Style::Fast, 0), curve(Style::Precise, 1)];
    Panel { title: title.to_owned(), x_name, y_name, log_x, curves }
}

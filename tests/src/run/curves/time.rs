//! Times of following and searching, against what the paper's Fig. 6 varies: the number of roundels,
//! their size, and the image's.

use roundel_tests::timing::{Case, Times, times};

use crate::plot::{Curve, Panel, Style};

const USUAL: Case = Case { width: 1920, height: 1080, count: 100, diameter_px: 30.0 };

/// Times against number, size and image.
pub fn panels(quick: bool) -> Vec<Panel> {
    let rounds = if quick { 10 } else { 60 };
    let counts = [1, 3, 10, 30, 100, 200, 400].map(|count| Case { count, ..USUAL });
    let sizes = [12.0, 15.0, 20.0, 30.0, 45.0, 60.0, 80.0, 110.0].map(|diameter_px| Case {
        count: 1,
        diameter_px,
        ..USUAL
    });
    let images = [(640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160)]
        .map(|(width, height)| Case { width, height, count: 50, ..USUAL });
    let of_counts = measured(&counts, |case| case.count as f64, rounds);
    let of_sizes = measured(&sizes, |case| case.diameter_px, 20 * rounds);
    let of_images = measured(&images, |case| (case.width * case.height) as f64 / 1e6, rounds);
    let ms = |times: &Times| 1e3 * times.follow_s;
    let us = |times: &Times| 1e6 * times.follow_s;
    let search_ms = |times: &Times| 1e3 * times.search_s;
    let (count, size, image) = ("roundels", "outer diameter, px", "image, megapixels");
    vec![
        panel("followed: 30 px, 1920x1080", [count, "ms a frame"], true, &of_counts, ms),
        panel("followed: one in 1920x1080", [size, "µs"], true, &of_sizes, us),
        panel("followed: 50 of 30 px", [image, "ms a frame"], false, &of_images, ms),
        panel("first search: 50 of 30 px", [image, "ms a frame"], false, &of_images, search_ms),
    ]
}

/// A place on the axis, and the times of both modes there.
type Point = (f64, [Times; 2]);

fn measured(cases: &[Case], place: fn(&Case) -> f64, rounds: usize) -> Vec<Point> {
    cases.iter().map(|case| (place(case), times(case, rounds))).collect()
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

//! `mask` of a camera: polygons in pixels that are not searched.

use std::ops::Range;

use roundel_core::camera::{Camera, PixelPoint};
use toml::{Spanned, de::DeValue};

use super::reader::{Table, found, number};

const HELP: &str = "write a list of polygons, each a list of corners [u, v] in pixels: \
                    mask = [[[0, 0], [320, 0], [0, 200]]]";

pub(super) fn mask(table: &Table<'_, '_>, camera: &Camera) -> Vec<Vec<PixelPoint>> {
    let Some(value) = table.value("mask") else { return Vec::new() };
    let Some(items) = value.get_ref().as_array() else {
        let found = found(value.get_ref());
        let message = format!("`mask` must be a list of polygons, found {found}");
        return table.reject("mask", message, HELP).unwrap_or_default();
    };
    if !items.is_empty() && items.iter().all(|item| corner(item).is_some()) {
        let message = "`mask` must be a list of polygons, found the corners of one";
        let help = "put one more pair of brackets round it";
        return table.reject("mask", message, help).unwrap_or_default();
    }
    let read: Vec<Vec<PixelPoint>> = (1..)
        .zip(items.iter())
        .filter_map(|(place, item)| polygon(table, place, item, camera))
        .collect();
    if !items.is_empty() && read.len() == items.len() && cover_all_pixels(&read, camera) {
        let (width, height) = (camera.width(), camera.height());
        let message = format!("`mask` covers the whole frame of {width} x {height} pixels");
        table.fail("mask", message, "leave something to look for roundels in");
    }
    read
}

fn polygon(
    table: &Table<'_, '_>,
    place: usize,
    item: &Spanned<DeValue<'_>>,
    camera: &Camera,
) -> Option<Vec<PixelPoint>> {
    let reject = |item: &Spanned<DeValue<'_>>, message: String, help: &str| {
        table.fail_at(&item.span(), message, help);
        None
    };
    let polygon = format!("polygon {place} of `mask`");
    let Some(items) = item.get_ref().as_array() else {
        let found = found(item.get_ref());
        return reject(item, format!("{polygon} must be a list of corners, found {found}"), HELP);
    };
    let mut corners = Vec::with_capacity(items.len());
    for (number, item) in (1..).zip(items.iter()) {
        let Some(point) = corner(item) else {
            let found = found(item.get_ref());
            let message = format!(
                "corner {number} of {polygon} must be [u, v], two finite numbers of pixels, found {found}"
            );
            return reject(item, message, HELP);
        };
        corners.push(point);
    }
    if corners.len() < 3 {
        let message = format!("{polygon} must have at least 3 corners, found {}", corners.len());
        return reject(item, message, "");
    }
    if !covers_a_pixel(&corners, camera) {
        let (width, height) = (camera.width(), camera.height());
        let help = format!(
            "corners are [u, v], u from 0 at the left to {} at the right, v from 0 at the top to {} at the bottom",
            width.saturating_sub(1),
            height.saturating_sub(1)
        );
        let message = format!("{polygon} covers no pixel of the frame of {width} x {height}");
        return reject(item, message, &help);
    }
    Some(corners)
}

/// `[u, v]`, finite.
fn corner(item: &Spanned<DeValue<'_>>) -> Option<PixelPoint> {
    let numbers = item.get_ref().as_array()?;
    let read: Vec<f64> = numbers.iter().filter_map(|item| number(item.get_ref())).collect();
    let is_finite = read.iter().all(|number| number.is_finite());
    match (numbers.len(), read.as_slice()) {
        (2, &[u, v]) if is_finite => Some(PixelPoint { u, v }),
        _ => None,
    }
}

/// Whether the centre of a pixel of the frame lies in the polygon.
fn covers_a_pixel(polygon: &[PixelPoint], camera: &Camera) -> bool {
    (0..camera.height()).any(|v| !spans(polygon, v, camera.width()).is_empty())
}

/// Whether the centres of all pixels of the frame lie in the polygons.
fn cover_all_pixels(polygons: &[Vec<PixelPoint>], camera: &Camera) -> bool {
    (0..camera.height()).all(|v| {
        let row = polygons.iter().flat_map(|polygon| spans(polygon, v, camera.width()));
        let mut row: Vec<Range<usize>> = row.collect();
        row.sort_by_key(|span| span.start);
        let covered_to =
            row.iter().fold(0, |end, span| if span.start <= end { end.max(span.end) } else { end });
        covered_to == camera.width()
    })
}

/// The pixels of a row, of this width, whose centres lie in a polygon: those that a ray towards +u leaves an odd number
/// of times, as in [`roundel_core::marker::Mask`].
fn spans(polygon: &[PixelPoint], v: usize, width: usize) -> Vec<Range<usize>> {
    let v = v as f64;
    let before = polygon.iter().cycle().skip(polygon.len() - 1);
    let edges = polygon.iter().zip(before).filter(|(a, b)| (a.v > v) != (b.v > v));
    let mut crossings: Vec<f64> =
        edges.map(|(a, b)| a.u + (v - a.v) * (b.u - a.u) / (b.v - a.v)).collect();
    crossings.sort_by(f64::total_cmp);
    let pixel = |u: f64| u.ceil().clamp(0.0, width as f64) as usize;
    let spans = crossings.chunks_exact(2).map(|pair| pixel(pair[0])..pixel(pair[1]));
    spans.filter(|span| !span.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use roundel_core::{
        camera::{Intrinsics, Lens},
        marker::Mask,
    };

    use super::*;

    const SIZE: (usize, usize) = (12, 9);

    fn camera() -> Camera {
        let (width, height) = SIZE;
        let lens = Lens::PlumbBob([0.0; 5]);
        Camera::new(Intrinsics {
            width,
            height,
            fx_px: 9.0,
            fy_px: 9.0,
            cx_px: 5.5,
            cy_px: 4.0,
            lens,
        })
        .unwrap()
    }

    proptest! {
        #[test]
        fn rows_agree_with_the_mask(
            corners in prop::collection::vec(prop::collection::vec((-4i32..34, -4i32..26), 3..6), 1..4),
        ) {
            // Halves lie on the borders of pixels, wholes on their centres.
            let point = |&(u, v): &(i32, i32)| PixelPoint { u: f64::from(u) / 2.0, v: f64::from(v) / 2.0 };
            let polygons: Vec<Vec<PixelPoint>> =
                corners.iter().map(|corners| corners.iter().map(point).collect()).collect();
            let covered = |polygons: &[Vec<PixelPoint>]| -> Vec<bool> {
                let mask = Mask::of_polygons(polygons).unwrap();
                let pixels = (0..SIZE.1).flat_map(|v| (0..SIZE.0).map(move |u| (u, v)));
                pixels.map(|(u, v)| mask.covers(PixelPoint { u: u as f64, v: v as f64 })).collect()
            };
            for polygon in &polygons {
                let expected = covered(std::slice::from_ref(polygon)).contains(&true);
                prop_assert_eq!(covers_a_pixel(polygon, &camera()), expected);
            }
            let all = covered(&polygons).iter().all(|it| *it);
            prop_assert_eq!(cover_all_pixels(&polygons, &camera()), all);
        }
    }

    #[test]
    fn a_frame_can_be_covered_by_one_polygon_or_two() {
        let rectangle = |low: (f64, f64), high: (f64, f64)| {
            [(low.0, low.1), (high.0, low.1), (high.0, high.1), (low.0, high.1)]
                .map(|(u, v)| PixelPoint { u, v })
                .to_vec()
        };
        let whole = rectangle((0.0, 0.0), (12.0, 9.0));
        assert!(cover_all_pixels(&[whole], &camera()));
        let left = rectangle((-1.0, -1.0), (5.0, 9.0));
        let right = rectangle((4.5, -1.0), (90.0, 9.0));
        assert!(cover_all_pixels(&[right.clone(), left.clone()], &camera()));
        assert!(!cover_all_pixels(&[left], &camera()) && !cover_all_pixels(&[right], &camera()));
    }
}

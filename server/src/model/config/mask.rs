//! `mask` of a camera: polygons in pixels, in which nothing is looked for.

use roundel_core::{
    camera::{Camera, PixelPoint},
    marker::Mask,
};
use toml::{Spanned, de::DeValue};

use super::reader::{Table, found, number};

const HELP: &str = "write a list of polygons, each a list of corners [u, v] in pixels: \
                    mask = [[[0, 0], [320, 0], [0, 200]]]";

/// The polygons' corners; what is wrong is reported. None without the key.
pub(super) fn mask(table: &Table<'_, '_>, camera: &Camera) -> Vec<Vec<PixelPoint>> {
    let Some(value) = table.value("mask") else { return Vec::new() };
    let Some(items) = value.get_ref().as_array() else {
        let found = found(value.get_ref());
        let message = format!("`mask` must be a list of polygons, found {found}");
        table.fail_with_help(&value.span(), message, HELP);
        return Vec::new();
    };
    if !items.is_empty() && items.iter().all(|item| corner(item).is_some()) {
        let message = "`mask` must be a list of polygons, found the corners of one";
        table.fail_with_help(&value.span(), message, "put one more pair of brackets round it");
        return Vec::new();
    }
    let read: Vec<Vec<PixelPoint>> = (1..)
        .zip(items.iter())
        .filter_map(|(place, item)| polygon(table, place, item, camera))
        .collect();
    // Judged only when each of them could be read.
    if !items.is_empty() && read.len() == items.len() && covered(&read, camera).all(|it| it) {
        let (width, height) = (camera.width(), camera.height());
        let message = format!("`mask` covers the whole frame of {width} x {height} pixels");
        table.fail_with_help(&value.span(), message, "leave something to look for roundels in");
    }
    read
}

fn polygon(
    table: &Table<'_, '_>,
    place: usize,
    item: &Spanned<DeValue<'_>>,
    camera: &Camera,
) -> Option<Vec<PixelPoint>> {
    let Some(items) = item.get_ref().as_array() else {
        let found = found(item.get_ref());
        let message = format!("polygon {place} of `mask` must be a list of corners, found {found}");
        table.fail_with_help(&item.span(), message, HELP);
        return None;
    };
    let mut corners = Vec::with_capacity(items.len());
    for (number, item) in (1..).zip(items.iter()) {
        let Some(point) = corner(item) else {
            let message = format!(
                "corner {number} of polygon {place} of `mask` must be [u, v], two finite numbers of \
                 pixels, found {}",
                found(item.get_ref())
            );
            table.fail_with_help(&item.span(), message, HELP);
            return None;
        };
        corners.push(point);
    }
    if corners.len() < 3 {
        let message = format!(
            "polygon {place} of `mask` must have at least 3 corners, found {}",
            corners.len()
        );
        table.fail(&item.span(), message);
        return None;
    }
    if !covered(std::slice::from_ref(&corners), camera).any(|it| it) {
        let (width, height) = (camera.width(), camera.height());
        table.fail_with_help(
            &item.span(),
            format!("polygon {place} of `mask` covers no pixel of the frame of {width} x {height}"),
            format!(
                "corners are [u, v], u from 0 at the left to {} at the right, v from 0 at the top to \
                 {} at the bottom",
                width.saturating_sub(1),
                height.saturating_sub(1)
            ),
        );
        return None;
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

/// Of each pixel of the frame, whether its centre lies in one of these polygons.
fn covered(polygons: &[Vec<PixelPoint>], camera: &Camera) -> impl Iterator<Item = bool> {
    // Corners that make no mask were refused before.
    let mask = Mask::of_polygons(polygons).unwrap_or_default();
    let (width, height) = (camera.width(), camera.height());
    let pixels = (0..height).flat_map(move |v| (0..width).map(move |u| (u, v)));
    pixels.map(move |(u, v)| mask.covers(PixelPoint { u: u as f64, v: v as f64 }))
}

//! Chooses the format of a device, and sets its controls.

use super::{
    device::{ControlListing, Driver, FormatListing, code_text},
    pixels,
};
use crate::{
    capture::source::pixels::{PixelFormat, SampleFormat},
    model::{address::DeviceAddress, suggestion::nearest},
};

/// Rate where the address has none.
const DEFAULT_HZ: f64 = 30.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choice {
    pub(super) code: [u8; 4],
    /// `None`: JPEG.
    pub(super) pixels: Option<PixelFormat>,
    /// Rate to ask the device for.
    pub(super) rate_hz: Option<f64>,
}

/// Chooses the format with the highest rate, up to the wanted one; between equal rates the one that is cheapest to
/// convert.
pub(super) fn choose(
    formats: &[FormatListing],
    size: (usize, usize),
    address: &DeviceAddress,
) -> Result<Choice, String> {
    let wanted_hz = address.fps.unwrap_or(DEFAULT_HZ);
    let mut best: Option<(f64, u8, Choice)> = None;
    for format in formats.iter().filter(|format| !format.emulated) {
        let Some(pixels) = pixels(format.code) else { continue };
        // A device that lists no sizes may have this one.
        let has_size = format.width == 0 || (format.width as usize, format.height as usize) == size;
        if !has_size || address.format.is_some_and(|wanted| wanted != format.code) {
            continue;
        }
        // The slowest rate that suffices, or the fastest.
        let rates = &format.rates_hz;
        let enough = rates.iter().rev().find(|rate| **rate >= wanted_hz * 0.99);
        let rate_hz = enough.or(rates.first()).copied();
        let (gives_hz, cost) = (rate_hz.unwrap_or(wanted_hz).min(wanted_hz), cost(pixels));
        let rate_hz = rate_hz.or(address.fps);
        let is_better = best.as_ref().is_none_or(|(hz, least, _)| {
            gives_hz > hz * 1.01 || gives_hz > hz * 0.99 && cost < *least
        });
        if is_better {
            best = Some((gives_hz, cost, Choice { code: format.code, pixels, rate_hz }));
        }
    }
    best.map(|(.., choice)| choice).ok_or_else(|| {
        let wish =
            address.format.map(|code| format!(" as {}", code_text(code))).unwrap_or_default();
        format!(
            "has no usable format for {} x {} pixels{wish}; it has {}; choose one of these: in the camera file, or, \
             without one, as the size (--size; Size on the dashboard)",
            size.0,
            size.1,
            listed(formats)
        )
    })
}

/// Passes over the pixels.
fn cost(pixels: Option<PixelFormat>) -> u8 {
    match pixels {
        Some(PixelFormat::Grey(SampleFormat::Eight)) => 0,
        Some(PixelFormat::Packed { .. } | PixelFormat::Grey(_)) => 1,
        Some(PixelFormat::Bayer(_)) => 2,
        None => 9,
    }
}

/// Each format with its sizes.
fn listed(formats: &[FormatListing]) -> String {
    let formats = formats.chunk_by(|a, b| a.code == b.code).map(|sizes| {
        let unread = if sizes[0].is_read { "" } else { " (not read)" };
        let known = sizes.iter().filter(|size| size.width > 0);
        let known: String = known.map(|size| format!(" {}x{}", size.width, size.height)).collect();
        format!("{}{unread}{known}", sizes[0].format)
    });
    let formats = formats.collect::<Vec<_>>().join(", ");
    if formats.is_empty() { "no format at all".to_owned() } else { formats }
}

/// Sets controls in the order of the address and checks the values that the device took.
pub(super) fn set_controls(
    device: &mut impl Driver,
    address: &DeviceAddress,
) -> Result<(), String> {
    for (name, value) in &address.controls {
        // One control can change whether another one is settable, so each is looked up before it is set.
        let controls =
            device.controls().map_err(|error| format!("cannot list its controls: {error}"))?;
        let control = find(&controls, name)?;
        check(control, *value)?;
        let set = device.set_control(control.id, *value);
        let set = set.map_err(|error| format!("cannot set `{name}` to {value}: {error}"))?;
        if set != *value {
            tracing::warn!(camera = %address, "requested `{name}` = {value}, but the device uses {set}");
        }
    }
    Ok(())
}

fn find<'c>(controls: &'c [ControlListing], name: &str) -> Result<&'c ControlListing, String> {
    let names = || controls.iter().map(|control| control.name.as_str());
    controls.iter().find(|control| control.name == name).ok_or_else(|| {
        let meant = nearest(name, names()).map(|it| format!("; did you mean `{it}`?"));
        let all: Vec<&str> = names().collect();
        format!(
            "has no control `{name}`{}; options are fps, format and its controls: {}",
            meant.unwrap_or_default(),
            all.join(", ")
        )
    })
}

fn check(control: &ControlListing, value: i32) -> Result<(), String> {
    let ControlListing { name, least, most, step, .. } = control;
    if control.read_only {
        return Err(format!("`{name}` is read-only"));
    }
    if !control.is_settable {
        return Err(format!(
            "`{name}` is set by another control: switch that one off first, such as by auto_exposure=1 or \
             focus_automatic_continuous=0 before it"
        ));
    }
    let is_step = *step <= 1 || (value - least).rem_euclid(*step) == 0;
    if !(*least..=*most).contains(&value) || !is_step {
        return Err(format!(
            "`{name}` must be from {least} to {most} in steps of {step}, found {value}"
        ));
    }
    Ok(())
}

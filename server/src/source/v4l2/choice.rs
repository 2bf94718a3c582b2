//! Which of a device's formats is used, and how its controls are set.

use super::{
    device::{Control, Device, Driver, Format},
    pixels,
};
use crate::{
    source::{
        DeviceAddress,
        pixels::{PixelFormat, Samples},
    },
    suggestion::nearest,
};

/// Frames a second that are enough where none are wished for.
const USUAL_HZ: f64 = 30.0;

/// The format that is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choice {
    pub(super) code: [u8; 4],
    /// `None`: JPEG.
    pub(super) pixels: Option<PixelFormat>,
    /// What the device is asked for.
    pub(super) rate_hz: Option<f64>,
}

/// A code as a person writes it.
pub(super) fn text(code: [u8; 4]) -> String {
    String::from_utf8_lossy(&code).trim().to_owned()
}

/// The format that gives most frames, up to those that are wanted, and of several the one that costs least.
pub(super) fn choose(
    formats: &[Format],
    size: (usize, usize),
    address: &DeviceAddress,
) -> Result<Choice, String> {
    let wanted_hz = address.fps.unwrap_or(USUAL_HZ);
    let fitting = formats.iter().filter(|format| address.format.is_none_or(|it| it == format.code));
    let mut best: Option<(f64, u8, Choice)> = None;
    for format in fitting.filter(|format| !format.emulated) {
        let Some(pixels) = pixels(format.code) else { continue };
        let sized = format.sizes.iter().find(|it| (it.width as usize, it.height as usize) == size);
        // A device that lists no sizes is asked for ours.
        if sized.is_none() && !format.sizes.is_empty() {
            continue;
        }
        // The slowest that is fast enough, or the fastest.
        let rates = sized.map_or(&[][..], |size| &size.rates_hz);
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
        let wish = address.format.map(|code| format!(" as {}", text(code))).unwrap_or_default();
        format!(
            "gives no {} x {} pixels{wish} that can be used; it has {}; ask for one of these: by the camera file, or \
             where there is none yet by a size (--size; Size on the dashboard)",
            size.0,
            size.1,
            listed(formats)
        )
    })
}

/// Passes over the pixels.
fn cost(pixels: Option<PixelFormat>) -> u8 {
    match pixels {
        Some(PixelFormat::Grey(Samples::Eight)) => 0,
        Some(PixelFormat::Packed { .. } | PixelFormat::Grey(_)) => 1,
        Some(PixelFormat::Bayer(_)) => 2,
        None => 9,
    }
}

fn listed(formats: &[Format]) -> String {
    let all: Vec<String> = formats
        .iter()
        .map(|format| {
            let sizes = format.sizes.iter().map(|size| format!("{}x{}", size.width, size.height));
            let sizes: Vec<String> = sizes.collect();
            let unread = if pixels(format.code).is_none() { " (not read)" } else { "" };
            format!("{}{unread} {}", text(format.code), sizes.join(" "))
        })
        .collect();
    if all.is_empty() { "no format at all".to_owned() } else { all.join(", ") }
}

/// Sets controls one after the other, and looks at what became of each.
pub(super) fn set_controls<D: Driver>(
    device: &mut Device<D>,
    address: &DeviceAddress,
) -> Result<(), String> {
    for (name, value) in &address.controls {
        // Anew for each: automatic exposure, say, decides whether exposure can be set.
        let controls =
            device.controls().map_err(|error| format!("cannot list its controls: {error}"))?;
        let control = find(&controls, name)?;
        check(control, *value)?;
        let set = device.set_control(control.id, *value);
        let set = set.map_err(|error| format!("cannot set `{name}` to {value}: {error}"))?;
        if set != *value {
            tracing::warn!(camera = %address, "`{name}` was set to {value}, and the device took {set}");
        }
    }
    Ok(())
}

fn find<'c>(controls: &'c [Control], name: &str) -> Result<&'c Control, String> {
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

fn check(control: &Control, value: i32) -> Result<(), String> {
    let Control { name, least, most, step, .. } = control;
    if control.read_only {
        return Err(format!("`{name}` can only be read"));
    }
    if control.inactive {
        return Err(format!(
            "`{name}` is decided by another control: switch its automatic off first, such as auto_exposure=1 or \
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

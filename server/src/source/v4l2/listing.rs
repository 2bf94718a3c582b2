//! What is connected to this machine.

use std::{fs, io, path::PathBuf};

use serde::Serialize;

use super::{
    choice::text,
    device::{Device, Driver, Format},
    kernel::Kernel,
    pixels,
};
use crate::source::natural;

const FOLDER: &str = "/dev";
const PREFIX: &str = "video";

/// A device that gives frames, or why it cannot be asked.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceListing {
    /// Its file.
    pub path: PathBuf,
    /// What it calls itself.
    pub card: String,
    /// Where it is plugged in.
    pub bus: String,
    /// What it gives.
    pub formats: Vec<FormatListing>,
    /// What can be set.
    pub controls: Vec<ControlListing>,
    /// Why the rest is empty; empty where it is not.
    pub error: String,
}

/// A format in one size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FormatListing {
    /// Four-character code.
    pub format: String,
    /// As the driver says it.
    pub description: String,
    /// Whether Roundel can use it.
    pub is_read: bool,
    /// Columns, pixels; 0: any.
    pub width: u32,
    /// Rows, pixels; 0: any.
    pub height: u32,
    /// The fastest first.
    pub rates_hz: Vec<f64>,
}

/// A control that holds a number.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ControlListing {
    /// As it stands in a source's address.
    pub name: String,
    /// Least value.
    pub least: i32,
    /// Greatest value.
    pub most: i32,
    /// Distance of values.
    pub step: i32,
    /// Value when plugged in.
    pub default: i32,
    /// Value now.
    pub value: i32,
    /// Whether it can be set now: not those that are read only, or that another control decides.
    pub is_settable: bool,
}

/// All devices of this machine that give frames, in the order of their names.
pub fn devices() -> io::Result<Vec<DeviceListing>> {
    let mut paths: Vec<PathBuf> = fs::read_dir(FOLDER)?
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(PREFIX))
        .map(|entry| entry.path())
        .collect();
    paths.sort_by(|a, b| natural::compare(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(paths.into_iter().filter_map(listing).collect())
}

/// `None`: it gives no frames, such as the device files for what cameras say beside them.
fn listing(path: PathBuf) -> Option<DeviceListing> {
    let asked = Kernel::open(&path).and_then(|driver| ask(&mut Device { driver }));
    match asked {
        Ok(asked) => asked.map(|listing| DeviceListing { path, ..listing }),
        Err(error) => Some(DeviceListing { path, error: error.to_string(), ..empty() }),
    }
}

fn empty() -> DeviceListing {
    DeviceListing {
        path: PathBuf::new(),
        card: String::new(),
        bus: String::new(),
        formats: Vec::new(),
        controls: Vec::new(),
        error: String::new(),
    }
}

/// What a device says of itself; `None`: it gives no frames.
pub(super) fn ask<D: Driver>(device: &mut Device<D>) -> io::Result<Option<DeviceListing>> {
    let capability = device.capability()?;
    if !capability.captures {
        return Ok(None);
    }
    let formats = device.formats()?.iter().flat_map(formats).collect();
    let controls = device.controls()?.into_iter().map(|control| ControlListing {
        is_settable: !control.read_only && !control.inactive,
        name: control.name,
        least: control.least,
        most: control.most,
        step: control.step,
        default: control.default,
        value: control.value,
    });
    let (card, bus) = (capability.card, capability.bus);
    Ok(Some(DeviceListing { card, bus, formats, controls: controls.collect(), ..empty() }))
}

fn formats(format: &Format) -> Vec<FormatListing> {
    let of_size = |width, height, rates_hz: &[f64]| FormatListing {
        format: text(format.code),
        description: format.description.clone(),
        is_read: pixels(format.code).is_some(),
        width,
        height,
        rates_hz: rates_hz.to_vec(),
    };
    if format.sizes.is_empty() {
        return vec![of_size(0, 0, &[])];
    }
    format.sizes.iter().map(|size| of_size(size.width, size.height, &size.rates_hz)).collect()
}

//! Lists the video devices of this machine.

use std::{fs, io, path::PathBuf};

use serde::Serialize;

use super::{
    device::{ControlListing, Driver, FormatListing, text},
    kernel::Kernel,
};

/// A device that gives frames, or why it cannot be queried.
#[derive(Clone, Debug, Default, Serialize)]
pub struct DeviceListing {
    pub path: PathBuf,
    pub card: String,
    pub bus: String,
    pub formats: Vec<FormatListing>,
    pub controls: Vec<ControlListing>,
    /// Why the query failed; empty where it did not.
    pub error: String,
}

/// All devices of this machine that give frames, in the order of their names.
pub fn devices() -> io::Result<Vec<DeviceListing>> {
    let mut paths: Vec<PathBuf> = fs::read_dir("/dev")?
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with("video"))
        .map(|entry| entry.path())
        .collect();
    alphanumeric_sort::sort_path_slice(&mut paths);
    let listing = |path: PathBuf| {
        let listing = Kernel::open(&path).and_then(|mut device| query(&mut device));
        let listing = listing.unwrap_or_else(|error| {
            Some(DeviceListing { error: error.to_string(), ..DeviceListing::default() })
        });
        Some(DeviceListing { path, ..listing? })
    };
    Ok(paths.into_iter().filter_map(listing).collect())
}

/// Describes a device; `None` if it gives no frames, such as the device file of a camera's metadata.
pub(super) fn query(device: &mut impl Driver) -> io::Result<Option<DeviceListing>> {
    let capability = device.capability()?;
    if !capability.captures() {
        return Ok(None);
    }
    Ok(Some(DeviceListing {
        card: text(&capability.card),
        bus: text(&capability.bus),
        formats: device.formats()?,
        controls: device.controls()?,
        ..DeviceListing::default()
    }))
}

//! Lists the video devices of this machine.

use std::{fs, io, path::PathBuf};

use serde::Serialize;

use super::{
    device::{ControlListing, Device, Driver, FormatListing, text},
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
    Ok(paths.into_iter().filter_map(listing).collect())
}

/// `None` for a device file that gives no frames, such as a camera's metadata.
fn listing(path: PathBuf) -> Option<DeviceListing> {
    match Kernel::open(&path).and_then(|driver| query(&mut Device { driver })) {
        Ok(found) => found.map(|listing| DeviceListing { path, ..listing }),
        Err(error) => {
            Some(DeviceListing { path, error: error.to_string(), ..DeviceListing::default() })
        }
    }
}

/// Describes a device; `None` if it gives no frames.
pub(super) fn query<D: Driver>(device: &mut Device<D>) -> io::Result<Option<DeviceListing>> {
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

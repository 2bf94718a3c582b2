//! `v4l2:/dev/video0?fps=30&format=YUYV&CONTROL=NUMBER…`: a camera of this machine.

use std::{fmt, path::PathBuf};

use super::{AddressError, Options};
use crate::model::redact::is_secret_name;

#[derive(Clone, Debug, PartialEq)]
pub struct DeviceAddress {
    /// The device file; names in `/dev/v4l/by-id` stay with their camera.
    pub path: PathBuf,
    /// Frames a second; `None`: the highest rate up to 30.
    pub fps: Option<f64>,
    /// Four-character code; `None`: the cheapest format.
    pub format: Option<[u8; 4]>,
    /// Names as `roundel cameras` lists them, set in this order.
    pub controls: Vec<(String, i32)>,
}

impl fmt::Display for DeviceAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())
    }
}

pub(super) fn device(path: &str, query: &str) -> Result<DeviceAddress, AddressError> {
    if !path.starts_with('/') {
        return Err(AddressError::Invalid(
            "`v4l2:` needs a device file, such as `v4l2:/dev/video0?fps=30`; `roundel cameras` lists them",
        ));
    }
    let options = Options::parse_any(query);
    // Unknown controls are reported when the device is opened.
    let controls = options.iter().filter(|(key, _)| !["fps", "format"].contains(key));
    let control = |(name, value): (&str, &str)| match value.parse() {
        Ok(number) => Ok((name.to_owned(), number)),
        Err(_) => Err(AddressError::Value {
            what: format!("control `{name}`"),
            expected: "a whole number".to_owned(),
            found: if is_secret_name(name) { "***".to_owned() } else { value.to_owned() },
        }),
    };
    let expected = || "a code of up to four characters, such as YUYV or MJPG".to_owned();
    Ok(DeviceAddress {
        path: path.into(),
        fps: options.frame_rate()?,
        format: options.parsed("format", format_code, expected)?,
        controls: controls.map(control).collect::<Result<_, _>>()?,
    })
}

fn format_code(value: &str) -> Option<[u8; 4]> {
    let is_code = !value.is_empty() && value.len() <= 4 && value.is_ascii();
    is_code.then(|| format!("{value:4}"))?.into_bytes().try_into().ok()
}

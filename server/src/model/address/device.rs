//! `v4l2:/dev/video0?fps=30&format=YUYV&CONTROL=NUMBER…`: a camera of this machine.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use super::{AddressError, frame_rate};

/// A camera, and how it is to be set.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceAddress {
    /// The device file; those in `/dev/v4l/by-id` stay with their camera.
    pub path: PathBuf,
    /// Frames a second; `None`: as many as it gives, up to 30.
    pub fps: Option<f64>,
    /// Four-character code; `None`: the one that costs least.
    pub format: Option<[u8; 4]>,
    /// Names as `roundel cameras` lists them, in the order in which they are to be set.
    pub controls: Vec<(String, i32)>,
}

impl fmt::Display for DeviceAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())
    }
}

pub(super) fn device(path: &str, query: &str) -> Result<DeviceAddress, AddressError> {
    if !path.starts_with('/') {
        return Err(AddressError::Options(
            "`v4l2:` needs a device file, such as `v4l2:/dev/video0?fps=30`; `roundel cameras` lists them",
        ));
    }
    let path = Path::new(path).to_owned();
    let mut address = DeviceAddress { path, fps: None, format: None, controls: Vec::new() };
    for option in query.split('&').filter(|option| !option.is_empty()) {
        let (key, value) = option.split_once('=').unwrap_or((option, ""));
        match key {
            "fps" => address.fps = Some(frame_rate(value)?),
            "format" => address.format = Some(code(value)?),
            // Which controls there are, the device says when it is opened.
            control => address.controls.push((control.to_owned(), number(control, value)?)),
        }
    }
    Ok(address)
}

fn code(value: &str) -> Result<[u8; 4], AddressError> {
    let mut code = [b' '; 4];
    if value.is_empty() || value.len() > 4 || !value.is_ascii() {
        return Err(AddressError::Value {
            option: "format",
            expected: "a code of up to four characters, such as YUYV or MJPG".to_owned(),
            found: value.to_owned(),
        });
    }
    code[..value.len()].copy_from_slice(value.as_bytes());
    Ok(code)
}

fn number(control: &str, value: &str) -> Result<i32, AddressError> {
    value
        .parse()
        .map_err(|_| AddressError::Control { control: control.to_owned(), found: value.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_are_read_in_their_order() {
        let url = "fps=25&format=Y10&auto_exposure=1&exposure_time_absolute=-40";
        let address = device("/dev/video2", url).unwrap();
        assert_eq!((address.to_string().as_str(), address.fps), ("/dev/video2", Some(25.0)));
        assert_eq!(address.format, Some(*b"Y10 "));
        let controls =
            [("auto_exposure".to_owned(), 1), ("exposure_time_absolute".to_owned(), -40)];
        assert_eq!(address.controls, controls);
    }

    #[test]
    fn wrong_wishes_say_what_to_write() {
        for (path, query, expected) in [
            ("video0", "", "needs a device file, such as `v4l2:/dev/video0?fps=30`"),
            ("/dev/video0", "fps=0", "option `fps` must be a number above 0"),
            ("/dev/video0", "format=YUYV422", "a code of up to four characters"),
            ("/dev/video0", "gain=high", "control `gain` must be a whole number, found `high`"),
        ] {
            let error = device(path, query).expect_err(query).to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}

//! Camera files: the ROS `camera_info` YAML that calibration tools write.
//!
//! Reads `image_width`, `image_height`, `camera_matrix`, `distortion_model` and `distortion_coefficients`, and
//! `parameter_names` and `parameter_covariance`, which `roundel calibrate lens` adds. Other fields are ignored.
//! Errors name file, line, field and remedy.

mod uncertainty;

use std::{
    fmt::Write as _,
    io,
    path::{Path, PathBuf},
};

use roundel_core::{
    camera::{Camera, CameraError, Intrinsics, Lens},
    plan::precision::LensUncertainty,
};
use serde::Deserialize;
use serde_saphyr::Spanned;
use thiserror::Error;

use super::regular_file;

/// A longer file is not a camera file.
const MAX_BYTES: u64 = 1 << 20;
const MODELS: &str = "plumb_bob, rational_polynomial or equidistant";

#[derive(Debug, Error)]
pub enum CameraFileError {
    #[error("cannot read camera file {}: {source}; name an existing ROS camera_info YAML file", .path.display())]
    Read { path: PathBuf, source: io::Error },
    /// `found`: empty, or the file's content at the end of the sentence.
    #[error("{}:{line}: {message}{found}; {help}", .path.display())]
    Content { path: PathBuf, line: u64, message: String, found: String, help: String },
}

impl CameraFileError {
    /// The error without what was found in the file, for clients that name it.
    pub fn without_content(&self) -> String {
        match self {
            Self::Content { path, line, message, help, .. } => {
                format!("{}:{line}: {message}; {help}", path.display())
            }
            Self::Read { .. } => self.to_string(),
        }
    }
}

#[derive(Deserialize)]
struct CameraFileYaml {
    image_width: Option<Spanned<f64>>,
    image_height: Option<Spanned<f64>>,
    camera_matrix: Option<Spanned<Matrix>>,
    distortion_model: Option<Spanned<String>>,
    distortion_coefficients: Option<Spanned<Matrix>>,
    parameter_names: Option<Vec<String>>,
    parameter_covariance: Option<Spanned<Matrix>>,
}

#[derive(Deserialize)]
struct Matrix {
    data: Option<Spanned<Vec<f64>>>,
}

/// A [`CameraFileError::Content`] without the path.
struct FieldError {
    line: u64,
    message: String,
    found: String,
    help: String,
}

impl FieldError {
    fn at(line: u64, message: impl Into<String>, help: impl Into<String>) -> Self {
        Self { line, message: message.into(), found: String::new(), help: help.into() }
    }

    /// Adds the file's content to the message.
    fn with_content(self, found: impl Into<String>) -> Self {
        Self { found: found.into(), ..self }
    }

    fn missing(field: &str, example: &str) -> Self {
        Self::at(1, format!("missing field `{field}`"), format!("add `{example}`"))
    }
}

pub fn load(path: &Path) -> Result<Camera, CameraFileError> {
    Ok(load_with_uncertainty(path)?.0)
}

/// With the uncertainty of the parameters, if the file has it.
pub fn load_with_uncertainty(
    path: &Path,
) -> Result<(Camera, Option<LensUncertainty>), CameraFileError> {
    let path_buf = || path.to_owned();
    let text = regular_file::read_text(path, MAX_BYTES)
        .map_err(|source| CameraFileError::Read { path: path_buf(), source })?;
    parse(&text).map_err(|FieldError { line, message, found, help }| CameraFileError::Content {
        path: path_buf(),
        line,
        message,
        found,
        help,
    })
}

fn parse(text: &str) -> Result<(Camera, Option<LensUncertainty>), FieldError> {
    let document: CameraFileYaml = serde_saphyr::from_str(text).map_err(|error| {
        let line = error.location().map_or(1, |location| location.line());
        let reason = error.without_snippet().to_string();
        FieldError::at(
            line,
            "not a camera_info YAML",
            "write the file as ROS' camera_calibration does: numbers without quotes, matrices with \
             `rows`, `cols` and `data`",
        )
        .with_content(format!(": {}", reason.lines().next().unwrap_or_default()))
    })?;
    let (width, width_line) = side("image_width", document.image_width)?;
    let (height, height_line) = side("image_height", document.image_height)?;
    let (matrix, matrix_line) = camera_matrix(document.camera_matrix)?;
    let (lens, lens_line) = lens(document.distortion_model, document.distortion_coefficients)?;
    let uncertainty =
        uncertainty::uncertainty(&lens, document.parameter_names, document.parameter_covariance)?;
    let [fx_px, _, cx_px, _, fy_px, cy_px, ..] = matrix;
    let intrinsics = Intrinsics { width, height, fx_px, fy_px, cx_px, cy_px, lens };
    let camera = Camera::new(intrinsics).map_err(|error| {
        let line = match &error {
            CameraError::Size { field: "width", .. } => width_line,
            CameraError::Size { .. } => height_line,
            CameraError::Focal { .. } | CameraError::Center { .. } => matrix_line,
            CameraError::Coefficient { .. } => lens_line,
        };
        let (message, found) = describe_camera_error(&error);
        FieldError::at(line, message, "calibrate the camera again, or correct the number")
            .with_content(found)
    })?;
    Ok((camera, uncertainty))
}

/// The expectation, and the number that was found, with which core's messages end.
fn describe_camera_error(error: &CameraError) -> (String, String) {
    let mut message = error.to_string();
    let found = message.find(", found ").map(|at| message.split_off(at));
    (message, found.unwrap_or_default())
}

fn side(field: &str, value: Option<Spanned<f64>>) -> Result<(usize, u64), FieldError> {
    let value = value.ok_or_else(|| FieldError::missing(field, &format!("{field}: 1280")))?;
    let line = value.referenced.line();
    if !(1.0..=f64::from(u32::MAX)).contains(&value.value) || value.value.fract() != 0.0 {
        return Err(FieldError::at(
            line,
            format!("`{field}` must be a whole number of pixels above 0"),
            "write the size of the camera's images",
        )
        .with_content(format!(", found {}", value.value)));
    }
    Ok((value.value as usize, line))
}

/// The numbers of a matrix and their line.
fn data(
    field: &str,
    matrix: Option<Spanned<Matrix>>,
    example: &str,
) -> Result<(Vec<f64>, u64), FieldError> {
    let matrix = matrix.ok_or_else(|| FieldError::missing(field, example))?;
    let line = matrix.referenced.line();
    let data = matrix.value.data.ok_or_else(|| {
        FieldError::at(line, format!("`{field}` has no `data`"), format!("add `{example}`"))
    })?;
    Ok((data.value, data.referenced.line()))
}

fn camera_matrix(matrix: Option<Spanned<Matrix>>) -> Result<([f64; 9], u64), FieldError> {
    const EXAMPLE: &str =
        "camera_matrix: {rows: 3, cols: 3, data: [fx, 0, cx, 0, fy, cy, 0, 0, 1]}";
    let (numbers, line) = data("camera_matrix", matrix, EXAMPLE)?;
    let matrix = <[f64; 9]>::try_from(numbers).map_err(|numbers| {
        let message = format!("`camera_matrix.data` must have 9 numbers, found {}", numbers.len());
        FieldError::at(line, message, "write [fx, 0, cx, 0, fy, cy, 0, 0, 1], row by row")
    })?;
    if [matrix[1], matrix[3], matrix[6], matrix[7], matrix[8]] != [0.0, 0.0, 0.0, 0.0, 1.0] {
        return Err(FieldError::at(
            line,
            "`camera_matrix.data` must be [fx, 0, cx, 0, fy, cy, 0, 0, 1] (no skew)",
            "check that the matrix is written row by row",
        )
        .with_content(format!(", found {matrix:?}")));
    }
    Ok((matrix, line))
}

fn lens(
    model: Option<Spanned<String>>,
    coefficients: Option<Spanned<Matrix>>,
) -> Result<(Lens, u64), FieldError> {
    let model = model
        .ok_or_else(|| FieldError::missing("distortion_model", "distortion_model: plumb_bob"))?;
    let model_line = model.referenced.line();
    let wanted: &[usize] = match model.value.as_str() {
        "plumb_bob" => &[4, 5],
        "rational_polynomial" => &[8],
        "equidistant" | "fisheye" => &[4],
        other => {
            return Err(FieldError::at(
                model_line,
                format!("`distortion_model` must be {MODELS}"),
                "calibrate with one of these models",
            )
            .with_content(format!(", found \"{other}\"")));
        }
    };
    const EXAMPLE: &str = "distortion_coefficients: {rows: 1, cols: 5, data: [k1, k2, p1, p2, k3]}";
    let (k, line) = data("distortion_coefficients", coefficients, EXAMPLE)?;
    let lens = Lens::from_ros(&model.value, &k).ok_or_else(|| {
        let counts: Vec<String> = wanted.iter().map(ToString::to_string).collect();
        FieldError::at(
            line,
            format!(
                "`distortion_coefficients.data` of {} must have {} numbers, found {}",
                model.value,
                counts.join(" or "),
                k.len()
            ),
            "write them in ROS' order, or correct `distortion_model`",
        )
    })?;
    Ok((lens, line))
}

/// The text of a camera file. Numbers are exact; rectified images keep focal lengths and centre.
pub fn write(name: &str, camera: &Camera) -> String {
    write_with_uncertainty(name, camera, None)
}

/// With the uncertainty of the parameters.
pub fn write_with_uncertainty(
    name: &str,
    camera: &Camera,
    uncertainty: Option<&LensUncertainty>,
) -> String {
    let Intrinsics { width, height, fx_px, fy_px, cx_px, cy_px, lens } = camera.intrinsics();
    let coefficients = lens.coefficients();
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = write!(
        text,
        "image_width: {width}\nimage_height: {height}\ncamera_name: {name:?}\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  \
         data: [{fx_px:?}, 0.0, {cx_px:?}, 0.0, {fy_px:?}, {cy_px:?}, 0.0, 0.0, 1.0]\n\
         distortion_model: {}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {}\n  data: {coefficients:?}\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  \
         data: [{fx_px:?}, 0.0, {cx_px:?}, 0.0, 0.0, {fy_px:?}, {cy_px:?}, 0.0, 0.0, 0.0, 1.0, 0.0]\n",
        lens.name(),
        coefficients.len(),
    );
    if let Some(uncertainty) = uncertainty {
        text.push_str(&uncertainty::written(lens, uncertainty));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) const GOOD: &str = "\
image_width: 1280
image_height: 720
camera_name: north
camera_matrix:
  rows: 3
  cols: 3
  data: [733.0, 0, 640, 0, 734, 360, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.01, 1e-3, -2.0e-4, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
binning_x: 0
";

    fn unwrap<T>(result: Result<T, FieldError>) -> T {
        result.map_err(|wrong| wrong.message).unwrap()
    }

    #[test]
    fn a_ros_file_is_read() {
        let (camera, uncertainty) = unwrap(parse(GOOD));
        assert_eq!(uncertainty, None);
        let read = camera.intrinsics();
        assert_eq!((read.width, read.height), (1280, 720));
        assert_eq!((read.fx_px, read.fy_px, read.cx_px, read.cy_px), (733.0, 734.0, 640.0, 360.0));
        assert_eq!(read.lens, Lens::PlumbBob([-0.1, 0.01, 1e-3, -2e-4, 0.0]));
    }

    #[test]
    fn a_written_file_is_read_exactly() {
        for lens in [
            Lens::PlumbBob([-0.1, 0.02, 1e-17, -0.000_1, 0.3]),
            Lens::Rational([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 1.0 / 3.0]),
            Lens::Equidistant([1e-9, 0.0, -0.1, 5.0]),
        ] {
            let intrinsics = Intrinsics {
                width: 641,
                height: 480,
                fx_px: 1000.0 / 3.0,
                fy_px: 333.25,
                cx_px: 320.1,
                cy_px: 1e2,
                lens,
            };
            let camera = Camera::new(intrinsics).unwrap();
            let text = write("a \"quoted\" name", &camera);
            // ROS' own reader (camera_calibration_parsers) refuses a file without either.
            assert!(text.contains("rectification_matrix:\n  rows: 3\n"), "{text}");
            let p =
                "[333.3333333333333, 0.0, 320.1, 0.0, 0.0, 333.25, 100.0, 0.0, 0.0, 0.0, 1.0, 0.0]";
            assert!(
                text.contains(&format!("projection_matrix:\n  rows: 3\n  cols: 4\n  data: {p}")),
                "{text}"
            );
            assert_eq!(unwrap(parse(&text)), (camera.clone(), None));
            // All but the second coefficient are uncertain.
            let free: Vec<usize> =
                (0..camera.intrinsics().lens.coefficients().len()).filter(|&k| k != 1).collect();
            let root = nalgebra::DMatrix::from_fn(free.len() + 4, free.len() + 4, |row, column| {
                1.0 / (1.0 + row as f64 * 3.0 + column as f64)
            });
            let uncertainty = LensUncertainty { free, covariance: &root * root.transpose() };
            let text = write_with_uncertainty("known", &camera, Some(&uncertainty));
            let read = unwrap(parse(&text)).1.unwrap();
            assert_eq!(read.free, uncertainty.free);
            assert!((read.covariance - uncertainty.covariance).amax() < 1e-12);
        }
    }

    #[test]
    fn errors_name_their_line() {
        for (from, to, line, expected) in [
            ("image_width: 1280\n", "", 1, "missing field `image_width`"),
            ("1280", "0", 1, "`image_width` must be a whole number of pixels above 0, found 0"),
            ("720", "99999", 2, "height: expected 1 to 16384 pixels, found 99999"),
            ("720", "tall", 2, "not a camera_info YAML"),
            ("733.0, ", "", 7, "`camera_matrix.data` must have 9 numbers, found 8"),
            ("733.0", "-733.0", 7, "fx_px: expected a positive number of pixels, found -733"),
            ("733.0, 0", "733.0, 2", 7, "(no skew)"),
            (
                "plumb_bob",
                "plum_bob",
                8,
                "plumb_bob, rational_polynomial or equidistant, found \"plum_bob\"",
            ),
            ("plumb_bob", "equidistant", 12, "of equidistant must have 4 numbers, found 5"),
            ("-0.1", ".nan", 12, "expected finite coefficients, found NaN as number 0"),
            ("distortion_model: plumb_bob\n", "", 1, "missing field `distortion_model`"),
        ] {
            let wrong = parse(&GOOD.replacen(from, to, 1)).expect_err(expected);
            let text = format!("{}{}", wrong.message, wrong.found);
            assert!(text.contains(expected), "{expected}: {text}");
            assert_eq!(wrong.line, line, "{expected}: {text}");
            assert!(
                !wrong.message.contains("found")
                    || wrong.message.ends_with("found 8")
                    || wrong.message.ends_with("found 5"),
                "{text}"
            );
        }
        assert!(parse("just text").is_err());
        assert!(parse("").is_err());
    }
}

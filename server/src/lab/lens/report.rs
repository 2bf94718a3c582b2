//! Progress and result of a lens calibration, as clients see them.

use roundel_core::{
    calib::lens::{DiameterCheck, LensCalibration, MIN_ZONE_SIGHTINGS, View, ViewVerdict, ZONES},
    camera::PixelPoint,
    plan::precision::LensUncertainty,
};
use serde::Serialize;
use utoipa::ToSchema;

use super::board_search::CollectedViews;
use crate::model::camera_file;

/// Stage of a lens calibration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// No calibration was started, or it was cancelled.
    #[default]
    Idle,
    /// Views are being collected: move the board.
    Gathering,
    /// The lens is being estimated.
    Solving,
    /// Finished with a report.
    Done,
    /// Ended with an error.
    Failed,
}

/// The newest lens calibration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct LensStatus {
    pub stage: Stage,
    /// The camera of this server that is calibrated; empty: a source of its own.
    pub camera: String,
    /// The source that is calibrated, without user and password; empty: a camera of this server.
    pub source: String,
    /// Description of the board.
    pub board: String,
    /// Width of the pictures, pixels; 0 before the first.
    pub width: usize,
    /// Height of the pictures, pixels; 0 before the first.
    pub height: usize,
    /// Pictures that were searched.
    pub frames: usize,
    /// Views that were kept.
    pub taken: usize,
    /// Number of views that suffices once the coverage is complete.
    pub enough: usize,
    /// Minimum number of views for an estimate.
    pub least: usize,
    /// Maximum number of views kept.
    pub most: usize,
    /// Why the newest picture was kept or not, in words.
    pub newest: String,
    /// Whether it was kept.
    pub newest_taken: bool,
    /// Parts of the picture that the board has covered.
    pub coverage: CoverageReport,
    /// Outlines of the kept views, raw pixels.
    pub outlines: Vec<Vec<[f64; 2]>>,
    /// The board's outline in the newest picture; empty where it was not found.
    pub outline: Vec<[f64; 2]>,
    /// Missing views, most wanted first.
    pub missing: Vec<String>,
    /// Numbers of pictures by the reason for leaving them out, in words; empty before the first.
    pub left_out: String,
    /// Why there is no lens or no picture, and the remedy.
    pub error: String,
    pub report: Option<LensReport>,
    /// Whether the camera file can be saved on the server's machine and used by the camera.
    pub can_apply: bool,
    /// Where the camera file is saved; empty: not saved.
    pub applied: String,
}

/// Parts of the picture that the board has covered, by zones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct CoverageReport {
    /// Zones across.
    pub columns: usize,
    /// Zones down.
    pub rows: usize,
    /// Roundels seen in each zone, row by row from the top left.
    pub zones: Vec<usize>,
    /// Minimum number of roundels for a zone to count as visited.
    pub visited_from: usize,
    /// Share of visited zones, 0 to 1.
    pub share: f64,
}

/// Result of a lens calibration.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct LensReport {
    /// ROS name of the distortion model.
    pub distortion_model: String,
    /// fx, fy, cx, cy, and the estimated coefficients.
    pub parameters: Vec<LensParameter>,
    /// Rms reprojection error of the centres, pixels.
    pub rms_px: f64,
    /// Views used.
    pub views: usize,
    /// Views left out because they contradict the others.
    pub views_left_out: usize,
    /// Roundels left out of the used views.
    pub outliers: usize,
    /// Warning if the print's diameter and pitch look different from their description; else empty.
    pub width_warning: String,
}

/// One parameter of a lens.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct LensParameter {
    /// Name as in `camera_info`: fx, fy, cx, cy, k1, …
    pub name: String,
    pub value: f64,
    /// Standard deviation of the estimate.
    pub deviation: f64,
    /// `px`, or empty for a dimensionless number.
    pub unit: String,
}

impl LensReport {
    pub fn of(found: &LensCalibration) -> Self {
        let views = found.views.iter().flatten().count();
        let parameter = |(name, value, deviation): (&str, f64, f64)| LensParameter {
            name: name.to_owned(),
            value,
            deviation,
            unit: if PINHOLE.contains(&name) { "px" } else { "" }.to_owned(),
        };
        Self {
            distortion_model: found.model.ros_name().to_owned(),
            parameters: parameters(found).into_iter().map(parameter).collect(),
            rms_px: found.rms_px,
            views,
            views_left_out: found.views.len() - views,
            outliers: found.outliers,
            width_warning: width_doubt(found).unwrap_or_default(),
        }
    }
}

/// A warning if the print's diameter and pitch look different from their description.
pub fn width_doubt(found: &LensCalibration) -> Option<String> {
    let width = found.diameter_check.filter(DiameterCheck::is_doubtful)?;
    Some(format!(
        "diameter and pitch contradict the pictures: the roundels appear {:.2} mm wide, not {:.2}, if their pitch is {:.2} mm; \
         or the pitch is {:.2} mm if they are {:.2} mm wide (± {:.1} %). Measure both on the print: errors in them falsify \
         the lens",
        width.found_outer_mm(),
        width.outer_mm,
        width.pitch_mm,
        width.found_pitch_mm(),
        width.outer_mm,
        width.deviation * 100.0
    ))
}

/// The `camera_info` YAML of a lens with its covariance.
pub fn camera_file(name: &str, found: &LensCalibration) -> String {
    let (free, covariance) = (found.model.free().to_vec(), found.covariance.clone());
    let doubt = LensUncertainty { free, covariance };
    camera_file::write_with_uncertainty(name, &found.camera, Some(&doubt))
}

const PINHOLE: [&str; 4] = ["fx", "fy", "cx", "cy"];

/// Names, values and standard deviations of the estimated parameters.
pub fn parameters(found: &LensCalibration) -> Vec<(&'static str, f64, f64)> {
    let is = found.camera.intrinsics();
    let pinhole = PINHOLE.into_iter().zip([is.fx_px, is.fy_px, is.cx_px, is.cy_px]);
    let coefficients = is.lens.coefficients();
    let names = found.model.names();
    let free = names.into_iter().zip(found.model.free().iter().map(|&index| coefficients[index]));
    let values = pinhole.chain(free);
    values.zip(found.deviations()).map(|((name, value), sd)| (name, value, sd)).collect()
}

impl LensStatus {
    /// Updates the status with the views so far, and the verdict and view of the newest picture.
    pub(super) fn update(&mut self, gathered: &CollectedViews, newest: ViewVerdict, view: &View) {
        let selector = &gathered.selector;
        (self.width, self.height) = gathered.size;
        self.frames = gathered.frames;
        self.newest = verdict_text(newest).to_owned();
        self.newest_taken = newest == ViewVerdict::Taken;
        self.outline = corners(&view.outline());
        self.left_out = gathered.describe();
        if selector.taken().len() != self.taken || self.coverage.zones.is_empty() {
            self.taken = selector.taken().len();
            let (columns, rows) = ZONES;
            let (zones, share) =
                (selector.coverage().zones().to_vec(), selector.coverage().share());
            self.coverage =
                CoverageReport { columns, rows, zones, visited_from: MIN_ZONE_SIGHTINGS, share };
            self.outlines = selector.taken().iter().map(|view| corners(&view.outline())).collect();
            self.missing =
                selector.coverage().missing_views().iter().map(ToString::to_string).collect();
        }
        self.error.clear();
    }
}

fn corners(outline: &[PixelPoint]) -> Vec<[f64; 2]> {
    let rounded = |px: f64| (px * 10.0).round() / 10.0;
    outline.iter().map(|corner| [rounded(corner.u), rounded(corner.v)]).collect()
}

/// The verdict on a picture, for the operator who moves the board.
fn verdict_text(verdict: ViewVerdict) -> &'static str {
    match verdict {
        ViewVerdict::Taken => "view taken: move the board to the next place",
        ViewVerdict::NoBoard => "no roundel of the board is visible",
        ViewVerdict::TooLittle => "less than half of the board is visible, or it is another board",
        ViewVerdict::OtherBoard(..) => "the board has other columns or rows than entered",
        ViewVerdict::Moving => "the board is moving: hold it still for a moment",
        ViewVerdict::Duplicate(_) => "a similar view was taken already: move the board",
    }
}

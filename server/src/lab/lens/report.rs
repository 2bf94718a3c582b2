//! A lens calibration as clients are told of it: how far it is, and what came out.

use roundel_core::{
    calib::lens::{Coverage, LEAST_VIEWS, LensCalibration, VISITED, Verdict, View, Width, ZONES},
    camera::PixelPoint,
};
use serde::Serialize;
use utoipa::ToSchema;

use super::board_search::{CollectedViews, GOOD_VIEWS};

/// How far a lens calibration is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// None was asked for since the start, or it was given up.
    #[default]
    Idle,
    /// The board should be moved now.
    Gathering,
    /// The views are being worked on.
    Solving,
    /// There is a report.
    Done,
    /// There is none, and an error says why.
    Failed,
}

/// The newest lens calibration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct LensStatus {
    /// How far it is.
    pub stage: Stage,
    /// The camera of this server whose pictures are looked at; empty: a source of its own.
    pub camera: String,
    /// The source that was opened for it, without user and password; empty: a camera of this server.
    pub source: String,
    /// The board that is looked for, in words.
    pub board: String,
    /// Of the pictures, pixels; 0 before the first.
    pub width: usize,
    /// Likewise.
    pub height: usize,
    /// Pictures that were looked at.
    pub frames: usize,
    /// Views that were kept.
    pub taken: usize,
    /// So many are enough, once nothing is missing …
    pub enough: usize,
    /// … fewer than this tell no lens …
    pub least: usize,
    /// … and no more than so many are kept.
    pub most: usize,
    /// What became of the newest picture, in words.
    pub newest: String,
    /// Whether it was kept.
    pub newest_taken: bool,
    /// Where the board has been.
    pub coverage: CoverageReport,
    /// Outlines of the views that were kept, raw pixels.
    pub outlines: Vec<Vec<[f64; 2]>>,
    /// The board's outline in the newest picture; empty where it was not found.
    pub outline: Vec<[f64; 2]>,
    /// What is still missing, most wanted first; empty: nothing.
    pub missing: Vec<String>,
    /// How many pictures were left out, and why; empty before the first.
    pub left_out: String,
    /// Why there is no lens, or no picture, and what to do.
    pub error: String,
    /// What came out.
    pub report: Option<LensReport>,
    /// Whether its file can be kept on the server's machine, and be used from then on.
    pub can_apply: bool,
    /// Where the file is kept; empty: it is not.
    pub applied: String,
}

/// Where in the picture the board has been: zones, row by row from the top left.
#[derive(Clone, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct CoverageReport {
    /// Zones across.
    pub columns: usize,
    /// Zones down.
    pub rows: usize,
    /// Roundels seen in each.
    pub zones: Vec<usize>,
    /// A zone has been visited when it held so many.
    pub visited_from: usize,
    /// Share of the zones that have been visited, 0 to 1.
    pub share: f64,
}

impl CoverageReport {
    fn of(coverage: &Coverage) -> Self {
        let (columns, rows) = ZONES;
        let (zones, share) = (coverage.zones().to_vec(), coverage.share());
        Self { columns, rows, zones, visited_from: VISITED, share }
    }
}

/// What came out of a lens calibration.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct LensReport {
    /// ROS' name of the distortion model for which most speaks.
    pub distortion_model: String,
    /// fx, fy, cx, cy, and the coefficients that were estimated.
    pub parameters: Vec<LensParameter>,
    /// Rms distance between seen and predicted centres, pixels.
    pub rms_px: f64,
    /// Views that were used.
    pub views: usize,
    /// Views that were left out since they contradict the others.
    pub views_left_out: usize,
    /// Roundels that were left out of the views that were used.
    pub outliers: usize,
    /// What the print's diameter and pitch look like, if not as said; else empty.
    pub width_warning: String,
}

/// One number of a lens.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct LensParameter {
    /// As in `camera_info`'s terms: fx, fy, cx, cy, k1, …
    pub name: String,
    /// As found.
    pub value: f64,
    /// Its standard deviation.
    pub deviation: f64,
    /// `px`, or empty for a plain number.
    pub unit: String,
}

impl LensReport {
    /// What is told of a calibration.
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

/// That the print's diameter and pitch look other than said, if they do.
pub fn width_doubt(found: &LensCalibration) -> Option<String> {
    let width = found.width.filter(Width::is_doubtful)?;
    Some(format!(
        "the roundels look {:.2} mm wide, not {:.2}, if they are {:.2} mm from one to the next (or those {:.2} mm apart if \
         {:.2} mm wide), ± {:.1} %: measure both on the print, for the lens is off with them",
        width.found_outer_mm(),
        width.outer_mm,
        width.pitch_mm,
        width.found_pitch_mm(),
        width.outer_mm,
        width.deviation * 100.0
    ))
}

const PINHOLE: [&str; 4] = ["fx", "fy", "cx", "cy"];

/// Names, values and deviations of what was estimated.
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
    /// Takes over what was found so far, and in the newest picture.
    pub(super) fn update(&mut self, gathered: &CollectedViews, newest: Verdict, view: &View) {
        let chooser = &gathered.chooser;
        (self.width, self.height) = gathered.size;
        self.frames = gathered.frames;
        self.newest = verdict_text(newest).to_owned();
        self.newest_taken = newest == Verdict::Taken;
        self.outline = corners(&view.outline());
        self.left_out = gathered.describe();
        if chooser.taken().len() != self.taken || self.coverage.zones.is_empty() {
            self.taken = chooser.taken().len();
            self.coverage = CoverageReport::of(chooser.coverage());
            self.outlines = chooser.taken().iter().map(|view| corners(&view.outline())).collect();
            self.missing = chooser.coverage().wants().iter().map(ToString::to_string).collect();
        }
        self.error.clear();
    }

    pub(super) fn begun(camera: String, source: String, board: String, most: usize) -> Self {
        let stage = Stage::Gathering;
        let (enough, least) = (GOOD_VIEWS.min(most), LEAST_VIEWS);
        Self { stage, camera, source, board, most, enough, least, ..Self::default() }
    }
}

fn corners(outline: &[PixelPoint]) -> Vec<[f64; 2]> {
    let rounded = |px: f64| (px * 10.0).round() / 10.0;
    outline.iter().map(|corner| [rounded(corner.u), rounded(corner.v)]).collect()
}

/// What became of a picture, for who moves the board.
fn verdict_text(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Taken => "taken: on to the next place",
        Verdict::NoBoard => "no roundel of the board is seen",
        Verdict::TooLittle => "less than half of the board is seen, or it is another board",
        Verdict::OtherBoard(..) => "the board has other columns or rows than were said",
        Verdict::Moving => "the board moves: hold it still for a moment",
        Verdict::Alike(_) => "such a view is kept already: move the board on",
    }
}

//! `roundel calibrate lens`: a camera file from views of a board, or from a recording ([`super::moving`]).

use std::{
    fmt::{Display, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, bail};
use clap::Args;
use roundel_core::{
    calib::lens::{DistortionModel, LensCalibration, STRONG_EVIDENCE, calibrate},
    marker::{CodeLayout, Pattern},
};
use serde_json::{Value, json};

use super::{
    files, output,
    views::{self, BoardViews, ViewOptions},
};
use crate::{
    app::cli::{Format, print, size, words},
    lab::{
        lens::{
            board_search::{CalibrationTarget, CollectedViews},
            chessboard::{self, Chessboard},
            report::{camera_file, parameters, width_doubt},
        },
        print::{
            BOARD_LAYOUT, PrintJob, codes,
            spec::{self, Diameters},
        },
    },
    model::address::SourceAddress,
};

/// Calibrate a lens (focal length, principal point, distortion) from views of a printed board, or from a recording of
/// robots that other cameras saw too.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel print --board 7x5 board.pdf\n  \
    roundel calibrate lens --output north.yaml v4l2:/dev/video0\n      \
    move the board in front of the camera\n  \
    roundel calibrate lens --output north.yaml --size 1920x1080 v4l2:/dev/video0\n  \
    roundel calibrate lens --output north.yaml http://10.0.0.2:81/stream\n  \
    roundel calibrate lens --output north.yaml views/\n      \
    a folder, or files\n  \
    roundel calibrate lens --output north.yaml --board chessboard:9x6:25 views/\n  \
    roundel calibrate lens --output north.yaml --board charuco:10x7:25:18:DICT_4X4_50 views/\n  \
    roundel calibrate lens --output north.yaml --from-recording run.mcap --camera north\n\n\
    Fix the print to something flat. Hold the board still for a moment, near and far, in the middle and in every corner of \
    the picture, tilted to each side by 20° to 45°; good views are selected automatically. The command ends when no view is \
    missing, after --views views, or with Ctrl-C, which uses the views taken so far.\n\n\
    A recording made by a server (`roundel record`) needs no board: the sightings of coded roundels on moving robots are \
    matched to their trajectories from the other cameras. The arena must be calibrated, and the camera must stand still; \
    its own camera file and pose are not used.")]
pub(super) struct LensArgs {
    /// A source as in a configuration (images:, http:, v4l2:, rtsp:, file:, …), a folder, or image files
    #[arg(required_unless_present = "from_recording", value_name = "SOURCE")]
    sources: Vec<String>,
    /// A recording in which other cameras saw the same coded roundels
    #[arg(
        long,
        value_name = "FILE.mcap",
        requires = "camera",
        conflicts_with_all = ["sources", "board", "marker", "pitch", "code", "views", "size"]
    )]
    pub(super) from_recording: Option<PathBuf>,
    /// Camera of the recording to calibrate
    #[arg(long, value_name = "NAME", requires = "from_recording", conflicts_with = "sources")]
    pub(super) camera: Option<String>,
    /// The printed board: columns and rows of roundels; or chessboard:COLUMNSxROWS:SQUARE_MM by its inner corners, or
    /// charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY by its squares
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = parse_board, default_value = "7x5")]
    board: BoardArg,
    /// Outer diameter of its roundels, millimetres, as measured on the print [default: 30]
    #[arg(long, value_name = "OUTER_MM", value_parser = spec::diameters, allow_hyphen_values = true)]
    marker: Option<Diameters>,
    /// Distance from centre to centre, millimetres, as measured on the print [default: 1.2 of the outer diameter]
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pitch: Option<f64>,
    /// Codes of its roundels [default: 9]
    #[arg(long, value_name = "BITS[:DISTANCE]", value_parser = spec::code)]
    code: Option<CodeLayout>,
    /// Distortion model [default: selected automatically]
    #[arg(long, value_parser = words(&MODELS))]
    pub(super) model: Option<DistortionModel>,
    /// Maximum number of views to use
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u16).range(5..=500))]
    views: u16,
    /// Picture size to request from a camera [default: 1280x720, or what it delivers]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<(usize, usize)>,
    /// The camera's name in the file [default: the file's, or the recorded camera's]
    #[arg(long)]
    name: Option<String>,
    /// Camera file to write (camera_info YAML); an existing file is kept as FILE.previous.yaml. Without it, the lens is
    /// only printed
    #[arg(long, short, value_name = "FILE.yaml")]
    pub(super) output: Option<PathBuf>,
    /// Format of the report
    #[arg(long, value_enum, default_value_t = Format::Table)]
    pub(super) format: Format,
}

#[derive(Clone, Debug, PartialEq)]
enum BoardArg {
    Roundels((usize, usize)),
    Chessboard(Chessboard),
}

fn parse_board(text: &str) -> Result<BoardArg, String> {
    match chessboard::parse(text) {
        Some(board) => board.map(BoardArg::Chessboard),
        None => spec::sides(text).map(BoardArg::Roundels).map_err(|error| {
            format!(
                "{error}; for boards of other tools, use chessboard:9x6:25 or charuco:10x7:25:18:DICT_4X4_50"
            )
        }),
    }
}

const MODELS: [(&str, DistortionModel, &str); 3] = [
    ("plumb_bob", DistortionModel::PlumbBob, "k1 k2 p1 p2 k3"),
    ("rational_polynomial", DistortionModel::Rational, "k1 k2 p1 p2 k3 k4 k5 k6"),
    ("equidistant", DistortionModel::Equidistant, "k1 k2 k3 k4, for fisheyes"),
];

pub(super) fn run(arguments: &LensArgs) -> anyhow::Result<ExitCode> {
    let target = calibration_target(arguments)?;
    let max_views = usize::from(arguments.views);
    let options = ViewOptions { target: &target, max_views, size: arguments.size };
    let mut views_found = collect_views(&arguments.sources, &options)?;
    let CollectedViews { selector, size, .. } = &views_found.gathered;
    let found = calibrate(selector.target(), *size, selector.taken(), arguments.model);
    let found = found.with_context(|| {
        format!("no lens was found: {}{}", views_found.summary(), hint(&target, &views_found))
    })?;
    for (file, view) in views_found.taken.iter().zip(&found.views) {
        if let Err(why) = view {
            eprintln!("left out: {}: {why}", file.display());
            views_found.left_out.push((file.clone(), why.to_string()));
        }
    }
    let text = match arguments.format {
        Format::Json => format!("{}\n", report_of_views(&found, &views_found)),
        Format::Table => table(&found, &views_found)?,
    };
    let stem = arguments.output.as_deref().and_then(Path::file_stem).unwrap_or_default();
    write_results(arguments, &found, &stem.to_string_lossy(), &text)?;
    Ok(ExitCode::SUCCESS)
}

fn collect_views(sources: &[String], options: &ViewOptions<'_>) -> anyhow::Result<BoardViews> {
    let mut patterns = Vec::new();
    for source in sources {
        if !views::is_stream(source) {
            patterns.push(source.clone());
            continue;
        }
        match SourceAddress::parse(source, Path::new(""))? {
            // Images without a rate are not consecutive frames, so a different position of the board is not motion.
            SourceAddress::Images(images) if !images.is_timed() => patterns.push(images.pattern),
            address if sources.len() == 1 => {
                let gathered = views::collect_from_stream(source, &address, options)?;
                let (taken, left_out) = (Vec::new(), Vec::new());
                return Ok(BoardViews { gathered, files_left_out: 0, taken, left_out });
            }
            _ => bail!(
                "expected a single source: {source} cannot be combined with others; only files and folders can"
            ),
        }
    }
    views::reject_size_option(options, "pictures in files")?;
    files::collect_views(&patterns, options)
}

/// Writes the file, if one is requested, and prints the report even if that fails.
pub(super) fn write_results(
    arguments: &LensArgs,
    found: &LensCalibration,
    name: &str,
    report: &str,
) -> anyhow::Result<()> {
    let written = arguments.output.as_ref().map_or(Ok(()), |file| {
        output::write(file, &camera_file(arguments.name.as_deref().unwrap_or(name), found))
    });
    print(report)?;
    written
}

fn calibration_target(arguments: &LensArgs) -> anyhow::Result<CalibrationTarget> {
    let LensArgs { marker, pitch, code, .. } = arguments;
    match &arguments.board {
        BoardArg::Roundels(sides) => {
            let layout = code.unwrap_or(BOARD_LAYOUT);
            Ok(CalibrationTarget::Roundels(PrintJob::board(*sides, *marker, *pitch, layout)?))
        }
        BoardArg::Chessboard(board) => {
            if marker.is_some() || pitch.is_some() || code.is_some() {
                bail!(
                    "--marker, --pitch and --code apply only to boards of roundels; --board describes the squares of a \
                     chessboard, such as chessboard:9x6:25"
                );
            }
            Ok(CalibrationTarget::Chessboard(board.clone()))
        }
    }
}

/// Suggests why no view was taken. A board is not found if any part of its description is wrong.
fn hint(target: &CalibrationTarget, BoardViews { gathered, .. }: &BoardViews) -> String {
    let is_nowhere = gathered.without_board == gathered.frames;
    match target {
        CalibrationTarget::Roundels(board) if is_nowhere => {
            let codes = match board.kind().pattern {
                Pattern::Coded(layout) => format!(" with {}", codes(layout)),
                _ => String::new(),
            };
            format!(
                " (is it the board of {} x {} roundels{codes} (see its footer), lit, and large enough in the picture?)",
                board.columns(),
                board.rows()
            )
        }
        CalibrationTarget::Chessboard(Chessboard { markers: Some(_), .. }) if is_nowhere => {
            " (are these its counts of squares and its dictionary, and is the square at the top left black?)".to_owned()
        }
        _ if gathered.moving > 0 && gathered.selector.taken().is_empty() => {
            " (hold the board still for a moment at each place; pass photographs that are not consecutive frames as a \
             folder or as files)"
                .to_owned()
        }
        _ => String::new(),
    }
}

fn report_of_views(found: &LensCalibration, views_found: &BoardViews) -> Value {
    let BoardViews { gathered, files_left_out, taken, left_out } = views_found;
    let points = gathered.selector.target().points();
    let views: Vec<_> = found
        .views
        .iter()
        .enumerate()
        .map(|(index, view)| {
            let mut report = match view {
                Ok(view) => json!({"rms_px": view.rms_px, points: view.roundels}),
                Err(why) => json!({"left_out": why.to_string()}),
            };
            if let Some(file) = taken.get(index) {
                report["file"] = json!(file);
            }
            report
        })
        .collect();
    let mut report = report(found);
    report["views"] = json!(views);
    report["frames"] = json!(gathered.frames);
    report["files_left_out"] = json!(files_left_out);
    let of_file = |(file, why): &(PathBuf, String)| json!({"file": file, "why": why});
    report["left_out"] = json!(left_out.iter().map(of_file).collect::<Vec<_>>());
    report["coverage"] = json!(gathered.selector.coverage().share());
    report["width"] = found.diameter_check.map_or(Value::Null, |width| {
        json!({
            "ratio": width.ratio,
            "deviation": width.deviation,
            "found_outer_mm": width.found_outer_mm(),
            "found_pitch_mm": width.found_pitch_mm(),
            "warning": width_doubt(found),
        })
    });
    report
}

/// The lens and the comparison of distortion models.
pub(super) fn report(found: &LensCalibration) -> Value {
    let intrinsics = found.camera.intrinsics();
    let parameters: serde_json::Map<String, Value> = parameters(found)
        .into_iter()
        .map(|(name, value, sd)| (name.to_owned(), json!({"value": value, "deviation": sd})))
        .collect();
    json!({
        "width": intrinsics.width,
        "height": intrinsics.height,
        "distortion_model": intrinsics.lens.name(),
        "distortion_coefficients": intrinsics.lens.coefficients(),
        "parameters": parameters,
        "covariance": (0..found.covariance.nrows())
            .flat_map(|row| (row..found.covariance.ncols()).map(move |column| (row, column)))
            .map(|place| found.covariance[place])
            .collect::<Vec<_>>(),
        "rms_px": found.rms_px,
        "outliers": found.outliers,
        "evidence": found.evidence.iter().map(|evidence| json!({
            "model": evidence.model.ros_name(),
            "coefficients": evidence.model.names(),
            "rms_px": evidence.rms_px,
            "against": evidence.against,
        })).collect::<Vec<_>>(),
    })
}

fn table(found: &LensCalibration, views_found: &BoardViews) -> anyhow::Result<String> {
    let (mut text, gathered) = (String::new(), &views_found.gathered);
    let used = found.views.iter().flatten().count();
    writeln!(text, "{}", views_found.summary())?;
    writeln!(
        text,
        "{used} views used, {} left out, {} {} left out; rms {:.3} px; {} % of the picture covered",
        found.views.len() - used,
        found.outliers,
        gathered.selector.target().points(),
        found.rms_px,
        (gathered.selector.coverage().share() * 100.0).round()
    )?;
    write_parameters(&mut text, found)?;
    if let Some(doubt) = width_doubt(found) {
        writeln!(text, "Warning: {doubt}")?;
    }
    write_evidence(&mut text, found)?;
    write_missing(&mut text, &gathered.selector.coverage().missing_views())?;
    Ok(text)
}

/// The views or sightings that would improve the lens.
pub(super) fn write_missing(text: &mut String, missing: &[impl Display]) -> std::fmt::Result {
    if !missing.is_empty() {
        writeln!(text, "To improve the lens, add:")?;
    }
    missing.iter().try_for_each(|missing| writeln!(text, "  {missing}"))
}

/// A line for each distortion model with the evidence against it.
pub(super) fn write_evidence(text: &mut String, found: &LensCalibration) -> std::fmt::Result {
    if found.evidence.len() < 2 {
        return Ok(());
    }
    writeln!(
        text,
        "Distortion models (BIC above the lowest; the simplest model below {STRONG_EVIDENCE} is selected):"
    )?;
    for evidence in &found.evidence {
        let model = format!("{} ({})", evidence.model.ros_name(), evidence.model.names().join(" "));
        let taken = if evidence.model == found.model { "  selected" } else { "" };
        writeln!(
            text,
            "  {model:45} {:>9.1}  rms {:.3} px{taken}",
            evidence.against, evidence.rms_px
        )?;
    }
    Ok(())
}

/// A line for each parameter of the lens.
pub(super) fn write_parameters(text: &mut String, found: &LensCalibration) -> std::fmt::Result {
    writeln!(text, "{} ({})", found.model.ros_name(), found.model.names().join(" "))?;
    for (name, value, sd) in parameters(found) {
        match name {
            "fx" | "fy" | "cx" | "cy" => writeln!(text, "  {name:>3} {value:>12.3} ± {sd:.3} px")?,
            _ => writeln!(text, "  {name:>3} {value:>12.6} ± {sd:.6}")?,
        }
    }
    Ok(())
}

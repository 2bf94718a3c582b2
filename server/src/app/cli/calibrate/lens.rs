//! `roundel calibrate lens`: a camera file from views of the printed board, or from a recording ([`super::moving`]).

use std::{
    fmt::Write as _,
    io::Write as _,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use roundel_core::{
    calib::lens::{LensCalibration, Model, STRONG, calibrate},
    marker::{CodeLayout, Pattern},
    plan::precision::LensDoubt,
};
use serde_json::{Value, json};

use super::{
    Format, files, output,
    views::{self, BoardViews, ViewOptions},
};
use crate::{
    app::cli::size,
    lab::{
        lens::{
            board_search::CalibrationTarget,
            chessboard::{self, Chessboard},
            report::{parameters, width_doubt},
        },
        print::{
            BOARD_LAYOUT, PrintJob, codes,
            spec::{self, Diameters},
        },
    },
    model::address::SourceAddress,
    model::camera_file,
};

/// Find a lens: focal length, principal point and distortion, from views of the printed board, or from a recording of
/// robots that other cameras saw as well.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel print --board 7x5 board.pdf\n  \
    roundel calibrate lens --output north.yaml v4l2:/dev/video0\n      \
    move the board before the camera\n  \
    roundel calibrate lens --output north.yaml --size 1920x1080 v4l2:/dev/video0\n  \
    roundel calibrate lens --output north.yaml http://10.0.0.2:81/stream\n  \
    roundel calibrate lens --output north.yaml views/\n      \
    a folder, or files\n  \
    roundel calibrate lens --output north.yaml --board chessboard:9x6:25 views/\n  \
    roundel calibrate lens --output north.yaml --board charuco:10x7:25:18:DICT_4X4_50 views/\n  \
    roundel calibrate lens --output north.yaml --from-recording run.mcap --camera north\n\n\
    Good views are chosen by themselves: the board held still for a moment, near and far, in the middle and in every \
    corner, tilted to each side by 20° to 45°. Fix the print to something flat. It ends when nothing is missing, after \
    --views views, or with Ctrl-C, which takes what there is.\n\n\
    From a recording that a server has made (`roundel record`), without a board: where the other cameras had the coded \
    roundels of moving robots is held against where this one saw them. The arena must be calibrated, and the camera must \
    stand still; its own file and pose are not asked.")]
pub(super) struct LensArgs {
    /// A source as in a configuration (images:, http:, v4l2:, rtsp:, file:, …), a folder, or image files
    #[arg(required_unless_present = "from_recording", value_name = "SOURCE")]
    sources: Vec<String>,
    /// A recording in which other cameras saw coded roundels that this one saw
    #[arg(
        long,
        value_name = "FILE.mcap",
        requires = "camera",
        conflicts_with_all = ["sources", "board", "marker", "pitch", "code", "views", "size"]
    )]
    from_recording: Option<PathBuf>,
    /// The camera of the recording whose lens is wanted
    #[arg(long, value_name = "NAME", requires = "from_recording", conflicts_with = "sources")]
    camera: Option<String>,
    /// The printed board: columns and rows of roundels; or chessboard:COLUMNSxROWS:SQUARE_MM by its inner corners, or
    /// charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM:DICTIONARY by its squares
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = parse_board, default_value = "7x5")]
    board: BoardArg,
    /// Its roundels' outer diameter, millimetres, as measured on the print [default: 30]
    #[arg(long, value_name = "OUTER_MM", value_parser = spec::diameters, allow_hyphen_values = true)]
    marker: Option<Diameters>,
    /// From centre to centre, millimetres, as measured on the print [default: 1.2 of the outer diameter]
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pitch: Option<f64>,
    /// Its codes [default: 9]
    #[arg(long, value_name = "BITS[:DISTANCE]", value_parser = spec::code)]
    code: Option<CodeLayout>,
    /// The distortion model [default: the one that the views speak for]
    #[arg(long, value_enum)]
    model: Option<ModelArg>,
    /// Most views that are used
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u16).range(5..=500))]
    views: u16,
    /// Size of the pictures that is asked of a camera [default: 1280x720, or what it gives]
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<(usize, usize)>,
    /// The camera's name in the file [default: the file's, or the recorded camera's]
    #[arg(long)]
    name: Option<String>,
    /// Where the camera_info YAML is written, what was there is kept as FILE.previous.yaml; without it, it is only shown
    #[arg(long, short, value_name = "FILE.yaml")]
    output: Option<PathBuf>,
    /// How to print the report
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

/// A board as it is described.
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
                "{error}; boards of other tools are described as chessboard:9x6:25 or charuco:10x7:25:18:DICT_4X4_50"
            )
        }),
    }
}

/// Words for distortion models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum ModelArg {
    /// k1 k2 p1 p2 k3
    PlumbBob,
    /// k1 k2 p1 p2 k3 k4 k5 k6
    RationalPolynomial,
    /// k1 k2 k3 k4, for fisheyes
    Equidistant,
}

impl LensArgs {
    /// The recording and its camera, if the lens is calibrated from one.
    pub(super) fn recorded_camera(&self) -> Option<(&Path, &str)> {
        Some((self.from_recording.as_deref()?, self.camera.as_deref()?))
    }

    pub(super) fn output(&self) -> Option<&Path> {
        self.output.as_deref()
    }

    pub(super) fn model(&self) -> Option<Model> {
        self.model.map(|word| match word {
            ModelArg::PlumbBob => Model::PlumbBob,
            ModelArg::RationalPolynomial => Model::Rational,
            ModelArg::Equidistant => Model::Equidistant,
        })
    }

    pub(super) fn format(&self) -> Format {
        self.format
    }
}

/// Chooses views, solves, writes the file, and prints the report.
pub(super) fn run(arguments: &LensArgs) -> anyhow::Result<ExitCode> {
    let sought = calibration_target(arguments)?;
    let most = usize::from(arguments.views);
    let mut views_found = collect_views(
        &arguments.sources,
        &ViewOptions { sought: &sought, most, size: arguments.size },
    )?;
    let gathered = &views_found.gathered;
    let taken = gathered.chooser.taken();
    let found = calibrate(gathered.chooser.target(), gathered.size, taken, arguments.model())
        .with_context(|| {
            format!("no lens was found: {}{}", views_found.summary(), hint(&sought, &views_found))
        })?;
    views_found.add_left_out(&found);
    let text = match arguments.format {
        Format::Json => format!("{}\n", report_of_views(&found, &views_found)),
        Format::Table => table(&found, &views_found)?,
    };
    let file = arguments.output.as_deref().map(stem).unwrap_or_default();
    write_results(arguments, &found, &file, &text)?;
    Ok(ExitCode::SUCCESS)
}

/// Searches every picture, or a stream until it ends, there are enough views, or Ctrl-C.
fn collect_views(sources: &[String], options: &ViewOptions<'_>) -> anyhow::Result<BoardViews> {
    let mut patterns = Vec::new();
    for source in sources {
        if !views::is_stream(source) {
            patterns.push(source.clone());
            continue;
        }
        match SourceAddress::parse(source, Path::new(""))? {
            // Without a rate nobody says that one was taken right after the other: a board that is elsewhere in the
            // next one has not moved.
            SourceAddress::Images(images) if !images.is_timed() => patterns.push(images.pattern),
            address if sources.len() == 1 => {
                let gathered = views::collect_from_stream(source, &address, options)?;
                return Ok(BoardViews {
                    gathered,
                    left_out: 0,
                    taken: Vec::new(),
                    out: Vec::new(),
                });
            }
            _ => bail!(
                "one source at a time: {source} is looked at by itself; files and folders may be several"
            ),
        }
    }
    views::reject_size_option(options, "pictures in files")?;
    files::collect_views(&patterns, options)
}

/// Writes the file if one is wanted, and prints the report, whatever becomes of the other.
pub(super) fn write_results(
    arguments: &LensArgs,
    found: &LensCalibration,
    name: &str,
    report: &str,
) -> anyhow::Result<()> {
    let written = arguments.output.as_ref().map_or(Ok(()), |file| {
        let name = arguments.name.as_deref().unwrap_or(name);
        let doubt =
            LensDoubt { free: found.model.free().to_vec(), covariance: found.covariance.clone() };
        output::write(file, &camera_file::write_with_uncertainty(name, &found.camera, Some(&doubt)))
    });
    std::io::stdout()
        .write_all(report.as_bytes())
        .context("cannot write to the standard output")?;
    written
}

fn stem(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
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
                    "--marker, --pitch and --code describe a board of roundels; a chessboard's squares are described in \
                     --board, such as chessboard:9x6:25"
                );
            }
            Ok(CalibrationTarget::Chessboard(board.clone()))
        }
    }
}

/// What may be wrong where there is no view at all: nothing of a board is found where anything of its description is wrong.
fn hint(sought: &CalibrationTarget, BoardViews { gathered, .. }: &BoardViews) -> String {
    let is_nowhere = gathered.without_board == gathered.frames;
    match sought {
        CalibrationTarget::Roundels(board) if is_nowhere => {
            let codes = match board.kind().pattern {
                Pattern::Coded(layout) => format!(" with {}", codes(layout)),
                _ => String::new(),
            };
            let (columns, rows) = (board.columns(), board.rows());
            format!(
                " (is it the board of {columns} x {rows} roundels{codes} (see its foot), lit, and large enough in the \
                 picture?)"
            )
        }
        CalibrationTarget::Chessboard(Chessboard { markers: Some(_), .. }) if is_nowhere => {
            " (are these its counts of squares and its dictionary, and is the square at the top left black?)".to_owned()
        }
        _ if gathered.moving > 0 && gathered.chooser.taken().is_empty() => {
            " (hold the board still for a moment at each place; photographs that do not follow one another in time are \
             given as a folder or as files)"
                .to_owned()
        }
        _ => String::new(),
    }
}

fn report_of_views(found: &LensCalibration, views_found: &BoardViews) -> Value {
    let BoardViews { gathered, left_out, taken, out } = views_found;
    let points = gathered.chooser.target().points();
    let views: Vec<_> = found
        .views
        .iter()
        .enumerate()
        .map(|(index, view)| {
            let mut told = match view {
                Ok(view) => json!({"rms_px": view.rms_px, points: view.roundels}),
                Err(why) => json!({"left_out": why.to_string()}),
            };
            if let Some(file) = taken.get(index) {
                told["file"] = json!(file);
            }
            told
        })
        .collect();
    let mut report = report(found);
    report["views"] = json!(views);
    report["frames"] = json!(gathered.frames);
    report["files_left_out"] = json!(left_out);
    let of_file = |(file, why): &(PathBuf, String)| json!({"file": file, "why": why});
    report["left_out"] = json!(out.iter().map(of_file).collect::<Vec<_>>());
    report["coverage"] = json!(gathered.chooser.coverage().share());
    report["width"] = found.width.map_or(Value::Null, |width| {
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

/// The lens, and what speaks for it.
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
        gathered.chooser.target().points(),
        found.rms_px,
        (gathered.chooser.coverage().share() * 100.0).round()
    )?;
    write_parameters(&mut text, found)?;
    if let Some(doubt) = width_doubt(found) {
        writeln!(text, "Warning: {doubt}")?;
    }
    write_evidence(&mut text, found)?;
    let wants = gathered.chooser.coverage().wants();
    if !wants.is_empty() {
        writeln!(text, "It would be known better with:")?;
        for want in wants {
            writeln!(text, "  {want}")?;
        }
    }
    Ok(text)
}

/// What speaks against each model, a line a model.
pub(super) fn write_evidence(text: &mut String, found: &LensCalibration) -> std::fmt::Result {
    if found.evidence.len() < 2 {
        return Ok(());
    }
    writeln!(
        text,
        "Evidence against each model (Schwarz's criterion less the least; {STRONG} is strong, and of those below the simplest \
         is taken):"
    )?;
    for evidence in &found.evidence {
        let model = format!("{} ({})", evidence.model.ros_name(), evidence.model.names().join(" "));
        let taken = if evidence.model == found.model { "  taken" } else { "" };
        writeln!(
            text,
            "  {model:45} {:>9.1}  rms {:.3} px{taken}",
            evidence.against, evidence.rms_px
        )?;
    }
    Ok(())
}

/// The lens, a line a parameter.
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

//! `roundel plan`: what cameras and roundels would reach, and which ones it takes.

mod arena;
mod ignored_options;
mod load;
mod measure;
mod optics;
mod roundel;
mod single;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use roundel_core::{
    marker::{CodeLayout, Kind, Mode},
    plan::{Imaging, map::Field, search::Wish},
};

use crate::lab::{
    plan::{
        machine_timings::{MachineTimings, default_path},
        map_drawing,
        plan_map::MapLayer,
        plan_map::PlanMap,
    },
    print::spec::{self, Diameters, PolarityArg, PrintSpec},
};

/// Precision that may be wanted, millimetres.
const PRECISION_RANGE_MM: std::ops::RangeInclusive<f64> = 1e-4..=1e6;
/// Ratio of the diameters of a plain roundel, if nobody says another.
const DEFAULT_RATIO: f64 = 0.4;

/// Foretell range, precision and time, and what it takes.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  \
    roundel plan --resolution 1280x720 --fov 80 --marker 160:64 --distance 5\n  \
    roundel plan --camera north.yaml --marker 160 --code 8:2 --distance 5 --tilt 30 --count 24\n  \
    roundel plan --camera north.yaml --distance 8 --precision 2\n      \
    which roundel is located to 2 mm at 8 m?\n  \
    roundel plan --camera north.yaml --marker 160:64 --arena 10x8 --mount 3:5 --map grid.svg\n      \
    how many cameras see it all, and where?\n  \
    roundel plan --camera north.yaml --arena 10x8 --mount 3:5 --precision 1\n      \
    the same, to 1 mm, and with which roundel?\n  \
    roundel plan --config lab.toml --map lab.png\n      \
    what does the installation see?\n  \
    roundel plan --measure\n      \
    how fast is this machine?\n\n\
    Precision is that of one frame (of one set of frames, over an arena): rms of the distance from the truth. Beside \
    each figure of one camera stands what the model of the WhyCon paper says (section 5)."
)]
pub struct PlanArgs {
    /// ROS camera_info YAML of the camera
    #[arg(long, value_name = "FILE", conflicts_with_all = ["resolution", "fov", "config"])]
    camera: Option<PathBuf>,
    /// Columns and rows of the camera's picture, instead of a camera file
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = spec::sides, requires = "fov", allow_hyphen_values = true)]
    resolution: Option<(usize, usize)>,
    /// Its horizontal field of view, degrees
    #[arg(long, value_name = "DEGREES", requires = "resolution")]
    fov: Option<f64>,
    /// Diameters in millimetres [default: 160; with --precision it is searched for]
    #[arg(long, value_name = "OUTER_MM[:INNER_MM[:MINOR_MM]]", value_parser = spec::diameters, allow_hyphen_values = true)]
    marker: Option<Diameters>,
    /// Codes: bits, and the least Hamming distance
    #[arg(long, value_name = "BITS[:DISTANCE]", value_parser = spec::code)]
    code: Option<CodeLayout>,
    /// Which of ring and disc is black
    #[arg(long, value_enum, default_value_t)]
    polarity: PolarityArg,
    /// What is worth more [default: precise; with --config: as configured]
    #[arg(long, value_enum)]
    mode: Option<ModeArg>,
    /// Distance along the optical axis, metres [default: midway from the nearest to the farthest]
    #[arg(long, value_name = "M")]
    distance: Option<f64>,
    /// Tilt of the roundel against the picture, degrees [default: 0]
    #[arg(long, value_name = "DEGREES")]
    tilt: Option<f64>,
    /// Deviation of the noise, grey levels of 255
    #[arg(long, default_value_t = Imaging::default().noise)]
    noise: f64,
    /// Deviation of the lens' blur, pixels
    #[arg(long, value_name = "PX", default_value_t = Imaging::default().blur_px)]
    blur: f64,
    /// Grey level of black print
    #[arg(long, default_value_t = Imaging::default().black)]
    black: f64,
    /// Grey level of white paper
    #[arg(long, default_value_t = Imaging::default().white)]
    white: f64,
    /// Roundels in the picture, over an arena in every one [default: 10]
    #[arg(long)]
    count: Option<u32>,
    /// How fast they move across the line of sight, metres a second [default: 0.5]
    #[arg(long, value_name = "M_S")]
    speed: Option<f64>,
    /// Frames a second that the camera takes [default: 30]
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Share of frames in which they are lost and the whole picture is searched, 0 to 1 [default: 0]
    #[arg(long, value_name = "SHARE")]
    lost: Option<f64>,
    /// Wanted: rms of the distance from the truth, millimetres
    #[arg(long, value_name = "MM")]
    precision: Option<f64>,
    /// How many such cameras, looking straight down, cover an arena of these sides, metres?
    #[arg(long, value_name = "WIDTHxDEPTH", value_parser = sides_m, conflicts_with = "config", allow_hyphen_values = true)]
    arena: Option<[f64; 2]>,
    /// Height of the roundels in the arena, metres [default: 0.3]
    #[arg(long, value_name = "M")]
    height: Option<f64>,
    /// With --arena: the height that cameras hang at, or LOWEST:HIGHEST, metres
    #[arg(long, value_name = "M[:M]", value_parser = heights_m, requires = "arena", conflicts_with = "config", allow_hyphen_values = true)]
    mount: Option<[f64; 2]>,
    /// With --arena: cameras that have to see every place
    #[arg(long, default_value_t = 1, requires = "arena", conflicts_with = "config")]
    views: usize,
    /// With --arena: share of it in which all this has to hold
    #[arg(long, default_value_t = 0.98, requires = "arena", conflicts_with = "config")]
    share: f64,
    /// The cameras of this installation
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// With --config: the kind of roundel [default: the first one]
    #[arg(long, value_name = "NAME", requires = "config", conflicts_with = "marker")]
    kind: Option<String>,
    /// With --config or --arena: write the map, as .svg, .png or .json
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// What the map shows [default: precision]
    #[arg(long, value_enum)]
    show: Option<MapLayer>,
    /// From spot to spot of the map, metres [default: about 2400 spots]
    #[arg(long, value_name = "M")]
    step: Option<f64>,
    /// Measure what this machine takes for a frame, and keep it
    #[arg(long)]
    measure: bool,
    /// Where that is kept [default: beside --config, else machine.toml in the folder roundel of your configurations]
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// How to print the report
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Words for modes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ModeArg {
    /// Fitted to grey levels
    Precise,
    /// By moments
    Fast,
}

/// How the report is printed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Format {
    /// For people
    #[default]
    Table,
    /// One JSON object
    Json,
}

/// Answers, and writes the map if one is wanted.
pub(super) fn run(arguments: &PlanArgs) -> anyhow::Result<ExitCode> {
    for line in ignored_options::ignored_options(arguments) {
        eprintln!("{line}");
    }
    arguments.check()?;
    if arguments.measure {
        measure::run(arguments)?;
    } else if let Some(config) = &arguments.config {
        arena::plan_installation(arguments, config)?;
    } else if let Some(arena_m) = arguments.arena {
        arena::plan_arena(arguments, arena_m)?;
    } else if arguments.map.is_some() {
        bail!(
            "a map needs cameras with places: expected --config FILE, or --arena WIDTHxDEPTH with --mount"
        );
    } else {
        single::run(arguments)?;
    }
    Ok(ExitCode::SUCCESS)
}

impl PlanArgs {
    /// What can be told before anything is searched for, in the words and units of the options.
    fn check(&self) -> anyhow::Result<()> {
        if let Some(path) = &self.map {
            map_file_type(path)?;
        }
        let height = self.height();
        let [least, most] = Field::HEIGHTS_M;
        if !(least..=most).contains(&height) {
            bail!("--height: expected {least} to {most} m, found {height}");
        }
        let least_above = Wish::LEAST_ABOVE_M;
        match self.mount {
            Some([low, _]) if self.arena.is_some() && low < height + least_above => bail!(
                "--mount: expected cameras that hang {least_above} m or more above the roundels, which are {height} m \
                 high (--height), found {low} m"
            ),
            _ => {}
        }
        match self.precision {
            Some(precision) if !PRECISION_RANGE_MM.contains(&precision) => {
                let (least, most) = (PRECISION_RANGE_MM.start(), PRECISION_RANGE_MM.end());
                bail!("--precision: expected {least} to {most} mm, found {precision}")
            }
            _ => Ok(()),
        }
    }

    /// The wanted rms, metres.
    fn most_m(&self) -> Option<f64> {
        self.precision.map(|precision| precision * 1e-3)
    }

    fn imaging(&self) -> Imaging {
        let Self { noise, blur, black, white, .. } = *self;
        Imaging { noise, blur_px: blur, black, white }
    }

    fn tilt(&self) -> f64 {
        self.tilt.unwrap_or(0.0)
    }

    fn count(&self) -> u32 {
        self.count.unwrap_or(10)
    }

    fn speed(&self) -> f64 {
        self.speed.unwrap_or(0.5)
    }

    fn rate(&self) -> f64 {
        self.rate.unwrap_or(30.0)
    }

    fn lost(&self) -> f64 {
        self.lost.unwrap_or(0.0)
    }

    fn height(&self) -> f64 {
        self.height.unwrap_or(0.3)
    }

    fn mode(&self) -> Mode {
        match self.mode {
            Some(ModeArg::Fast) => Mode::Fast,
            Some(ModeArg::Precise) | None => Mode::Precise,
        }
    }

    /// The roundel, with the usual proportions where they are not said.
    fn kind(&self) -> anyhow::Result<Kind> {
        let mut diameters =
            self.marker.unwrap_or(Diameters { outer_m: 0.16, inner_m: None, minor_m: None });
        if diameters.inner_m.is_none() && self.code.is_none() {
            diameters.inner_m = Some(DEFAULT_RATIO * diameters.outer_m);
        }
        let polarity = self.polarity.into();
        let print = PrintSpec { diameters: Some(diameters), code: self.code, polarity };
        print.kind().context("--marker: expected OUTER_MM:INNER_MM, such as 160:64")
    }

    /// Its times, and where they come from.
    fn machine(&self) -> anyhow::Result<(MachineTimings, String)> {
        let usual = default_path(self.config.as_deref());
        match (&self.machine, usual) {
            (Some(path), _) => Ok((MachineTimings::load(path)?, measured_source(path))),
            (None, Some(path)) if path.exists() => Ok((MachineTimings::load(&path)?, measured_source(&path))),
            (None, _) => Ok((
                MachineTimings::default(),
                "not measured: those of a virtual machine (AMD EPYC) stand in; `roundel plan --measure` measures this \
                 machine"
                    .to_owned(),
            )),
        }
    }

    /// Writes the map, if that is wanted.
    fn write_map(&self, map: &PlanMap) -> anyhow::Result<()> {
        let Some(path) = &self.map else { return Ok(()) };
        let failed = || format!("cannot write {}", path.display());
        let bytes = match map_file_type(path)? {
            MapFileType::Svg => map_drawing::svg(map, self.show.unwrap_or_default()).into_bytes(),
            MapFileType::Png => {
                map_drawing::png(map, self.show.unwrap_or_default()).with_context(failed)?
            }
            MapFileType::Json => serde_json::to_vec_pretty(map).with_context(failed)?,
        };
        std::fs::write(path, bytes).with_context(failed)?;
        eprintln!("wrote {}", path.display());
        Ok(())
    }
}

/// What a map is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum MapFileType {
    Svg,
    Png,
    Json,
}

fn map_file_type(path: &Path) -> anyhow::Result<MapFileType> {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match ending.as_str() {
        "svg" => Ok(MapFileType::Svg),
        "png" => Ok(MapFileType::Png),
        "json" => Ok(MapFileType::Json),
        _ => bail!("--map {}: expected a name that ends in .svg, .png or .json", path.display()),
    }
}

fn measured_source(path: &Path) -> String {
    format!("measured, {}", path.display())
}

/// Reads `WIDTHxDEPTH` in metres.
fn sides_m(text: &str) -> Result<[f64; 2], String> {
    let wrong = || format!("expected WIDTHxDEPTH in metres above 0, such as 10x8, found `{text}`");
    let (width, depth) = text.split_once(['x', 'X', '×']).ok_or_else(wrong)?;
    let side = |text: &str| text.trim().parse::<f64>().ok().filter(|side| *side > 0.0);
    side(width).zip(side(depth)).map(|(width, depth)| [width, depth]).ok_or_else(wrong)
}

/// Reads `M` or `M:M`.
fn heights_m(text: &str) -> Result<[f64; 2], String> {
    let wrong =
        || format!("expected a height in metres, or LOWEST:HIGHEST, such as 3:5, found `{text}`");
    let (low, high) = text.split_once(':').unwrap_or((text, text));
    let height = |text: &str| text.trim().parse::<f64>().ok().filter(|height| height.is_finite());
    let ends = height(low).zip(height(high)).filter(|(low, high)| low <= high);
    ends.map(|(low, high)| [low, high]).ok_or_else(wrong)
}

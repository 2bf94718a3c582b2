//! `roundel plan`: predicts range, accuracy and time per frame, and searches for cameras and roundels that meet requirements.

mod arena;
mod ignored_options;
mod inputs;
mod measure;
mod report;
mod single;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, anyhow, bail};
use clap::{Args, ValueEnum};
use roundel_core::{
    marker::{CodeLayout, Kind, Mode},
    plan::{Imaging, search::Requirements},
};

use super::{Format, MODES, words};
use crate::lab::{
    plan::{
        map_drawing::{self, MapFormat},
        plan_map::MapLayer,
    },
    print::spec::{self, Diameters, PolarityArg, PrintSpec},
};

/// Default ratio of the diameters of a plain roundel.
const DEFAULT_RATIO: f64 = 0.4;

/// Predict range, accuracy and load, or find the roundel and the cameras that an accuracy requires
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  \
    roundel plan --resolution 1280x720 --fov 80 --marker 160:64 --distance 5\n  \
    roundel plan --camera north.yaml --marker 160 --code 8:2 --distance 5 --tilt 30 --count 24\n  \
    roundel plan --camera north.yaml --distance 8 --precision 2\n      \
    which roundel is located to 2 mm at 8 m?\n  \
    roundel plan --camera north.yaml --marker 160:64 --arena 10x8 --mount 3:5 --map grid.svg\n      \
    how many cameras cover the arena, and where?\n  \
    roundel plan --camera north.yaml --arena 10x8 --mount 3:5 --precision 1\n      \
    the same to 1 mm, and with which roundel?\n  \
    roundel plan --config lab.toml --map lab.png\n      \
    what does the installation cover?\n  \
    roundel plan --measure\n      \
    how fast is this computer?\n\n\
    Accuracy is the rms distance from the truth after one frame (over an arena: after one frame of each camera). For one \
    camera, the report also shows the prediction of the WhyCon paper (section 5). Times are measured on this computer, on \
    simulated frames."
)]
pub struct PlanArgs {
    /// ROS camera_info YAML of the camera
    #[arg(long, value_name = "FILE", conflicts_with_all = ["resolution", "fov", "config"])]
    camera: Option<PathBuf>,
    /// Resolution of the camera, instead of a camera file
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = spec::sides, requires = "fov", allow_hyphen_values = true)]
    resolution: Option<(usize, usize)>,
    /// Horizontal field of view of that camera, degrees
    #[arg(long, value_name = "DEGREES", requires = "resolution")]
    fov: Option<f64>,
    /// Diameters in millimetres [default: 160; with --precision the smallest sufficient one]
    #[arg(long, value_name = "OUTER_MM[:INNER_MM[:MINOR_MM]]", value_parser = spec::diameters, allow_hyphen_values = true)]
    marker: Option<Diameters>,
    /// Coded roundels: bits and minimum Hamming distance
    #[arg(long, value_name = "BITS[:DISTANCE]", value_parser = spec::code)]
    code: Option<CodeLayout>,
    /// Whether the ring or the disc is black
    #[arg(long, value_enum, default_value_t)]
    polarity: PolarityArg,
    /// How roundels are located: precise (fitted to grey levels) or fast (by moments) [default: precise; with --config:
    /// as configured]
    #[arg(long, value_parser = words(&MODES))]
    mode: Option<Mode>,
    /// Distance along the optical axis, metres [default: midway from the nearest to the farthest]
    #[arg(long, value_name = "M")]
    distance: Option<f64>,
    /// Tilt of the roundel against the image plane, degrees [default: 0]
    #[arg(long, value_name = "DEGREES")]
    tilt: Option<f64>,
    /// Standard deviation of the noise, grey levels of 255
    #[arg(long, default_value_t = Imaging::default().noise)]
    noise: f64,
    /// Standard deviation of the lens' blur, pixels
    #[arg(long, value_name = "PX", default_value_t = Imaging::default().blur_px)]
    blur: f64,
    /// Grey level of black print
    #[arg(long, default_value_t = Imaging::default().black)]
    black: f64,
    /// Grey level of white paper
    #[arg(long, default_value_t = Imaging::default().white)]
    white: f64,
    /// Roundels in each picture, for the time per frame [default: 10]
    #[arg(long)]
    count: Option<u32>,
    /// Speed of the roundels across the line of sight, metres per second [default: 0.5]
    #[arg(long, value_name = "M_S")]
    speed: Option<f64>,
    /// Frame rate of the cameras, hertz [default: 30]
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Share of frames in which roundels are lost and the whole picture is searched, 0 to 1 [default: 0]
    #[arg(long, value_name = "SHARE")]
    lost: Option<f64>,
    /// Required accuracy: rms distance from the truth, millimetres
    #[arg(long, value_name = "MM")]
    precision: Option<f64>,
    /// Find the fewest cameras of this type, looking straight down, that cover an arena of this size, metres
    #[arg(long, value_name = "WIDTHxDEPTH", value_parser = sides_m, conflicts_with = "config", allow_hyphen_values = true)]
    arena: Option<[f64; 2]>,
    /// Height of the roundels in the arena, metres [default: 0.3]
    #[arg(long, value_name = "M")]
    height: Option<f64>,
    /// With --arena: mounting height of the cameras, or LOWEST:HIGHEST, metres
    #[arg(long, value_name = "M[:M]", value_parser = heights_m, requires = "arena", conflicts_with = "config", allow_hyphen_values = true)]
    mount: Option<[f64; 2]>,
    /// With --arena: number of cameras that must see each spot
    #[arg(long, default_value_t = 1, requires = "arena", conflicts_with = "config")]
    views: usize,
    /// With --arena: share of the spots that must meet the requirements
    #[arg(long, default_value_t = 0.98, requires = "arena", conflicts_with = "config")]
    share: f64,
    /// Plan with the cameras of this configuration
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// With --config: the kind of roundel [default: the first one]
    #[arg(long, value_name = "NAME", requires = "config", conflicts_with = "marker")]
    kind: Option<String>,
    /// With --config or --arena: write the map to this file, .svg, .png or .json
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Layer of a drawn map [default: precision]
    #[arg(long, value_enum)]
    show: Option<MapLayer>,
    /// Distance between the spots of the map, metres [default: about 2400 spots]
    #[arg(long, value_name = "M")]
    step: Option<f64>,
    /// Measure the time per frame of a few typical cases on this computer
    #[arg(long)]
    measure: bool,
    /// Ignored: each plan measures its own case on this computer
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Format of the report
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
}

/// Prints the report, and writes the map if requested.
pub(super) fn run(arguments: &PlanArgs) -> anyhow::Result<ExitCode> {
    for line in ignored_options::ignored_options(arguments) {
        eprintln!("{line}");
    }
    arguments.check()?;
    let map = match arguments {
        PlanArgs { measure: true, .. } => measure::run(arguments.format).map(|()| None)?,
        PlanArgs { config: Some(config), .. } => Some(arena::plan_installation(arguments, config)?),
        PlanArgs { arena: Some(arena_m), .. } => Some(arena::plan_arena(arguments, *arena_m)?),
        PlanArgs { map: Some(_), .. } => bail!(
            "--map: expected cameras with positions: add --config FILE, or --arena WIDTHxDEPTH with --mount"
        ),
        _ => single::run(arguments).map(|()| None)?,
    };
    if let (Some(map), Some(path)) = (&map, &arguments.map) {
        let failed = || format!("cannot write {}", path.display());
        let show = arguments.show.unwrap_or_default();
        let bytes = map_drawing::encode(map, map_format(path)?, show).with_context(failed)?;
        std::fs::write(path, bytes).with_context(failed)?;
        eprintln!("wrote {}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

impl PlanArgs {
    /// Checks values before any search starts, so that errors use the names and units of the options.
    fn check(&self) -> anyhow::Result<()> {
        if let Some(path) = &self.map {
            map_format(path)?;
        }
        let limits = [
            ("--distance", self.distance, f64::MIN_POSITIVE..=f64::MAX, "metres above 0"),
            ("--fov", self.fov, 1.0..=150.0, "1 to 150 degrees (--camera for a wider lens)"),
            ("--height", self.height, -1e3..=1e3, "-1000 to 1000 m"),
            ("--lost", self.lost, 0.0..=1.0, "a share of 0 to 1"),
            ("--precision", self.precision, 1e-4..=1e6, "0.0001 to 1000000 mm"),
            ("--rate", self.rate, 0.01..=1e5, "0.01 to 100000 frames per second"),
            ("--speed", self.speed, 0.0..=1e3, "0 to 1000 m/s"),
        ];
        for (option, found, range, expected) in limits {
            if let Some(found) = found
                && !range.contains(&found)
            {
                bail!("{option}: expected {expected}, found {found}");
            }
        }
        let (height, least_above) = (self.height(), Requirements::MIN_HEIGHT_ABOVE_M);
        if let (Some(_), Some([low, _])) = (self.arena, self.mount)
            && low < height + least_above
        {
            bail!(
                "--mount: expected cameras at least {least_above} m above the roundels, whose height is {height} m \
                 (--height), found {low} m"
            );
        }
        Ok(())
    }

    /// The required accuracy, metres.
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

    fn rate(&self) -> f64 {
        self.rate.unwrap_or(30.0)
    }

    fn lost(&self) -> f64 {
        self.lost.unwrap_or(0.0)
    }

    fn height(&self) -> f64 {
        self.height.unwrap_or(0.3)
    }

    /// The roundel, with default proportions if `--marker` has none.
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
}

/// The format of a map by the ending of its file name.
fn map_format(path: &Path) -> anyhow::Result<MapFormat> {
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    MapFormat::from_str(&ending, true).map_err(|_| {
        anyhow!("--map {}: expected a name that ends in .svg, .png or .json", path.display())
    })
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

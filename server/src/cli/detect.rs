//! `roundel detect`: what the detector finds in image files.

mod output;

use std::{
    collections::HashSet,
    fs::{self, File},
    io::{self, BufWriter, IsTerminal as _, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
    time::Instant,
};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use roundel_core::{
    frame::Frame,
    id::TrackNumber,
    marker::{Detector, Kind, Params, RejectCounts, Ring, Scratch, TrackedRing, Tracker},
    pose::{Locator, RoundelPose},
};

use super::told;
use crate::{
    camera_file,
    drawing::Canvas,
    image_file::{self, GreyImage},
};

/// Find roundels in images.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel detect photo.jpg\n  \
    roundel detect --camera north.yaml --marker 160:64 --format json frames/*.png\n  \
    roundel detect --sequence --draw drawn video/*.png\n\n\
    Poses need both --camera and --marker. An image that cannot be read is reported, the others are\n\
    still searched, and the exit code is 1.")]
pub struct DetectArgs {
    /// PNG, JPEG, PGM or BMP files
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Camera file (ROS camera_info YAML), for poses
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Diameters of the print in millimetres; without the inner one, rings of any ratio are found
    #[arg(long, value_name = "OUTER_MM[:INNER_MM]", value_parser = marker)]
    marker: Option<Marker>,
    /// The images are consecutive frames of one camera: tracks carry over
    #[arg(long)]
    sequence: bool,
    /// Write each image as PNG with what was found drawn in
    #[arg(long, value_name = "DIR")]
    draw: Option<PathBuf>,
    /// Tell how many candidates were refused, and why
    #[arg(long)]
    explain: bool,
    /// How to print [default: table on a terminal, json into a file or pipe]
    #[arg(long, value_enum)]
    format: Option<Format>,
}

/// How results are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// For people
    Table,
    /// One JSON object a line, an image each
    Json,
}

/// The print, as given on the command line.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Marker {
    outer_m: f64,
    inner_m: Option<f64>,
}

fn marker(text: &str) -> Result<Marker, String> {
    let millimetres = |text: &str| -> Result<f64, String> {
        let value: f64 = text.trim().parse().map_err(|_| {
            format!("expected OUTER_MM or OUTER_MM:INNER_MM, such as 160:64, found `{text}`")
        })?;
        if value > 0.0 && value <= 1e5 {
            Ok(value * 1e-3)
        } else {
            Err(format!("expected a diameter above 0 mm, at most 100000 mm, found `{text}`"))
        }
    };
    let (outer, inner) = match text.split_once(':') {
        Some((outer, inner)) => (outer, Some(inner)),
        None => (text, None),
    };
    let outer_m = millimetres(outer)?;
    let inner_m = inner.map(millimetres).transpose()?;
    match inner_m {
        Some(inner_m) if inner_m >= outer_m => {
            Err(format!("the inner diameter must be below the outer one, found `{text}`"))
        }
        _ => Ok(Marker { outer_m, inner_m }),
    }
}

/// What was found in one image.
struct Found {
    image: GreyImage,
    elapsed_us: f64,
    roundels: Vec<Roundel>,
    rejects: RejectCounts,
}

/// One roundel in one image.
struct Roundel {
    track: Option<TrackNumber>,
    ring: Ring,
    pose: Option<RoundelPose>,
}

/// Searches images one after the other.
struct Search {
    finder: Finder,
    locator: Option<Locator>,
    marker: Option<Marker>,
}

enum Finder {
    /// Each image for itself.
    Single { detector: Box<Detector>, scratch: Box<Scratch> },
    /// Frames of one camera.
    Sequence { tracker: Box<Tracker> },
}

/// Searches all images and prints what was found, in the order given.
pub(super) fn run(arguments: &DetectArgs) -> anyhow::Result<ExitCode> {
    let mut search = Search::new(arguments)?;
    if let Some(folder) = &arguments.draw {
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    let mut drawn = HashSet::new();
    let mut failed = false;
    let format = arguments
        .format
        .unwrap_or_else(|| if io::stdout().is_terminal() { Format::Table } else { Format::Json });
    let mut out = BufWriter::new(io::stdout().lock());
    for path in &arguments.images {
        let outcome = search.image(path);
        if let Err(error) = &outcome {
            failed = true;
            eprintln!("error: {}", told(error));
        }
        let printed = match format {
            Format::Json => output::json(&mut out, path, &outcome, arguments.explain),
            Format::Table => output::table(&mut out, path, &outcome, arguments.explain),
        };
        // Each line is there as soon as it is known. Who reads them may have seen enough.
        match printed.and_then(|()| out.flush()) {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => break,
            printed => printed.context("cannot write to the standard output")?,
        }
        if let (Some(folder), Ok(found)) = (&arguments.draw, &outcome) {
            let target = folder.join(drawing_name(path, &mut drawn));
            draw(&target, found)
                .with_context(|| format!("cannot write the drawing {}", target.display()))?;
        }
    }
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

impl Search {
    fn new(arguments: &DetectArgs) -> anyhow::Result<Self> {
        let camera = arguments.camera.as_deref().map(camera_file::load).transpose()?;
        let kinds = arguments.marker.and_then(|marker| {
            marker.inner_m.map(|inner_m| kind("marker", marker.outer_m, inner_m))
        });
        let detector =
            Detector::new(kinds.into_iter().collect(), Params::default()).context("--marker")?;
        let mode = detector.params().mode;
        let locator = camera.map(|camera| Locator::new(camera, detector.kinds().to_vec(), mode));
        let finder = if arguments.sequence {
            Finder::Sequence { tracker: Box::new(Tracker::new(detector)) }
        } else {
            Finder::Single { detector: Box::new(detector), scratch: Box::default() }
        };
        Ok(Self { finder, locator, marker: arguments.marker })
    }

    fn image(&mut self, path: &Path) -> anyhow::Result<Found> {
        let image = image_file::load(path)?;
        if let Some(camera) = self.locator.as_ref().map(Locator::camera)
            && (camera.width(), camera.height()) != (image.width, image.height)
        {
            bail!(
                "{}: expected an image of {} x {} pixels as the camera file says, found {} x {}",
                path.display(),
                camera.width(),
                camera.height(),
                image.width,
                image.height
            );
        }
        let frame = image.frame().with_context(|| path.display().to_string())?;
        let begun = Instant::now();
        let (mut roundels, rejects) = match &mut self.finder {
            Finder::Single { detector, scratch } => {
                let rings = detector.detect(&frame, scratch);
                let found = rings.iter().map(|&ring| roundel(None, ring)).collect::<Vec<_>>();
                (found, *scratch.rejects())
            }
            Finder::Sequence { tracker } => {
                let rings = tracker.process(&frame);
                let found = rings.iter().map(|tracked| roundel(Some(tracked.track), tracked.ring));
                (found.collect(), *tracker.rejects())
            }
        };
        if let (Some(locator), Some(marker)) = (&mut self.locator, self.marker) {
            for roundel in &mut roundels {
                locate(locator, marker, &frame, roundel);
            }
        }
        let elapsed_us = begun.elapsed().as_secs_f64() * 1e6;
        Ok(Found { image, elapsed_us, roundels, rejects })
    }
}

fn roundel(track: Option<TrackNumber>, ring: Ring) -> Roundel {
    Roundel { track, ring, pose: None }
}

fn kind(name: &str, outer_m: f64, inner_m: f64) -> Kind {
    Kind::plain(name, outer_m, inner_m)
}

/// Where the print's inner diameter was not given, it is taken as it is seen: the ratio of two
/// nearly concentric circles is nearly that of their images.
fn locate(locator: &mut Locator, marker: Marker, frame: &Frame, roundel: &mut Roundel) {
    let ring = roundel.ring;
    let located = match (roundel.track, ring.kind) {
        (Some(track), Some(_)) => locator.locate(frame, &TrackedRing { track, ring }),
        _ => {
            let inner_m = marker.inner_m.unwrap_or_else(|| {
                marker.outer_m * ring.inner.mean_radius_px() / ring.outer.mean_radius_px()
            });
            locator.locate_single(frame, &kind("", marker.outer_m, inner_m), &ring)
        }
    };
    if let Ok(located) = located {
        roundel.ring = located.ring;
        roundel.pose = Some(located.pose);
    }
}

/// A name of its own for each drawing of this run.
fn drawing_name(image: &Path, taken: &mut HashSet<String>) -> String {
    let stem = image.file_stem().unwrap_or_default().to_string_lossy();
    let mut name = format!("{stem}.png");
    let mut number = 2;
    while !taken.insert(name.clone()) {
        name = format!("{stem}-{number}.png");
        number += 1;
    }
    name
}

fn draw(target: &Path, found: &Found) -> anyhow::Result<()> {
    let (width, height) = (found.image.width, found.image.height);
    let mut canvas = Canvas::of(width, height, &found.image.pixels);
    for roundel in &found.roundels {
        canvas.draw_ring(&roundel.ring, roundel.track);
    }
    let file = BufWriter::new(File::create(target)?);
    let mut encoder = png::Encoder::new(file, u32::try_from(width)?, u32::try_from(height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(canvas.rgb())?;
    writer.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markers_are_read_with_or_without_the_inner_diameter() {
        assert_eq!(marker("160:64"), Ok(Marker { outer_m: 0.16, inner_m: Some(0.064) }));
        assert_eq!(marker("160"), Ok(Marker { outer_m: 0.16, inner_m: None }));
        for (text, expected) in [
            ("64:160", "must be below the outer one"),
            ("big", "such as 160:64, found `big`"),
            ("0", "above 0 mm"),
            ("nan:1", "above 0 mm"),
        ] {
            let error = marker(text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn drawings_of_images_with_one_name_do_not_overwrite_each_other() {
        let mut taken = HashSet::new();
        let names =
            ["a/1.png", "b/1.jpg", "c/2.png"].map(|path| drawing_name(Path::new(path), &mut taken));
        assert_eq!(names, ["1.png", "1-2.png", "2.png"]);
    }
}

//! `roundel detect`: finds roundels in image files.

mod output;
mod search;

use std::{
    collections::HashSet,
    fs::{self, File},
    io::{self, BufWriter, IsTerminal as _, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context;
use clap::Args;
use roundel_core::marker::{CodeLayout, Mode};

use self::search::{ImageDetections, ImageSearch};
use super::{Format, MODES, error_chain, words};
use crate::lab::{
    drawing::Overlay,
    print::spec::{self, Diameters, PolarityArg},
};

/// Find roundels in images.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel detect photo.jpg\n  \
    roundel detect --camera north.yaml --marker 160:64 --format json frames/*.png\n  \
    roundel detect --camera north.yaml --marker 122 --code 8:2 photo.jpg\n  \
    roundel detect --camera north.yaml --marker 160:96:64 photo.jpg\n  \
    roundel detect --polarity white-ring --marker 160:64 photo.jpg\n  \
    roundel detect --sequence --mode fast --draw drawn video/*.png\n  \
    roundel detect --explain --draw drawn photo.jpg\n\n\
    Poses need both --camera and --marker. An image that cannot be read is reported, the others are\n\
    still searched, and the exit code is 1.")]
pub struct DetectArgs {
    /// PNG, JPEG, PGM or BMP files
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// Camera file (ROS camera_info YAML), for poses
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Diameters of the print in millimetres. Without the inner one, rings of any ratio are found (with --code, those
    /// of ratio 0.6). An elliptical disc has a longer and a shorter inner diameter
    #[arg(long, value_name = "OUTER_MM[:INNER_MM[:MINOR_MM]]", value_parser = spec::diameters)]
    marker: Option<Diameters>,
    /// Read codes: bits and minimum Hamming distance of the printed codes [default distance: 1]
    #[arg(long, value_name = "BITS[:DISTANCE]", value_parser = spec::code)]
    code: Option<CodeLayout>,
    /// Whether ring or disc is black; a white ring is printed on black
    #[arg(long, value_enum, default_value_t)]
    polarity: PolarityArg,
    /// Prefer precision or speed
    #[arg(long, default_value = "precise", value_parser = words(&MODES))]
    mode: Mode,
    /// The images are consecutive frames of one camera: tracks carry over
    #[arg(long)]
    sequence: bool,
    /// Write each image as PNG with its detections to this folder
    #[arg(long, value_name = "DIR")]
    draw: Option<PathBuf>,
    /// Report rejected candidates and the reasons; with --draw, draw them too
    #[arg(long)]
    explain: bool,
    /// A table, or one JSON object per line and image [default: table on a terminal, json into a file or pipe]
    #[arg(long, value_enum)]
    format: Option<Format>,
}

/// Searches all images and prints the detections in their order.
pub(super) fn run(arguments: &DetectArgs) -> anyhow::Result<ExitCode> {
    let mut search = ImageSearch::new(arguments)?;
    if let Some(folder) = &arguments.draw {
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create the folder {}", folder.display()))?;
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
            eprintln!("error: {}", error_chain(error));
        }
        let printed = match format {
            Format::Json => output::json(&mut out, path, &outcome, arguments.explain),
            Format::Table => output::table(&mut out, path, &outcome, arguments.explain),
        };
        // Output is flushed after each image. The search ends when the reader closes the pipe.
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

/// The drawing's file name, unique in this run.
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

fn draw(target: &Path, found: &ImageDetections) -> anyhow::Result<()> {
    let (width, height) = (found.image.width, found.image.height);
    let mut overlay = Overlay::new(width, height, &found.image.pixels);
    overlay.draw_rejected(&found.rejected);
    for roundel in &found.roundels {
        overlay.draw_ring(&roundel.ring, roundel.track);
    }
    let file = BufWriter::new(File::create(target)?);
    let mut encoder = png::Encoder::new(file, u32::try_from(width)?, u32::try_from(height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&overlay.rgb())?;
    writer.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawings_of_images_with_one_name_do_not_overwrite_each_other() {
        let mut taken = HashSet::new();
        let names =
            ["a/1.png", "b/1.jpg", "c/2.png"].map(|path| drawing_name(Path::new(path), &mut taken));
        assert_eq!(names, ["1.png", "1-2.png", "2.png"]);
    }
}

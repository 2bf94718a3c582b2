//! Views of the board from image files. Unreadable files are reported and left out, and so are pictures that do not have the
//! most frequent size.

use std::path::{Path, PathBuf};

use anyhow::bail;
use indicatif::ProgressBar;
use roundel_core::calib::lens::ViewVerdict;

use super::views::{BoardViews, ViewOptions};
use crate::{
    capture::{
        image_file::{self, ImageError},
        source::image_list::list_files,
    },
    lab::lens::board_search::BoardSearch,
    model::stop::StopSignal,
};

/// Added to the hint for videos if this build cannot play them.
const PLAYER: &str = if cfg!(feature = "gst") {
    ""
} else {
    ", with a build that has GStreamer (`cargo build --release -p roundel-server --features gst`)"
};

/// The pictures of one size.
struct SameSizeImages {
    size: (usize, usize),
    /// In order, with their verdicts.
    files: Vec<(PathBuf, ViewVerdict)>,
    search: BoardSearch,
}

impl SameSizeImages {
    /// Files of the views, in their order.
    fn taken(&self) -> Vec<PathBuf> {
        let taken = self.files.iter().filter(|(_, verdict)| *verdict == ViewVerdict::Taken);
        taken.map(|(file, _)| file.clone()).collect()
    }

    /// The other files, and why they were left out.
    fn left_out(&self) -> Vec<(PathBuf, String)> {
        let taken = self.taken();
        let why = |verdict: ViewVerdict| match verdict {
            ViewVerdict::Taken => None,
            ViewVerdict::NoBoard => Some("without the board".to_owned()),
            ViewVerdict::TooLittle => {
                Some("with less than half of the board, or of another one".to_owned())
            }
            ViewVerdict::Moving => Some("in motion".to_owned()),
            ViewVerdict::Duplicate(like) => {
                let file = taken.get(like).map(|file| file.display().to_string());
                Some(format!("like {}", file.unwrap_or_default()))
            }
            ViewVerdict::OtherBoard(columns, rows) => {
                Some(format!("of a board of {columns} x {rows} or more"))
            }
        };
        let of_file =
            |(file, verdict): &(PathBuf, ViewVerdict)| Some((file.clone(), why(*verdict)?));
        self.files.iter().filter_map(of_file).collect()
    }
}

/// Searches all files of the given folders and patterns.
pub(super) fn collect_views(
    patterns: &[String],
    views: &ViewOptions<'_>,
) -> anyhow::Result<BoardViews> {
    // Rejects an unsupported target before any file is read.
    BoardSearch::new(views.target, false)?;
    let mut files = Vec::new();
    for pattern in patterns {
        files.extend(list_files(pattern, &StopSignal::default())?);
    }
    let is_one = files.len() == 1;
    let bar = ProgressBar::new(files.len() as u64);
    let (mut groups, mut left_out) = (Vec::<SameSizeImages>::new(), Vec::new());
    for file in files {
        bar.inc(1);
        match add_image(&mut groups, &file, views)? {
            Ok(true) => break,
            Ok(false) => {}
            Err(why) if is_one => bail!(why),
            Err(why) => {
                bar.suspend(|| eprintln!("left out: {why}"));
                left_out.push((file, why));
            }
        }
    }
    bar.finish_and_clear();
    let largest = groups.iter().map(|group| group.files.len()).max();
    let Some(chosen) = groups.iter().position(|group| Some(group.files.len()) == largest) else {
        bail!("none of the {} files can be used: see the errors above", left_out.len());
    };
    let chosen = groups.swap_remove(chosen);
    let (width, height) = chosen.size;
    for SameSizeImages { size, files, .. } in &groups {
        for (file, _) in files {
            let why = format!(
                "expected {width} x {height} pixels as in most pictures, found {} x {}: all pictures of a camera must have \
                 the same size",
                size.0, size.1
            );
            eprintln!("left out: {}: {why}", file.display());
            left_out.push((file.clone(), why));
        }
    }
    let files_left_out = left_out.len();
    let (taken, without_view) = (chosen.taken(), chosen.left_out());
    let Some(gathered) = chosen.search.into_gathered() else { bail!("no picture arrived") };
    if let Some(error) = gathered.other_print(true) {
        return Err(error.into());
    }
    for (file, why) in &without_view {
        eprintln!("left out: {}: {why}", file.display());
    }
    left_out.extend(without_view);
    Ok(BoardViews { gathered, files_left_out, taken, left_out })
}

/// Searches one file. Returns whether there are enough views, or why the file is left out.
fn add_image(
    groups: &mut Vec<SameSizeImages>,
    file: &Path,
    views: &ViewOptions<'_>,
) -> anyhow::Result<Result<bool, String>> {
    let image = match image_file::load(file) {
        Ok(image) => image,
        Err(error) => return Ok(Err(describe_error(&error))),
    };
    let frame = match image.frame() {
        Ok(frame) => frame,
        Err(error) => return Ok(Err(format!("{}: {error}", file.display()))),
    };
    let size = (image.width, image.height);
    let known = groups.iter().position(|group| group.size == size);
    if known.is_none() {
        let search = BoardSearch::new(views.target, false)?;
        groups.push(SameSizeImages { size, files: Vec::new(), search });
    }
    let index = known.unwrap_or(groups.len() - 1);
    let group = &mut groups[index];
    let (verdict, _) = group.search.look(&frame)?;
    group.files.push((file.to_path_buf(), verdict));
    Ok(Ok(group.search.gathered().is_some_and(|it| it.selector.taken().len() >= views.max_views)))
}

fn describe_error(error: &ImageError) -> String {
    match error {
        ImageError::Video { path, .. } => {
            format!("{error}; open a video as `file:{}`{PLAYER}", path.display())
        }
        _ => error.to_string(),
    }
}

//! Views of the board out of image files. What cannot be looked at is named and left out, and so are pictures of another
//! size than most, whichever comes first.

use std::path::{Path, PathBuf};

use anyhow::bail;
use indicatif::ProgressBar;
use roundel_core::calib::lens::Verdict;

use super::views::{BoardViews, ViewOptions};
use crate::{
    capture::{
        image_file::{self, ImageError},
        source::image_files,
    },
    lab::lens::board_search::{BoardSearch, CollectedViews},
};

/// What plays a video, if this program cannot.
const PLAYER: &str = if cfg!(feature = "gst") {
    ""
} else {
    ", in a roundel that was built with GStreamer (`cargo build --release -p roundel-server --features gst`)"
};

/// The pictures of one size.
struct SameSizeImages {
    size: (usize, usize),
    /// In order, with what became of each.
    files: Vec<(PathBuf, Verdict)>,
    search: BoardSearch,
}

impl SameSizeImages {
    /// Files of the views that were taken, in their order.
    fn taken(&self) -> Vec<PathBuf> {
        let taken = self.files.iter().filter(|(_, verdict)| *verdict == Verdict::Taken);
        taken.map(|(file, _)| file.clone()).collect()
    }

    /// Those that were not, and why.
    fn out(&self) -> Vec<(PathBuf, String)> {
        let taken = self.taken();
        let why = |verdict: Verdict| match verdict {
            Verdict::Taken => None,
            Verdict::NoBoard => Some("without the board".to_owned()),
            Verdict::TooLittle => {
                Some("with less than half of the board, or of another one".to_owned())
            }
            Verdict::Moving => Some("in motion".to_owned()),
            Verdict::Alike(like) => {
                Some(format!("like {}", taken.get(like).map_or(String::new(), |it| shown(it))))
            }
            Verdict::OtherBoard(columns, rows) => {
                Some(format!("of a board of {columns} x {rows} or more"))
            }
        };
        let of_file = |(file, verdict): &(PathBuf, Verdict)| Some((file.clone(), why(*verdict)?));
        self.files.iter().filter_map(of_file).collect()
    }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// Looks at all files of folders and patterns.
pub(super) fn collect_views(
    patterns: &[String],
    views: &ViewOptions<'_>,
) -> anyhow::Result<BoardViews> {
    // What this program cannot look for at all is told before any file.
    BoardSearch::new(views.sought, false)?;
    let mut files = Vec::new();
    for pattern in patterns {
        files.extend(image_files(pattern).map_err(anyhow::Error::msg)?);
    }
    let is_one = files.len() == 1;
    let bar = ProgressBar::new(files.len() as u64);
    let (mut groups, mut out) = (Vec::<SameSizeImages>::new(), Vec::new());
    for file in files {
        bar.inc(1);
        let looked = add_image(&mut groups, &file, views)?;
        match looked {
            Ok(true) => break,
            Ok(false) => {}
            Err(why) if is_one => bail!(why),
            Err(why) => {
                bar.suspend(|| eprintln!("left out: {why}"));
                out.push((file, why));
            }
        }
    }
    bar.finish_and_clear();
    let most = groups.iter().map(|group| group.files.len()).max();
    let Some(chosen) = groups.iter().position(|group| Some(group.files.len()) == most) else {
        bail!("no picture is left of {}: what is wrong with each is said above", out.len());
    };
    let chosen = groups.swap_remove(chosen);
    let (width, height) = chosen.size;
    for SameSizeImages { size, files, .. } in &groups {
        for (file, _) in files {
            let why = format!(
                "expected {width} x {height} pixels as most have, found {} x {}: pictures of one camera have one size",
                size.0, size.1
            );
            eprintln!("left out: {}: {why}", file.display());
            out.push((file.clone(), why));
        }
    }
    let left_out = out.len();
    let (taken, left) = (chosen.taken(), chosen.out());
    let Some(gathered) = chosen.search.into_gathered() else { bail!("no picture came") };
    if let Some(error) = gathered.other_print(true) {
        return Err(error.into());
    }
    for (file, why) in &left {
        eprintln!("left out: {}: {why}", file.display());
    }
    out.extend(left);
    Ok(BoardViews { gathered, left_out, taken, out })
}

/// Looks at one: whether there is enough, or why it is left out.
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
    let place = match groups.iter().position(|group| group.size == size) {
        Some(place) => place,
        None => {
            let search = BoardSearch::new(views.sought, false)?;
            groups.push(SameSizeImages { size, files: Vec::new(), search });
            groups.len() - 1
        }
    };
    let group = &mut groups[place];
    let (verdict, _) = group.search.look(&frame)?;
    group.files.push((file.to_path_buf(), verdict));
    let taken = |gathered: &CollectedViews| gathered.chooser.taken().len();
    Ok(Ok(group.search.gathered().map_or(0, taken) >= views.most))
}

/// Why a file is no picture; a video is a source.
fn describe_error(error: &ImageError) -> String {
    match error {
        ImageError::Video { path, .. } => {
            format!("{error}; a video is given as `file:{}`{PLAYER}", path.display())
        }
        _ => error.to_string(),
    }
}

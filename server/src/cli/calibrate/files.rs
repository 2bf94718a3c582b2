//! Views of the board out of image files. What cannot be looked at is named and left out, and so are pictures of another
//! size than most, whichever comes first.

use std::path::{Path, PathBuf};

use anyhow::bail;
use indicatif::ProgressBar;

use super::views::{Looked, Views};
use crate::{
    image_file::{self, ImageError},
    lens::search::{Gathered, Search},
    source::image_files,
};

/// What plays a video, if this program cannot.
const PLAYER: &str = if cfg!(feature = "gst") {
    ""
} else {
    ", in a roundel that was built with GStreamer (`cargo build --release -p roundel-server --features gst`)"
};

/// The pictures of one size.
struct Album {
    size: (usize, usize),
    files: Vec<PathBuf>,
    search: Search,
}

/// Looks at all files of folders and patterns.
pub(super) fn gather(patterns: &[String], views: &Views<'_>) -> anyhow::Result<Looked> {
    // What this program cannot look for at all is told before any file.
    Search::new(views.sought, false)?;
    let mut files = Vec::new();
    for pattern in patterns {
        files.extend(image_files(pattern).map_err(anyhow::Error::msg)?);
    }
    let is_one = files.len() == 1;
    let bar = ProgressBar::new(files.len() as u64);
    let (mut albums, mut left_out) = (Vec::<Album>::new(), 0);
    for file in files {
        bar.inc(1);
        match look(&mut albums, &file, views)? {
            Ok(true) => break,
            Ok(false) => {}
            Err(why) if is_one => bail!(why),
            Err(why) => {
                left_out += 1;
                bar.suspend(|| eprintln!("left out: {why}"));
            }
        }
    }
    bar.finish_and_clear();
    let most = albums.iter().map(|album| album.files.len()).max();
    let Some(chosen) = albums.iter().position(|album| Some(album.files.len()) == most) else {
        bail!("no picture is left of {left_out}: what is wrong with each is said above");
    };
    let Album { size: (width, height), search, .. } = albums.swap_remove(chosen);
    for Album { size, files, .. } in &albums {
        left_out += files.len();
        for file in files {
            eprintln!(
                "left out: {}: expected {width} x {height} pixels as most have, found {} x {}: pictures of one camera \
                 have one size",
                file.display(),
                size.0,
                size.1
            );
        }
    }
    let Some(gathered) = search.into_gathered() else { bail!("no picture came") };
    match gathered.other_print(true) {
        Some(error) => Err(error.into()),
        None => Ok(Looked { gathered, left_out }),
    }
}

/// Looks at one: whether there is enough, or why it is left out.
fn look(
    albums: &mut Vec<Album>,
    file: &Path,
    views: &Views<'_>,
) -> anyhow::Result<Result<bool, String>> {
    let image = match image_file::load(file) {
        Ok(image) => image,
        Err(error) => return Ok(Err(told(&error))),
    };
    let frame = match image.frame() {
        Ok(frame) => frame,
        Err(error) => return Ok(Err(format!("{}: {error}", file.display()))),
    };
    let size = (image.width, image.height);
    let place = match albums.iter().position(|album| album.size == size) {
        Some(place) => place,
        None => {
            let search = Search::new(views.sought, false)?;
            albums.push(Album { size, files: Vec::new(), search });
            albums.len() - 1
        }
    };
    let album = &mut albums[place];
    album.files.push(file.to_path_buf());
    album.search.look(&frame)?;
    let taken = |gathered: &Gathered| gathered.chooser.taken().len();
    Ok(Ok(album.search.gathered().map_or(0, taken) >= views.most))
}

/// Why a file is no picture; a video is a source.
fn told(error: &ImageError) -> String {
    match error {
        ImageError::Video { path, .. } => {
            format!("{error}; a video is given as `file:{}`{PLAYER}", path.display())
        }
        _ => error.to_string(),
    }
}

//! Views of the board out of a stream; those out of files are in [`super::files`].

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use roundel_core::{calib::lens::LensCalibration, frame::Frame};

use super::coverage;
use crate::{
    capture::source::{OpenSource, Playback, SourceError, SourceOpener},
    lab::lens::board_search::{BoardSearch, CalibrationTarget, CollectedViews},
    model::{address::SourceAddress, stop::StopSignal},
};

/// Asked of a camera that lets one choose, where nobody says a size.
const USUAL_SIZE: (usize, usize) = (1280, 720);

/// Where no spinner turns, so often a line says how far it is.
const LOGGED: Duration = Duration::from_secs(10);

/// What is looked for.
pub(super) struct ViewOptions<'a> {
    pub(super) sought: &'a CalibrationTarget,
    /// No more than so many.
    pub(super) most: usize,
    /// Columns and rows that are asked of a camera; `None`: the usual ones, or what it gives.
    pub(super) size: Option<(usize, usize)>,
}

/// What was looked at.
pub(super) struct BoardViews {
    pub(super) gathered: CollectedViews,
    /// Files that could not be looked at.
    pub(super) left_out: usize,
    /// Files of the views that were taken, in their order; a stream has none.
    pub(super) taken: Vec<PathBuf>,
    /// Files that were left out, and why.
    pub(super) out: Vec<(PathBuf, String)>,
}

impl BoardViews {
    /// Tells which views the calibration has left out, and why; those of a stream have no names.
    pub(super) fn add_left_out(&mut self, found: &LensCalibration) {
        for (file, view) in self.taken.iter().zip(&found.views) {
            if let Err(why) = view {
                eprintln!("left out: {}: {why}", file.display());
                self.out.push((file.clone(), why.to_string()));
            }
        }
    }

    /// How many pictures were left out, and why.
    pub(super) fn summary(&self) -> String {
        let pictures = self.gathered.describe();
        match self.left_out {
            0 => pictures,
            1 => format!("{pictures}; 1 file left out"),
            files => format!("{pictures}; {files} files left out"),
        }
    }
}

/// What has been taken has its size.
pub(super) fn reject_size_option(views: &ViewOptions<'_>, what: &str) -> anyhow::Result<()> {
    if views.size.is_some() {
        bail!("--size is asked of a camera, and {what} have the size that they have: leave it out");
    }
    Ok(())
}

/// Whether it is a source's address; a drive's letter is none.
pub(super) fn is_stream(source: &str) -> bool {
    !Path::new(source).exists()
        && source.split_once(':').is_some_and(|(scheme, _)| scheme.len() > 1)
}

/// Looks at a picture; whether there is enough.
fn add_image(
    search: &mut BoardSearch,
    frame: &Frame<'_>,
    views: &ViewOptions<'_>,
) -> anyhow::Result<bool> {
    search.look(frame)?;
    if let Some(error) = search.gathered().and_then(|it| it.other_print(false)) {
        return Err(error.into());
    }
    let enough = |it: &CollectedViews| it.chooser.taken().len() >= views.most || it.is_complete();
    Ok(search.gathered().is_some_and(enough))
}

/// How far it is, with a small map of where the board has been.
fn message(search: &BoardSearch) -> String {
    let map = search.gathered().map(|it| coverage::render(it.chooser.coverage()));
    [Some(search.message()), map].into_iter().flatten().collect::<Vec<_>>().join("\n")
}

fn done(search: BoardSearch, what: &str) -> anyhow::Result<CollectedViews> {
    let gathered = search.into_gathered().with_context(|| format!("{what}: no picture came"))?;
    gathered.other_print(true).map_or(Ok(gathered), |error| Err(error.into()))
}

pub(super) fn collect_from_stream(
    source: &str,
    address: &SourceAddress,
    views: &ViewOptions<'_>,
) -> anyhow::Result<CollectedViews> {
    let mut size = match address {
        SourceAddress::Push(_) => {
            bail!("a `push:` camera is calibrated where it is: run this there, on its own source")
        }
        SourceAddress::Sim(sim) => {
            reject_size_option(views, "simulated pictures")?;
            let camera = crate::model::simulated::simulated_camera(sim)?.camera;
            (camera.width(), camera.height())
        }
        SourceAddress::Images(_) => {
            reject_size_option(views, "pictures in files")?;
            USUAL_SIZE
        }
        _ => views.size.unwrap_or(USUAL_SIZE),
    };
    let (stop, interrupted) = (StopSignal::default(), Arc::new(AtomicBool::new(false)));
    let (stopping, noted) = (stop.clone(), interrupted.clone());
    // Ctrl-C takes what there is; a second one ends the process.
    thread::Builder::new().name("signals".to_owned()).spawn(move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else {
            return;
        };
        if runtime.block_on(tokio::signal::ctrl_c()).is_ok() {
            noted.store(true, Ordering::Relaxed);
            stopping.stop();
            let _ = runtime.block_on(tokio::signal::ctrl_c());
            std::process::exit(130);
        }
    })?;
    let (clock, playback) = Playback::begin(std::iter::once(address))?;
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {msg}")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    let mut search = BoardSearch::new(views.sought, true)?;
    let mut logged = Instant::now();
    loop {
        let mut opener = SourceOpener::new(address.clone(), size, clock, playback, stop.clone());
        let outcome = opener.open().and_then(|mut stream| {
            loop {
                let lent = stream.next_frame()?;
                match add_image(&mut search, &lent.frame, views) {
                    Ok(false) if !bar.is_hidden() => bar.set_message(message(&search)),
                    Ok(false) if logged.elapsed() >= LOGGED => {
                        logged = Instant::now();
                        eprintln!("{}", search.message());
                    }
                    Ok(false) => {}
                    Ok(true) => return Ok(()),
                    Err(error) => return Err(SourceError::Failed(error.to_string())),
                }
            }
        });
        match outcome {
            Err(SourceError::Size { found, .. })
                if views.size.is_none() && search.gathered().is_none() && found != size =>
            {
                size = found;
            }
            Err(SourceError::Size { found, .. }) => bail!(other_size(source, size, found, views)),
            Ok(()) | Err(SourceError::Finished) => break,
            Err(SourceError::Stopped) if interrupted.load(Ordering::Relaxed) => break,
            Err(error) => {
                let why = error.to_string();
                bail!(if why.starts_with(source) { why } else { format!("{source}: {why}") })
            }
        }
    }
    bar.finish_and_clear();
    done(search, source)
}

fn other_size(
    source: &str,
    (width, height): (usize, usize),
    found: (usize, usize),
    views: &ViewOptions<'_>,
) -> String {
    let (as_what, remedy) = match views.size {
        Some(_) => {
            ("as --size asks", "give its own size, or leave --size out to take what it gives")
        }
        None => ("as before", "a lens is calibrated for one size"),
    };
    format!(
        "{source}: expected pictures of {width} x {height} pixels {as_what}, found {} x {}: {remedy}",
        found.0, found.1
    )
}

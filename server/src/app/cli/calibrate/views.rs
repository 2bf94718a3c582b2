//! Views of the board from a stream; [`super::files`] has those from image files.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use roundel_core::frame::Frame;

use super::coverage;
use crate::{
    app::cli::progress_bar,
    capture::source::SourceError,
    lab::lens::{
        board_search::{BoardSearch, CalibrationTarget, CollectedViews},
        picture_source::{OpenedSource, for_each_source_frame},
    },
    model::{address::SourceAddress, stop::StopSignal},
};

/// Time between progress lines where there is no terminal for a spinner.
const LOG_INTERVAL: Duration = Duration::from_secs(10);

pub(super) struct ViewOptions<'a> {
    pub(super) target: &'a CalibrationTarget,
    /// Maximum number of views to keep.
    pub(super) max_views: usize,
    /// Columns and rows to request from a camera; `None` accepts what it delivers.
    pub(super) size: Option<(usize, usize)>,
}

pub(super) struct BoardViews {
    pub(super) gathered: CollectedViews,
    /// Number of files that could not be searched.
    pub(super) files_left_out: usize,
    /// Files of the views, in their order; empty for a stream.
    pub(super) taken: Vec<PathBuf>,
    /// Files without a view, and why.
    pub(super) left_out: Vec<(PathBuf, String)>,
}

impl BoardViews {
    /// Numbers of pictures and views, and of pictures and files left out.
    pub(super) fn summary(&self) -> String {
        let pictures = self.gathered.describe();
        match self.files_left_out {
            0 => pictures,
            1 => format!("{pictures}; 1 file left out"),
            files => format!("{pictures}; {files} files left out"),
        }
    }
}

/// `--size` does not apply to existing pictures.
pub(super) fn reject_size_option(views: &ViewOptions<'_>, what: &str) -> anyhow::Result<()> {
    if views.size.is_some() {
        bail!("--size applies only to cameras; {what} have a fixed size: leave it out");
    }
    Ok(())
}

/// Whether it is the address of a source. A single letter before the colon is a drive.
pub(super) fn is_stream(source: &str) -> bool {
    !Path::new(source).exists()
        && source.split_once(':').is_some_and(|(scheme, _)| scheme.len() > 1)
}

/// Collects views until there are enough, the stream ends, or Ctrl-C; a second Ctrl-C ends the process.
pub(super) fn collect_from_stream(
    source: &str,
    address: &SourceAddress,
    views: &ViewOptions<'_>,
) -> anyhow::Result<CollectedViews> {
    match address {
        SourceAddress::Push(_) => {
            bail!(
                "a `push:` camera is calibrated on its own computer: run this command there, with the camera's source"
            )
        }
        SourceAddress::Sim(_) => reject_size_option(views, "simulated pictures")?,
        SourceAddress::Images(_) => reject_size_option(views, "pictures in files")?,
        _ => {}
    }
    let stop = StopSignal::default();
    let on_signal = stop.clone();
    tokio::spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            on_signal.stop();
            let _ = tokio::signal::ctrl_c().await;
            std::process::exit(super::ENDED_BY_SIGNAL.into());
        }
    });
    let bar = progress_bar(None, "{spinner} {msg}")?;
    bar.enable_steady_tick(Duration::from_millis(200));
    let mut search = BoardSearch::new(views.target, true)?;
    let mut logged = Instant::now();
    let mut look = |frame: &Frame<'_>| -> Result<bool, String> {
        search.look(frame).map_err(|error| error.to_string())?;
        let Some(gathered) = search.gathered() else { return Ok(false) };
        if let Some(error) = gathered.other_print(false) {
            return Err(error.to_string());
        }
        if !bar.is_hidden() {
            let map = coverage::render(gathered.selector.coverage());
            bar.set_message(format!("{}\n{map}", search.message()));
        } else if logged.elapsed() >= LOG_INTERVAL {
            logged = Instant::now();
            eprintln!("{}", search.message());
        }
        Ok(gathered.is_complete() || gathered.selector.taken().len() >= views.max_views)
    };
    let opened = OpenedSource { address: address.clone(), rules: None, size: views.size };
    match for_each_source_frame(&opened, &stop, &mut look) {
        Ok(()) | Err(SourceError::Stopped) => {}
        Err(SourceError::Size { expected, found, .. }) => {
            let (as_what, remedy) = match views.size {
                Some(_) => ("(--size)", "use that size, or leave --size out"),
                None => ("as before", "a lens is calibrated for one size"),
            };
            bail!(
                "{source}: expected pictures of {} x {} pixels {as_what}, found {} x {}: {remedy}",
                expected.0,
                expected.1,
                found.0,
                found.1
            );
        }
        Err(error) => {
            let why = error.to_string();
            bail!(if why.starts_with(source) { why } else { format!("{source}: {why}") })
        }
    }
    bar.finish_and_clear();
    let gathered =
        search.into_gathered().with_context(|| format!("{source}: no picture arrived"))?;
    match gathered.other_print(true) {
        Some(error) => Err(error.into()),
        None => Ok(gathered),
    }
}

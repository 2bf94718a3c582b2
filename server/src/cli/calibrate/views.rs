//! Views of the board out of a stream, a folder or files.

use std::{
    path::Path,
    sync::Arc,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use roundel_core::frame::Frame;

use crate::{
    image_file,
    lens::search::{Gathered, Search, Sought},
    source::{OpenSource, Playback, SourceAddress, SourceError, SourceOpener, image_files},
    stop::Stop,
};

/// Asked of a camera that lets one choose.
const USUAL_SIZE: (usize, usize) = (1280, 720);

/// What is looked for.
pub(super) struct Views<'a> {
    pub(super) sought: &'a Sought,
    /// No more than so many.
    pub(super) most: usize,
}

/// Looks at every picture, or at a stream until it ends, there is enough, or Ctrl-C.
pub(super) fn gather(sources: &[String], views: &Views<'_>) -> anyhow::Result<Gathered> {
    match sources {
        [source] if is_stream(source) => of_stream(source, views),
        _ => of_files(sources, views),
    }
}

/// Whether it is a source's address; a drive's letter is none.
fn is_stream(source: &str) -> bool {
    !Path::new(source).exists()
        && source.split_once(':').is_some_and(|(scheme, _)| scheme.len() > 1)
}

fn searched(views: &Views<'_>, still: bool) -> anyhow::Result<Search> {
    Ok(Search::new(views.sought, still)?)
}

/// Looks at a picture; whether there is enough. Of files, all that there are.
fn look(
    search: &mut Search,
    frame: &Frame<'_>,
    views: &Views<'_>,
    still: bool,
) -> anyhow::Result<bool> {
    search.look(frame)?;
    if let Some(error) = search.gathered().and_then(|it| it.other_print(false)) {
        return Err(error.into());
    }
    let enough =
        |it: &Gathered| it.chooser.taken().len() >= views.most || (still && it.is_complete());
    Ok(search.gathered().is_some_and(enough))
}

fn done(search: Search, what: &str) -> anyhow::Result<Gathered> {
    let gathered = search.into_gathered().with_context(|| format!("{what}: no picture came"))?;
    gathered.other_print(true).map_or(Ok(gathered), |error| Err(error.into()))
}

fn of_files(sources: &[String], views: &Views<'_>) -> anyhow::Result<Gathered> {
    let mut search = searched(views, false)?;
    let mut files = Vec::new();
    for source in sources {
        files.extend(image_files(source).map_err(anyhow::Error::msg)?);
    }
    let bar = ProgressBar::new(files.len() as u64);
    for file in files {
        let image = image_file::load(&file)?;
        let name = file.display().to_string();
        let frame = image.frame().with_context(|| name.clone())?;
        bar.inc(1);
        if look(&mut search, &frame, views, false).context(name)? {
            break;
        }
    }
    bar.finish_and_clear();
    done(search, "no file")
}

fn of_stream(source: &str, views: &Views<'_>) -> anyhow::Result<Gathered> {
    let address = SourceAddress::parse(source, Path::new(""))?;
    if let SourceAddress::Push(_) = address {
        bail!("a `push:` camera is calibrated where it is: run this there, on its own source");
    }
    let (stop, interrupted) = (Stop::default(), Arc::new(AtomicBool::new(false)));
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
    let (clock, playback) = Playback::begin(std::iter::once(&address))?;
    let mut size = match &address {
        SourceAddress::Sim(sim) => {
            let camera = crate::source::simulated_camera(sim)?.camera;
            (camera.width(), camera.height())
        }
        _ => USUAL_SIZE,
    };
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {msg}")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    let mut search = searched(views, true)?;
    loop {
        let mut opener = SourceOpener::new(address.clone(), size, clock, playback, stop.clone());
        let outcome = opener.open().and_then(|mut stream| {
            loop {
                let lent = stream.next_frame()?;
                match look(&mut search, &lent.frame, views, true) {
                    Ok(false) => bar.set_message(search.message()),
                    Ok(true) => return Ok(()),
                    Err(error) => return Err(SourceError::Failed(error.to_string())),
                }
            }
        });
        match outcome {
            Err(SourceError::Size { found, .. })
                if search.gathered().is_none() && found != size =>
            {
                size = found;
            }
            Ok(()) | Err(SourceError::Finished) => break,
            Err(SourceError::Stopped) if interrupted.load(Ordering::Relaxed) => break,
            Err(error) => bail!("{source}: {error}"),
        }
    }
    bar.finish_and_clear();
    done(search, source)
}

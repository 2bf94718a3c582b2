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
use roundel_core::{
    calib::{
        board::Board,
        lens::{Chooser, Verdict, View},
    },
    frame::Frame,
    marker::{Detector, Mode, Params, Scratch},
};

use crate::{
    image_file,
    source::{OpenSource, Playback, SourceAddress, SourceError, SourceOpener, image_files},
    stop::Stop,
};

/// Asked of a camera that lets one choose.
const USUAL_SIZE: (usize, usize) = (1280, 720);
/// Enough views, once nothing is missing.
const GOOD_VIEWS: usize = 20;

/// What is looked for.
pub(super) struct Views<'a> {
    pub(super) board: &'a Board,
    /// No more than so many.
    pub(super) most: usize,
}

/// What was found.
pub(super) struct Gathered {
    pub(super) size: (usize, usize),
    pub(super) chooser: Chooser,
    /// Pictures that were looked at, and what became of them.
    pub(super) frames: usize,
    without_board: usize,
    too_little: usize,
    moving: usize,
    alike: usize,
}

impl Gathered {
    /// How many pictures were left out, and why.
    pub(super) fn told(&self) -> String {
        let Self { frames, without_board, too_little, moving, alike, .. } = self;
        let taken = self.chooser.taken().len();
        let mut text = format!("{frames} pictures, {taken} views taken");
        for (count, why) in [
            (without_board, "without the board"),
            (too_little, "with too little of it"),
            (moving, "in motion"),
            (alike, "like another one"),
        ] {
            if *count > 0 {
                text.push_str(&format!(", {count} {why}"));
            }
        }
        text
    }
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

struct Search<'a> {
    views: &'a Views<'a>,
    detector: Detector,
    scratch: Scratch,
    gathered: Option<Gathered>,
    still: bool,
}

impl<'a> Search<'a> {
    fn new(views: &'a Views<'a>, still: bool) -> anyhow::Result<Self> {
        let params = Params { mode: Mode::Precise, ..Params::default() };
        let detector = Detector::new(vec![views.board.kind()], params)?;
        Ok(Self { views, detector, scratch: Scratch::default(), gathered: None, still })
    }

    /// Looks at a picture; whether there is enough.
    fn look(&mut self, frame: &Frame<'_>, what: &str) -> anyhow::Result<bool> {
        let size = (frame.width(), frame.height());
        let (board, still) = (self.views.board, self.still);
        let gathered = self.gathered.get_or_insert_with(|| Gathered {
            size,
            chooser: Chooser::new(board.clone(), size, still),
            frames: 0,
            without_board: 0,
            too_little: 0,
            moving: 0,
            alike: 0,
        });
        if gathered.size != size {
            let (width, height) = gathered.size;
            bail!(
                "{what}: expected {width} x {height} pixels as the pictures before, found {} x {}: pictures of \
                 one camera have one size",
                size.0,
                size.1
            );
        }
        gathered.frames += 1;
        let rings = self.detector.detect(frame, &mut self.scratch);
        match gathered.chooser.offer(View::of_rings(board, rings)) {
            Verdict::Taken => {}
            Verdict::NoBoard => gathered.without_board += 1,
            Verdict::TooLittle => gathered.too_little += 1,
            Verdict::Moving => gathered.moving += 1,
            Verdict::Alike => gathered.alike += 1,
        }
        let taken = gathered.chooser.taken().len();
        let is_complete = taken >= GOOD_VIEWS && gathered.chooser.coverage().wants().is_empty();
        Ok(taken >= self.views.most || (still && is_complete))
    }

    fn done(self, what: &str) -> anyhow::Result<Gathered> {
        self.gathered.with_context(|| format!("{what}: no picture came"))
    }

    /// What is still missing, for who moves the board.
    fn message(&self) -> String {
        let Some(gathered) = &self.gathered else { return "waiting for a picture".to_owned() };
        let coverage = gathered.chooser.coverage();
        let taken = gathered.chooser.taken().len();
        let covered = (coverage.share() * 100.0).round();
        let next = coverage.wants().first().map_or_else(
            || "hold it still at new places".to_owned(),
            |want| format!("wanted: {want}"),
        );
        format!("{taken} views, {covered} % of the picture; {next}")
    }
}

fn of_files(sources: &[String], views: &Views<'_>) -> anyhow::Result<Gathered> {
    let mut search = Search::new(views, false)?;
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
        if search.look(&frame, &name)? {
            break;
        }
    }
    bar.finish_and_clear();
    search.done("no file")
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
    let mut search = Search::new(views, true)?;
    loop {
        let mut opener = SourceOpener::new(address.clone(), size, clock, playback, stop.clone());
        let outcome = opener.open().and_then(|mut stream| {
            loop {
                let lent = stream.next_frame()?;
                match search.look(&lent.frame, source) {
                    Ok(false) => bar.set_message(search.message()),
                    Ok(true) => return Ok(()),
                    Err(error) => return Err(SourceError::Failed(error.to_string())),
                }
            }
        });
        match outcome {
            Err(SourceError::Size { found, .. }) if search.gathered.is_none() && found != size => {
                size = found;
            }
            Ok(()) | Err(SourceError::Finished) => break,
            Err(SourceError::Stopped) if interrupted.load(Ordering::Relaxed) => break,
            Err(error) => bail!("{source}: {error}"),
        }
    }
    bar.finish_and_clear();
    search.done(source)
}

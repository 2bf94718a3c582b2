//! Records an arena's simulated observations with a running server, in real time.

use std::{
    collections::VecDeque,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use roundel_core::{time::Timestamp, world::FrameObservations};
use roundel_server::{
    app::serve::Server,
    capture::source::{
        FrameSource, LentFrame, OpenSource, RemoteDetections, SourceError, SourceOutput,
    },
    model::{capture_clock::CaptureClock, config::Config, stop::StopSignal},
};

use crate::{
    arena::Arena,
    export::{Export, camera_yaml},
    optics::Pinhole,
};

/// Time for the server to start.
const LEAD_S: f64 = 0.5;

#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    pub file: PathBuf,
    /// Messages that were dropped because the machine is too slow.
    pub dropped: u64,
}

/// A source that delivers one camera's observations when they are due.
struct ObservationSource {
    coming: VecDeque<FrameObservations>,
    clock: roundel_server::model::clock::Clock,
    stop: StopSignal,
}

impl FrameSource for ObservationSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        Err(SourceError::Failed("it gives what was seen, and no frames".into()))
    }

    fn next(&mut self) -> Result<SourceOutput<'_>, SourceError> {
        let observations = self.coming.pop_front().ok_or(SourceError::Finished)?;
        let wait_s = observations.received_time.seconds_since(self.clock.now());
        if wait_s > 0.0 {
            self.stop.wait(Duration::from_secs_f64(wait_s));
        }
        if self.stop.is_stopped() {
            return Err(SourceError::Stopped);
        }
        let clock = CaptureClock::EXACT;
        Ok(SourceOutput::Detections(Box::new(RemoteDetections {
            observations,
            clock,
            skipped: 0,
            figures: None,
        })))
    }
}

/// Opens the source once.
struct Once(Option<ObservationSource>);

impl OpenSource for Once {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        match self.0.take() {
            Some(source) => Ok(Box::new(source)),
            None => Err(SourceError::Finished),
        }
    }
}

/// Records frames of the arena's cameras into an existing folder. `wrong_lenses` replaces the lenses of some cameras
/// in the configuration.
pub fn record(
    arena: &Arena,
    frames: impl Iterator<Item = FrameObservations>,
    folder: &Path,
    wrong_lenses: &[(usize, Pinhole)],
) -> anyhow::Result<Recorded> {
    let site = folder.join("site");
    fs::create_dir(&site)?;
    let config = Export::lab(1).write(arena, &site)?.config;
    for (index, optics) in wrong_lenses {
        let name = &arena.sites[*index].name;
        fs::write(site.join(format!("{name}.yaml")), camera_yaml(name, optics))?;
    }
    let text = fs::read_to_string(&config)? + "\n[recording]\nstart = true\nmin_free_mb = 0\n";
    fs::write(&config, text)?;
    let config = Config::load(&config)?;
    let mut seen: Vec<VecDeque<FrameObservations>> = vec![VecDeque::new(); arena.sites.len()];
    let start_ns = arena.start_ns;
    let mut end_ns = start_ns;
    for frame in frames {
        end_ns = end_ns.max(frame.received_time.as_ns());
        seen[frame.camera.0 as usize].push_back(frame);
    }
    let length = Duration::from_secs_f64((end_ns - start_ns) as f64 * 1e-9 + 2.0 * LEAD_S);
    let seen = Arc::new(Mutex::new(seen));
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async move {
        let base: Mutex<Option<Timestamp>> = Mutex::new(None);
        let server = Server::start_with_sources(config, move |setting| {
            let mut base = base.lock().unwrap_or_else(PoisonError::into_inner);
            let begin = *base.get_or_insert_with(|| setting.clock.now().plus_seconds(LEAD_S));
            let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
            let mut coming = std::mem::take(&mut seen[setting.index]);
            coming.iter_mut().for_each(|frame| shift(frame, begin.as_ns() - start_ns));
            let (clock, stop) = (setting.clock, setting.stop);
            Box::new(Once(Some(ObservationSource { coming, clock, stop })))
        })
        .await?;
        tokio::time::sleep(length).await;
        let status = server.recorder().status();
        server.shutdown().await;
        let file = PathBuf::from(status.folder).join(status.file);
        Ok(Recorded { file, dropped: status.dropped })
    })
}

/// Moves a frame in time.
fn shift(frame: &mut FrameObservations, by_ns: i64) {
    let moved = |time: Timestamp| Timestamp::from_ns(time.as_ns() + by_ns);
    frame.capture_time = moved(frame.capture_time);
    frame.received_time = moved(frame.received_time);
    for detection in &mut frame.detections {
        detection.capture_time = moved(detection.capture_time);
    }
}

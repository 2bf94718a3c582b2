//! A recording that is ready to be played.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use roundel_core::{id::CameraId, time::Timestamp};
use roundel_proto::v1;

use super::{
    ReplayError, ReplayFrom, ReplayStatus,
    engine::{Engine, EngineSettings},
    reader::{FusionUpdate, Reader, RecordingHeader},
};
use crate::{
    archive::{record::schema::Topic, replay::from_recording},
    model::{
        clock::Clock,
        config::{Config, Lenses},
        hub::{Hub, Installation},
    },
};

/// What is to be played.
#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    pub file: PathBuf,
    pub from: ReplayFrom,
    /// In place of the recorded configuration.
    pub config: Option<PathBuf>,
}

/// A recording that is ready to happen.
pub struct ReplaySession {
    pub reader: Reader,
    pub engine: Engine,
    pub updates: Vec<(Timestamp, FusionUpdate)>,
    pub hub: Arc<Hub>,
    pub clock: Clock,
    pub late_window_ms: f64,
}

impl ReplaySession {
    /// Opens a recording, and sets everything up for it.
    pub fn open(options: &ReplayOptions) -> Result<Self, ReplayError> {
        let mut reader = Reader::open(&options.file, options.from == ReplayFrom::Frames)?;
        let RecordingHeader { configuration, updates, cameras } =
            RecordingHeader::read(&mut reader)?;
        let lacks =
            |what, remedy| Err(ReplayError::Lacks { path: options.file.clone(), what, remedy });
        if options.from != ReplayFrom::Snapshots && updates.is_empty() {
            return lacks(
                "word of what fusion was told of cameras, as what is streamed by `roundel record --output`",
                "play its snapshots, or record on the server",
            );
        }
        if options.from == ReplayFrom::Frames && !reader.file().has_frames() {
            return lacks("frames", "record with --frames-every 1 to search them anew");
        }
        let lens = |(name, camera): (&String, &v1::Camera)| {
            from_recording::read_lens(camera).map(|lens| (name.clone(), lens))
        };
        let lenses: Lenses = cameras.iter().filter_map(lens).collect();
        let config = match options.from {
            ReplayFrom::Snapshots => None,
            ReplayFrom::Observations | ReplayFrom::Frames => {
                Some(read_config(options, &configuration, &lenses)?)
            }
        };
        let number = |(_, told): &(Timestamp, FusionUpdate)| match told {
            FusionUpdate::Camera(told) => Some((told.camera.clone(), CameraId(told.number))),
            FusionUpdate::Settings(_) => None,
        };
        let ids: BTreeMap<String, CameraId> =
            updates.iter().filter_map(number).filter(|(name, _)| !name.is_empty()).collect();
        let (begin, _) = reader.span();
        let clock = Clock::anchored(Instant::now(), begin);
        let hub = Arc::new(Hub::new(installation(&configuration, config.as_ref(), begin)));
        let from = options.from;
        let late_window_ms = config.as_ref().map_or(0.0, |it| it.fusion.late_window_s * 1e3);
        // Who wants other settings than the recorded ones does not want these changed either.
        let is_recorded = options.config.is_none();
        let settings = config.map(|config| EngineSettings { config, lenses, is_recorded });
        let mut engine = Engine::new(hub.clone(), clock, from, (settings, ids));
        // Cameras are there before anything happens.
        if let Some(raw) = reader.first(Topic::Health)? {
            engine.process(&raw, &mut reader);
        }
        Ok(Self { reader, engine, updates, hub, clock, late_window_ms })
    }

    /// The newest of everything.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }
}

/// The configuration that a recording was made with, or the one that is wanted instead.
fn read_config(
    options: &ReplayOptions,
    recorded: &v1::RecordedConfiguration,
    lenses: &Lenses,
) -> Result<Config, ReplayError> {
    let path = options.file.clone();
    let (text, origin) = match &options.config {
        Some(config) => {
            let failed = |source| ReplayError::Io { path: config.clone(), source };
            (std::fs::read_to_string(config).map_err(failed)?, config.display().to_string())
        }
        None => (recorded.text.clone(), format!("that Roundel {} recorded", recorded.version)),
    };
    Config::parse_recorded(&text, lenses).map_err(|problems| ReplayError::Config {
        path,
        origin,
        problems,
    })
}

fn installation(
    recorded: &v1::RecordedConfiguration,
    config: Option<&Config>,
    started: Timestamp,
) -> Installation {
    let rate_hz = recorded.snapshot_rate_hz;
    let source_id = format!("replay-of-{}", recorded.source_id);
    let plain = Installation {
        name: recorded.name.clone(),
        source_id: source_id.clone(),
        started,
        snapshot_rate_hz: if rate_hz > 0.0 { rate_hz } else { 60.0 },
        cameras: BTreeMap::new(),
        kinds: recorded.roundels.clone(),
        object_names: BTreeMap::new(),
        body_names: Vec::new(),
    };
    match config {
        // Names by kinds and bodies are those of the machine that fuses.
        Some(config) => Installation {
            cameras: BTreeMap::new(),
            source_id,
            name: plain.name,
            snapshot_rate_hz: plain.snapshot_rate_hz,
            ..crate::fusion::setup::installation(config, started)
        },
        None => plain,
    }
}

/// How a replay of this file begins.
pub fn initial_status(session: &ReplaySession, file: &Path, from: ReplayFrom) -> ReplayStatus {
    let span = session.reader.span();
    ReplayStatus {
        file: file.to_owned(),
        from,
        speed: 1.0,
        span,
        position: span.0,
        ..ReplayStatus::default()
    }
}

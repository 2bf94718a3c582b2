//! An opened recording with its reader, engine, hub and clock.

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
        config::{Config, Lenses, MAX_BYTES},
        hub::{Hub, Installation},
        regular_file,
    },
};

#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    pub file: PathBuf,
    pub from: ReplayFrom,
    /// Replaces the recorded configuration.
    pub config: Option<PathBuf>,
}

pub struct ReplaySession {
    pub reader: Reader,
    pub engine: Engine,
    pub updates: Vec<(Timestamp, FusionUpdate)>,
    pub hub: Arc<Hub>,
    pub clock: Clock,
    pub late_window_ms: f64,
}

impl ReplaySession {
    pub fn open(options: &ReplayOptions) -> Result<Self, ReplayError> {
        let mut reader = Reader::open(&options.file, options.from == ReplayFrom::Frames)?;
        let RecordingHeader { configuration, updates, cameras } =
            RecordingHeader::read(&mut reader)?;
        let lacks =
            |what, remedy| Err(ReplayError::Lacks { path: options.file.clone(), what, remedy });
        if options.from != ReplayFrom::Snapshots && updates.is_empty() {
            return lacks(
                "camera updates of fusion, as in all recordings of `roundel record --output`",
                "replay its snapshots, or record on the server",
            );
        }
        if options.from == ReplayFrom::Frames && !reader.file().has_frames() {
            return lacks("frames", "record with --frames-every 1 to search them again");
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
        let id = |(_, update): &(Timestamp, FusionUpdate)| match update {
            FusionUpdate::Camera(it) if !it.camera.is_empty() => {
                Some((it.camera.clone(), CameraId(it.number)))
            }
            _ => None,
        };
        let ids: BTreeMap<String, CameraId> = updates.iter().filter_map(id).collect();
        let (begin, _) = reader.span();
        let clock = Clock::anchored(Instant::now(), begin);
        let hub = Arc::new(Hub::new(installation(&configuration, config.as_ref(), begin)));
        let late_window_ms = config.as_ref().map_or(0.0, |it| it.fusion.late_window_s * 1e3);
        // Recorded changes apply only to the recorded configuration.
        let is_recorded = options.config.is_none();
        let settings = config.map(|config| EngineSettings { config, lenses, is_recorded });
        let mut engine = Engine::new(hub.clone(), clock, options.from, settings, ids);
        // Cameras are shown from the start.
        if let Some(raw) = reader.first(Topic::Health)? {
            engine.process(&raw, &mut reader);
        }
        Ok(Self { reader, engine, updates, hub, clock, late_window_ms })
    }
}

/// The configuration of the options, or the recorded one.
fn read_config(
    options: &ReplayOptions,
    recorded: &v1::RecordedConfiguration,
    lenses: &Lenses,
) -> Result<Config, ReplayError> {
    let (text, origin) = match &options.config {
        Some(config) => {
            let failed = |source| ReplayError::Io { path: config.clone(), source };
            (
                regular_file::read_text(config, MAX_BYTES).map_err(failed)?,
                config.display().to_string(),
            )
        }
        None => (recorded.text.clone(), format!("recorded by Roundel {}", recorded.version)),
    };
    Config::parse_recorded(&text, lenses).map_err(|problems| ReplayError::Config {
        path: options.file.clone(),
        origin,
        problems,
    })
}

fn installation(
    recorded: &v1::RecordedConfiguration,
    config: Option<&Config>,
    started: Timestamp,
) -> Installation {
    // When fusing again, the names of kinds and bodies are those of the configuration.
    let fused =
        config.map(|config| crate::fusion::camera_manager::setup::installation(config, started));
    let (kinds, object_names, body_names) = match fused {
        Some(it) => (it.kinds, it.object_names, it.body_names),
        None => (recorded.roundels.clone(), BTreeMap::new(), Vec::new()),
    };
    let rate_hz = recorded.snapshot_rate_hz;
    Installation {
        name: recorded.name.clone(),
        source_id: format!("replay-of-{}", recorded.source_id),
        started,
        snapshot_rate_hz: if rate_hz > 0.0 { rate_hz } else { 60.0 },
        cameras: BTreeMap::new(),
        kinds,
        object_names,
        body_names,
    }
}

/// State of a replay at its start.
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

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
    From, ReplayError, Status,
    script::{Prologue, Script, Told},
    stage::{Settings, Stage},
};
use crate::{
    archive::{record::schema::Topic, replay::replayed},
    model::{
        clock::Clock,
        config::{Config, Lenses},
        hub::{Hub, Installation},
    },
};

/// What is to be played.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// The recording.
    pub file: PathBuf,
    /// What is taken from it.
    pub from: From,
    /// In place of the recorded configuration.
    pub config: Option<PathBuf>,
}

/// A recording that is ready to happen.
pub struct Scene {
    pub script: Script,
    pub stage: Stage,
    pub told: Vec<(Timestamp, Told)>,
    pub hub: Arc<Hub>,
    pub clock: Clock,
    pub late_window_ms: f64,
}

impl Scene {
    /// Opens a recording, and sets everything up for it.
    pub fn open(wanted: &Wanted) -> Result<Self, ReplayError> {
        let mut script = Script::open(&wanted.file, wanted.from == From::Frames)?;
        let Prologue { configuration, told, cameras } = Prologue::read(&mut script)?;
        let lacks =
            |what, remedy| Err(ReplayError::Lacks { path: wanted.file.clone(), what, remedy });
        if wanted.from != From::Snapshots && told.is_empty() {
            return lacks(
                "word of what fusion was told of cameras, as what is streamed by `roundel record --output`",
                "play its snapshots, or record on the server",
            );
        }
        if wanted.from == From::Frames && !script.reader().has_frames() {
            return lacks("frames", "record with --frames-every 1 to search them anew");
        }
        let lens = |(name, camera): (&String, &v1::Camera)| {
            replayed::read_lens(camera).map(|lens| (name.clone(), lens))
        };
        let lenses: Lenses = cameras.iter().filter_map(lens).collect();
        let config = match wanted.from {
            From::Snapshots => None,
            From::Observations | From::Frames => {
                Some(read_config(wanted, &configuration, &lenses)?)
            }
        };
        let number = |(_, told): &(Timestamp, Told)| match told {
            Told::Camera(told) => Some((told.camera.clone(), CameraId(told.number))),
            Told::Settings(_) => None,
        };
        let ids: BTreeMap<String, CameraId> =
            told.iter().filter_map(number).filter(|(name, _)| !name.is_empty()).collect();
        let (begin, _) = script.span();
        let clock = Clock::anchored(Instant::now(), begin);
        let hub = Arc::new(Hub::new(installation(&configuration, config.as_ref(), begin)));
        let from = wanted.from;
        let late_window_ms = config.as_ref().map_or(0.0, |it| it.fusion.late_window_s * 1e3);
        // Who wants other settings than the recorded ones does not want these changed either.
        let is_recorded = wanted.config.is_none();
        let settings = config.map(|config| Settings { config, lenses, is_recorded });
        let mut stage = Stage::new(hub.clone(), clock, from, (settings, ids));
        // Cameras are there before anything happens.
        if let Some(raw) = script.first(Topic::Health)? {
            stage.show(&raw, &mut script);
        }
        Ok(Self { script, stage, told, hub, clock, late_window_ms })
    }

    /// The newest of everything.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }
}

/// The configuration that a recording was made with, or the one that is wanted instead.
fn read_config(
    wanted: &Wanted,
    recorded: &v1::RecordedConfiguration,
    lenses: &Lenses,
) -> Result<Config, ReplayError> {
    let path = wanted.file.clone();
    let (text, origin) = match &wanted.config {
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
pub fn beginning(scene: &Scene, file: &Path, from: From) -> Status {
    let span = scene.script.span();
    Status { file: file.to_owned(), from, speed: 1.0, span, position: span.0, ..Status::default() }
}

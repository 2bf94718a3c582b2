//! The recording thread: writes items of the tap into files.

use std::{
    collections::BTreeMap,
    fs, io,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use roundel_core::{id::CameraId, time::Timestamp};
use roundel_proto::v1;

use super::{
    RecordError, RecorderShared, RecordingOptions,
    file_writer::{FileWriter, MessageStamp},
    folder, frame_compression,
    item::write_item,
    megabytes,
    schema::Topic,
};
use crate::model::{
    command::{CameraChange, CameraUpdate},
    convert,
    hub::EventKind,
    tap::{LatestCameraUpdate, RecordedItem},
};

/// A killed process loses at most the messages of this time.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);
const MAINTENANCE_INTERVAL: Duration = Duration::from_secs(1);
const LOSS_REPORT_INTERVAL: Duration = Duration::from_secs(60);

pub(super) struct RecordingTask {
    shared: Arc<RecorderShared>,
    items: Receiver<RecordedItem>,
    compressor: JoinHandle<()>,
    name: String,
    started: Timestamp,
    length: Option<Duration>,
    file: FileWriter,
    file_started: Instant,
    /// Age up to which files of other recordings are not deleted.
    keep: Duration,
    budgeted: folder::BudgetedFiles,
    /// Sums over completed files.
    bytes: u64,
    messages: u64,
    files: u32,
    deleted: u32,
    configuration: Option<String>,
    camera_updates: BTreeMap<CameraId, LatestCameraUpdate>,
    /// When losses were last reported, and their number.
    reported_losses: Option<(Instant, u64)>,
}

impl RecordingTask {
    /// Creates the first file, so that errors are returned at once, and opens the tap.
    pub(super) fn start(
        shared: Arc<RecorderShared>,
        options: &RecordingOptions,
    ) -> Result<Self, RecordError> {
        let config = &shared.config;
        let folder = config.folder.clone();
        let failed = |source| RecordError::Folder { folder: folder.clone(), source };
        fs::create_dir_all(&folder).map_err(failed)?;
        let free_bytes = folder::free_bytes(&folder).map_err(failed)?;
        let min_free_bytes = config.min_free_bytes;
        if free_bytes < min_free_bytes {
            return Err(RecordError::Full { folder, free_bytes, min_free_bytes });
        }
        let installation = shared.hub.installation();
        let keep = if options.by_client { config.keep } else { Duration::ZERO };
        let mut budgeted = folder::BudgetedFiles::new(&folder, &installation.name);
        let kept_bytes = budgeted.kept_bytes(keep).map_err(failed)?;
        // This recording needs the file that is written and the one before it.
        if kept_bytes > 0 && kept_bytes + 2 * config.rotate_bytes > config.budget_bytes {
            let budget_bytes = config.budget_bytes;
            return Err(RecordError::Budget { keep, kept_bytes, budget_bytes });
        }
        let name = if options.name.is_empty() { &installation.name } else { &options.name };
        let (name, started) = (folder::sanitize_name(name), shared.clock.now());
        let file = create_file(&shared, &name, started, 1).map_err(failed)?;
        let frames_every = options.frames_every.unwrap_or(config.frames_every);
        let receiver = shared.hub.tap().open(frames_every);
        let format = config.frames_format;
        let builder = std::thread::Builder::new().name("recorded frames".to_owned());
        let compressor = builder
            .spawn(move || frame_compression::run(&receiver.frames, &receiver.compressed, format))
            .inspect_err(|_| shared.hub.tap().close())
            .map_err(RecordError::Thread)?;
        let mut task = Self {
            items: receiver.items,
            compressor,
            name,
            started,
            length: options.length,
            file,
            file_started: Instant::now(),
            keep,
            budgeted,
            bytes: 0,
            messages: 0,
            files: 1,
            deleted: 0,
            configuration: None,
            camera_updates: BTreeMap::new(),
            reported_losses: None,
            shared: shared.clone(),
        };
        for update in &receiver.camera_updates {
            task.apply_camera_update(update);
        }
        if let Err(error) = task.write_state() {
            shared.hub.tap().close();
            return Err(failed(error));
        }
        *shared.status() = v1::Recording {
            state: v1::RecordingState::Recording.into(),
            folder: folder.display().to_string(),
            started_time_ns: started.as_ns(),
            budget_bytes: config.budget_bytes,
            frames_every,
            disk_free_bytes: free_bytes,
            ..v1::Recording::default()
        };
        task.report();
        let message = format!("Recording into {}.", task.file.path().display());
        task.publish_event(EventKind::RecordingBegun, message);
        Ok(task)
    }

    /// Writes until the tap is closed.
    pub(super) fn run(mut self) {
        let written = self.write_all();
        let tap = self.shared.hub.tap();
        tap.close();
        let folder = self.shared.config.folder.clone();
        self.messages += self.file.messages();
        let written = match written {
            Ok(()) => self.file.finish().map(|bytes| self.bytes += bytes),
            Err(error) => {
                self.bytes += self.file.truncate_to_complete();
                Err(error)
            }
        };
        // Ends the compressor if it waits for space in this queue.
        drop(self.items);
        let _ = self.compressor.join();
        let error = written.err().map(|error| match error.kind() {
            io::ErrorKind::StorageFull => format!(
                "{error} ({}): free some space, or change `folder` in [recording]",
                folder.display()
            ),
            _ => format!("{error} ({})", folder.display()),
        });
        let mut status = self.shared.status();
        (status.bytes, status.messages) = (self.bytes, self.messages);
        (status.files, status.deleted) = (self.files, self.deleted);
        status.seconds = self.shared.clock.now().seconds_since(self.started);
        status.dropped = tap.dropped();
        status.disk_free_bytes = folder::free_bytes(&folder).unwrap_or(0);
        if let Some(error) = error {
            drop(status);
            return self.shared.fail(&error);
        }
        (status.state, status.error) = (v1::RecordingState::Stopped.into(), String::new());
        drop(status);
        let files = match self.files {
            1 => "1 file".to_owned(),
            files => format!("{files} files"),
        };
        let size = megabytes(self.bytes);
        let message = format!("Recording stopped: {size} in {files} in {}.", folder.display());
        tracing::info!("{message}");
        self.shared.hub.publish_event(self.shared.clock.now(), EventKind::RecordingEnded, message);
    }

    fn write_all(&mut self) -> io::Result<()> {
        let begun = Instant::now();
        let (mut next_flush, mut next_maintenance) =
            (begun + FLUSH_INTERVAL, begun + MAINTENANCE_INTERVAL);
        loop {
            let now = Instant::now();
            if now >= next_flush {
                self.flush()?;
                next_flush = now + FLUSH_INTERVAL;
            }
            if now >= next_maintenance {
                self.maintain()?;
                next_maintenance = now + MAINTENANCE_INTERVAL;
            }
            if self.length.is_some_and(|length| now - begun >= length) {
                // Items already taken are still written.
                self.shared.hub.tap().close();
            }
            match self.items.recv_timeout(next_flush.saturating_duration_since(now)) {
                Ok(item) => self.write(&item)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.maintain(),
            }
        }
    }

    fn write(&mut self, item: &RecordedItem) -> io::Result<()> {
        match item {
            RecordedItem::CameraUpdate(update) => self.apply_camera_update(update),
            RecordedItem::Settings(applied) => self.configuration = Some(applied.text.clone()),
            _ => {}
        }
        let installation = self.shared.hub.installation();
        write_item(&mut self.file, &installation, item, self.shared.clock.now())
    }

    fn apply_camera_update(&mut self, update: &CameraUpdate) {
        if let CameraChange::Removed = update.change {
            self.camera_updates.remove(&update.camera);
        } else {
            self.camera_updates.entry(update.camera).or_default().apply(&update.change);
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()?;
        self.report();
        Ok(())
    }

    /// Records the health of the cameras, and enforces the limits of file size and disk space.
    fn maintain(&mut self) -> io::Result<()> {
        self.write_health()?;
        self.write_configuration()?;
        self.flush()?;
        self.file.sync()?;
        let config = &self.shared.config;
        let free_bytes = folder::free_bytes(&config.folder)?;
        self.shared.status().disk_free_bytes = free_bytes;
        if free_bytes < config.min_free_bytes {
            let message = format!(
                "the disk of {} has {} left, less than the minimum of {} (`min_free_mb` in [recording])",
                config.folder.display(),
                megabytes(free_bytes),
                megabytes(config.min_free_bytes)
            );
            return Err(io::Error::new(io::ErrorKind::StorageFull, message));
        }
        let is_large = self.file.bytes() >= config.rotate_bytes;
        if is_large || self.file_started.elapsed() >= config.rotate_after {
            self.rotate()?;
        }
        let config = &self.shared.config;
        let budget = folder::Budget {
            bytes: config.budget_bytes,
            prefix: &folder::file_prefix(&self.name, self.started),
            keep: self.keep,
            open: self.file.path(),
        };
        let deleted = self.budgeted.enforce(&budget)?;
        for path in &deleted {
            tracing::info!(file = %path.display(), "deleted an old recording (`budget_gb`)");
        }
        self.deleted += deleted.len() as u32;
        self.report_losses();
        Ok(())
    }

    fn rotate(&mut self) -> io::Result<()> {
        let next = create_file(&self.shared, &self.name, self.started, self.files + 1)?;
        let full = std::mem::replace(&mut self.file, next);
        self.files += 1;
        (self.file_started, self.configuration) = (Instant::now(), None);
        self.messages += full.messages();
        self.bytes += full.finish()?;
        self.write_state()
    }

    /// Writes the current state at the start of a file, so that each file can be replayed alone.
    fn write_state(&mut self) -> io::Result<()> {
        let (installation, now) = (self.shared.hub.installation(), self.shared.clock.now());
        let updates = self.camera_updates.iter();
        for update in updates.flat_map(|(camera, latest)| latest.updates(*camera)) {
            let message = convert::fused_camera(&installation, &update);
            self.file.write(Topic::Calibration, MessageStamp::at(now, 0), &message)?;
        }
        self.write_configuration()?;
        self.write_health()
    }

    fn write_health(&mut self) -> io::Result<()> {
        let hub = &self.shared.hub;
        let (installation, states) = (hub.installation(), hub.cameras());
        let each = states.iter().filter(|(id, _)| installation.cameras.contains_key(id));
        let cameras = each.map(|(id, state)| convert::camera(&installation, *id, state)).collect();
        let stamp = MessageStamp::at(self.shared.clock.now(), 0);
        self.file.write(Topic::Health, stamp, &v1::ListCamerasResponse { cameras })
    }

    /// Writes the configuration if it has changed.
    fn write_configuration(&mut self) -> io::Result<()> {
        let text = (self.shared.text)();
        if Some(&text) == self.configuration.as_ref() {
            return Ok(());
        }
        let installation = self.shared.hub.installation();
        let message = convert::recorded_configuration(&installation, &text);
        self.configuration = Some(text);
        let stamp = MessageStamp::at(self.shared.clock.now(), 0);
        self.file.write(Topic::Configuration, stamp, &message)
    }

    fn report(&self) {
        let mut status = self.shared.status();
        status.bytes = self.bytes + self.file.bytes();
        status.messages = self.messages + self.file.messages();
        (status.files, status.deleted) = (self.files, self.deleted);
        let name = self.file.path().file_name().unwrap_or_default();
        status.file = name.to_string_lossy().into_owned();
    }

    fn report_losses(&mut self) {
        let dropped = self.shared.hub.tap().dropped();
        let (reported_at, reported) = self.reported_losses.unwrap_or((self.file_started, 0));
        let is_due =
            self.reported_losses.is_none() || reported_at.elapsed() >= LOSS_REPORT_INTERVAL;
        if dropped > reported && is_due {
            self.reported_losses = Some((Instant::now(), dropped));
            let message = format!(
                "{} messages are missing in the recording: the disk of {} or this computer is too slow. Record fewer \
                 frames, or change `folder` in [recording].",
                dropped - reported,
                self.shared.config.folder.display()
            );
            self.publish_event(EventKind::RecordingLossy, message);
        }
    }

    fn publish_event(&self, kind: EventKind, message: String) {
        tracing::info!("{message}");
        self.shared.hub.publish_event(self.shared.clock.now(), kind, message);
    }
}

fn create_file(
    shared: &RecorderShared,
    name: &str,
    started: Timestamp,
    number: u32,
) -> io::Result<FileWriter> {
    let installation = shared.hub.installation();
    let about = BTreeMap::from([
        ("installation".to_owned(), installation.name.clone()),
        ("source_id".to_owned(), installation.source_id.clone()),
        ("number".to_owned(), number.to_string()),
    ]);
    let path = shared.config.folder.join(folder::file_name(name, started, number));
    FileWriter::create(&path, &about)
}

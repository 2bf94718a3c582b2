//! The recording's thread: from the tap into files.

use std::{
    collections::BTreeMap,
    fs, io,
    path::PathBuf,
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
    RecordError, RecorderShared, RecordingOptions, RecordingState,
    file_writer::{FileWriter, MessageStamp},
    folder, frame_compression,
    item::write_item,
    megabytes,
    schema::Topic,
};
use crate::model::{
    command::CameraUpdate,
    convert,
    hub::EventKind,
    tap::{LatestCameraUpdate, RecordedItem},
};

/// A chunk is closed and handed to the system so often: what a killed process loses is younger.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);
/// Health, the disk, the budget, and what makes a file long enough.
const MAINTENANCE_INTERVAL: Duration = Duration::from_secs(1);
/// Losses are told again after so long.
const LOSS_REPORT_INTERVAL: Duration = Duration::from_secs(60);

/// A recording that is being made.
pub(super) struct RecordingTask {
    shared: Arc<RecorderShared>,
    items: Receiver<RecordedItem>,
    pictures: Option<JoinHandle<()>>,
    name: String,
    started: Timestamp,
    length: Option<Duration>,
    file: Option<FileWriter>,
    file_begun: Instant,
    bytes: u64,
    messages: u64,
    files: u32,
    deleted: u32,
    configuration: Option<String>,
    camera_updates: BTreeMap<CameraId, LatestCameraUpdate>,
    reported_losses: Option<(Instant, u64)>,
}

impl RecordingTask {
    /// Makes the first file, so that what is wrong is known at once, and opens the tap.
    pub(super) fn start(
        shared: Arc<RecorderShared>,
        options: &RecordingOptions,
    ) -> Result<Self, RecordError> {
        let config = &shared.config;
        let folder = config.folder.clone();
        let failed = |source| RecordError::Folder { folder: folder.clone(), source };
        fs::create_dir_all(&folder).map_err(failed)?;
        let free_bytes = folder::free_bytes(&folder).map_err(failed)?;
        if free_bytes < config.min_free_bytes {
            let min_free_bytes = config.min_free_bytes;
            return Err(RecordError::Full { folder, free_bytes, min_free_bytes });
        }
        let installation = shared.hub.installation();
        let name = if options.name.is_empty() { &installation.name } else { &options.name };
        let frames_every = options.frames_every.unwrap_or(config.frames_every);
        let receiver = shared.hub.tap().open(frames_every);
        let format = config.frames_format;
        let builder = std::thread::Builder::new().name("recorded frames".to_owned());
        let pictures = builder
            .spawn(move || frame_compression::run(&receiver.frames, &receiver.compressed, format))
            .map_err(RecordError::Thread);
        let (name, started) = (folder::sanitize_name(name), shared.clock.now());
        let mut task = Self {
            items: receiver.items,
            pictures: None,
            name,
            started,
            length: options.length,
            file: None,
            file_begun: Instant::now(),
            bytes: 0,
            messages: 0,
            files: 0,
            deleted: 0,
            configuration: None,
            camera_updates: BTreeMap::new(),
            reported_losses: None,
            shared: shared.clone(),
        };
        receiver.camera_updates.into_iter().for_each(|told| task.apply_camera_update(&told));
        let begun = pictures.and_then(|pictures| {
            task.pictures = Some(pictures);
            task.open_file().map_err(failed)
        });
        if let Err(error) = begun {
            shared.hub.tap().close();
            return Err(error);
        }
        *shared.status() = super::RecordingStatus {
            state: RecordingState::Recording,
            folder,
            started,
            budget_bytes: config.budget_bytes,
            frames_every,
            disk_free_bytes: free_bytes,
            ..super::RecordingStatus::default()
        };
        task.report();
        let message = format!("What happens is recorded into {}.", task.path().display());
        task.publish_event(EventKind::RecordingBegun, message);
        Ok(task)
    }

    /// Writes until the tap is closed.
    pub(super) fn run(mut self) {
        let ended = self.write_all();
        self.shared.hub.tap().close();
        let ended = ended.and_then(|()| match self.file.take() {
            Some(file) => {
                let messages = file.messages();
                let bytes = file.finish()?;
                (self.bytes, self.messages) = (self.bytes + bytes, self.messages + messages);
                Ok(())
            }
            None => Ok(()),
        });
        let ended = ended.map_err(|error| match error.kind() {
            io::ErrorKind::StorageFull => format!(
                "{error} ({}): make room, or record elsewhere (`folder` in [recording])",
                self.shared.config.folder.display()
            ),
            _ => format!("{error} ({})", self.shared.config.folder.display()),
        });
        if let Some(file) = self.file.take() {
            self.messages += file.messages();
            self.bytes += file.truncate_to_complete();
        }
        // Whoever compresses waits for room in this queue.
        drop(self.items);
        if let Some(pictures) = self.pictures.take() {
            let _ = pictures.join();
        }
        let shared = self.shared;
        let dropped = shared.hub.tap().dropped();
        let folder = shared.config.folder.clone();
        let (kind, message) = match &ended {
            Ok(()) => {
                let files = if self.files == 1 { "a file" } else { "files" };
                let message = format!(
                    "A recording was ended: {files} of {} in {}.",
                    megabytes(self.bytes),
                    folder.display()
                );
                (EventKind::RecordingEnded, message)
            }
            Err(error) => {
                let message = format!(
                    "The recording ended by itself: {error}. What was recorded until then can be read; nothing else \
                     is affected."
                );
                tracing::error!("{message}");
                (EventKind::RecordingFailed, message)
            }
        };
        let status_is_fine = ended.is_ok();
        let mut status = shared.status();
        status.state = if ended.is_ok() { RecordingState::Stopped } else { RecordingState::Failed };
        status.error = ended.err().unwrap_or_default();
        (status.bytes, status.messages) = (self.bytes, self.messages);
        (status.files, status.deleted) = (self.files, self.deleted);
        status.seconds = shared.clock.now().seconds_since(self.started);
        status.dropped = dropped;
        status.disk_free_bytes = folder::free_bytes(&folder).unwrap_or(0);
        drop(status);
        if status_is_fine {
            tracing::info!("{message}");
        }
        shared.hub.publish_event(shared.clock.now(), kind, message);
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
                // What was taken until now is still written.
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
            RecordedItem::CameraUpdate(told) => self.apply_camera_update(told),
            RecordedItem::Settings(written) => self.configuration = Some(written.text.clone()),
            _ => {}
        }
        let (hub, now) = (&self.shared.hub, self.shared.clock.now());
        self.file.iter_mut().try_for_each(|file| write_item(file, &hub.installation(), item, now))
    }

    fn apply_camera_update(&mut self, told: &CameraUpdate) {
        self.camera_updates.entry(told.camera).or_default().apply(&told.change);
        if matches!(told.change, crate::model::command::CameraChange::Removed) {
            self.camera_updates.remove(&told.camera);
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        if let Some(file) = &mut self.file {
            file.flush()?;
        }
        self.report();
        Ok(())
    }

    /// What is looked after once a second.
    fn maintain(&mut self) -> io::Result<()> {
        self.write_health()?;
        self.write_configuration()?;
        self.flush()?;
        if let Some(file) = &self.file {
            file.sync()?;
        }
        let config = self.shared.config.clone();
        let free_bytes = folder::free_bytes(&config.folder)?;
        self.shared.status().disk_free_bytes = free_bytes;
        if free_bytes < config.min_free_bytes {
            return Err(io::Error::new(
                io::ErrorKind::StorageFull,
                format!(
                    "the disk of {} has {} left, and {} are to be kept (`min_free_mb` in [recording])",
                    config.folder.display(),
                    megabytes(free_bytes),
                    megabytes(config.min_free_bytes)
                ),
            ));
        }
        let is_long = self.file.as_ref().is_some_and(|file| file.bytes() >= config.rotate_bytes);
        if is_long || self.file_begun.elapsed() >= config.rotate_after {
            self.rotate()?;
        }
        let open = self.path();
        let deleted = folder::enforce_budget(&config.folder, config.budget_bytes, Some(&open))?;
        for path in &deleted {
            tracing::info!(file = %path.display(), "an old recording made room for a new one");
        }
        self.deleted += deleted.len() as u32;
        self.report_losses();
        Ok(())
    }

    fn rotate(&mut self) -> io::Result<()> {
        if let Some(file) = self.file.take() {
            self.messages += file.messages();
            self.bytes += file.finish()?;
        }
        self.open_file()
    }

    fn open_file(&mut self) -> io::Result<()> {
        self.files += 1;
        let name = folder::file_name(&self.name, self.started, self.files);
        let installation = self.shared.hub.installation();
        let about = BTreeMap::from([
            ("installation".to_owned(), installation.name.clone()),
            ("source_id".to_owned(), installation.source_id.clone()),
            ("number".to_owned(), self.files.to_string()),
        ]);
        let path = self.shared.config.folder.join(name);
        let file = FileWriter::create(&path, &about)?;
        self.file_begun = Instant::now();
        self.configuration = None;
        let now = self.shared.clock.now();
        let file = self.file.insert(file);
        for told in self.camera_updates.iter().flat_map(|(camera, memory)| memory.updates(*camera))
        {
            let message = convert::fused_camera(&installation, &told);
            file.write(Topic::Calibration, MessageStamp::at(now, 0), &message)?;
        }
        self.write_configuration()?;
        self.write_health()
    }

    fn write_health(&mut self) -> io::Result<()> {
        let hub = &self.shared.hub;
        let (installation, states) = (hub.installation(), hub.cameras());
        let each = states.iter().filter(|(id, _)| installation.cameras.contains_key(id));
        let cameras = each.map(|(id, state)| convert::camera(&installation, *id, state)).collect();
        let message = v1::ListCamerasResponse { cameras };
        let stamp = MessageStamp::at(self.shared.clock.now(), 0);
        self.file.iter_mut().try_for_each(|file| file.write(Topic::Health, stamp, &message))
    }

    /// If it is another one than before.
    fn write_configuration(&mut self) -> io::Result<()> {
        let text = (self.shared.text)();
        if Some(&text) == self.configuration.as_ref() {
            return Ok(());
        }
        let installation = self.shared.hub.installation();
        let message = convert::recorded_configuration(&installation, &text);
        self.configuration = Some(text);
        let stamp = MessageStamp::at(self.shared.clock.now(), 0);
        self.file.iter_mut().try_for_each(|file| file.write(Topic::Configuration, stamp, &message))
    }

    fn path(&self) -> PathBuf {
        self.file.as_ref().map(|file| file.path().to_owned()).unwrap_or_default()
    }

    fn report(&self) {
        let mut status = self.shared.status();
        let (bytes, messages) =
            self.file.as_ref().map_or((0, 0), |file| (file.bytes(), file.messages()));
        (status.bytes, status.messages) = (self.bytes + bytes, self.messages + messages);
        (status.files, status.deleted) = (self.files, self.deleted);
        let path = self.path();
        status.file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    }

    fn report_losses(&mut self) {
        let dropped = self.shared.hub.tap().dropped();
        let (reported_at, reported) = self.reported_losses.unwrap_or((self.file_begun, 0));
        let is_due =
            self.reported_losses.is_none() || reported_at.elapsed() >= LOSS_REPORT_INTERVAL;
        if dropped > reported && is_due {
            self.reported_losses = Some((Instant::now(), dropped));
            let message = format!(
                "{} messages are missing in the recording: the disk of {} or this machine is too slow for it. Record \
                 fewer frames, or elsewhere.",
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

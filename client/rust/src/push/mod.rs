//! Sends frames or detections to a camera of the server whose source is `push:`.
//!
//! | module | purpose |
//! | --- | --- |
//! | `queue` | bounded queue of items to be sent and to be acknowledged |
//! | `connection` | greeting, probes, sending, acknowledgements |
//!
//! A task owns the connection, so [`Pusher::frame`] and [`Pusher::observations`] never block. Without a connection, items are
//! kept as long as the server can use them. Older items, and frames replaced by newer ones, are dropped and counted. At any
//! time
//!
//! ```text
//! captured = acknowledged + dropped + waiting
//! ```
//!
//! Items in flight when a connection breaks are sent again if the server did not receive them. Sequence numbers prevent
//! duplicates.

mod connection;
mod queue;

use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use tokio::{
    sync::{Notify, watch},
    task::JoinHandle,
    time::{Instant, sleep, timeout},
};

use crate::{
    Client, Error,
    call_headers::Deadline,
    clock::{ClockEstimator, ClockOffset},
    v1,
};
use queue::{Item, SendQueue};

/// Limit for one message: a grey picture of 5000 x 3000 pixels fits.
const MAX_MESSAGE_BYTES: usize = 16 * 1024 * 1024;

/// The clock of the capture times, ns since any epoch.
type ClockFn = Arc<dyn Fn() -> i64 + Send + Sync>;

/// Camera, sender and clock of a [`Pusher`].
#[derive(Clone)]
pub struct PushOptions {
    camera: String,
    sender: String,
    times: v1::PushTimes,
    now: ClockFn,
}

impl PushOptions {
    /// Feeds the camera of that name. Capture times are of this machine's Unix clock, whose offset from the server's clock is
    /// measured.
    pub fn new(camera: impl Into<String>) -> Self {
        let now = || {
            let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            i64::try_from(unix.as_nanos()).unwrap_or(i64::MAX)
        };
        let sender = format!("process {}", std::process::id());
        let times = v1::PushTimes::Server;
        Self { camera: camera.into(), sender, times, now: Arc::new(now) }
    }

    /// Name of this program on the dashboard.
    pub fn sender(self, name: impl Into<String>) -> Self {
        Self { sender: name.into(), ..self }
    }

    /// Uses this clock for capture times, ns since any epoch. It must not be set while in use.
    pub fn clock(self, now: impl Fn() -> i64 + Send + Sync + 'static) -> Self {
        Self { now: Arc::new(now), ..self }
    }

    /// Declares capture times of a clock that this program cannot read, such as a counter of the camera or externally
    /// synchronized Unix time. They are sent unchanged, and the server converts them.
    pub fn times(self, times: v1::PushTimes) -> Self {
        Self { times, ..self }
    }
}

impl fmt::Debug for PushOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { camera, sender, times, .. } = self;
        f.debug_struct("PushOptions")
            .field("camera", camera)
            .field("sender", sender)
            .field("times", times)
            .finish_non_exhaustive()
    }
}

/// The picture of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Picture {
    /// 8-bit grey pixels in row order without padding, with width and height.
    Grey(Vec<u8>, [u32; 2]),
    /// A JPEG file.
    Jpeg(Vec<u8>),
}

/// State of a [`Pusher`].
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct PushStatus {
    /// Frames and observations queued so far, which is the newest sequence number.
    pub captured: u64,
    /// Number acknowledged by the server.
    pub acknowledged: u64,
    /// Number dropped: replaced by newer frames, or too old for the server.
    pub dropped: u64,
    /// Number still to be sent or acknowledged.
    pub waiting: u64,
    /// Whether a connection is established.
    pub connected: bool,
    /// Connections established so far.
    pub connections: u64,
    /// Why there is no connection, and the remedy; empty while there is one.
    pub error: String,
    /// Whether the server rejects this sender. The pusher retries in case the configuration changes.
    pub refused: bool,
    /// Offset of the server's clock; `None` before the first probe.
    pub clock_offset: Option<ClockOffset>,
}

/// State shared by the pusher and its task.
struct Shared {
    state: Mutex<State>,
    work_available: Notify,
    status: watch::Sender<PushStatus>,
    calibration: watch::Sender<Option<v1::PushedCalibration>>,
    picture_requests: watch::Sender<u64>,
    options: PushOptions,
    run_id: String,
}

struct State {
    queue: SendQueue,
    clock: ClockEstimator,
    /// Why the sender has no frames; cleared by the next frame.
    trouble: Option<String>,
    /// Whether it was sent over this connection.
    is_trouble_sent: bool,
    /// The requested picture, to be sent.
    picture: Option<v1::PushedPicture>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now_ns(&self) -> i64 {
        (self.options.now)()
    }

    /// Updates and publishes the status, with the additional `change`.
    fn publish(&self, change: impl FnOnce(&mut PushStatus)) {
        let now_ns = self.now_ns();
        let (counts, clock_offset) = {
            let mut state = self.lock();
            state.queue.expire(now_ns);
            (state.queue.counts(), state.clock.offset_at(now_ns))
        };
        self.status.send_modify(|status| {
            (status.captured, status.acknowledged) = (counts.captured, counts.acknowledged);
            (status.dropped, status.waiting) = (counts.dropped, counts.waiting);
            status.clock_offset = clock_offset;
            change(status);
        });
    }
}

/// Feeds one camera until it is dropped. Reconnects automatically.
pub struct Pusher {
    shared: Arc<Shared>,
    task: JoinHandle<()>,
}

impl Client {
    /// Starts to feed a camera. Connects and reconnects in the background with backoff (100 ms to 5 s, with jitter), so the
    /// server may come up later; see [`Pusher::status`]. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// [`Error::InvalidAddress`].
    pub fn push(&self, options: PushOptions) -> Result<Pusher, Error> {
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                queue: SendQueue::default(),
                clock: ClockEstimator::default(),
                trouble: None,
                is_trouble_sent: false,
                picture: None,
            }),
            work_available: Notify::new(),
            status: watch::Sender::default(),
            calibration: watch::Sender::new(None),
            picture_requests: watch::Sender::new(0),
            options,
            run_id: format!("{:016x}{:016x}", fastrand::u64(..), fastrand::u64(..)),
        });
        let headers = self.headers(Deadline::NONE);
        let task = tokio::spawn(connection::run(shared.clone(), self.connector().clone(), headers));
        Ok(Pusher { shared, task })
    }
}

impl Pusher {
    /// Queues a frame and returns its sequence number. Replaces a frame that still waits.
    ///
    /// `capture_time_ns` is the middle of the exposure on the clock of the options; `clock` gives its source and accuracy.
    pub fn frame(
        &self,
        picture: Picture,
        capture_time_ns: i64,
        clock: Option<v1::CaptureClock>,
    ) -> u64 {
        let picture = match picture {
            Picture::Jpeg(file) => v1::pushed_frame::Picture::Jpeg(file),
            Picture::Grey(pixels, [width, height]) => {
                v1::pushed_frame::Picture::Grey(v1::GreyPicture { width, height, pixels })
            }
        };
        let frame = v1::PushedFrame { sequence: 0, capture_time_ns, clock, picture: Some(picture) };
        self.enqueue(Item::Frame(Arc::new(frame)))
    }

    /// Queues the observations of a frame and returns their sequence number. Their times are of the clock of the options;
    /// their `sequence` is set here.
    pub fn observations(&self, observations: v1::PushedObservations) -> u64 {
        self.enqueue(Item::Observations(Arc::new(observations)))
    }

    /// Reports why there are no frames, and the remedy. The next frame clears it.
    pub fn trouble(&self, error: impl Into<String>) {
        {
            let mut state = self.shared.lock();
            state.trouble = Some(error.into());
            state.is_trouble_sent = false;
        }
        self.shared.work_available.notify_one();
    }

    /// Number of picture requests from the server. A sender of observations answers each with [`Pusher::picture`], if it can.
    pub fn picture_requests(&self) -> watch::Receiver<u64> {
        self.shared.picture_requests.subscribe()
    }

    /// Queues a requested picture for display. Replaces one that still waits. Its times are of the clock of the options.
    pub fn picture(&self, picture: v1::PushedPicture) {
        self.shared.lock().picture = Some(picture);
        self.shared.work_available.notify_one();
    }

    fn enqueue(&self, item: Item) -> u64 {
        let now_ns = self.shared.now_ns();
        let sequence = {
            let mut state = self.shared.lock();
            state.trouble = None;
            state.queue.add(item, now_ns)
        };
        self.shared.work_available.notify_one();
        self.shared.publish(|_| {});
        sequence
    }

    /// The current status.
    pub fn status(&self) -> PushStatus {
        self.shared.publish(|_| {});
        self.shared.status.borrow().clone()
    }

    /// The status, with each change.
    pub fn statuses(&self) -> watch::Receiver<PushStatus> {
        self.shared.status.subscribe()
    }

    /// The lens and pose of the camera on the server, once received, and each change.
    pub fn calibration(&self) -> watch::Receiver<Option<v1::PushedCalibration>> {
        self.shared.calibration.subscribe()
    }

    /// Waits until all items are acknowledged, at most `patience`, and ends the connection. Counts the rest as dropped.
    pub async fn finish(self, patience: Duration) -> PushStatus {
        let drained = async {
            while self.status().waiting > 0 {
                sleep(Duration::from_millis(5)).await;
            }
        };
        let deadline = Instant::now() + patience;
        if timeout(patience, drained).await.is_ok() {
            // The last probe reports the dropped items to the server.
            let probes = self.shared.lock().clock.probes_answered();
            self.shared.work_available.notify_one();
            while self.shared.lock().clock.probes_answered() == probes && Instant::now() < deadline
            {
                sleep(Duration::from_millis(5)).await;
            }
        }
        self.task.abort();
        self.shared.lock().queue.drop_all();
        self.status()
    }
}

impl Drop for Pusher {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl fmt::Debug for Pusher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pusher").field("options", &self.shared.options).finish_non_exhaustive()
    }
}

//! Frames and detections sent into a camera of the server whose source is `push:`.
//!
//! | module | what it does |
//! | --- | --- |
//! | `backlog` | what waits to be sent and what waits to be acknowledged; bounded, and every one counted |
//! | `link` | one connection: greeting, probes, sending, acknowledgements |
//!
//! Nothing here ever waits for the network but the task that owns the connection: [`Pusher::frame`] and
//! [`Pusher::observations`] leave what they are given and return. While there is no connection the newest is kept
//! for as long as the server could still use it; what grows older, or gives way to newer frames, is dropped and
//! counted, so that at any time
//!
//! ```text
//! captured = acknowledged + dropped + waiting
//! ```
//!
//! What was under way when a connection broke is sent again if the server did not get it; sequence numbers see to
//! it that nothing counts twice.

mod backlog;
mod link;

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
    clock::{ClockOffset, ServerClock},
    v1,
};
use backlog::{Backlog, Item};

/// Largest message that is sent: a grey picture of 5000 x 3000 pixels fits.
const MAX_MESSAGE_BYTES: usize = 16 * 1024 * 1024;

/// Tells the time that captures are stamped with, ns since whatever epoch.
type Now = Arc<dyn Fn() -> i64 + Send + Sync>;

/// Which camera is fed, and by whom.
#[derive(Clone)]
pub struct PushOptions {
    camera: String,
    sender: String,
    times: v1::PushTimes,
    now: Now,
}

impl PushOptions {
    /// Feeds the camera of that name. Capture times are those of this machine's Unix clock, whether it is right or
    /// not: what it differs by from the server's is measured.
    pub fn new(camera: impl Into<String>) -> Self {
        let now = || {
            let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            i64::try_from(unix.as_nanos()).unwrap_or(i64::MAX)
        };
        let sender = format!("process {}", std::process::id());
        let times = v1::PushTimes::Server;
        Self { camera: camera.into(), sender, times, now: Arc::new(now) }
    }

    /// What this program calls itself on the dashboard.
    pub fn sender(self, name: impl Into<String>) -> Self {
        Self { sender: name.into(), ..self }
    }

    /// Capture times are those of this clock, ns since an epoch of its own; it must never be set while it is used.
    pub fn clock(self, now: impl Fn() -> i64 + Send + Sync + 'static) -> Self {
        Self { now: Arc::new(now), ..self }
    }

    /// Capture times are of a clock that this program cannot read (a counter of its camera, or Unix time kept in
    /// step by others): they are sent as they are, and the server knows what to do with them.
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

/// A picture to be sent.
#[derive(Clone, Debug, PartialEq)]
pub enum Picture {
    /// 8-bit grey, row by row without gaps, of so many columns and rows.
    Grey(Vec<u8>, [u32; 2]),
    /// A JPEG file.
    Jpeg(Vec<u8>),
}

/// How pushing goes.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct PushStatus {
    /// Frames and observations handed over so far: the newest sequence number.
    pub captured: u64,
    /// Of these, taken by the server.
    pub acknowledged: u64,
    /// Given up: they gave way to newer ones, or had grown too old for the server to use.
    pub dropped: u64,
    /// Still to be sent or acknowledged.
    pub waiting: u64,
    /// Whether there is a connection that works.
    pub connected: bool,
    /// Connections so far.
    pub connections: u64,
    /// Why there is none, and what to do; empty while there is one.
    pub error: String,
    /// Whether trying again cannot help: the server refuses this sender. It is tried again all the same, in case
    /// its configuration changes.
    pub refused: bool,
    /// The server's clock less this program's, and its standard deviation; `None` before the first probe.
    pub clock_offset: Option<ClockOffset>,
}

/// What the pusher and its task share.
struct Shared {
    state: Mutex<State>,
    /// There is something to be sent.
    news: Notify,
    status: watch::Sender<PushStatus>,
    calibration: watch::Sender<Option<v1::PushedCalibration>>,
    picture_requests: watch::Sender<u64>,
    options: PushOptions,
    run_id: String,
}

struct State {
    backlog: Backlog,
    clock: ServerClock,
    /// Why the sender has no frames, until the next one.
    trouble: Option<String>,
    /// Whether this connection's server knows.
    trouble_told: bool,
    /// To be sent, since it was asked for.
    picture: Option<v1::PushedPicture>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now_ns(&self) -> i64 {
        (self.options.now)()
    }

    /// Brings the status up to date, with what `change` does to it.
    fn publish(&self, change: impl FnOnce(&mut PushStatus)) {
        let now_ns = self.now_ns();
        let (counts, clock_offset) = {
            let mut state = self.lock();
            state.backlog.expire(now_ns);
            (state.backlog.counts(), state.clock.offset_at(now_ns))
        };
        self.status.send_modify(|status| {
            (status.captured, status.acknowledged) = (counts.captured, counts.acknowledged);
            (status.dropped, status.waiting) = (counts.dropped, counts.waiting);
            status.clock_offset = clock_offset;
            change(status);
        });
    }
}

/// Feeds one camera, through losses of the connection, until it is dropped.
pub struct Pusher {
    shared: Arc<Shared>,
    task: JoinHandle<()>,
}

impl Client {
    /// Begins to feed a camera. Nobody needs to be there yet: the connection is made, and made again, with growing
    /// pauses (100 ms to 5 s, with jitter); [`Pusher::status`] says how it goes. To be called within a tokio
    /// runtime.
    ///
    /// # Errors
    /// [`Error::InvalidAddress`].
    pub fn push(&self, options: PushOptions) -> Result<Pusher, Error> {
        let (address, endpoint) = crate::address::endpoint(self.address())?;
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                backlog: Backlog::default(),
                clock: ServerClock::default(),
                trouble: None,
                trouble_told: false,
                picture: None,
            }),
            news: Notify::new(),
            status: watch::Sender::default(),
            calibration: watch::Sender::new(None),
            picture_requests: watch::Sender::new(0),
            options,
            run_id: format!("{:016x}{:016x}", fastrand::u64(..), fastrand::u64(..)),
        });
        let task = tokio::spawn(link::run(shared.clone(), address, endpoint));
        Ok(Pusher { shared, task })
    }
}

impl Pusher {
    /// Leaves a picture to be sent, and returns its sequence number. Of pictures the newest wins.
    ///
    /// `capture_time_ns` is the middle of the exposure on the clock of the options; `clock` says where it comes from
    /// and how far off it may be.
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
        self.leave(Item::Frame(Arc::new(frame)))
    }

    /// Leaves what was seen in a frame to be sent, and returns its sequence number. All times in it are of the clock
    /// of the options; its `sequence` is given here.
    pub fn observations(&self, observations: v1::PushedObservations) -> u64 {
        self.leave(Item::Observations(Arc::new(observations)))
    }

    /// Says why there are no frames, and what to do. The next frame takes it back.
    pub fn trouble(&self, error: impl Into<String>) {
        {
            let mut state = self.shared.lock();
            state.trouble = Some(error.into());
            state.trouble_told = false;
        }
        self.shared.news.notify_one();
    }

    /// Counts how often the server has asked for a picture; each time a sender of observations answers with
    /// [`Pusher::picture`], if it can.
    pub fn picture_requests(&self) -> watch::Receiver<u64> {
        self.shared.picture_requests.subscribe()
    }

    /// Leaves a picture for people to look at, as the server has asked. Of two that wait the newer one is sent; all times
    /// in it are of the clock of the options.
    pub fn picture(&self, picture: v1::PushedPicture) {
        self.shared.lock().picture = Some(picture);
        self.shared.news.notify_one();
    }

    fn leave(&self, item: Item) -> u64 {
        let now_ns = self.shared.now_ns();
        let sequence = {
            let mut state = self.shared.lock();
            state.trouble = None;
            state.backlog.add(item, now_ns)
        };
        self.shared.news.notify_one();
        self.shared.publish(|_| {});
        sequence
    }

    /// How it goes, now.
    pub fn status(&self) -> PushStatus {
        self.shared.publish(|_| {});
        self.shared.status.borrow().clone()
    }

    /// How it goes, at each change.
    pub fn statuses(&self) -> watch::Receiver<PushStatus> {
        self.shared.status.subscribe()
    }

    /// The lens and place that the server has the camera at, once it has said so, and each change.
    pub fn calibration(&self) -> watch::Receiver<Option<v1::PushedCalibration>> {
        self.shared.calibration.subscribe()
    }

    /// Waits until nothing waits any more, at most so long, and ends the connection. What is left then is counted as
    /// dropped.
    pub async fn finish(self, patience: Duration) -> PushStatus {
        let drained = async {
            while self.status().waiting > 0 {
                sleep(Duration::from_millis(5)).await;
            }
        };
        let deadline = Instant::now() + patience;
        if timeout(patience, drained).await.is_ok() {
            // The last probe tells the server what will never come.
            let probes = self.shared.lock().clock.probes_answered();
            self.shared.news.notify_one();
            while self.shared.lock().clock.probes_answered() == probes && Instant::now() < deadline
            {
                sleep(Duration::from_millis(5)).await;
            }
        }
        self.task.abort();
        self.shared.lock().backlog.give_up();
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

//! A receiving thread with a mailbox for the newest item, for sources that block or push.
//!
//! Memory is bounded: one item waits and another is in use. A new item replaces one that was not taken, and the
//! replaced item is counted. No item within the timeout of the consumer is a stall, which is an error like any other:
//! the worker's supervisor opens the source again.

use std::{
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use tokio_util::sync::CancellationToken;

use super::SourceError;
use crate::model::stop::Stop;

/// How often a wait checks the stop signal.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// How long a drop waits for the thread to end.
const GRACE: Duration = Duration::from_secs(1);

/// The waiting item, and counts since the last one was taken.
struct State<T> {
    newest: Option<T>,
    replaced: u64,
    broken: u64,
    /// Explanation for the message of a stall.
    hint: &'static str,
    end: Option<SourceError>,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    news: Condvar,
    cancelled: CancellationToken,
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The receiving thread's side.
pub(super) struct Sink<T>(Arc<Shared<T>>);

impl<T> Clone for Sink<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T> Sink<T> {
    pub(super) fn put(&self, item: T) {
        let mut state = self.0.lock();
        let replaced = state.newest.replace(item);
        state.replaced += u64::from(replaced.is_some());
        drop(state);
        self.0.news.notify_one();
    }

    /// Counts items that arrived broken.
    pub(super) fn count_broken(&self, count: u64) {
        self.0.lock().broken += count;
    }

    /// Sets the explanation for a later stall.
    pub(super) fn hint(&self, hint: &'static str) {
        self.0.lock().hint = hint;
    }

    /// Ends the feed with a reason; only the first one counts.
    pub(super) fn end(&self, error: SourceError) {
        self.0.lock().end.get_or_insert(error);
        self.0.news.notify_one();
    }

    /// Resolves when the consumer is dropped.
    pub(super) async fn cancelled(&self) {
        self.0.cancelled.cancelled().await;
    }
}

/// The newest item, with counts since the one before.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Taken<T> {
    pub(super) item: T,
    /// Items that it replaced.
    pub(super) replaced: u64,
    /// Items that arrived broken.
    pub(super) broken: u64,
}

/// The consumer's side.
pub(super) struct Feed<T> {
    shared: Arc<Shared<T>>,
    thread: Option<JoinHandle<()>>,
    stop: Stop,
}

impl<T: Send + 'static> Feed<T> {
    /// Starts the thread; `receive` returns the reason of the end.
    pub(super) fn start(
        name: &str,
        stop: Stop,
        receive: impl FnOnce(&Sink<T>) -> SourceError + Send + 'static,
    ) -> Result<Self, SourceError> {
        let shared = Arc::new(Shared {
            state: Mutex::new(State { newest: None, replaced: 0, broken: 0, hint: "", end: None }),
            news: Condvar::new(),
            cancelled: CancellationToken::new(),
        });
        let sink = Sink(shared.clone());
        let run = move || {
            // The drop of the guard reports a panic.
            let guard = Ending(sink);
            let why = receive(&guard.0);
            guard.0.end(why);
        };
        let thread = thread::Builder::new().name(name.to_owned()).spawn(run).map_err(|error| {
            SourceError::Failed(format!("cannot start the thread `{name}`: {error}"))
        })?;
        Ok(Self { shared, thread: Some(thread), stop })
    }

    /// Waits for an item; a stall once `patience` has passed since `since`.
    pub(super) fn next(&self, since: Instant, patience: Duration) -> Result<Taken<T>, SourceError> {
        let mut state = self.shared.lock();
        loop {
            if self.stop.is_stopped() {
                return Err(SourceError::Stopped);
            }
            if let Some(item) = state.newest.take() {
                let replaced = std::mem::take(&mut state.replaced);
                let broken = std::mem::take(&mut state.broken);
                return Ok(Taken { item, replaced, broken });
            }
            if let Some(end) = &state.end {
                return Err(end.clone());
            }
            let rest = patience.saturating_sub(since.elapsed());
            if rest.is_zero() {
                return Err(SourceError::Failed(stalled(patience, state.hint, state.broken)));
            }
            let wait = self.shared.news.wait_timeout(state, rest.min(LOOK_EVERY));
            state = wait.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

fn stalled(patience: Duration, hint: &str, broken: u64) -> String {
    let mut message = format!("stalled: no picture for {:.1} s", patience.as_secs_f64());
    if broken > 0 {
        message.push_str(&format!(", {broken} broken"));
    }
    if !hint.is_empty() {
        message.push_str(&format!("; {hint}"));
    }
    message
}

impl<T> Drop for Feed<T> {
    fn drop(&mut self) {
        self.shared.cancelled.cancel();
        let Some(thread) = self.thread.take() else { return };
        let deadline = Instant::now() + GRACE;
        while !thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        if thread.is_finished() {
            // A panic was already reported as the end of the feed.
            let _ = thread.join();
        } else {
            let name = thread.thread().name().unwrap_or_default();
            tracing::warn!(thread = name, "does not end and is detached");
        }
    }
}

/// Ends the feed when the thread ends, also by a panic.
struct Ending<T>(Sink<T>);

impl<T> Drop for Ending<T> {
    fn drop(&mut self) {
        let message = "internal error, please report it: the receiving thread ended";
        self.0.end(SourceError::Failed(message.to_owned()));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    const PATIENCE: Duration = Duration::from_secs(60);

    fn next(feed: &Feed<u32>) -> Result<Taken<u32>, SourceError> {
        feed.next(Instant::now(), PATIENCE)
    }

    fn failed<T: std::fmt::Debug>(result: Result<T, SourceError>) -> String {
        match result {
            Err(SourceError::Failed(message)) => message,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_newest_wins_and_what_it_replaced_is_counted() {
        let (go, gone) = channel::<()>();
        let (done, finished) = channel();
        let feed = Feed::start("feed", Stop::default(), move |sink| {
            (1..=3).for_each(|item| sink.put(item));
            sink.count_broken(2);
            done.send(()).unwrap();
            gone.recv().unwrap();
            sink.put(4);
            SourceError::Finished
        })
        .unwrap();
        finished.recv().unwrap();
        assert_eq!(next(&feed).unwrap(), Taken { item: 3, replaced: 2, broken: 2 });
        go.send(()).unwrap();
        // An item that was received before the end comes first.
        assert_eq!(next(&feed).unwrap(), Taken { item: 4, replaced: 0, broken: 0 });
        assert_eq!(next(&feed), Err(SourceError::Finished));
    }

    #[test]
    fn a_stall_says_what_came_instead_and_ends_the_thread() {
        let (done, finished) = channel();
        let feed = Feed::<u32>::start("feed", Stop::default(), move |sink| {
            sink.hint("what arrives is text");
            sink.count_broken(7);
            while !sink.0.cancelled.is_cancelled() {
                thread::sleep(Duration::from_millis(1));
            }
            done.send(()).unwrap();
            SourceError::Finished
        })
        .unwrap();
        while feed.shared.lock().broken == 0 {
            thread::sleep(Duration::from_millis(1));
        }
        let message = failed(feed.next(Instant::now(), Duration::from_millis(100)));
        assert_eq!(message, "stalled: no picture for 0.1 s, 7 broken; what arrives is text");
        drop(feed);
        finished.recv_timeout(PATIENCE).unwrap();
    }

    #[test]
    fn a_panic_and_the_servers_end_are_told() {
        let stop = Stop::default();
        let feed = Feed::<u32>::start("feed", stop.clone(), |_| panic!("the socket bit me"));
        assert!(failed(next(&feed.unwrap())).contains("internal error"));
        let feed = Feed::<u32>::start("feed", stop.clone(), |sink| {
            while !sink.0.cancelled.is_cancelled() {
                thread::sleep(Duration::from_millis(1));
            }
            SourceError::Finished
        });
        stop.stop();
        assert_eq!(next(&feed.unwrap()), Err(SourceError::Stopped));
    }
}

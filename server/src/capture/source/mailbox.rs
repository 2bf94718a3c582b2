//! A receiving thread with a mailbox for the newest item, for sources that block or push.
//!
//! Memory is bounded: one item waits and another is in use. A new item replaces one that was not taken, and the
//! replaced item is counted. No item within the timeout of the consumer is a stall, which is an error like any other:
//! the worker's supervisor opens the source again.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use tokio_util::sync::CancellationToken;

use super::SourceError;
use crate::model::stop::StopSignal;

/// How often a wait checks the stop signal.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// How long a drop waits for the thread to end.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(1);

/// The waiting item, and counts since the last one was taken.
struct MailboxState<T> {
    newest: Option<T>,
    replaced: u64,
    broken: u64,
    /// Explanation for the message of a stall.
    hint: &'static str,
    end: Option<SourceError>,
}

/// The receiving thread's side.
pub(super) struct MailboxSender<T> {
    state: Mutex<MailboxState<T>>,
    changed: Condvar,
    cancelled: CancellationToken,
}

impl<T> MailboxSender<T> {
    fn lock(&self) -> MutexGuard<'_, MailboxState<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn send(&self, item: T) {
        let mut state = self.lock();
        let replaced = state.newest.replace(item);
        state.replaced += u64::from(replaced.is_some());
        drop(state);
        self.changed.notify_one();
    }

    pub(super) fn count_broken(&self, count: u64) {
        self.lock().broken += count;
    }

    /// Sets the explanation for a later stall.
    pub(super) fn hint(&self, hint: &'static str) {
        self.lock().hint = hint;
    }

    /// Resolves when the consumer is dropped.
    pub(super) async fn cancelled(&self) {
        self.cancelled.cancelled().await;
    }
}

/// The newest item, with counts since the one before.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Received<T> {
    pub(super) item: T,
    pub(super) replaced: u64,
    pub(super) broken: u64,
}

pub(super) struct Mailbox<T> {
    shared: Arc<MailboxSender<T>>,
    thread: Option<JoinHandle<()>>,
    stop: StopSignal,
}

impl<T: Send + 'static> Mailbox<T> {
    /// Starts the thread; `receive` returns the reason of the end.
    pub(super) fn start(
        name: &str,
        stop: StopSignal,
        receive: impl FnOnce(&MailboxSender<T>) -> SourceError + Send + 'static,
    ) -> Result<Self, SourceError> {
        let (newest, end) = (None, None);
        let shared = Arc::new(MailboxSender {
            state: Mutex::new(MailboxState { newest, replaced: 0, broken: 0, hint: "", end }),
            changed: Condvar::new(),
            cancelled: CancellationToken::new(),
        });
        let sender = shared.clone();
        let run = move || {
            let end = catch_unwind(AssertUnwindSafe(|| receive(&sender))).unwrap_or_else(|_| {
                let message = "internal error, please report it: the receiving thread ended";
                SourceError::Failed(message.to_owned())
            });
            sender.lock().end = Some(end);
            sender.changed.notify_one();
        };
        let thread = thread::Builder::new().name(name.to_owned()).spawn(run).map_err(|error| {
            SourceError::Failed(format!("cannot start the thread `{name}`: {error}"))
        })?;
        Ok(Self { shared, thread: Some(thread), stop })
    }

    /// Waits for an item; a stall once `patience` has passed since `since`.
    pub(super) fn next(
        &self,
        since: Instant,
        patience: Duration,
    ) -> Result<Received<T>, SourceError> {
        let mut state = self.shared.lock();
        loop {
            if self.stop.is_stopped() {
                return Err(SourceError::Stopped);
            }
            if let Some(item) = state.newest.take() {
                let replaced = std::mem::take(&mut state.replaced);
                let broken = std::mem::take(&mut state.broken);
                return Ok(Received { item, replaced, broken });
            }
            if let Some(end) = &state.end {
                return Err(end.clone());
            }
            let rest = patience.saturating_sub(since.elapsed());
            if rest.is_zero() {
                return Err(SourceError::Failed(stalled(patience, state.hint, state.broken)));
            }
            let wait = self.shared.changed.wait_timeout(state, rest.min(POLL_INTERVAL));
            state = wait.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Message of a stall.
pub(super) fn stalled(patience: Duration, hint: &str, broken: u64) -> String {
    let mut message = format!("stalled: no picture for {:.1} s", patience.as_secs_f64());
    if broken > 0 {
        message.push_str(&format!(", {broken} broken"));
    }
    if !hint.is_empty() {
        message.push_str(&format!("; {hint}"));
    }
    message
}

impl<T> Drop for Mailbox<T> {
    fn drop(&mut self) {
        self.shared.cancelled.cancel();
        let Some(thread) = self.thread.take() else { return };
        let deadline = Instant::now() + SHUTDOWN_GRACE;
        while !thread.is_finished() && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(1));
        }
        if thread.is_finished() {
            let _ = thread.join();
        } else {
            let name = thread.thread().name().unwrap_or_default();
            tracing::warn!(thread = name, "does not end and is detached");
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    const PATIENCE: Duration = Duration::from_secs(60);

    fn next(mailbox: &Mailbox<u32>) -> Result<Received<u32>, SourceError> {
        mailbox.next(Instant::now(), PATIENCE)
    }

    fn failed<T: std::fmt::Debug>(result: Result<T, SourceError>) -> String {
        match result {
            Err(SourceError::Failed(message)) => message,
            other => panic!("{other:?}"),
        }
    }

    fn wait_for_drop(sink: &MailboxSender<u32>) {
        while !sink.cancelled.is_cancelled() {
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn the_newest_item_wins_and_replaced_ones_are_counted() {
        let (go, gone) = channel::<()>();
        let (done, finished) = channel();
        let mailbox = Mailbox::start("feed", StopSignal::default(), move |sink| {
            (1..=3).for_each(|item| sink.send(item));
            sink.count_broken(2);
            done.send(()).unwrap();
            gone.recv().unwrap();
            sink.send(4);
            SourceError::Finished
        })
        .unwrap();
        finished.recv().unwrap();
        assert_eq!(next(&mailbox).unwrap(), Received { item: 3, replaced: 2, broken: 2 });
        go.send(()).unwrap();
        // An item that was received before the end comes first.
        assert_eq!(next(&mailbox).unwrap(), Received { item: 4, replaced: 0, broken: 0 });
        assert_eq!(next(&mailbox), Err(SourceError::Finished));
    }

    #[test]
    fn a_stall_is_explained_and_the_thread_ends_with_the_mailbox() {
        let (done, finished) = channel();
        let mailbox = Mailbox::<u32>::start("feed", StopSignal::default(), move |sink| {
            sink.hint("what arrives is text");
            sink.count_broken(7);
            wait_for_drop(sink);
            done.send(()).unwrap();
            SourceError::Finished
        })
        .unwrap();
        while mailbox.shared.lock().broken == 0 {
            thread::sleep(Duration::from_millis(1));
        }
        let message = failed(mailbox.next(Instant::now(), Duration::from_millis(100)));
        assert_eq!(message, "stalled: no picture for 0.1 s, 7 broken; what arrives is text");
        drop(mailbox);
        finished.recv_timeout(PATIENCE).unwrap();
    }

    #[test]
    fn a_panic_and_the_stop_signal_are_reported() {
        let stop = StopSignal::default();
        let mailbox = Mailbox::<u32>::start("feed", stop.clone(), |_| panic!("the socket bit me"));
        assert!(failed(next(&mailbox.unwrap())).contains("internal error"));
        let mailbox = Mailbox::<u32>::start("feed", stop.clone(), |sink| {
            wait_for_drop(sink);
            SourceError::Finished
        });
        stop.stop();
        assert_eq!(next(&mailbox.unwrap()), Err(SourceError::Stopped));
    }
}

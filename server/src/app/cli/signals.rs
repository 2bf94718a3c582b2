//! Signals that end the process: SIGINT, SIGTERM and SIGHUP.
//!
//! A server listens to them on a thread of its own. Requests that hang can block the runtime, and must not keep the process:
//! when the time of a shutdown is over, or at a second signal, it ends at once.

use std::{
    future::{pending, poll_fn},
    process::exit,
    task::Poll,
    time::Duration,
};

use anyhow::Context;
use tokio::{
    runtime,
    signal::unix::{Signal, SignalKind, signal},
    time::sleep,
};
use tokio_util::sync::CancellationToken;

use super::log;
use crate::app::serve::SHUTDOWN_TIMEOUT;

/// Exit code of a process that a second signal ended.
const ENDED_BY_SIGNAL: i32 = 130;
/// Exit code of a process that did not shut down in time.
const TIMED_OUT: i32 = 1;
/// Signals within this time count as one, because a terminal or supervisor may signal both the process and its group.
const ONE_SIGNAL: Duration = Duration::from_millis(300);

/// Waits for a signal or the end of a duration. Signals no longer end the process from this call on; the duration begins
/// with the first poll.
pub(super) fn signal_or_after(
    duration: Option<Duration>,
) -> anyhow::Result<impl Future<Output = ()>> {
    let mut signals = Signals::listen()?;
    Ok(async move {
        tokio::select! {
            () = signals.next() => {}
            () = after(duration) => {}
        }
    })
}

/// The end of a server: a signal, or its duration. From then on, the process has [`SHUTDOWN_TIMEOUT`] to shut down.
pub(super) struct ServerEnd {
    begun: CancellationToken,
    duration: Option<Duration>,
}

impl ServerEnd {
    pub(super) fn listen(duration: Option<Duration>) -> anyhow::Result<Self> {
        let begun = CancellationToken::new();
        let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
        let mut signals = {
            let _entered = runtime.enter();
            Signals::listen()?
        };
        let token = begun.clone();
        let watch = async move {
            tokio::select! {
                () = signals.next() => {}
                () = token.cancelled() => {}
            }
            token.cancel();
            let second = async {
                sleep(ONE_SIGNAL).await;
                signals.discard();
                signals.next().await;
            };
            tokio::select! {
                () = second => {
                    tracing::warn!("ending at once on a second signal");
                    log::finish();
                    exit(ENDED_BY_SIGNAL);
                }
                () = sleep(SHUTDOWN_TIMEOUT) => {
                    tracing::error!("not shut down within {SHUTDOWN_TIMEOUT:?}: ending at once");
                    log::finish();
                    exit(TIMED_OUT);
                }
            }
        };
        let builder = std::thread::Builder::new().name("signals".to_owned());
        let thread = builder.spawn(move || runtime.block_on(watch));
        thread.context("cannot start the thread of the signals")?;
        Ok(Self { begun, duration })
    }

    /// Waits for the end.
    pub(super) async fn wait(&self) {
        tokio::select! {
            () = self.begun.cancelled() => {}
            () = after(self.duration) => self.begin(),
        }
    }

    /// Ends the server now.
    pub(super) fn begin(&self) {
        self.begun.cancel();
    }
}

async fn after(duration: Option<Duration>) {
    match duration {
        Some(duration) => sleep(duration).await,
        None => pending().await,
    }
}

struct Signals(Vec<Signal>);

impl Signals {
    fn listen() -> anyhow::Result<Self> {
        let mut kinds = vec![SignalKind::interrupt(), SignalKind::terminate()];
        // `nohup` and some supervisors start programs that must survive their terminal.
        if !is_ignored(SignalKind::hangup()) {
            kinds.push(SignalKind::hangup());
        }
        let signals = kinds.into_iter().map(signal).collect::<Result<_, _>>();
        Ok(Self(signals.context("cannot listen for signals")?))
    }

    async fn next(&mut self) {
        poll_fn(|context| {
            let is_ready = self.0.iter_mut().any(|it| it.poll_recv(context).is_ready());
            if is_ready { Poll::Ready(()) } else { Poll::Pending }
        })
        .await;
    }

    /// Forgets signals that have arrived.
    fn discard(&mut self) {
        let mut context = std::task::Context::from_waker(std::task::Waker::noop());
        for signal in &mut self.0 {
            let _ = signal.poll_recv(&mut context);
        }
    }
}

/// Whether the process was started with this signal ignored, as far as the system shows it.
fn is_ignored(kind: SignalKind) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (kind.as_raw_value() - 1) & 1 == 1
}

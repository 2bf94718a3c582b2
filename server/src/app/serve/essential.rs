//! Threads and tasks without which a server is of no use: fusion and the APIs.
//!
//! If one of them ends before the shutdown, by a panic or otherwise, the process must end too, with an exit code that makes
//! its supervisor restart it. Everything else (cameras, recording, history, calibration) fails alone.

use tokio_util::sync::CancellationToken;

/// Lives as long as an essential thread or task.
pub(super) struct Essential {
    name: &'static str,
    /// Whether the server is shutting down.
    may_end: Box<dyn Fn() -> bool + Send>,
    failed: CancellationToken,
}

impl Essential {
    /// Cancels `failed` when this is dropped while `may_end` is false.
    pub(super) fn new(
        name: &'static str,
        failed: &CancellationToken,
        may_end: impl Fn() -> bool + Send + 'static,
    ) -> Self {
        Self { name, may_end: Box::new(may_end), failed: failed.clone() }
    }
}

impl Drop for Essential {
    fn drop(&mut self) {
        if !(self.may_end)() {
            tracing::error!(
                "internal error, please report it with the log: {} has ended",
                self.name
            );
            self.failed.cancel();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(may_end: bool, work: impl FnOnce() + Send + 'static) -> bool {
        let failed = CancellationToken::new();
        let essential = Essential::new("fusion", &failed, move || may_end);
        let thread = std::thread::spawn(move || {
            let _essential = essential;
            work();
        });
        let _ = thread.join();
        failed.is_cancelled()
    }

    #[test]
    fn an_early_end_is_a_failure() {
        assert!(run(false, || panic!("for this test")));
        assert!(run(false, || {}));
        assert!(!run(true, || {}));
    }
}

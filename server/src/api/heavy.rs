//! Requests that take much memory or processor time: prints, plans, tables of codes, the history and pictures.
//!
//! Their work runs on blocking threads, and all of it shares a number of threads and of bytes. A request waits for its
//! share for at most [`ADMISSION_TIMEOUT`], and is then rejected as [`ApiError::ResourceExhausted`]. Work that takes longer
//! than [`TIME_LIMIT`] is stopped, and so is the work of a client that has gone: then the future of the handler is dropped,
//! which sets the signal that the work polls. The threads are released when the work has ended, the bytes when the response
//! has been sent.

use std::{fmt, ops::Deref, sync::Arc, time::Duration};

use axum::body::Bytes;
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore},
    time::timeout,
};

use super::error::ApiError;
use crate::model::stop::StopSignal;

/// Longest wait for threads and bytes.
const ADMISSION_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest work of one request.
const TIME_LIMIT: Duration = Duration::from_secs(30);
/// Unit of the byte budget.
const BLOCK_BYTES: usize = 64 * 1024;

/// Threads and memory of one class of requests.
pub struct HeavyWork {
    threads: Arc<Semaphore>,
    blocks: Arc<Semaphore>,
    total_blocks: usize,
    admission_timeout: Duration,
}

impl HeavyWork {
    pub fn new(threads: usize, bytes: usize) -> Self {
        let total_blocks = bytes.div_ceil(BLOCK_BYTES).max(1);
        Self {
            threads: Arc::new(Semaphore::new(threads.max(1))),
            blocks: Arc::new(Semaphore::new(total_blocks)),
            total_blocks,
            admission_timeout: ADMISSION_TIMEOUT,
        }
    }

    /// Runs work that takes about `bytes` of memory, its result included. Work beyond the whole budget runs alone.
    pub(super) async fn run<T: Send + 'static, E: Into<ApiError> + Send + 'static>(
        &self,
        bytes: usize,
        work: impl FnOnce(&StopSignal) -> Result<T, E> + Send + 'static,
    ) -> Result<Charged<T>, ApiError> {
        let blocks = bytes.div_ceil(BLOCK_BYTES).clamp(1, self.total_blocks);
        let admission = async {
            let memory = self.blocks.clone().acquire_many_owned(blocks as u32).await;
            Ok::<_, tokio::sync::AcquireError>((
                memory?,
                self.threads.clone().acquire_owned().await?,
            ))
        };
        let Ok(Ok((memory, thread))) = timeout(self.admission_timeout, admission).await else {
            return Err(busy());
        };
        let stop = StopSignal::default();
        let _stops_when_dropped = StopOnDrop(stop.clone());
        let task = tokio::task::spawn_blocking(move || {
            let _thread = thread;
            if stop.is_stopped() {
                return Err(stopped());
            }
            let value = work(&stop).map_err(E::into)?;
            Ok(Charged { value, memory })
        });
        match timeout(TIME_LIMIT, task).await {
            Ok(Ok(done)) => done,
            Ok(Err(error)) => {
                Err(ApiError::Internal(format!("the request's work was aborted: {error}")))
            }
            Err(_) => Err(ApiError::ResourceExhausted(format!(
                "the request took longer than {TIME_LIMIT:?}: request less at a time"
            ))),
        }
    }
}

/// The error of a request that finds no free threads or bytes.
fn busy() -> ApiError {
    ApiError::ResourceExhausted(
        "the server is busy with other prints, plans, pictures or queries of the history: try again in a moment"
            .to_owned(),
    )
}

/// The error of work that finds its signal set. Its client has gone, or has been answered.
pub(super) fn stopped() -> ApiError {
    ApiError::Unavailable("the request was cancelled".to_owned())
}

/// About half of the processors, so that cameras and fusion keep the others.
pub(super) fn half_of_the_processors() -> usize {
    std::thread::available_parallelism().map_or(1, |count| count.get() / 2).max(1)
}

struct StopOnDrop(StopSignal);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// A result whose memory counts until it is dropped.
pub(super) struct Charged<T> {
    value: T,
    memory: OwnedSemaphorePermit,
}

impl<T> Charged<T> {
    /// The value, which is not counted any more.
    pub(super) fn into_inner(self) -> T {
        self.value
    }

    /// Reduces the counted memory to this.
    pub(super) fn shrink_to(&mut self, bytes: usize) {
        let excess = self.memory.num_permits().saturating_sub(bytes.div_ceil(BLOCK_BYTES).max(1));
        // Dropping the part releases it.
        drop(self.memory.split(excess));
    }
}

impl Charged<Vec<u8>> {
    /// Bytes that count until their last clone is dropped.
    pub(super) fn into_bytes(mut self) -> Bytes {
        self.shrink_to(self.value.len());
        Bytes::from_owner(self)
    }
}

impl<T> Deref for Charged<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl AsRef<[u8]> for Charged<Vec<u8>> {
    fn as_ref(&self) -> &[u8] {
        &self.value
    }
}

impl<T> fmt::Debug for Charged<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Charged")
            .field("blocks", &self.memory.num_permits())
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    const MB: usize = 1024 * 1024;

    fn impatient(threads: usize, bytes: usize) -> HeavyWork {
        let admission_timeout = Duration::from_millis(20);
        HeavyWork { admission_timeout, ..HeavyWork::new(threads, bytes) }
    }

    fn file(bytes: usize) -> impl FnOnce(&StopSignal) -> Result<Vec<u8>, ApiError> {
        move |_| Ok(vec![7; bytes])
    }

    #[tokio::test]
    async fn memory_counts_until_the_response_is_sent() {
        let heavy = impatient(4, 4 * MB);
        let first = heavy.run(3 * MB, file(2 * MB)).await.unwrap();
        let error = heavy.run(2 * MB, file(1)).await.unwrap_err();
        assert!(matches!(&error, ApiError::ResourceExhausted(why) if why.contains("try again")));
        // Only what the file takes is still counted.
        let sent = first.into_bytes();
        let other = heavy.run(2 * MB, file(1)).await.unwrap();
        let rest = sent.slice(MB..);
        drop((sent, other));
        assert!(heavy.run(3 * MB, file(1)).await.is_err());
        drop(rest);
        // More than the whole budget is admitted alone.
        assert_eq!(heavy.run(100 * MB, file(5)).await.unwrap().into_inner().len(), 5);
    }

    #[tokio::test]
    async fn work_stops_when_its_client_has_gone_and_holds_its_thread_until_then() {
        let heavy = HeavyWork::new(1, 4 * MB);
        let (begun, has_begun) = mpsc::channel();
        let request = heavy.run(1, move |stop: &StopSignal| {
            begun.send(()).unwrap();
            assert!(stop.wait(Duration::from_secs(60)), "not stopped");
            Ok::<_, ApiError>(())
        });
        let mut request = Box::pin(request);
        while has_begun.try_recv().is_err() {
            assert!(timeout(Duration::from_millis(5), &mut request).await.is_err());
        }
        drop(request);
        heavy.run(1, |_| Ok::<_, ApiError>(())).await.expect("the thread is free again");
    }
}

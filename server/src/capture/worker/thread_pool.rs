//! Threads that share the precise fits of one frame.
//!
//! In precise mode each ring of a frame is fitted independently ([`roundel_core::pose::Locator`]), and the threads of
//! the worker's pool share the fits; the result is the same to the last bit. If all cores are busy, the worker does most
//! of them; helpers sleep while there is no work. In fast mode locating a frame's rings takes less than waking a helper.

use std::thread::available_parallelism;

/// Limit of threads of one worker, including its own; more would wait longer than they work.
const MAX_THREADS: usize = 4;

/// Runs a worker in its own pool, with one thread for each core up to [`MAX_THREADS`].
pub(super) fn in_thread_pool<R: Send>(camera: &str, work: impl FnOnce() -> R + Send) -> R {
    let threads = available_parallelism().map_or(1, usize::from).min(MAX_THREADS);
    if threads < 2 {
        return work();
    }
    let name = camera.to_owned();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(move |_| format!("camera {name}"))
        .build();
    match pool {
        Ok(pool) => pool.install(work),
        Err(error) => {
            tracing::warn!(camera, %error, "cannot start a thread pool for this camera's worker; it uses one thread");
            work()
        }
    }
}

//! Threads that help a camera's worker with the rings of a frame.
//!
//! In precise mode each ring of a frame is fitted by itself, and the fits are shared among the threads of the worker's own
//! pool ([`roundel_core::pose::Locator`]): sooner by what idle cores take of them, and the same to the last bit. Where
//! all cores are busy, the worker fits most of them; helpers sleep while there is nothing to do. In fast mode a frame's
//! rings take less than it takes to wake a helper for a part of them.

use std::thread::available_parallelism;

/// Threads of one worker at most, its own among them: more would wait for one another for longer than they work.
const MAX_THREADS: usize = 4;

/// Runs a worker on a thread of a pool of its own, as large as the machine has cores.
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
            tracing::warn!(camera, %error, "no threads to help this camera's worker; it works alone");
            work()
        }
    }
}

//! Distributes the rings of one frame over the threads of the caller's pool.
//!
//! A caller on a thread of a [`rayon`] pool (`ThreadPool::install`) shares its work with idle threads of that pool;
//! on any other thread everything runs on the caller. The results are the same. Each thread keeps its own memory, so
//! nothing is allocated per frame.

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

/// Memory per thread. A chunk overwrites whatever an earlier panic left behind.
#[derive(Debug)]
pub(crate) struct PerThread<S> {
    each: Vec<Mutex<S>>,
}

impl<S> Default for PerThread<S> {
    fn default() -> Self {
        Self { each: Vec::new() }
    }
}

/// A clone starts with empty memory.
impl<S> Clone for PerThread<S> {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl<S: Default + Send> PerThread<S> {
    /// Memory of the first thread.
    pub fn first(&mut self) -> &mut S {
        if self.each.is_empty() {
            self.each.push(Mutex::default());
        }
        self.each[0].get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// Calls `work` on chunks of at most `at_a_time` items, with the memory of the thread that runs
    /// it and the index of the chunk's first item.
    pub fn for_each_chunk<T: Send>(
        &mut self,
        items: &mut [T],
        at_a_time: usize,
        work: impl Fn(&mut S, usize, &mut [T]) + Sync,
    ) {
        let at_a_time = at_a_time.max(1);
        let is_alone = items.len() <= at_a_time || rayon::current_thread_index().is_none();
        let threads = if is_alone { 1 } else { rayon::current_num_threads() };
        if self.each.len() < threads {
            self.each.resize_with(threads, Mutex::default);
        }
        if threads == 1 {
            let memory = self.first();
            for (number, items) in items.chunks_mut(at_a_time).enumerate() {
                work(memory, number * at_a_time, items);
            }
            return;
        }
        let each = &self.each;
        let pieces = items.par_chunks_mut(at_a_time).with_max_len(1).enumerate();
        pieces.for_each(|(number, items)| {
            // Uncontended: nothing else runs on this thread until the closure returns.
            let thread = rayon::current_thread_index().unwrap_or_default();
            let mut memory = each[thread].lock().unwrap_or_else(PoisonError::into_inner);
            work(&mut memory, number * at_a_time, items);
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Each item becomes its index; the memory counts the items.
    fn places(shares: &mut PerThread<usize>, count: usize, at_a_time: usize) -> Vec<usize> {
        let mut items = vec![usize::MAX; count];
        let max = AtomicUsize::new(0);
        let used = |shares: &mut PerThread<usize>| -> usize {
            shares.each.iter_mut().map(|used| *used.get_mut().unwrap()).sum()
        };
        let before = used(shares);
        shares.for_each_chunk(&mut items, at_a_time, |used, first, items| {
            *used += items.len();
            max.fetch_max(items.len(), Ordering::Relaxed);
            items.iter_mut().enumerate().for_each(|(place, item)| *item = first + place);
        });
        assert!(max.into_inner() <= at_a_time);
        assert_eq!(used(shares) - before, count);
        items
    }

    #[test]
    fn each_item_is_processed_once_in_a_pool_and_outside() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let mut shares = PerThread::default();
        for (count, at_a_time) in [(0, 1), (1, 1), (7, 2), (40, 3), (16, 8), (8, 8)] {
            let expected: Vec<usize> = (0..count).collect();
            assert_eq!(places(&mut shares, count, at_a_time), expected);
            assert_eq!(pool.install(|| places(&mut shares, count, at_a_time)), expected);
        }
        assert_eq!(shares.each.len(), 3);
    }

    #[test]
    fn two_threads_of_a_pool_run_concurrently() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let (barrier, mut items) = (std::sync::Barrier::new(2), [0; 2]);
        // Each chunk waits for the other: run one after the other, they would never pass.
        pool.install(|| {
            let mut shares = PerThread::<()>::default();
            shares.for_each_chunk(&mut items, 1, |(), first, items| {
                barrier.wait();
                items[0] = first + 1;
            });
        });
        assert_eq!(items, [1, 2]);
    }
}

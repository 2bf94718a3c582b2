//! Servers under seeded faults. `cargo run -p roundel-tests -- chaos` runs more seeds.
//!
//! A program of its own, since cargo runs test programs one after another: these tests run in real time, and other
//! tests would disturb them.

use roundel_tests::chaos::{self, timetable::Stage};

async fn keeps_promises(seeds: std::ops::Range<u64>, stage: Stage, at_once: usize) {
    let mut broken = Vec::new();
    chaos::run_all(seeds, stage, at_once, |outcome| {
        if !outcome.is_kept() {
            broken.push(outcome.to_string());
        }
    })
    .await;
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fifty_seeds_keep_their_promises() {
    keeps_promises(1..51, Stage::Library, 6).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn real_processes_keep_their_promises() {
    keeps_promises(1..5, Stage::Process, 2).await;
}

//! Hours of operation in seconds; `cargo run --release -p roundel-tests -- soak` runs 30 days.
//!
//! A program of its own, since it measures the memory and the open files of its process.

use roundel_tests::soak;

#[test]
fn nothing_grows_and_clocks_stay_synchronized_for_hours() {
    let samples = soak::run(0.1, |_| {}).unwrap();
    let mut problems = soak::growths(&samples);
    problems.extend(soak::clock_problems(&samples));
    assert!(problems.is_empty(), "{problems:#?}\n{samples:#?}");
}

//! Hours of operation in seconds; `cargo run --release -p roundel-tests --bin soak` runs 30.

use roundel_tests::soak;

#[test]
fn nothing_grows_within_hours() {
    let samples = soak::run(0.1, |_| {}).unwrap();
    let growths = soak::growths(&samples);
    assert!(growths.is_empty(), "{growths:#?}\n{samples:#?}");
}

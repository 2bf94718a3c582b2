//! Delays between attempts to connect.

use std::time::Duration;

use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};

/// Delays that double from 100 ms to 5 s, each shortened at random by up to a half, so that the clients of a restarted
/// server do not reconnect at the same time.
pub(crate) fn delays() -> ExponentialBackoff {
    // The jitter adds up to as much again.
    ExponentialBuilder::new()
        .with_min_delay(Duration::from_millis(50))
        .with_max_delay(Duration::from_millis(2500))
        .without_max_times()
        .with_jitter()
        .build()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_grow_to_the_cap() {
        let ms = Duration::from_millis;
        let delays: Vec<Duration> = delays().take(100).collect();
        assert!((ms(50)..=ms(100)).contains(&delays[0]), "{delays:?}");
        assert!((ms(2500)..=ms(5000)).contains(&delays[99]), "{delays:?}");
    }
}

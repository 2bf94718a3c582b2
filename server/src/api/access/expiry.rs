//! Ends streams when the credentials that opened them expire.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use axum::http::Extensions;
use tokio::time::{Instant, sleep_until};

/// Why a stream ends.
pub const EXPIRED: &str = "the credentials that opened this stream have expired";

/// When the credentials of a request expire, if ever. An extension of the request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Expiry(Option<Instant>);

impl Expiry {
    pub fn of(extensions: &Extensions) -> Self {
        extensions.get().copied().unwrap_or_default()
    }

    pub(super) fn at(instant: Instant) -> Self {
        Self(Some(instant))
    }

    /// From seconds of Unix time. A date that no clock reaches is none.
    pub(super) fn at_unix(expires_s: i64) -> Self {
        let expires = u64::try_from(expires_s).unwrap_or(0);
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let left = Duration::from_secs(expires).saturating_sub(since_epoch);
        Self(Instant::now().checked_add(left))
    }

    pub(super) fn earlier(self, other: Self) -> Self {
        Self(self.0.into_iter().chain(other.0).min())
    }

    pub fn instant(self) -> Option<Instant> {
        self.0
    }

    /// Completes when the credentials expire.
    pub async fn reached(self) {
        match self.0 {
            Some(instant) => sleep_until(instant).await,
            None => std::future::pending().await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_earlier_of_two_ends_a_stream() {
        let [soon, late] = [2_000_000_000, 3_000_000_000].map(Expiry::at_unix);
        assert!(soon.instant() < late.instant());
        assert_eq!(late.earlier(soon), soon);
        assert_eq!(Expiry::default().earlier(late), late);
        assert!(Expiry::at_unix(-5).instant().is_some_and(|at| at <= Instant::now()));
        assert_eq!(Expiry::at_unix(i64::MAX).earlier(soon), soon);
    }
}

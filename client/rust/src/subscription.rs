//! Which snapshots, and what of them.

use std::time::Duration;

use crate::v1;

/// Which snapshots a client wants; all of everything by default.
///
/// ```
/// use roundel_client::Subscription;
///
/// let wanted = Subscription::default()
///     .names(["drone", "cart"])
///     .codes([12])
///     .max_rate_hz(30.0)
///     .horizon(std::time::Duration::from_millis(20))
///     .without_covariance();
/// # let _ = wanted;
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Subscription {
    request: v1::SubscribeSnapshotsRequest,
}

impl Subscription {
    /// Only these objects, by `object_id`, and those of [`names`](Self::names) and [`codes`](Self::codes). A server that
    /// is started anew gives ids anew: after that they are other objects'.
    pub fn ids(mut self, ids: impl IntoIterator<Item = u64>) -> Self {
        self.request.object_ids.extend(ids);
        self
    }

    /// Likewise those of these configured names, as soon and as long as they have them.
    pub fn names<S: Into<String>>(mut self, names: impl IntoIterator<Item = S>) -> Self {
        self.request.names.extend(names.into_iter().map(Into::into));
        self
    }

    /// Likewise those that were seen with these codes, by their numbers in whatever layout.
    pub fn codes(self, numbers: impl IntoIterator<Item = u32>) -> Self {
        self.codes_of(0, numbers)
    }

    /// The same in an installation with several layouts: codes of so many bits.
    pub fn codes_of(mut self, bits: u32, numbers: impl IntoIterator<Item = u32>) -> Self {
        let code = |number| v1::Code { bits, number };
        self.request.codes.extend(numbers.into_iter().map(code));
        self
    }

    /// Only objects of these kinds of roundel, by configured name.
    pub fn roundels<S: Into<String>>(mut self, names: impl IntoIterator<Item = S>) -> Self {
        self.request.roundels = names.into_iter().map(Into::into).collect();
        self
    }

    /// Only objects within the box between two corners of the world frame, metres. A side may be
    /// infinite.
    pub fn region(mut self, min_m: [f64; 3], max_m: [f64; 3]) -> Self {
        let corner = |[x, y, z]: [f64; 3]| Some(v1::Vector3 { x, y, z });
        self.request.region = Some(v1::Box { min: corner(min_m), max: corner(max_m) });
        self
    }

    /// At most this many snapshots a second.
    pub fn max_rate_hz(mut self, rate_hz: f64) -> Self {
        self.request.max_rate_hz = Some(rate_hz);
        self
    }

    /// Every pose predicted this far past the server's pose time, up to a second.
    pub fn horizon(mut self, horizon: Duration) -> Self {
        self.request.horizon_ms = Some(horizon.as_secs_f64() * 1e3);
        self
    }

    /// Without covariances: less than half the bytes.
    pub fn without_covariance(mut self) -> Self {
        self.request.omit_covariance = true;
        self
    }

    /// The message that asks for it once.
    pub(crate) fn into_single_request(self) -> v1::GetSnapshotRequest {
        let v1::SubscribeSnapshotsRequest { object_ids, names, codes, roundels, .. } = self.request;
        let v1::SubscribeSnapshotsRequest { region, horizon_ms, omit_covariance, .. } =
            self.request;
        v1::GetSnapshotRequest {
            object_ids,
            region,
            horizon_ms,
            omit_covariance,
            roundels,
            names,
            codes,
        }
    }

    /// The message that asks for it.
    pub fn into_request(self) -> v1::SubscribeSnapshotsRequest {
        self.request
    }
}

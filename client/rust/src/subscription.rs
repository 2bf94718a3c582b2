//! Filters for subscriptions to snapshots.

use std::time::Duration;

use crate::v1;

/// Selects the snapshots and objects that a client receives. The default selects everything.
///
/// ```
/// use roundel_client::Subscription;
///
/// let subscription = Subscription::default()
///     .names(["drone", "cart"])
///     .codes([12])
///     .max_rate_hz(30.0)
///     .horizon(std::time::Duration::from_millis(20))
///     .without_covariance();
/// # let _ = subscription;
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Subscription {
    request: v1::SubscribeSnapshotsRequest,
}

impl Subscription {
    /// Only these objects, by `object_id`, plus those of [`names`](Self::names) and [`codes`](Self::codes). A restarted
    /// server assigns new ids, so the same id may be another object.
    pub fn ids(mut self, ids: impl IntoIterator<Item = u64>) -> Self {
        self.request.object_ids.extend(ids);
        self
    }

    /// Objects with these configured names, plus those of [`ids`](Self::ids) and [`codes`](Self::codes).
    pub fn names<S: Into<String>>(mut self, names: impl IntoIterator<Item = S>) -> Self {
        self.request.names.extend(names.into_iter().map(Into::into));
        self
    }

    /// Objects with codes of these numbers in any layout, plus those of [`ids`](Self::ids) and [`names`](Self::names).
    pub fn codes(self, numbers: impl IntoIterator<Item = u32>) -> Self {
        self.codes_of(0, numbers)
    }

    /// Like [`codes`](Self::codes), for the layout with this number of bits.
    pub fn codes_of(mut self, bits: u32, numbers: impl IntoIterator<Item = u32>) -> Self {
        let code = |number| v1::Code { bits, number };
        self.request.codes.extend(numbers.into_iter().map(code));
        self
    }

    /// Only objects with these kinds of roundel, by configured name.
    pub fn roundels<S: Into<String>>(mut self, names: impl IntoIterator<Item = S>) -> Self {
        self.request.roundels = names.into_iter().map(Into::into).collect();
        self
    }

    /// Only objects in the box between two corners in the world frame, metres, which may be infinite.
    pub fn region(mut self, min_m: [f64; 3], max_m: [f64; 3]) -> Self {
        let corner = |[x, y, z]: [f64; 3]| Some(v1::Vector3 { x, y, z });
        self.request.region = Some(v1::Box { min: corner(min_m), max: corner(max_m) });
        self
    }

    /// Maximum rate of snapshots.
    pub fn max_rate_hz(mut self, rate_hz: f64) -> Self {
        self.request.max_rate_hz = Some(rate_hz);
        self
    }

    /// Predicts every pose this far past the server's pose time, up to a second.
    pub fn horizon(mut self, horizon: Duration) -> Self {
        self.request.horizon_ms = Some(horizon.as_secs_f64() * 1e3);
        self
    }

    /// Omits covariances and accelerations, which halves the message size.
    pub fn without_covariance(mut self) -> Self {
        self.request.omit_covariance = true;
        self
    }

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

    /// The request of this subscription.
    pub fn into_request(self) -> v1::SubscribeSnapshotsRequest {
        self.request
    }
}

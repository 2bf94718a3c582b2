//! Selections of snapshots: validated once, then applied to each snapshot.
//!
//! A request becomes a [`Selection`]: a [`Filter`], which determines the content of a message, and a rate limit
//! ([`crate::api::snapshot_subscription`]). Filters compare and hash by value, so that subscribers with equal filters
//! share encoded snapshots.

mod object_selector;

use std::{
    borrow::Cow,
    hash::{DefaultHasher, Hash, Hasher},
    sync::Arc,
};

use roundel_core::{id::KindId, world};
use roundel_proto::v1;

use crate::{
    api::{convert, error::ApiError, region::Region},
    model::hub::{FusedSnapshot, Installation},
};
pub use object_selector::MAX_SELECTORS;
use object_selector::ObjectSelector;

/// Longest prediction past the server's pose time, milliseconds.
pub const MAX_HORIZON_MS: f64 = 1000.0;

/// Names in errors of the fields whose names differ between messages and queries.
#[derive(Debug)]
pub struct FieldNames {
    ids: &'static str,
    /// Smallest and largest corner of the region.
    corners: [&'static str; 2],
}

pub const MESSAGE_FIELDS: FieldNames =
    FieldNames { ids: "object_ids", corners: ["region.min", "region.max"] };
/// In queries of REST and the WebSocket.
pub const QUERY_FIELDS: FieldNames = FieldNames { ids: "ids", corners: ["min", "max"] };

/// Determines the content of a snapshot's message. Cloning, hashing and comparing with a clone take constant time.
#[derive(Clone, Debug)]
pub struct Filter {
    spec: Arc<FilterSpec>,
    digest: u64,
}

#[derive(Clone, Debug, Default)]
struct FilterSpec {
    objects: ObjectSelector,
    /// Ascending, each once; empty: all.
    kinds: Vec<KindId>,
    region: Option<Region>,
    horizon_s: f64,
    omit_covariance: bool,
}

impl FilterSpec {
    /// All fields in comparable form: numbers as bits, with a single zero. Validation excludes NaN.
    fn key(&self) -> (&ObjectSelector, &[KindId], Option<[u64; 6]>, u64, bool) {
        let region = self.region.as_ref().map(|region| {
            let (min, max) = (&region.min_m, &region.max_m);
            [min.x, min.y, min.z, max.x, max.y, max.z].map(|side| (side + 0.0).to_bits())
        });
        (&self.objects, &self.kinds, region, (self.horizon_s + 0.0).to_bits(), self.omit_covariance)
    }

    fn select<'a>(
        &self,
        installation: &Installation,
        snapshot: &'a world::Snapshot,
    ) -> Cow<'a, world::Snapshot> {
        let mut chosen = Cow::Borrowed(snapshot);
        if !self.objects.selects_all() || !self.kinds.is_empty() {
            let wanted = |state: &&world::ObjectState| {
                let is_kind = |kind| self.kinds.binary_search(&kind).is_ok();
                let of_kind = self.kinds.is_empty() || state.kind.is_some_and(is_kind);
                of_kind && self.objects.includes(installation, state)
            };
            chosen = Cow::Owned(world::Snapshot {
                objects: snapshot.objects.iter().filter(wanted).cloned().collect(),
                ..*snapshot
            });
        }
        if self.horizon_s > 0.0 {
            chosen = Cow::Owned(chosen.predicted(self.horizon_s));
        }
        if let Some(region) = &self.region
            && chosen.objects.iter().any(|state| !region.contains(&state.position_m))
        {
            chosen.to_mut().objects.retain(|state| region.contains(&state.position_m));
        }
        chosen
    }
}

impl From<FilterSpec> for Filter {
    fn from(spec: FilterSpec) -> Self {
        let mut hasher = DefaultHasher::new();
        spec.key().hash(&mut hasher);
        Self { spec: Arc::new(spec), digest: hasher.finish() }
    }
}

impl Default for Filter {
    fn default() -> Self {
        FilterSpec::default().into()
    }
}

impl Filter {
    /// Whether it leaves every object as it is. Such filters have few different encodings.
    pub fn selects_all(&self) -> bool {
        let FilterSpec { objects, kinds, region, horizon_s, omit_covariance: _ } = &*self.spec;
        objects.selects_all() && kinds.is_empty() && region.is_none() && *horizon_s == 0.0
    }

    /// The snapshot's message; `sent_time_ns` and `missed` belong to the subscriber and are left 0.
    pub fn message(&self, installation: &Installation, fused: &FusedSnapshot) -> v1::Snapshot {
        let chosen = self.spec.select(installation, &fused.snapshot);
        convert::snapshot(installation, fused, &chosen, !self.spec.omit_covariance)
    }
}

impl PartialEq for Filter {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.spec, &other.spec)
            || self.digest == other.digest && self.spec.key() == other.spec.key()
    }
}

impl Eq for Filter {}

impl Hash for Filter {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.digest.hash(state);
    }
}

/// What a subscriber receives, and how often.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    pub filter: Filter,
    /// Above 0; `None`: every snapshot.
    pub max_rate_hz: Option<f64>,
}

impl Selection {
    /// Checks a request against the server's kinds of roundel; `names` are for errors.
    pub fn new(
        request: v1::SubscribeSnapshotsRequest,
        kinds: &[String],
        names: &FieldNames,
    ) -> Result<Self, ApiError> {
        let region = request.region.map(|it| Region::checked(it, names.corners)).transpose()?;
        if let Some(rate_hz) = request.max_rate_hz
            && !(rate_hz > 0.0 && rate_hz.is_finite())
        {
            let expected = "a rate above 0 (leave it out for every snapshot)";
            return Err(ApiError::invalid("max_rate_hz", expected, rate_hz));
        }
        let horizon_ms = request.horizon_ms.unwrap_or(0.0);
        if !(0.0..=MAX_HORIZON_MS).contains(&horizon_ms) {
            let expected = format!("milliseconds from 0 to {MAX_HORIZON_MS}");
            return Err(ApiError::invalid("horizon_ms", expected, horizon_ms));
        }
        Ok(Self {
            filter: Filter::from(FilterSpec {
                objects: ObjectSelector::checked(&request, names)?,
                kinds: checked_kinds(&request.roundels, kinds)?,
                region,
                horizon_s: horizon_ms * 1e-3,
                omit_covariance: request.omit_covariance,
            }),
            max_rate_hz: request.max_rate_hz,
        })
    }
}

fn checked_kinds(wanted: &[String], known: &[String]) -> Result<Vec<KindId>, ApiError> {
    let kind = |name: &String| match known.iter().position(|known| known == name) {
        Some(place) => Ok(KindId(place as u16)),
        None => {
            let expected = format!("any of {}", known.join(", "));
            Err(ApiError::invalid("roundels", expected, format!("{name:?}")))
        }
    };
    let mut kinds = wanted.iter().map(kind).collect::<Result<Vec<KindId>, ApiError>>()?;
    kinds.sort_unstable();
    kinds.dedup();
    Ok(kinds)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    fn checked(request: v1::SubscribeSnapshotsRequest) -> Result<Selection, ApiError> {
        Selection::new(request, &["robot", "cart"].map(str::to_owned), &MESSAGE_FIELDS)
    }

    fn filter(object_ids: &[u64], min_x_m: f64, horizon_ms: f64) -> Filter {
        let corner = |x| Some(v1::Vector3 { x, y: 0.0, z: 0.0 });
        let request = v1::SubscribeSnapshotsRequest {
            object_ids: object_ids.to_vec(),
            region: Some(v1::Box { min: corner(min_x_m), max: corner(9.0) }),
            horizon_ms: Some(horizon_ms),
            ..Default::default()
        };
        checked(request).unwrap().filter
    }

    fn named(names: &[&str], codes: &[(u32, u32)]) -> Filter {
        let request = v1::SubscribeSnapshotsRequest {
            names: names.iter().map(|&name| name.into()).collect(),
            codes: codes.iter().map(|&(bits, number)| v1::Code { bits, number }).collect(),
            ..Default::default()
        };
        checked(request).unwrap().filter
    }

    #[test]
    fn equal_selections_have_equal_filters_whatever_their_order() {
        let same = [
            filter(&[1, 2], 0.0, 0.0),
            filter(&[2, 1, 2], -0.0, -0.0),
            filter(&[1, 1, 2, 2], 0.0, -0.0),
        ];
        assert_eq!(HashSet::from(same).len(), 1);
        let spec = || FilterSpec::clone(&filter(&[1, 2], 0.0, 0.0).spec);
        let different = [
            filter(&[1, 2], 0.0, 0.0),
            filter(&[1], 0.0, 0.0),
            filter(&[1, 2], 0.5, 0.0),
            filter(&[1, 2], 0.0, 0.5),
            Filter::from(FilterSpec { omit_covariance: true, ..spec() }),
            Filter::from(FilterSpec { region: None, ..spec() }),
            Filter::from(FilterSpec { kinds: vec![KindId(1)], ..spec() }),
            named(&["a"], &[]),
            named(&["b"], &[]),
            named(&[], &[(0, 1)]),
            named(&[], &[(8, 1)]),
        ];
        assert_eq!(HashSet::from(different).len(), 11);
        let same =
            [named(&["b", "a"], &[(8, 2), (0, 1)]), named(&["a", "b", "a"], &[(0, 1), (8, 2)])];
        assert_eq!(HashSet::from(same).len(), 1);
    }

    #[test]
    fn an_unknown_kind_is_rejected_with_a_list_of_the_known() {
        let selection = |name: &str| {
            let roundels = vec!["cart".into(), name.into()];
            checked(v1::SubscribeSnapshotsRequest { roundels, ..Default::default() })
        };
        assert_eq!(selection("robot").unwrap().filter.spec.kinds, [KindId(0), KindId(1)]);
        let error = selection("robots").unwrap_err().to_string();
        assert_eq!(error, "roundels: expected any of robot, cart, found \"robots\"");
    }
}

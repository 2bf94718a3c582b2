//! Encodes each snapshot once per filter and encoding, and shares the bytes among subscribers.
//!
//! The shared bytes lack the [`SubscriberFields`], which are sent in front of them: neither protobuf nor JSON prescribes an
//! order of fields. Only the encodings of the newest snapshot are cached. `benches/subscribers` compares sharing with
//! encoding for each subscriber.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError},
    time::{Duration, Instant},
};

use axum::body::Bytes;
use prost::Message;
use roundel_proto::v1;

use super::selection::Filter;
use crate::model::hub::{FusedSnapshot, Hub};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    Protobuf,
    Json,
}

/// Fields of a snapshot message that differ between subscribers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubscriberFields {
    /// Time of handing the message to the connection, ns since the Unix epoch.
    pub sent_time_ns: i64,
    /// Snapshots skipped since the subscriber's previous message.
    pub missed: u64,
}

impl SubscriberFields {
    /// Protobuf fields to send before the shared ones.
    pub fn protobuf(self) -> Vec<u8> {
        let Self { sent_time_ns, missed } = self;
        v1::Snapshot { sent_time_ns, missed, ..Default::default() }.encode_to_vec()
    }

    /// `before` and the start of the JSON object that the shared fields continue.
    pub fn json(self, before: &str) -> String {
        let Self { sent_time_ns, missed } = self;
        format!(r#"{before}{{"sent_time_ns":"{sent_time_ns}","missed":{missed},"#)
    }
}

#[derive(Default)]
pub struct SnapshotEncoder {
    cache: Mutex<EncodingCache>,
}

type CachedEncoding = Arc<OnceLock<Bytes>>;

/// Encodings of the newest snapshot.
#[derive(Default)]
struct EncodingCache {
    sequence: u64,
    slots: HashMap<(Encoding, Filter), CachedEncoding>,
    encoded: u64,
}

impl SnapshotEncoder {
    /// The filtered snapshot without [`SubscriberFields`]. Encodes it if no subscriber has requested it yet.
    pub fn shared(
        &self,
        hub: &Hub,
        fused: &FusedSnapshot,
        filter: &Filter,
        encoding: Encoding,
    ) -> Bytes {
        self.shared_at_cost(hub, fused, filter, encoding).0
    }

    /// Like [`Self::shared`], with the time that the encoding took; zero if it was shared.
    pub fn shared_at_cost(
        &self,
        hub: &Hub,
        fused: &FusedSnapshot,
        filter: &Filter,
        encoding: Encoding,
    ) -> (Bytes, Duration) {
        let mut cost = Duration::ZERO;
        let mut encode = || {
            let begun = Instant::now();
            let bytes = encode(&filter.message(&hub.installation(), fused), encoding);
            cost = begun.elapsed();
            bytes
        };
        let mut cache = self.lock();
        let Some(shared) = cache.slot(fused.sequence, filter, encoding) else {
            // The cache already holds a newer snapshot.
            drop(cache);
            let bytes = encode();
            return (bytes, cost);
        };
        drop(cache);
        let bytes = shared.get_or_init(encode).clone();
        (bytes, cost)
    }

    fn lock(&self) -> MutexGuard<'_, EncodingCache> {
        self.cache.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of encodings made since the start.
    pub fn encoded(&self) -> u64 {
        self.lock().encoded
    }
}

impl EncodingCache {
    /// The slot of a snapshot's encoding, which may still be empty; `None` if the cache holds a newer snapshot.
    fn slot(
        &mut self,
        sequence: u64,
        filter: &Filter,
        encoding: Encoding,
    ) -> Option<CachedEncoding> {
        if self.sequence > sequence {
            return None;
        }
        if self.sequence < sequence {
            self.sequence = sequence;
            self.slots.clear();
        }
        let Self { slots, encoded, .. } = self;
        let slot = slots.entry((encoding, filter.clone())).or_insert_with(|| {
            *encoded += 1;
            CachedEncoding::default()
        });
        Some(slot.clone())
    }
}

fn encode(message: &v1::Snapshot, encoding: Encoding) -> Bytes {
    match encoding {
        Encoding::Protobuf => message.encode_to_vec().into(),
        Encoding::Json => match serde_json::to_string(message) {
            Ok(text) => without_subscriber_fields(&text).into(),
            // The generated types contain only values that JSON can represent.
            Err(error) => unreachable!("a snapshot cannot be encoded as JSON: {error}"),
        },
    }
}

/// A snapshot's JSON without its opening brace and without the [`SubscriberFields`], which are 0 in it.
fn without_subscriber_fields(text: &str) -> String {
    // These fields precede or follow all objects, so texts within objects are not affected.
    let fields = text.strip_prefix('{').unwrap_or(text);
    let fields = fields.replacen(r#""sent_time_ns":"0","#, "", 1);
    match fields.strip_suffix(r#","missed":0}"#) {
        Some(fields) => format!("{fields}}}"),
        None => fields,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::selection::Selection;

    fn message() -> v1::Snapshot {
        v1::Snapshot {
            sequence: 7,
            source_id: "ab".into(),
            pose_time_ns: 5,
            objects: vec![v1::ObjectState { name: "\"missed\":0}".into(), ..Default::default() }],
            ..Default::default()
        }
    }

    #[test]
    fn a_subscribers_own_fields_make_the_message_whole() {
        let own = SubscriberFields { sent_time_ns: 1_700_000_000_123_456_789, missed: 3 };
        let whole =
            v1::Snapshot { sent_time_ns: own.sent_time_ns, missed: own.missed, ..message() };
        let shared = encode(&message(), Encoding::Protobuf);
        let bytes = [own.protobuf(), shared.to_vec()].concat();
        assert_eq!(v1::Snapshot::decode(bytes.as_slice()).unwrap(), whole);
        for objects in [message().objects, vec![]] {
            let shared =
                encode(&v1::Snapshot { objects: objects.clone(), ..message() }, Encoding::Json);
            let text = format!("{}{}]", own.json("["), std::str::from_utf8(&shared).unwrap());
            let [read]: [v1::Snapshot; 1] = serde_json::from_str(&text).unwrap();
            assert_eq!(read, v1::Snapshot { objects, ..whole.clone() }, "{text}");
        }
    }

    #[test]
    fn equal_requests_share_an_encoding_until_the_next_snapshot() {
        let (encoder, hub) = (SnapshotEncoder::default(), Hub::new(installation()));
        let fused = |sequence| FusedSnapshot { sequence, ..Default::default() };
        let all = Selection::default().filter;
        let first = encoder.shared(&hub, &fused(1), &all, Encoding::Protobuf);
        let second = encoder.shared(&hub, &fused(1), &all, Encoding::Protobuf);
        assert_eq!((first.as_ptr(), encoder.encoded()), (second.as_ptr(), 1));
        encoder.shared(&hub, &fused(1), &all, Encoding::Json);
        assert_eq!(encoder.encoded(), 2);
        let next = encoder.shared(&hub, &fused(2), &all, Encoding::Protobuf);
        assert_ne!(next, first);
        // A subscriber that is behind gets its own encoding, and the cache stays with the newest snapshot.
        assert_eq!(encoder.shared(&hub, &fused(1), &all, Encoding::Protobuf), first);
        let again = encoder.shared(&hub, &fused(2), &all, Encoding::Protobuf);
        assert_eq!((again.as_ptr(), encoder.encoded()), (next.as_ptr(), 3));
    }

    fn installation() -> crate::model::hub::Installation {
        crate::model::hub::Installation {
            name: String::new(),
            source_id: "ab".into(),
            started: Default::default(),
            snapshot_rate_hz: 60.0,
            cameras: Default::default(),
            kinds: vec![],
            object_names: Default::default(),
            body_names: vec![],
        }
    }
}

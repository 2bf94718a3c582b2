//! The parts of the stream that a WebSocket client has selected.

use axum::http::Uri;
use prost::Message as _;
use roundel_proto::v1;
use tokio_tungstenite::tungstenite::Message;

use crate::api::{
    ApiState,
    error::ApiError,
    observation_subscription::ObservationSubscription,
    query::QueryParameters,
    selection::{MESSAGE_FIELDS, QUERY_FIELDS, Selection},
    snapshot_encoder::Encoding,
};

/// Expected message, for errors.
const REQUEST_EXAMPLE: &str = r#"a message such as {"snapshots": {"object_ids": [1, 2], "max_rate_hz": 30}, "cameras": true, "events": true}"#;
const PARTS: [&str; 4] = ["snapshots", "cameras", "events", "observations"];

pub(super) struct StreamSelection {
    pub(super) snapshots: Option<Selection>,
    pub(super) cameras: bool,
    pub(super) events: bool,
    pub(super) observations: Option<ObservationSubscription>,
}

impl StreamSelection {
    /// Reads a message on the open socket.
    pub(super) fn from_message(
        api: &ApiState,
        message: &Message,
        encoding: Encoding,
    ) -> Result<Self, ApiError> {
        let wrong = |found: String| ApiError::invalid("message", REQUEST_EXAMPLE, found);
        let request: v1::StreamRequest = match (message, encoding) {
            (Message::Text(text), _) => {
                serde_json::from_str(text).map_err(|error| wrong(error.to_string()))?
            }
            (Message::Binary(bytes), Encoding::Protobuf) => {
                v1::StreamRequest::decode(bytes.as_ref())
                    .map_err(|error| wrong(error.to_string()))?
            }
            _ => return Err(wrong("binary bytes, which are for roundel.v1.protobuf".into())),
        };
        let installation = api.hub.installation();
        let selection = |request| Selection::new(request, &installation.kinds, &MESSAGE_FIELDS);
        let observation_subscription =
            |it: v1::SubscribeObservationsRequest| ObservationSubscription::new(api, it.cameras);
        Ok(Self {
            snapshots: request.snapshots.map(selection).transpose()?,
            cameras: request.cameras,
            events: request.events,
            observations: request.observations.map(observation_subscription).transpose()?,
        })
    }

    /// Reads the query of the handshake.
    pub(super) fn from_query(api: &ApiState, uri: &Uri) -> Result<Self, ApiError> {
        let mut parameters = QueryParameters::of(uri)?;
        let mut include: Vec<String> = parameters.take_list("include", "")?;
        let max_rate_hz = parameters.take_parsed("max_rate_hz", "a number of hertz")?;
        let request = v1::SubscribeSnapshotsRequest { max_rate_hz, ..parameters.take_selection()? };
        let cameras: Vec<String> = parameters.take_list("cameras", "names of cameras")?;
        parameters.finish()?;
        if let Some(unknown) = include.iter().find(|part| !PARTS.contains(&part.as_str())) {
            let expected = format!("any of {}", PARTS.join(","));
            return Err(ApiError::invalid("include", expected, format!("{unknown:?}")));
        }
        if include.is_empty() {
            include.push(PARTS[0].to_owned());
        }
        let selection = Selection::new(request, &api.hub.installation().kinds, &QUERY_FIELDS)?;
        let is_included = |part: &str| include.iter().any(|included| included == part);
        Ok(Self {
            snapshots: is_included(PARTS[0]).then_some(selection),
            cameras: is_included(PARTS[1]),
            events: is_included(PARTS[2]),
            observations: is_included(PARTS[3])
                .then(|| ObservationSubscription::new(api, cameras))
                .transpose()?,
        })
    }
}

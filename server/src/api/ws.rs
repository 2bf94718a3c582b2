//! `/api/v1/stream`: snapshots, cameras, events and observations over one WebSocket.
//!
//! The server sends text messages with one key each: `{"snapshot":…}`, `{"cameras":[…]}` twice a second, `{"event":…}`
//! beginning with the newest logged events, and `{"observations":…}` for every frame. With the subprotocol
//! `roundel.v1.protobuf` it sends the same content as a binary `StreamMessage` (`stream.proto`). A message from the client
//! replaces its selection. An invalid message is answered with `{"error":…}`, and the selection stays.

mod socket;
mod stream_selection;

use std::{convert::Infallible, io, pin::pin, sync::Arc, time::Duration};

use axum::{
    body::Body,
    extract::State,
    http::{Request, Response},
};
use bytes::BufMut as _;
use prost::{
    Message as _,
    encoding::{WireType, encode_key, encode_varint},
};
use roundel_proto::v1;
use serde::Serialize;
use tokio::{
    sync::broadcast,
    time::{Instant, Interval, MissedTickBehavior, interval, interval_at, timeout},
};
use tokio_tungstenite::tungstenite::{
    self, Message,
    error::ProtocolError,
    protocol::{CloseFrame, WebSocketConfig, frame::coding::CloseCode},
};

use super::{
    ApiState, MAX_REQUEST_BYTES,
    access::expiry::{EXPIRED, Expiry},
    encoding_budget::EncodingShare,
    error::{ApiError, ErrorBody, SHUTTING_DOWN},
    listener::{count_stalled, encoding_share},
    observation_subscription::ObservationSubscription,
    queries,
    snapshot_encoder::Encoding,
    snapshot_subscription::{EncodedSnapshot, SnapshotSubscription},
};
use crate::model::hub;
use socket::{Handshake, Socket, offered};
use stream_selection::StreamSelection;

/// Client messages are short, and tungstenite's default of 128 kB per connection would add up.
const READ_BUFFER_BYTES: usize = 4 * 1024;
const PING_INTERVAL: Duration = Duration::from_secs(5);
/// A client that answers no ping for this long is disconnected.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(20);
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);
const CAMERA_INTERVAL: Duration = Duration::from_millis(500);
/// Logged events that are sent first.
const EVENT_BACKLOG: usize = 50;
/// Subprotocols, one for each encoding. The first one is the default.
const PROTOCOLS: [&str; 2] = ["roundel.v1.json", "roundel.v1.protobuf"];

/// Opens the stream with a WebSocket handshake.
///
/// A slow client skips to the newest snapshot, which has the number of those it missed. A client that reads nothing for 10 s
/// is disconnected. The subprotocol `roundel.v1.protobuf` selects binary messages (StreamMessage of `stream.proto`) instead
/// of text. A message `{"snapshots": {…}, "cameras": true, "events": true}` (StreamRequest) on the open socket replaces the
/// selection.
#[utoipa::path(
    get, path = "/api/v1/stream", tag = "poses",
    params(
        ("include" = Option<String>, Query, description = "any of snapshots,cameras,events,observations [snapshots]", example = "snapshots,cameras,events"),
        ("cameras" = Option<String>, Query, description = "observations of these cameras only, commas between", example = "north"),
        ("max_rate_hz" = Option<f64>, Query, description = "maximum number of snapshots per second"),
        ("ids" = Option<String>, Query, description = "only these objects, and those of names and codes; commas between. Ids change when the server restarts", example = "1,2"),
        ("names" = Option<String>, Query, description = "objects with these configured names, commas between", example = "cart"),
        ("codes" = Option<String>, Query, description = "objects seen with these codes, commas between; 8:12 for one of 8 bits", example = "12"),
        ("roundels" = Option<String>, Query, description = "only objects of these kinds of roundel, commas between", example = "robot"),
        ("min" = Option<String>, Query, description = "with max: only objects in this box of the world frame; its smallest corner, metres", example = "-1,-1,0"),
        ("max" = Option<String>, Query, description = "the box's largest corner, metres", example = "1,1,2"),
        ("horizon_ms" = Option<f64>, Query, description = "predict every pose this far past the server's pose time, 0 to 1000"),
        ("omit_covariance" = Option<bool>, Query, description = "omit the covariances"),
    ),
    responses(
        (status = 101, description = "text messages with one key each: {\"snapshot\":Snapshot}, {\"cameras\":[Camera]} twice a second, {\"event\":Event}, {\"observations\":FrameObservations}; {\"error\":{code, message}} if a message from the client is invalid"),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 403, description = "the page's origin is not in [server] allow_origins", body = ErrorBody),
        (status = 426, description = "the request is not a WebSocket handshake", body = ErrorBody),
    ),
)]
pub async fn stream(
    State(api): State<Arc<ApiState>>,
    request: Request<Body>,
) -> Result<Response<Body>, ApiError> {
    let selection = StreamSelection::from_query(&api, request.uri())?;
    let connection = Connection {
        share: encoding_share(request.extensions()),
        expiry: Expiry::of(request.extensions()),
    };
    let protocols = offered(&request);
    let mut handshake = Handshake::new(request).map_err(ApiError::UpgradeRequired)?;
    let chosen = handshake.choose(&protocols, &PROTOCOLS);
    let encoding = if chosen == Some(PROTOCOLS[1]) { Encoding::Protobuf } else { Encoding::Json };
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_REQUEST_BYTES))
        .max_frame_size(Some(MAX_REQUEST_BYTES))
        .read_buffer_size(READ_BUFFER_BYTES)
        .write_buffer_size(0);
    Ok(handshake.answer(config, move |socket| {
        Session::new(api, selection, encoding, connection).run(socket)
    }))
}

/// A message to the client. As JSON, the variant's name is the only key.
#[derive(Serialize)]
#[serde(rename_all = "lowercase")]
enum Outgoing {
    #[serde(skip)]
    Snapshot(EncodedSnapshot),
    Cameras(Vec<v1::Camera>),
    Event(v1::Event),
    Observations(v1::FrameObservations),
    Error(v1::StreamError),
}

impl Outgoing {
    fn encode(self, encoding: Encoding) -> Result<Message, serde_json::Error> {
        use v1::stream_message::Message as Alternative;
        let alternative = match (encoding, self) {
            (Encoding::Json, Self::Snapshot(EncodedSnapshot { own, shared })) => {
                let shared = str::from_utf8(&shared).expect("JSON is UTF-8");
                let mut text = own.json(r#"{"snapshot":"#);
                text.reserve(shared.len() + 1);
                text.push_str(shared);
                text.push('}');
                return Ok(text.into());
            }
            (Encoding::Json, other) => return Ok(serde_json::to_string(&other)?.into()),
            (Encoding::Protobuf, Self::Snapshot(snapshot)) => {
                return Ok(Message::binary(stream_message(&snapshot)));
            }
            (Encoding::Protobuf, Self::Cameras(cameras)) => {
                Alternative::Cameras(v1::ListCamerasResponse { cameras })
            }
            (Encoding::Protobuf, Self::Event(event)) => Alternative::Event(event),
            (Encoding::Protobuf, Self::Observations(frame)) => Alternative::Observations(frame),
            (Encoding::Protobuf, Self::Error(error)) => Alternative::Error(error),
        };
        let message = v1::StreamMessage { message: Some(alternative) };
        Ok(Message::binary(message.encode_to_vec()))
    }
}

/// Encodes a StreamMessage around an encoded snapshot.
fn stream_message(EncodedSnapshot { own, shared }: &EncodedSnapshot) -> Vec<u8> {
    const SNAPSHOT_FIELD: u32 = 1;
    let own = own.protobuf();
    let length = own.len() + shared.len();
    let mut bytes = Vec::with_capacity(length + 8);
    encode_key(SNAPSHOT_FIELD, WireType::LengthDelimited, &mut bytes);
    encode_varint(length as u64, &mut bytes);
    bytes.put_slice(&own);
    bytes.put_slice(shared);
    bytes
}

/// Why a session ends.
enum SessionEnd {
    Shutdown,
    /// The client violated the protocol, or its credentials have expired: close code and reason.
    Wrong(CloseCode, String),
    /// The client has left or does not read, so no close frame is sent.
    Gone,
}

impl SessionEnd {
    /// The end that a read error causes, with its close code (RFC 6455, section 7.4.1).
    fn of(error: &tungstenite::Error) -> Self {
        use tungstenite::Error;
        match error {
            Error::Capacity(_) => Self::Wrong(CloseCode::Size, ApiError::TooLarge.to_string()),
            Error::Utf8(_) => Self::Wrong(CloseCode::Invalid, "expected UTF-8 text".to_owned()),
            Error::Protocol(ProtocolError::ResetWithoutClosingHandshake) => Self::Gone,
            Error::Protocol(error) => Self::Wrong(CloseCode::Protocol, error.to_string()),
            _ => Self::Gone,
        }
    }
}

/// What the handshake's request came with.
struct Connection {
    share: Arc<EncodingShare>,
    expiry: Expiry,
}

struct Session {
    api: Arc<ApiState>,
    encoding: Encoding,
    connection: Connection,
    subscription: Option<SnapshotSubscription>,
    cameras: Option<Interval>,
    backlog: Vec<Arc<hub::Event>>,
    events: Option<broadcast::Receiver<Arc<hub::Event>>>,
    observation_subscription: Option<ObservationSubscription>,
}

impl Session {
    fn new(
        api: Arc<ApiState>,
        selection: StreamSelection,
        encoding: Encoding,
        connection: Connection,
    ) -> Self {
        let backlog = Vec::new();
        let (subscription, cameras, events, observation_subscription) = (None, None, None, None);
        let mut session = Self {
            api,
            encoding,
            connection,
            subscription,
            cameras,
            backlog,
            events,
            observation_subscription,
        };
        session.change(selection);
        session
    }

    fn change(&mut self, selection: StreamSelection) {
        let api = &self.api;
        let subscription = selection.snapshots.map(|selection| {
            SnapshotSubscription::new(api.clone(), selection, self.connection.share.clone())
        });
        let cameras = selection.cameras.then(|| {
            let mut ticks = interval(CAMERA_INTERVAL);
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            ticks
        });
        if !selection.events {
            self.events = None;
        } else if self.events.is_none() {
            let (remembered, receiver) = api.hub.events(EVENT_BACKLOG);
            (self.backlog, self.events) = (remembered, Some(receiver));
        }
        (self.subscription, self.cameras, self.observation_subscription) =
            (subscription, cameras, selection.observations);
    }

    async fn run(mut self, mut socket: Socket) {
        let Err(end) = self.run_loop(&mut socket).await;
        let (code, reason) = match end {
            SessionEnd::Shutdown => (CloseCode::Away, SHUTTING_DOWN.to_owned()),
            SessionEnd::Wrong(code, reason) => (code, reason),
            SessionEnd::Gone => return,
        };
        let frame = CloseFrame { code, reason: reason.into() };
        let _ = timeout(CLOSE_TIMEOUT, socket.close(frame)).await;
    }

    async fn run_loop(&mut self, socket: &mut Socket) -> Result<Infallible, SessionEnd> {
        let mut pings = interval_at(Instant::now() + PING_INTERVAL, PING_INTERVAL);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut last_heard = Instant::now();
        loop {
            for event in std::mem::take(&mut self.backlog) {
                self.send(socket, Outgoing::Event(Arc::unwrap_or_clone(event))).await?;
            }
            let message = tokio::select! {
                () = self.api.cancel.cancelled() => return Err(SessionEnd::Shutdown),
                () = self.connection.expiry.reached() => {
                    return Err(SessionEnd::Wrong(CloseCode::Policy, EXPIRED.to_owned()));
                }
                incoming = socket.recv() => match incoming {
                    Some(Ok(message)) => {
                        last_heard = Instant::now();
                        match self.handle_request(&message) {
                            Ok(()) => continue,
                            Err(error) => Outgoing::Error(error.into()),
                        }
                    }
                    Some(Err(error)) => return Err(SessionEnd::of(&error)),
                    None => return Err(SessionEnd::Gone),
                },
                _ = pings.tick() => {
                    if last_heard.elapsed() > SILENCE_TIMEOUT {
                        return Err(SessionEnd::Gone);
                    }
                    self.transmit(socket, Message::Ping(Default::default())).await?;
                    continue;
                }
                snapshot = next_snapshot(&mut self.subscription, self.encoding) => {
                    Outgoing::Snapshot(snapshot.ok_or(SessionEnd::Shutdown)?)
                }
                () = next_tick(&mut self.cameras) => Outgoing::Cameras(queries::cameras(&self.api)),
                frame = next_frame(&mut self.observation_subscription) => match frame.ok_or(SessionEnd::Shutdown)? {
                    Ok(frame) => Outgoing::Observations(frame),
                    Err(error) => {
                        self.observation_subscription = None;
                        Outgoing::Error(error.into())
                    }
                },
                event = next_event(&mut self.events) => {
                    let event = event.ok_or(SessionEnd::Shutdown)?;
                    Outgoing::Event(Arc::unwrap_or_clone(event))
                }
            };
            self.send(socket, message).await?;
        }
    }

    fn handle_request(&mut self, message: &Message) -> Result<(), ApiError> {
        if matches!(message, Message::Text(_) | Message::Binary(_)) {
            self.change(StreamSelection::from_message(&self.api, message, self.encoding)?);
        }
        Ok(())
    }

    async fn send(&self, socket: &mut Socket, message: Outgoing) -> Result<(), SessionEnd> {
        match message.encode(self.encoding) {
            Ok(message) => self.transmit(socket, message).await,
            Err(error) => {
                tracing::error!(%error, "could not encode a message as JSON");
                Ok(())
            }
        }
    }

    /// Sends a message. The connection's write timeout ends the session of a client that does not read.
    async fn transmit(&self, socket: &mut Socket, message: Message) -> Result<(), SessionEnd> {
        let mut send = pin!(socket.send(message));
        tokio::select! {
            biased;
            sent = &mut send => sent.map_err(|error| self.send_failed(&error)),
            // A message that was begun is completed: the close frame must follow it.
            () = self.api.cancel.cancelled() => match timeout(CLOSE_TIMEOUT, &mut send).await {
                Ok(Ok(())) => Err(SessionEnd::Shutdown),
                _ => Err(SessionEnd::Gone),
            },
        }
    }

    fn send_failed(&self, error: &tungstenite::Error) -> SessionEnd {
        if let tungstenite::Error::Io(error) = error
            && error.kind() == io::ErrorKind::TimedOut
        {
            count_stalled(&self.api);
        }
        SessionEnd::Gone
    }
}

async fn next_snapshot(
    subscription: &mut Option<SnapshotSubscription>,
    encoding: Encoding,
) -> Option<EncodedSnapshot> {
    match subscription {
        Some(subscription) => subscription.next(encoding).await,
        None => std::future::pending().await,
    }
}

async fn next_tick(ticks: &mut Option<Interval>) {
    match ticks {
        Some(ticks) => {
            ticks.tick().await;
        }
        None => std::future::pending().await,
    }
}

async fn next_event(
    events: &mut Option<broadcast::Receiver<Arc<hub::Event>>>,
) -> Option<Arc<hub::Event>> {
    match events {
        Some(events) => queries::next_event(events).await,
        None => std::future::pending().await,
    }
}

async fn next_frame(
    observation_subscription: &mut Option<ObservationSubscription>,
) -> Option<Result<v1::FrameObservations, ApiError>> {
    match observation_subscription {
        Some(observation_subscription) => observation_subscription.next().await,
        None => std::future::pending().await,
    }
}

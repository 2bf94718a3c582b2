//! `/api/v1/stream`: one WebSocket with everything that a page needs.
//!
//! Text messages with one key each: `{"snapshot":…}`, `{"cameras":[…]}` twice a second, and
//! `{"event":…}`, beginning with the newest remembered ones. What the client sends is ignored.

use std::{sync::Arc, time::Duration};

use axum::{
    extract::{
        State,
        ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code, rejection},
    },
    http::Uri,
    response::Response,
};
use roundel_proto::v1;
use serde::Serialize;
use tokio::{
    sync::broadcast,
    time::{Instant, Interval, MissedTickBehavior, interval, interval_at, timeout},
};

use super::{
    Api,
    error::{ApiError, ErrorBody, SHUTTING_DOWN},
    feed::Feed,
    grpc,
    query::Parameters,
    selection::{QUERY_FIELDS, Selection},
};
use crate::{convert, hub};

/// Largest message that a client may send; it is read and forgotten.
const MAX_INCOMING_BYTES: usize = 64 * 1024;
/// How often a client is asked whether it lives.
const PING_INTERVAL: Duration = Duration::from_secs(5);
/// A client that answers no ping for this long is cut off.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(20);
/// How long a client may take to answer a close frame.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);
/// How often the cameras are sent.
const CAMERA_INTERVAL: Duration = Duration::from_millis(500);
/// Remembered events that are sent first.
const EVENT_BACKLOG: usize = 50;
/// What can be included.
const PARTS: [&str; 3] = ["snapshots", "cameras", "events"];

/// What a client asked for.
#[derive(Debug)]
struct Wanted {
    snapshots: Option<Selection>,
    cameras: bool,
    events: bool,
}

impl Wanted {
    fn of(uri: &Uri) -> Result<Self, ApiError> {
        let mut parameters = Parameters::of(uri)?;
        let mut include: Vec<String> = parameters.take_list("include", "")?;
        let max_rate_hz = parameters.take_parsed("max_rate_hz", "a number of hertz")?;
        let request = v1::SubscribeSnapshotsRequest { max_rate_hz, ..parameters.take_selection()? };
        parameters.finish()?;
        if let Some(unknown) = include.iter().find(|part| !PARTS.contains(&part.as_str())) {
            let expected = format!("any of {}", PARTS.join(","));
            return Err(ApiError::invalid("include", expected, format!("{unknown:?}")));
        }
        if include.is_empty() {
            include.push(PARTS[0].to_owned());
        }
        let selection = Selection::new(request, &QUERY_FIELDS)?;
        let is_included = |part: &str| include.iter().any(|included| included == part);
        Ok(Self {
            snapshots: is_included(PARTS[0]).then_some(selection),
            cameras: is_included(PARTS[1]),
            events: is_included(PARTS[2]),
        })
    }
}

/// Opens the stream; a WebSocket handshake.
///
/// A client that reads too slowly gets the newest snapshot and the number that it missed; one that
/// does not read at all is cut off after 10 s.
#[utoipa::path(
    get, path = "/api/v1/stream", tag = "poses",
    params(
        ("include" = Option<String>, Query, description = "any of snapshots,cameras,events; snapshots if left out", example = "snapshots,cameras,events"),
        ("max_rate_hz" = Option<f64>, Query, description = "at most this many snapshots a second"),
        ("ids" = Option<String>, Query, description = "only these objects, commas between", example = "1,2"),
        ("min" = Option<String>, Query, description = "with max: only objects in this box of the world frame; its smallest corner, metres", example = "-1,-1,0"),
        ("max" = Option<String>, Query, description = "the box's largest corner, metres", example = "1,1,2"),
        ("horizon_ms" = Option<f64>, Query, description = "predict every pose this far past the server's pose time, 0 to 1000"),
        ("omit_covariance" = Option<bool>, Query, description = "leave the covariances out"),
    ),
    responses(
        (status = 101, description = "text messages with one key each: {\"snapshot\":Snapshot}, {\"cameras\":[Camera]} twice a second, {\"event\":Event}"),
        (status = 400, description = "names the wrong parameter", body = ErrorBody),
        (status = 426, description = "no WebSocket handshake", body = ErrorBody),
    ),
)]
pub async fn stream(
    State(api): State<Arc<Api>>,
    uri: Uri,
    upgrade: Result<WebSocketUpgrade, rejection::WebSocketUpgradeRejection>,
) -> Result<Response, ApiError> {
    let wanted = Wanted::of(&uri)?;
    let upgrade = upgrade.map_err(|error| ApiError::UpgradeRequired(error.to_string()))?;
    let upgrade = upgrade.max_message_size(MAX_INCOMING_BYTES).max_frame_size(MAX_INCOMING_BYTES);
    Ok(upgrade.on_upgrade(|socket| Session::new(api, wanted).run(socket)))
}

/// What is sent: one key each.
#[derive(Serialize)]
#[serde(rename_all = "lowercase")]
enum Outgoing {
    Snapshot(v1::Snapshot),
    Cameras(Vec<v1::Camera>),
    Event(v1::Event),
}

/// Why a session ends.
enum End {
    /// The server goes down: the client is told.
    Shutdown,
    /// The client has gone, or does not read: nothing can be told.
    Gone,
}

/// One open WebSocket.
struct Session {
    api: Arc<Api>,
    feed: Option<Feed>,
    cameras: Option<Interval>,
    remembered: Vec<Arc<hub::Event>>,
    events: Option<broadcast::Receiver<Arc<hub::Event>>>,
}

impl Session {
    fn new(api: Arc<Api>, wanted: Wanted) -> Self {
        let feed = wanted.snapshots.map(|selection| Feed::new(api.clone(), selection));
        let cameras = wanted.cameras.then(|| {
            let mut ticks = interval(CAMERA_INTERVAL);
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            ticks
        });
        let (remembered, events) = if wanted.events {
            let (remembered, receiver) = api.hub.events(EVENT_BACKLOG);
            (remembered, Some(receiver))
        } else {
            (Vec::new(), None)
        };
        Self { api, feed, cameras, remembered, events }
    }

    async fn run(mut self, mut socket: WebSocket) {
        let Err(End::Shutdown) = self.converse(&mut socket).await else {
            return;
        };
        let frame = CloseFrame { code: close_code::AWAY, reason: SHUTTING_DOWN.into() };
        // Reading on until the client has answered keeps the frame from being lost in a reset.
        let farewell = async {
            socket.send(Message::Close(Some(frame))).await?;
            while let Some(message) = socket.recv().await {
                message?;
            }
            Ok::<_, axum::Error>(())
        };
        let _ = timeout(CLOSE_TIMEOUT, farewell).await;
    }

    async fn converse(&mut self, socket: &mut WebSocket) -> Result<(), End> {
        for event in std::mem::take(&mut self.remembered) {
            let event = convert::event(&event);
            self.send(socket, &Outgoing::Event(event)).await?;
        }
        let mut pings = interval_at(Instant::now() + PING_INTERVAL, PING_INTERVAL);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut last_heard = Instant::now();
        loop {
            let message = tokio::select! {
                () = self.api.cancel.cancelled() => return Err(End::Shutdown),
                incoming = socket.recv() => match incoming {
                    Some(Ok(_)) => {
                        last_heard = Instant::now();
                        continue;
                    }
                    Some(Err(_)) | None => return Err(End::Gone),
                },
                _ = pings.tick() => {
                    if last_heard.elapsed() > SILENCE_TIMEOUT {
                        return Err(End::Gone);
                    }
                    self.transmit(socket, Message::Ping(Default::default())).await?;
                    continue;
                }
                snapshot = next_snapshot(&mut self.feed) => {
                    Outgoing::Snapshot(snapshot.ok_or(End::Shutdown)?)
                }
                () = next_tick(&mut self.cameras) => Outgoing::Cameras(grpc::cameras(&self.api)),
                event = next_event(&mut self.events) => {
                    let event = event.ok_or(End::Shutdown)?;
                    Outgoing::Event(convert::event(&event))
                }
            };
            self.send(socket, &message).await?;
        }
    }

    async fn send(&self, socket: &mut WebSocket, message: &Outgoing) -> Result<(), End> {
        match serde_json::to_string(message) {
            Ok(text) => self.transmit(socket, Message::text(text)).await,
            Err(error) => {
                tracing::error!(%error, "could not write a message as JSON");
                Ok(())
            }
        }
    }

    /// Sends, unless the client does not read or the server goes down meanwhile.
    async fn transmit(&self, socket: &mut WebSocket, message: Message) -> Result<(), End> {
        tokio::select! {
            sent = timeout(self.api.limits.send_timeout, socket.send(message)) => match sent {
                Ok(Ok(())) => Ok(()),
                Ok(Err(_)) | Err(_) => Err(End::Gone),
            },
            () = self.api.cancel.cancelled() => Err(End::Shutdown),
        }
    }
}

async fn next_snapshot(feed: &mut Option<Feed>) -> Option<v1::Snapshot> {
    match feed {
        Some(feed) => feed.next().await,
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
        Some(events) => grpc::next_event(events).await,
        None => std::future::pending().await,
    }
}

//! SubscribeSnapshots, by hand: what many subscribers want is one piece of memory that all their connections send from.
//!
//! tonic's codecs write each message into a buffer of the connection's own. Here a response's body hands HTTP/2 two
//! pieces a message: some thirty bytes of the subscriber's own (gRPC's header of five, time sent, count missed), and the
//! shared rest by reference. HTTP/2 asks for the next one when the client has room, and gets the newest there is.
//!
//! Once that works for a subscriber, its messages go past HTTP/2's library ([`Direct`]), and where many want the same,
//! all of them from one [sheet](crate::api::sheets).
//!
//! Who has room for nothing is cut off by the port, as with every answer.

use std::{
    convert::Infallible,
    panic::resume_unwind,
    pin::Pin,
    sync::{Arc, OnceLock, atomic::Ordering},
    task::{Context, Poll},
};

use axum::{
    body::{Body, Bytes},
    extract::Request,
    http::{HeaderMap, HeaderValue, header},
    response::Response,
};
use futures::{Stream, StreamExt, stream};
use http_body_util::{BodyExt, Limited};
use hyper::body::Frame;
use prost::Message;
use roundel_proto::v1;
use tokio::task::JoinError;
use tokio_util::task::AbortOnDropHandle;
use tonic::Status;

use crate::api::{
    Api, MAX_REQUEST_BYTES,
    encoded::{Form, Own},
    error::{ApiError, SHUTTING_DOWN},
    feed::{Due, Feed},
    port::{Direct, Line, Sheet},
    selection::{MESSAGE_FIELDS, Selection},
    sheets::Way,
};

/// Where tonic would look for the call.
pub(super) const PATH: &str = "/roundel.v1.Roundel/SubscribeSnapshots";
/// On average: one connection may have more.
const SUBSCRIPTIONS_PER_CLIENT: usize = 4;
/// gRPC's header of a message: whether it is compressed, and its length, big-endian.
const HEADER_BYTES: usize = 5;

/// Answers the call.
pub(super) async fn subscribe(api: Arc<Api>, request: Request) -> Result<Response, Infallible> {
    let line = request.extensions().get().cloned();
    let selection = selection(&api, request).await;
    let response = match selection.and_then(|it| Ok(admitted(&api, it)?)) {
        Ok(selection) => {
            let feed = Feed::new(api.clone(), selection);
            let subscription = Subscription { api, feed, line };
            let mut response = Response::new(Body::new(Snapshots::new(subscription)));
            let grpc = HeaderValue::from_static("application/grpc");
            response.headers_mut().insert(header::CONTENT_TYPE, grpc);
            response
        }
        Err(status) => status.into_http(),
    };
    Ok(response)
}

/// The same, if there is room for another subscription: each may want something else, which is to be encoded.
fn admitted(api: &Api, selection: Selection) -> Result<Selection, ApiError> {
    let most = SUBSCRIPTIONS_PER_CLIENT * api.limits.max_clients;
    if api.counters.snapshot_subscribers.load(Ordering::Relaxed) < most as u64 {
        return Ok(selection);
    }
    let limit = format!(
        "this server has as many subscriptions to snapshots as it takes: {most}, which is {SUBSCRIPTIONS_PER_CLIENT} for \
         each of [limits] max_clients"
    );
    Err(ApiError::ResourceExhausted(limit))
}

async fn selection(api: &Api, request: Request) -> Result<Selection, Status> {
    let body = Limited::new(request.into_body(), HEADER_BYTES + MAX_REQUEST_BYTES);
    let bytes = body.collect().await.map_err(|error| {
        if error.is::<http_body_util::LengthLimitError>() {
            ApiError::TooLarge.into()
        } else {
            Status::cancelled(format!("the request ended early: {error}"))
        }
    })?;
    let request = decoded(&bytes.to_bytes())?;
    Ok(Selection::new(request, &api.hub.installation().kinds, &MESSAGE_FIELDS)?)
}

fn decoded(bytes: &[u8]) -> Result<v1::SubscribeSnapshotsRequest, Status> {
    let Some((&[compressed, length @ ..], message)) = bytes.split_first_chunk::<HEADER_BYTES>()
    else {
        return Err(Status::internal("expected one message, found none"));
    };
    if compressed != 0 {
        return Err(Status::unimplemented("this server takes no compressed requests"));
    }
    let length = u32::from_be_bytes(length) as usize;
    if length != message.len() {
        let found = message.len();
        return Err(Status::internal(format!(
            "expected one message of {length} bytes as its header says, found {found} bytes"
        )));
    }
    v1::SubscribeSnapshotsRequest::decode(message)
        .map_err(|error| Status::internal(format!("the request is no message: {error}")))
}

/// What one subscriber gets, and how.
struct Subscription {
    api: Arc<Api>,
    feed: Feed,
    /// Its connection, where messages may go past HTTP/2's library.
    line: Option<Line>,
}

impl Subscription {
    /// Its messages as far as they go through HTTP/2's library; the others go past it as `direct`.
    fn messages(
        self,
        direct: Arc<OnceLock<Direct>>,
    ) -> impl Stream<Item = Result<Pieces, Status>> + Send {
        stream::unfold(Some((self, 0)), move |state| {
            let direct = direct.clone();
            async move {
                let (mut this, given) = state?;
                let due = this.feed.next(Form::Protobuf).await?;
                if let Some(number) = direct.get().and_then(|direct| direct.take_over(given)) {
                    let task = tokio::spawn(this.send_past(direct, number, due));
                    let ended = AbortOnDropHandle::new(task).await;
                    return match ended.map_err(JoinError::try_into_panic) {
                        Err(Ok(panic)) => resume_unwind(panic),
                        // Who has ended it hears no more of it; otherwise there are no more snapshots.
                        Ok(()) | Err(Err(_)) => Some((Err(shutting_down()), None)),
                    };
                }
                let head = head(due.own, due.shared.len());
                if given == 0
                    && let Some(line) = &this.line
                {
                    direct.get_or_init(|| line.direct(&head));
                }
                let given = given + (head.len() + due.shared.len()) as u64;
                Some((Ok((head, due.shared)), Some((this, given))))
            }
        })
    }

    /// Sends by the stream of this number until there is no more to send, or nobody to send it to.
    async fn send_past(mut self, direct: Arc<OnceLock<Direct>>, number: u32, mut due: Due) {
        let Some(direct) = direct.get() else { return };
        loop {
            let own = head(due.own, due.shared.len());
            let sheet = match due.own.missed {
                0 => {
                    let (what, who) = ((due.sequence, due.shared.len()), self.feed.filter());
                    let make = || Sheet::frames(number, &own, &due.shared);
                    self.api.sheets.sheet(what, (who, Way::Grpc(number)), make)
                }
                _ => None,
            };
            let shared = u64::from(sheet.is_some());
            self.api.counters.snapshots_shared.fetch_add(shared, Ordering::Relaxed);
            let Ok(is_ready) = direct.send(own, due.shared, sheet.as_deref()) else { return };
            if !is_ready && direct.ready().await.is_err() {
                return;
            }
            let Some(next) = self.feed.next(Form::Protobuf).await else { return };
            due = next;
        }
    }
}

/// A message's two pieces: what is the subscriber's own, and what it shares.
type Pieces = (Bytes, Bytes);

/// The body: messages until the server goes down.
struct Snapshots {
    messages: Pin<Box<dyn Stream<Item = Result<Pieces, Status>> + Send>>,
    /// The rest of the message that is under way.
    rest: Option<Bytes>,
    is_ended: bool,
}

impl Snapshots {
    fn new(subscription: Subscription) -> Self {
        let direct = Arc::new(OnceLock::new());
        let cancel = subscription.api.cancel.clone();
        let messages = subscription.messages(direct.clone());
        let end = stream::once(async move {
            cancel.cancelled().await;
            if let Some(direct) = direct.get() {
                Direct::stop(direct).await;
            }
            Err(shutting_down())
        });
        let messages = Box::pin(stream::select(messages, end));
        Self { messages, rest: None, is_ended: false }
    }

    fn trailers(&mut self, status: &Status) -> Frame<Bytes> {
        self.is_ended = true;
        let mut trailers = HeaderMap::new();
        // What cannot be a header is left out of the message by tonic, and the code stays.
        let _ = status.add_header(&mut trailers);
        Frame::trailers(trailers)
    }
}

fn shutting_down() -> Status {
    ApiError::Unavailable(SHUTTING_DOWN.into()).into()
}

/// What stands before the shared part of a message of `shared` bytes.
fn head(own: Own, shared: usize) -> Bytes {
    let own = own.protobuf();
    let length = (own.len() + shared) as u32;
    [&[0], length.to_be_bytes().as_slice(), &own].concat().into()
}

impl hyper::body::Body for Snapshots {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        if self.is_ended {
            return Poll::Ready(None);
        }
        let frame = match self.rest.take() {
            Some(rest) => Poll::Ready(Frame::data(rest)),
            None => match self.messages.poll_next_unpin(context) {
                Poll::Ready(Some(Ok((head, shared)))) => {
                    self.rest = Some(shared).filter(|shared| !shared.is_empty());
                    Poll::Ready(Frame::data(head))
                }
                Poll::Ready(Some(Err(status))) => Poll::Ready(self.trailers(&status)),
                Poll::Ready(None) => Poll::Ready(self.trailers(&Status::ok(""))),
                Poll::Pending => Poll::Pending,
            },
        };
        frame.map(|frame| Some(Ok(frame)))
    }
}

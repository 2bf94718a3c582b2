//! SubscribeSnapshots, by hand: what many subscribers want is one piece of memory that all their connections send from.
//!
//! tonic's codecs write each message into a buffer of the connection's own. Here a response's body hands HTTP/2 two
//! pieces a message: some thirty bytes of the subscriber's own (gRPC's header of five, time sent, count missed), and the
//! shared rest by reference. HTTP/2 asks for the next one when the client has room, and gets the newest there is.
//!
//! Who has room for nothing is cut off by the port, as with every answer.

use std::{
    convert::Infallible,
    pin::Pin,
    sync::Arc,
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
use tonic::Status;

use super::MAX_REQUEST_BYTES;
use crate::api::{
    Api,
    encoded::{Form, Own},
    error::{ApiError, SHUTTING_DOWN},
    feed::Feed,
    selection::{MESSAGE_FIELDS, Selection},
};

/// Where tonic would look for the call.
pub(super) const PATH: &str = "/roundel.v1.Roundel/SubscribeSnapshots";
/// gRPC's header of a message: whether it is compressed, and its length, big-endian.
const HEADER_BYTES: usize = 5;

/// Answers the call.
pub(super) async fn subscribe(api: Arc<Api>, request: Request) -> Result<Response, Infallible> {
    let response = match selection(&api, request).await {
        Ok(selection) => {
            let mut response = Response::new(Body::new(Snapshots::new(api, selection)));
            let grpc = HeaderValue::from_static("application/grpc");
            response.headers_mut().insert(header::CONTENT_TYPE, grpc);
            response
        }
        Err(status) => status.into_http(),
    };
    Ok(response)
}

async fn selection(api: &Api, request: Request) -> Result<Selection, Status> {
    let body = Limited::new(request.into_body(), HEADER_BYTES + MAX_REQUEST_BYTES);
    let bytes = body.collect().await.map_err(|error| {
        if error.is::<http_body_util::LengthLimitError>() {
            Status::out_of_range(format!("expected a request of at most {MAX_REQUEST_BYTES} bytes"))
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
    fn new(api: Arc<Api>, selection: Selection) -> Self {
        let feed = Feed::new(api.clone(), selection);
        let messages = stream::unfold(feed, |mut feed| async move {
            let due = feed.next(Form::Protobuf).await?;
            Some((Ok((head(due.own, due.shared.len()), due.shared)), feed))
        });
        let end = stream::once(async move {
            api.cancel.cancelled().await;
            Err(ApiError::Unavailable(SHUTTING_DOWN.into()).into())
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

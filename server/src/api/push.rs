//! The gRPC service `Push`: remote programs send frames and detections to the push endpoints of their cameras.
//!
//! Messages are bounded in bytes and in detections, and before a greeting has been accepted they are short. A message that
//! exceeds a limit ends the stream with an error, as any invalid one: a node has the same limits by default.

mod codec;

use std::{
    convert::Infallible,
    future::{Ready, ready},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use axum::{
    body::{Body, Bytes},
    extract::Request,
    http,
};
use futures::{
    StreamExt,
    stream::{self, BoxStream},
};
use http_body_util::{BodyStream, StreamBody};
use roundel_core::id::CameraId;
use roundel_proto::v1::{
    self, push_request::Message as Incoming, push_response::Message as Answer,
};
use tokio::{sync::mpsc, time::timeout};
use tonic::{
    Extensions, Response, Status, Streaming,
    server::{Grpc, StreamingService},
};

use self::codec::PushCodec;
use super::{
    ApiState,
    error::{ApiError, SHUTTING_DOWN},
    peer::Peer,
    queries,
};
use crate::{
    capture::{
        push_messages::{self as convert, WireFieldError},
        source::push::{
            PushEndpoint, PushError, PushedItem, SenderClock, SenderHello, SenderSession,
        },
    },
    model::{access::Identity, hub::Picture, untrusted_text::sanitized},
};

pub(super) const PATH: &str = "/roundel.v1.Push/Send";
/// Largest message: a grey picture of 5000 x 3000 pixels fits.
const MAX_MESSAGE_BYTES: usize = 16 * 1024 * 1024;
/// Bytes of a stream whose greeting has not been accepted.
const MAX_GREETING_BYTES: usize = 64 * 1024;
/// Capacity of the response queue. While it is full because the sender does not read, its messages are not read.
const RESPONSE_QUEUE_LEN: usize = 16;
/// Longer names are truncated.
const MAX_NAME_LEN: usize = 80;

/// Serves the method with a codec of its own.
pub(super) async fn send(
    api: Arc<ApiState>,
    request: Request,
) -> Result<http::Response<tonic::body::Body>, Infallible> {
    let mut grpc = Grpc::new(PushCodec(api.ports.clone()))
        .apply_max_message_size_config(Some(MAX_MESSAGE_BYTES), None);
    let is_accepted = Arc::new(AtomicBool::new(false));
    let request = request.map(|body| short_until(is_accepted.clone(), body));
    Ok(grpc.streaming(Send { api, is_accepted }, request).await)
}

/// Bounds a body to [`MAX_GREETING_BYTES`] while the greeting has not been accepted.
fn short_until(is_accepted: Arc<AtomicBool>, body: Body) -> Body {
    let mut received = 0;
    let frames = BodyStream::new(body).map(move |frame| {
        let frame = frame?;
        received += frame.data_ref().map_or(0, Bytes::len);
        if received > MAX_GREETING_BYTES && !is_accepted.load(Ordering::Relaxed) {
            let expected = format!("at most {MAX_GREETING_BYTES} bytes before its welcome");
            let error = ApiError::invalid("greeting", expected, "more");
            return Err(axum::Error::new(Status::from(error)));
        }
        Ok(frame)
    });
    Body::new(StreamBody::new(frames))
}

struct Send {
    api: Arc<ApiState>,
    is_accepted: Arc<AtomicBool>,
}

impl StreamingService<v1::PushRequest> for Send {
    type Response = v1::PushResponse;
    type ResponseStream = BoxStream<'static, Result<v1::PushResponse, Status>>;
    type Future = Ready<Result<Response<Self::ResponseStream>, Status>>;

    fn call(&mut self, request: tonic::Request<Streaming<v1::PushRequest>>) -> Self::Future {
        let (answers, mut receiver) = mpsc::channel(RESPONSE_QUEUE_LEN);
        let (api, is_accepted) = (self.api.clone(), self.is_accepted.clone());
        tokio::spawn(async move {
            let (_, extensions, messages) = request.into_parts();
            let stream = SenderStream { messages, extensions, is_accepted };
            let session = serve_sender(&api, stream, &answers);
            let outcome = tokio::select! {
                outcome = session => outcome,
                () = api.cancel.cancelled() => Err(Status::unavailable(SHUTTING_DOWN)),
                // The sender has disconnected.
                () = answers.closed() => return,
            };
            if let Err(status) = outcome {
                // The sender may have disconnected.
                let _ = answers.send(Err(status)).await;
            }
        });
        let answers = stream::poll_fn(move |context| receiver.poll_recv(context));
        ready(Ok(Response::new(answers.boxed())))
    }
}

struct SenderStream {
    messages: Streaming<v1::PushRequest>,
    /// [`Peer`] and [`Identity`].
    extensions: Extensions,
    is_accepted: Arc<AtomicBool>,
}

async fn serve_sender(
    api: &ApiState,
    SenderStream { mut messages, extensions, is_accepted }: SenderStream,
    answers: &mpsc::Sender<Result<v1::PushResponse, Status>>,
) -> Result<(), Status> {
    let limit = api.limits.request_timeout;
    let Ok(first) = timeout(limit, messages.message()).await else {
        let expected = format!("a greeting within {limit:?}");
        return Err(ApiError::invalid("message", expected, "nothing").into());
    };
    let Some(v1::PushRequest { message: Some(Incoming::Greeting(greeting)) }) = first? else {
        return Err(ApiError::invalid("message", "a greeting first", "another message").into());
    };
    convert::check_text(&greeting.camera, "greeting.camera").map_err(ApiError::from)?;
    if let Some(identity) = extensions.get::<Arc<Identity>>() {
        check_feed(identity, &greeting.camera)?;
    }
    let (camera, endpoint) = endpoint(api, &greeting.camera)?;
    let times = convert::sender_clock(greeting.times).map_err(ApiError::from)?;
    let hello = sender_hello(&greeting, times, extensions.get());
    let session = endpoint.connect(&hello).map_err(ApiError::from)?;
    is_accepted.store(true, Ordering::Relaxed);
    let link = LinkStatus { api, camera, endpoint: endpoint.clone() };
    link.publish();
    let session = PushSession {
        session,
        link,
        times,
        answers,
        sent_calibration: None,
        sends_detections: false,
    };
    tokio::select! {
        outcome = session.run(&mut messages) => outcome,
        () = endpoint.closed() => Err(ApiError::from(PushError::Closed).into()),
    }
}

fn check_feed(identity: &Identity, camera: &str) -> Result<(), ApiError> {
    if identity.may_feed(camera) {
        return Ok(());
    }
    let name = &identity.name;
    Err(ApiError::PermissionDenied(format!(
        "\"{name}\" must not feed the camera \"{}\": add it to `cameras` of its [[access]] entry",
        camera.escape_debug()
    )))
}

fn sender_hello(
    greeting: &v1::PushGreeting,
    times: SenderClock,
    peer: Option<&Peer>,
) -> SenderHello {
    let name: String = sanitized(&greeting.sender).chars().take(MAX_NAME_LEN).collect();
    SenderHello {
        sender: if name.trim().is_empty() { "a program".to_owned() } else { name },
        address: peer.map_or_else(|| "unknown address".to_owned(), |peer| peer.address.to_string()),
        run_id: greeting.run_id.chars().take(MAX_NAME_LEN).collect(),
        times,
        next_sequence: greeting.next_sequence,
        dropped: greeting.dropped,
    }
}

fn endpoint(api: &ApiState, name: &str) -> Result<(CameraId, Arc<PushEndpoint>), ApiError> {
    let id = queries::camera_id(api, name)?;
    let endpoint = api.ports.get(id);
    let endpoint = endpoint.ok_or_else(|| {
        let installation = api.hub.installation();
        let source = installation.cameras.get(&id).map_or("", |info| &info.source);
        ApiError::FailedPrecondition(format!(
            "camera {name:?} takes its frames from `{source}`: only a camera with source = \"push:\" accepts frames"
        ))
    })?;
    Ok((id, endpoint))
}

/// Publishes the state of a camera's connection, also when it breaks.
struct LinkStatus<'a> {
    api: &'a ApiState,
    camera: CameraId,
    endpoint: Arc<PushEndpoint>,
}

impl LinkStatus<'_> {
    fn publish(&self) {
        let link = self.endpoint.link();
        self.api.hub.update_camera(self.camera, |state| state.link = Some(link));
    }
}

impl Drop for LinkStatus<'_> {
    fn drop(&mut self) {
        self.publish();
    }
}

struct PushSession<'a> {
    /// Dropped before `link`, which then publishes its end.
    session: SenderSession,
    link: LinkStatus<'a>,
    times: SenderClock,
    answers: &'a mpsc::Sender<Result<v1::PushResponse, Status>>,
    sent_calibration: Option<v1::PushedCalibration>,
    /// Whether it sends detections instead of frames. The worker then has no pictures, and the sender is asked for them.
    sends_detections: bool,
}

impl PushSession<'_> {
    async fn answer(&self, message: Answer) {
        // A disconnected sender ends the session in `send`.
        let _ = self.answers.send(Ok(v1::PushResponse { message: Some(message) })).await;
    }

    async fn run(mut self, messages: &mut Streaming<v1::PushRequest>) -> Result<(), Status> {
        let welcome = v1::PushWelcome {
            source_id: self.link.api.hub.installation().source_id.clone(),
            newest_sequence: self.session.newest_sequence,
            late_window_ms: self.link.api.late_window_ms,
        };
        self.answer(Answer::Welcome(welcome)).await;
        self.send_calibration().await;
        while let Some(request) = messages.message().await? {
            self.take(request).await?;
            self.link.publish();
            self.send_calibration().await;
            self.request_picture().await;
        }
        Ok(())
    }

    async fn take(&mut self, request: v1::PushRequest) -> Result<(), ApiError> {
        let arrived = self.link.api.clock.now();
        let (sequence, (what, clock)) = match request.message {
            Some(Incoming::Frame(frame)) => (frame.sequence, convert::frame(frame)?),
            Some(Incoming::Observations(seen)) => {
                self.sends_detections = true;
                let installation = self.link.api.hub.installation();
                (seen.sequence, convert::pushed_detections(&installation, seen)?)
            }
            Some(Incoming::Trouble(v1::PushedTrouble { error })) => {
                return Ok(self.session.report_failure(&error)?);
            }
            Some(Incoming::Probe(probe)) => {
                let known = [probe.round_trip_ms, probe.clock_deviation_ms];
                self.session.keep_alive(probe.next_sequence, known)?;
                let replied_time_ns = self.link.api.clock.now().as_ns();
                let (sent_time_ns, received_time_ns) = (probe.sent_time_ns, arrived.as_ns());
                let times = v1::PushProbeAnswer { sent_time_ns, received_time_ns, replied_time_ns };
                self.answer(Answer::ProbeAnswer(times)).await;
                return Ok(());
            }
            Some(Incoming::Picture(picture)) => return self.take_picture(picture).await,
            Some(Incoming::Greeting(_)) => {
                return Err(ApiError::invalid("message", "one greeting", "another one"));
            }
            None => return Err(ApiError::invalid("message", "a field of PushRequest", "none")),
        };
        let pushed = PushedItem { what, times: self.times, clock, arrived };
        self.session.put(sequence, pushed).await?;
        self.answer(Answer::Acknowledgement(v1::PushAcknowledgement { sequence })).await;
        Ok(())
    }

    /// Requests a picture from the sender if a client wants one and the worker has none.
    async fn request_picture(&self) {
        let LinkStatus { api, camera, .. } = &self.link;
        if self.sends_detections && api.hub.take_picture_request(*camera) {
            self.answer(Answer::PictureRequest(v1::PushPictureRequest {})).await;
        }
    }

    async fn take_picture(&self, picture: v1::PushedPicture) -> Result<(), ApiError> {
        let LinkStatus { api, camera, .. } = &self.link;
        let no_picture = match convert::still_image(&api.hub.installation(), picture)? {
            Ok((still, seen)) => {
                let model = api.hub.camera(*camera).and_then(|state| state.camera);
                let size = model.map_or((0, 0), |model| (model.width(), model.height()));
                // Decoding takes some milliseconds.
                match tokio::task::spawn_blocking(move || still.pixels(size)).await {
                    Ok(Ok(pixels)) => {
                        let picture = Picture::new(size, pixels, Arc::new(seen));
                        api.hub.publish_picture(*camera, picture);
                        String::new()
                    }
                    Ok(Err(why)) => why,
                    Err(error) => error.to_string(),
                }
            }
            Err(why) => why,
        };
        Ok(self.session.picture_answered(no_picture)?)
    }

    /// Sends the camera's lens and calibration version when they have changed.
    async fn send_calibration(&mut self) {
        let state = self.link.api.hub.camera(self.link.camera);
        let newest = state.and_then(|state| convert::pushed_calibration(&state));
        if let Some(calibration) = newest.filter(|it| self.sent_calibration.as_ref() != Some(it)) {
            self.sent_calibration = Some(calibration.clone());
            self.answer(Answer::Calibration(calibration)).await;
        }
    }
}

impl From<WireFieldError> for ApiError {
    fn from(WireFieldError { field, expected, found }: WireFieldError) -> Self {
        Self::InvalidArgument { field, expected, found }
    }
}

impl From<PushError> for ApiError {
    fn from(error: PushError) -> Self {
        match error {
            PushError::Taken { .. } | PushError::Closed => {
                Self::FailedPrecondition(error.to_string())
            }
            PushError::Superseded => Self::Aborted(error.to_string()),
            PushError::Sequence => Self::invalid("sequence", "a number from 1", 0),
        }
    }
}

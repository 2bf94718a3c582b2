//! gRPC's `Push`: frames and detections of remote programs, into the ports of their cameras.

use std::{net::SocketAddr, sync::Arc};

use futures::{Stream, StreamExt, stream};
use roundel_core::id::CameraId;
use roundel_proto::v1::{
    self, push_request::Message as Incoming, push_response::Message as Answer,
    push_server::PushServer,
};
use tokio::sync::mpsc;
use tonic::{Request, Response, Status, Streaming};

use super::{
    ApiState,
    error::{ApiError, SHUTTING_DOWN},
    queries,
};
use crate::{
    capture::{
        push_messages::{self as convert, WireFieldError},
        source::push::{
            PushEndpoint, PushError, PushedItem, SenderClock, SenderHello, SenderSession,
        },
    },
    model::hub::Picture,
};

/// Largest message: a grey picture of 5000 x 3000 pixels fits.
const MAX_MESSAGE_BYTES: usize = 16 * 1024 * 1024;
/// Answers that wait for a sender that does not read; its own messages are not read then either.
const ANSWERS: usize = 16;
/// A longer name than this is cut.
const MAX_NAME: usize = 80;

/// Who connects, as an extension of each request.
#[derive(Clone, Copy, Debug)]
pub struct PeerAddress(pub SocketAddr);

#[derive(Clone)]
pub struct Service {
    api: Arc<ApiState>,
}

pub fn service(api: &Arc<ApiState>) -> PushServer<Service> {
    PushServer::new(Service { api: api.clone() }).max_decoding_message_size(MAX_MESSAGE_BYTES)
}

type Answers = std::pin::Pin<Box<dyn Stream<Item = Result<v1::PushResponse, Status>> + Send>>;

#[tonic::async_trait]
impl v1::push_server::Push for Service {
    type SendStream = Answers;

    async fn send(
        &self,
        request: Request<Streaming<v1::PushRequest>>,
    ) -> Result<Response<Self::SendStream>, Status> {
        let peer = request.extensions().get::<PeerAddress>().copied();
        let (answers, receiver) = mpsc::channel(ANSWERS);
        let api = self.api.clone();
        tokio::spawn(async move {
            let session = serve_sender(&api, request.into_inner(), peer, &answers);
            let outcome = tokio::select! {
                outcome = session => outcome,
                () = api.cancel.cancelled() => Err(Status::unavailable(SHUTTING_DOWN)),
                // The sender has gone: nobody reads the answers any more.
                () = answers.closed() => return,
            };
            if let Err(status) = outcome {
                // A sender that has gone is told nothing.
                let _ = answers.send(Err(status)).await;
            }
        });
        let answers = stream::unfold(receiver, |mut receiver| async move {
            let answer = receiver.recv().await?;
            Some((answer, receiver))
        });
        Ok(Response::new(answers.boxed()))
    }
}

/// Takes messages until their end.
async fn serve_sender(
    api: &ApiState,
    mut messages: Streaming<v1::PushRequest>,
    peer: Option<PeerAddress>,
    answers: &mpsc::Sender<Result<v1::PushResponse, Status>>,
) -> Result<(), Status> {
    let Some(v1::PushRequest { message: Some(Incoming::Greeting(greeting)) }) =
        messages.message().await?
    else {
        return Err(ApiError::invalid("message", "a greeting first", "something else").into());
    };
    let (camera, endpoint) = endpoint(api, &greeting.camera)?;
    let times = convert::sender_clock(greeting.times).map_err(ApiError::from)?;
    let session = endpoint.connect(&read(&greeting, times, peer)).map_err(ApiError::from)?;
    let lease = CameraLease { api, camera, endpoint, session: Some(session) };
    lease.show();
    let endpoint = lease.endpoint.clone();
    let session =
        PushSession { lease, times, answers, sent_calibration: None, sends_detections: false };
    tokio::select! {
        outcome = session.run(&mut messages) => outcome,
        () = endpoint.closed() => Err(ApiError::from(PushError::Closed).into()),
    }
}

fn read(greeting: &v1::PushGreeting, times: SenderClock, peer: Option<PeerAddress>) -> SenderHello {
    let name: String = greeting.sender.chars().take(MAX_NAME).collect();
    SenderHello {
        sender: if name.trim().is_empty() { "a program".to_owned() } else { name },
        address: peer.map_or_else(|| "unknown address".to_owned(), |peer| peer.0.to_string()),
        run_id: greeting.run_id.chars().take(MAX_NAME).collect(),
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
            "camera {name:?} takes its frames from `{source}`: only one with source = \"push:\" can be fed"
        ))
    })?;
    Ok((id, endpoint))
}

/// A sender's hold on a camera, shown in the hub to its very end: a connection may break at any await.
struct CameraLease<'a> {
    api: &'a ApiState,
    camera: CameraId,
    endpoint: Arc<PushEndpoint>,
    /// Until the end.
    session: Option<SenderSession>,
}

impl CameraLease<'_> {
    /// Shows who feeds the camera, and how that goes.
    fn show(&self) {
        let link = self.endpoint.link();
        self.api.hub.update_camera(self.camera, |state| state.link = Some(link));
    }

    fn session(&self) -> Result<&SenderSession, PushError> {
        self.session.as_ref().ok_or(PushError::Superseded)
    }
}

impl Drop for CameraLease<'_> {
    fn drop(&mut self) {
        self.session = None;
        self.show();
    }
}

struct PushSession<'a> {
    lease: CameraLease<'a>,
    times: SenderClock,
    answers: &'a mpsc::Sender<Result<v1::PushResponse, Status>>,
    /// What the sender was told of the camera's lens.
    sent_calibration: Option<v1::PushedCalibration>,
    /// Of pictures, the worker has them.
    sends_detections: bool,
}

impl PushSession<'_> {
    async fn answer(&self, message: Answer) {
        // A sender that has gone ends the whole conversation elsewhere.
        let _ = self.answers.send(Ok(v1::PushResponse { message: Some(message) })).await;
    }

    async fn run(mut self, messages: &mut Streaming<v1::PushRequest>) -> Result<(), Status> {
        let session = self.lease.session().map_err(ApiError::from)?;
        let welcome = v1::PushWelcome {
            source_id: self.lease.api.hub.installation().source_id.clone(),
            newest_sequence: session.newest_sequence,
            late_window_ms: self.lease.api.late_window_ms,
        };
        self.answer(Answer::Welcome(welcome)).await;
        self.send_calibration().await;
        while let Some(request) = messages.message().await? {
            self.take(request).await?;
            self.lease.show();
            self.send_calibration().await;
            self.request_picture().await;
        }
        Ok(())
    }

    async fn take(&mut self, request: v1::PushRequest) -> Result<(), ApiError> {
        let arrived = self.lease.api.clock.now();
        let (sequence, (what, clock)) = match request.message {
            Some(Incoming::Frame(frame)) => (frame.sequence, convert::frame(frame)?),
            Some(Incoming::Observations(seen)) => {
                self.sends_detections = true;
                (
                    seen.sequence,
                    convert::pushed_detections(&self.lease.api.hub.installation(), seen)?,
                )
            }
            Some(Incoming::Trouble(v1::PushedTrouble { error })) => {
                return Ok(self.lease.session()?.report_failure(error)?);
            }
            Some(Incoming::Probe(probe)) => {
                let known = [probe.round_trip_ms, probe.clock_deviation_ms];
                self.lease.session()?.keep_alive(probe.next_sequence, known)?;
                let replied_time_ns = self.lease.api.clock.now().as_ns();
                let (sent_time_ns, received_time_ns) = (probe.sent_time_ns, arrived.as_ns());
                let times = v1::PushProbeAnswer { sent_time_ns, received_time_ns, replied_time_ns };
                self.answer(Answer::ProbeAnswer(times)).await;
                return Ok(());
            }
            Some(Incoming::Picture(picture)) => return self.take_picture(picture).await,
            Some(Incoming::Greeting(_)) => {
                return Err(ApiError::invalid("message", "one greeting", "another one"));
            }
            None => {
                return Err(ApiError::invalid("message", "what PushRequest knows", "nothing"));
            }
        };
        let pushed = PushedItem { what, times: self.times, clock, arrived };
        self.lease.session()?.put(sequence, pushed).await?;
        self.answer(Answer::Acknowledgement(v1::PushAcknowledgement { sequence })).await;
        Ok(())
    }

    /// Whoever sees what the camera sees has to be asked for a picture, if somebody wants one.
    async fn request_picture(&self) {
        let CameraLease { api, camera, .. } = &self.lease;
        if self.sends_detections && api.hub.take_picture_request(*camera) {
            self.answer(Answer::PictureRequest(v1::PushPictureRequest {})).await;
        }
    }

    async fn take_picture(&self, picture: v1::PushedPicture) -> Result<(), ApiError> {
        let CameraLease { api, camera, .. } = &self.lease;
        let no_picture = match convert::still_image(&api.hub.installation(), picture)? {
            Ok((still, seen)) => {
                let model = api.hub.camera(*camera).and_then(|state| state.camera);
                let size = model.map_or((0, 0), |model| (model.width(), model.height()));
                // Some milliseconds, which others should not wait for.
                let pixels = tokio::task::spawn_blocking(move || still.pixels(size)).await;
                let pixels = pixels.unwrap_or_else(|error| Err(error.to_string()));
                pixels.map(|pixels| {
                    let picture = Picture::new(size, pixels, Arc::new(seen));
                    api.hub.publish_picture(*camera, picture);
                })
            }
            Err(why) => Err(why),
        };
        Ok(self.lease.session()?.picture_answered(no_picture.err().unwrap_or_default())?)
    }

    /// Tells the lens and the place's version, where they are new.
    async fn send_calibration(&mut self) {
        let mut newest = None;
        self.lease.api.hub.update_camera(self.lease.camera, |state| {
            newest = convert::pushed_calibration(state);
        });
        if let Some(calibration) =
            newest.filter(|newest| self.sent_calibration.as_ref() != Some(newest))
        {
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
            PushError::Taken { .. } => Self::FailedPrecondition(error.to_string()),
            PushError::Superseded => Self::Aborted(error.to_string()),
            PushError::Closed => Self::FailedPrecondition(error.to_string()),
            PushError::Sequence => Self::invalid("sequence", "a number from 1", 0),
        }
    }
}

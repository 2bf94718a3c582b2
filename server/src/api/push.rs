//! gRPC's `Push`: frames and detections of remote programs, into the ports of their cameras.

use std::{net::SocketAddr, sync::Arc};

use futures::{Stream, StreamExt, stream};
use roundel_core::id::CameraId;
use roundel_proto::v1::{
    self, push_request::Message as Asked, push_response::Message as Answer, push_server::PushServer,
};
use tokio::sync::mpsc;
use tonic::{Request, Response, Status, Streaming};

use super::{
    Api,
    error::{ApiError, SHUTTING_DOWN},
    queries,
};
use crate::{
    capture::{
        push_messages::{self as convert, WireError},
        source::push::{Attachment, Greeting, Port, PushError, Pushed, Times},
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
pub struct Peer(pub SocketAddr);

/// Takes what is pushed.
#[derive(Clone)]
pub struct Service {
    api: Arc<Api>,
}

/// The service, for the router.
pub fn service(api: &Arc<Api>) -> PushServer<Service> {
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
        let peer = request.extensions().get::<Peer>().copied();
        let (answers, receiver) = mpsc::channel(ANSWERS);
        let api = self.api.clone();
        tokio::spawn(async move {
            let talk = converse(&api, request.into_inner(), peer, &answers);
            let outcome = tokio::select! {
                outcome = talk => outcome,
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
async fn converse(
    api: &Api,
    mut messages: Streaming<v1::PushRequest>,
    peer: Option<Peer>,
    answers: &mpsc::Sender<Result<v1::PushResponse, Status>>,
) -> Result<(), Status> {
    let Some(v1::PushRequest { message: Some(Asked::Greeting(greeting)) }) =
        messages.message().await?
    else {
        return Err(ApiError::invalid("message", "a greeting first", "something else").into());
    };
    let (camera, port) = port(api, &greeting.camera)?;
    let times = convert::times(greeting.times).map_err(ApiError::from)?;
    let attachment = port.attach(&read(&greeting, times, peer)).map_err(ApiError::from)?;
    let hold = Hold { api, camera, port, attachment: Some(attachment) };
    hold.show();
    let port = hold.port.clone();
    let talk = Talk { hold, times, answers, told: None, sends_detections: false };
    tokio::select! {
        outcome = talk.welcome_and_take(&mut messages) => outcome,
        () = port.closed() => Err(ApiError::from(PushError::Closed).into()),
    }
}

fn read(greeting: &v1::PushGreeting, times: Times, peer: Option<Peer>) -> Greeting {
    let name: String = greeting.sender.chars().take(MAX_NAME).collect();
    Greeting {
        sender: if name.trim().is_empty() { "a program".to_owned() } else { name },
        address: peer.map_or_else(|| "unknown address".to_owned(), |peer| peer.0.to_string()),
        run_id: greeting.run_id.chars().take(MAX_NAME).collect(),
        times,
        next_sequence: greeting.next_sequence,
        dropped: greeting.dropped,
    }
}

fn port(api: &Api, name: &str) -> Result<(CameraId, Arc<Port>), ApiError> {
    let id = queries::camera_id(api, name)?;
    let port = api.ports.get(id);
    let port = port.ok_or_else(|| {
        let installation = api.hub.installation();
        let source = installation.cameras.get(&id).map_or("", |info| &info.source);
        ApiError::FailedPrecondition(format!(
            "camera {name:?} takes its frames from `{source}`: only one with source = \"push:\" can be fed"
        ))
    })?;
    Ok((id, port))
}

/// A sender's hold on a camera, shown in the hub to its very end: a connection may break at any await.
struct Hold<'a> {
    api: &'a Api,
    camera: CameraId,
    port: Arc<Port>,
    /// Until the end.
    attachment: Option<Attachment>,
}

impl Hold<'_> {
    /// Shows who feeds the camera, and how that goes.
    fn show(&self) {
        let link = self.port.link();
        self.api.hub.update_camera(self.camera, |state| state.link = Some(link));
    }

    fn attachment(&self) -> Result<&Attachment, PushError> {
        self.attachment.as_ref().ok_or(PushError::Superseded)
    }
}

impl Drop for Hold<'_> {
    fn drop(&mut self) {
        self.attachment = None;
        self.show();
    }
}

/// One sender's connection.
struct Talk<'a> {
    hold: Hold<'a>,
    times: Times,
    answers: &'a mpsc::Sender<Result<v1::PushResponse, Status>>,
    /// What the sender was told of the camera's lens.
    told: Option<v1::PushedCalibration>,
    /// Of pictures, the worker has them.
    sends_detections: bool,
}

impl Talk<'_> {
    async fn answer(&self, message: Answer) {
        // A sender that has gone ends the whole conversation elsewhere.
        let _ = self.answers.send(Ok(v1::PushResponse { message: Some(message) })).await;
    }

    async fn welcome_and_take(
        mut self,
        messages: &mut Streaming<v1::PushRequest>,
    ) -> Result<(), Status> {
        let attachment = self.hold.attachment().map_err(ApiError::from)?;
        let welcome = v1::PushWelcome {
            source_id: self.hold.api.hub.installation().source_id.clone(),
            newest_sequence: attachment.newest_sequence,
            late_window_ms: self.hold.api.late_window_ms,
        };
        self.answer(Answer::Welcome(welcome)).await;
        self.tell_calibration().await;
        while let Some(request) = messages.message().await? {
            self.take(request).await?;
            self.hold.show();
            self.tell_calibration().await;
            self.ask_for_picture().await;
        }
        Ok(())
    }

    async fn take(&mut self, request: v1::PushRequest) -> Result<(), ApiError> {
        let arrived = self.hold.api.clock.now();
        let (sequence, (what, clock)) = match request.message {
            Some(Asked::Frame(frame)) => (frame.sequence, convert::frame(frame)?),
            Some(Asked::Observations(seen)) => {
                self.sends_detections = true;
                (seen.sequence, convert::seen(&self.hold.api.hub.installation(), seen)?)
            }
            Some(Asked::Trouble(v1::PushedTrouble { error })) => {
                return Ok(self.hold.attachment()?.trouble(error)?);
            }
            Some(Asked::Probe(probe)) => {
                let known = [probe.round_trip_ms, probe.clock_deviation_ms];
                self.hold.attachment()?.probe(probe.next_sequence, known)?;
                let replied_time_ns = self.hold.api.clock.now().as_ns();
                let (sent_time_ns, received_time_ns) = (probe.sent_time_ns, arrived.as_ns());
                let times = v1::PushProbeAnswer { sent_time_ns, received_time_ns, replied_time_ns };
                self.answer(Answer::ProbeAnswer(times)).await;
                return Ok(());
            }
            Some(Asked::Picture(picture)) => return self.take_picture(picture).await,
            Some(Asked::Greeting(_)) => {
                return Err(ApiError::invalid("message", "one greeting", "another one"));
            }
            None => {
                return Err(ApiError::invalid("message", "what PushRequest knows", "nothing"));
            }
        };
        let pushed = Pushed { what, times: self.times, clock, arrived };
        self.hold.attachment()?.put(sequence, pushed).await?;
        self.answer(Answer::Acknowledgement(v1::PushAcknowledgement { sequence })).await;
        Ok(())
    }

    /// Whoever sees what the camera sees has to be asked for a picture, if somebody wants one.
    async fn ask_for_picture(&self) {
        let Hold { api, camera, .. } = &self.hold;
        if self.sends_detections && api.hub.take_picture_request(*camera) {
            self.answer(Answer::PictureRequest(v1::PushPictureRequest {})).await;
        }
    }

    async fn take_picture(&self, picture: v1::PushedPicture) -> Result<(), ApiError> {
        let Hold { api, camera, .. } = &self.hold;
        let no_picture = match convert::still(&api.hub.installation(), picture)? {
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
        Ok(self.hold.attachment()?.pictured(no_picture.err().unwrap_or_default())?)
    }

    /// Tells the lens and the place's version, where they are new.
    async fn tell_calibration(&mut self) {
        let mut newest = None;
        self.hold.api.hub.update_camera(self.hold.camera, |state| {
            newest = convert::pushed_calibration(state);
        });
        if let Some(calibration) = newest.filter(|newest| self.told.as_ref() != Some(newest)) {
            self.told = Some(calibration.clone());
            self.answer(Answer::Calibration(calibration)).await;
        }
    }
}

impl From<WireError> for ApiError {
    fn from(WireError { field, expected, found }: WireError) -> Self {
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

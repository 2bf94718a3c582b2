//! The connection to a server, and its calls.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use futures::{Stream, StreamExt};
use tonic::{
    Code, Status, Streaming,
    transport::{Channel, Endpoint},
};

use crate::{
    Error, Snapshots, Subscription, address,
    deadline::{Deadline, Service},
    error::chain,
    v1::{self, roundel_client::RoundelClient},
};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// A server that is silent for so long is asked whether it lives, and has as long to answer.
const KEEP_ALIVE: Duration = Duration::from_secs(5);
/// What may be under way to a client that does not read: some snapshots, and not seconds of them,
/// so that it finds the newest when it comes back.
const STREAM_WINDOW_BYTES: u32 = 256 * 1024;
/// The same for all streams of a connection.
const CONNECTION_WINDOW_BYTES: u32 = 1024 * 1024;
/// Largest message; a snapshot of 10,000 objects with covariances takes 5 MB.
const MAX_MESSAGE_BYTES: usize = 64 * 1024 * 1024;

/// A connection to a Roundel server. Clones share it; it comes back by itself.
#[derive(Clone, Debug)]
pub struct Client {
    address: String,
    channel: Channel,
    /// As it was told; `None`: as is usual for each call.
    timeout: Option<Duration>,
}

impl Client {
    /// Connects to `http://HOST:PORT`, and makes sure that a Roundel server is there.
    ///
    /// # Errors
    /// [`Error::InvalidAddress`], [`Error::Unreachable`], [`Error::NotRoundel`], [`Error::TimedOut`], or
    /// [`Error::Server`] when it has no room.
    pub async fn connect(address: &str) -> Result<Self, Error> {
        let (address, endpoint) = address::endpoint(address)?;
        let endpoint = configured(endpoint);
        let channel = endpoint.connect().await.map_err(|error| Error::Unreachable {
            address: address.clone(),
            reason: chain(&error),
        })?;
        let client = Self::over(channel, address);
        client.greet().await?;
        Ok(client)
    }

    /// A client whose server may come up later: nothing is asked of it before the first call.
    ///
    /// # Errors
    /// [`Error::InvalidAddress`].
    pub fn connect_lazily(address: &str) -> Result<Self, Error> {
        let (address, endpoint) = address::endpoint(address)?;
        Ok(Self::over(configured(endpoint).connect_lazy(), address))
    }

    fn over(channel: Channel, address: String) -> Self {
        Self { address, channel, timeout: None }
    }

    /// The same connection, on which all calls with one answer wait so long for it, and then end with
    /// [`Error::TimedOut`]. The server gives up at the same time. Streams go on for as long as they like.
    ///
    /// If nobody says otherwise it is 15 s, and 60 s where the server opens, writes or searches something:
    /// [`test_source`](Self::test_source), [`add_camera`](Self::add_camera), [`change_camera`](Self::change_camera),
    /// [`remove_camera`](Self::remove_camera), [`apply_configuration`](Self::apply_configuration),
    /// [`stop_recording`](Self::stop_recording), [`history`](Self::history).
    pub fn with_timeout(mut self, timeout: Duration) -> Self {
        self.timeout = Some(timeout);
        self
    }

    /// Asks for the server's name, to tell a wrong port from a server with a bad day.
    async fn greet(&self) -> Result<(), Error> {
        let Err(status) = self.service().get_server_info(v1::GetServerInfoRequest {}).await else {
            return Ok(());
        };
        let is_foreign =
            matches!(status.code(), Code::Unimplemented | Code::Unknown | Code::Internal)
                || (status.code() == Code::Unavailable
                    && std::error::Error::source(&status).is_none());
        if is_foreign || speaks_no_http2(&status) {
            let reason = chain(&status);
            return Err(Error::NotRoundel { address: self.address.clone(), reason });
        }
        Err(self.error(&status))
    }

    /// The server's address, as `http://HOST:PORT`.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Snapshots from the newest one on, through losses of the connection.
    pub fn snapshots(&self, subscription: Subscription) -> Snapshots {
        Snapshots::new(self.clone(), subscription)
    }

    /// The newest snapshot, once.
    ///
    /// # Errors
    /// [`Error::Server`] before the first one.
    pub async fn snapshot(&self) -> Result<v1::Snapshot, Error> {
        self.snapshot_of(Subscription::default()).await
    }

    /// What the newest snapshot holds of what is wanted, once; a rate means nothing here.
    ///
    /// # Errors
    /// [`Error::Server`] before the first one, and [`Error::Refused`] with the field that is wrong.
    pub async fn snapshot_of(&self, subscription: Subscription) -> Result<v1::Snapshot, Error> {
        let answer = self.service().get_snapshot(subscription.into_single_request()).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Every object of now and of the last minute, by id.
    ///
    /// # Errors
    /// Of the connection.
    pub async fn objects(&self) -> Result<Vec<v1::Object>, Error> {
        let answer = self.service().list_objects(v1::ListObjectsRequest {}).await;
        answer.map(|list| list.into_inner().objects).map_err(|status| self.error(&status))
    }

    /// Every camera, in the order of the server's configuration, as it is now: how it does, where it is
    /// (`pose`, with `pose_status` and `pose_reason` while that is not known), and what is known of its
    /// clock (`clock`: how late its stamps are in milliseconds, by how much more each second in parts per
    /// million, and the deviation of that). [`crate::camera_pose_at`] follows one that rides on an object.
    ///
    /// # Errors
    /// Of the connection.
    pub async fn cameras(&self) -> Result<Vec<v1::Camera>, Error> {
        let answer = self.service().list_cameras(v1::ListCamerasRequest {}).await;
        answer.map(|list| list.into_inner().cameras).map_err(|status| self.error(&status))
    }

    /// What a camera sees, as a JPEG file with what was found drawn in; waits up to a second for a new frame.
    ///
    /// # Errors
    /// [`Error::Refused`] for a camera that does not exist, [`Error::Server`] for one that gave no frame, and those of the
    /// connection.
    pub async fn picture(&self, camera: &str) -> Result<v1::CameraPicture, Error> {
        let request = v1::GetPictureRequest { camera: camera.to_owned() };
        let answer = self.service().get_picture(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Has the server open a source for about two seconds and say what it gives; `error` in the answer says why one
    /// fails. No size: as its pictures come.
    ///
    /// # Errors
    /// [`Error::Refused`] for an address that is none, while another one is tried, or by a server that tries none for
    /// its clients; and those of the connection.
    pub async fn test_source(
        &self,
        source: &str,
        size: Option<[u32; 2]>,
    ) -> Result<v1::SourceTest, Error> {
        let [width, height] = size.unwrap_or_default();
        let request = v1::TestSourceRequest { source: source.to_owned(), width, height };
        let answer = self.long_service().test_source(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// What the server says of itself.
    ///
    /// # Errors
    /// Of the connection.
    pub async fn info(&self) -> Result<v1::ServerInfo, Error> {
        let answer = self.service().get_server_info(v1::GetServerInfoRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Events from now on, after the newest `backlog` remembered ones (up to 1000). The stream ends
    /// with an error when the connection is lost; a gap in `sequence` is what was missed.
    ///
    /// [`v1::EventKind`] lists what can happen to objects, cameras, the configuration, calibrations and recordings;
    /// `message` says it in a sentence. A newer server may send kinds that this client does not know: `kind()` is
    /// `Unspecified` then.
    ///
    /// # Errors
    /// [`Error::Refused`] for too long a backlog, and those of the connection.
    pub async fn events(&self, backlog: u32) -> Result<Messages<v1::Event>, Error> {
        let request = v1::SubscribeEventsRequest { backlog };
        let answer = self.streams().subscribe_events(request).await;
        Ok(self.messages(answer.map_err(|status| self.error(&status))?.into_inner()))
    }

    /// What the cameras of these names see, frame by frame from now on; no names: all cameras. The
    /// stream ends with an error when the connection is lost.
    ///
    /// # Errors
    /// [`Error::Refused`] for a camera that does not exist, and those of the connection.
    pub async fn observations(
        &self,
        cameras: &[&str],
    ) -> Result<Messages<v1::FrameObservations>, Error> {
        let cameras = cameras.iter().map(|&name| name.to_owned()).collect();
        let request = v1::SubscribeObservationsRequest { cameras };
        let answer = self.streams().subscribe_observations(request).await;
        Ok(self.messages(answer.map_err(|status| self.error(&status))?.into_inner()))
    }

    /// What the cameras of these names saw in their newest frames, once; no names: all cameras. A camera that has given
    /// no frame yet is not among them.
    ///
    /// # Errors
    /// As of [`Client::observations`].
    pub async fn newest_observations(
        &self,
        cameras: &[&str],
    ) -> Result<Vec<v1::FrameObservations>, Error> {
        let cameras = cameras.iter().map(|&name| name.to_owned()).collect();
        let answer = self.service().get_observations(v1::GetObservationsRequest { cameras }).await;
        answer.map(|frames| frames.into_inner().frames).map_err(|status| self.error(&status))
    }

    pub(crate) async fn subscribe(
        &self,
        request: v1::SubscribeSnapshotsRequest,
    ) -> Result<Streaming<v1::Snapshot>, Error> {
        let answer = self.streams().subscribe_snapshots(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// For one call with one answer: a handle on the connection.
    pub(crate) fn service(&self) -> Service {
        self.handle(Deadline::usual(self.timeout))
    }

    /// The same for a call for which the server opens, writes or searches something.
    pub(crate) fn long_service(&self) -> Service {
        self.handle(Deadline::long(self.timeout))
    }

    /// For one call with a stream of answers.
    pub(crate) fn streams(&self) -> Service {
        self.handle(Deadline::NEVER)
    }

    fn handle(&self, deadline: Deadline) -> Service {
        let service = RoundelClient::with_interceptor(self.channel.clone(), deadline);
        service.max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub(crate) fn error(&self, status: &Status) -> Error {
        Error::from_status(&self.address, status)
    }

    pub(crate) fn messages<T>(&self, received: Streaming<T>) -> Messages<T> {
        Messages { address: self.address.clone(), received }
    }
}

/// Messages of one call; the end of the connection is the end of the stream.
#[derive(Debug)]
pub struct Messages<T> {
    address: String,
    received: Streaming<T>,
}

impl<T> Stream for Messages<T> {
    type Item = Result<T, Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let polled = self.received.poll_next_unpin(context);
        polled.map_err(|status| Error::from_status(&self.address, &status))
    }
}

fn configured(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_TIMEOUT)
        .tcp_nodelay(true)
        .http2_keep_alive_interval(KEEP_ALIVE)
        .keep_alive_timeout(KEEP_ALIVE)
        .keep_alive_while_idle(true)
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
}

/// A server of something else hangs up on HTTP/2's greeting or answers it with other bytes.
fn speaks_no_http2(status: &Status) -> bool {
    let said = chain(status);
    said.contains("http2 error") || said.contains("frame with invalid size")
}

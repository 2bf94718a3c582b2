//! The connection to a server, and its calls.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use futures::{Stream, StreamExt};
use tonic::{
    Code, Response, Status, Streaming,
    metadata::{Ascii, MetadataValue},
    transport::{Channel, Endpoint},
};

use crate::{
    ConnectOptions, Error, Snapshots, Subscription,
    call_headers::{CallHeaders, Deadline, Service},
    connector::Connector,
    error::error_chain,
    v1::{self, roundel_client::RoundelClient},
};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval of keep-alive pings to a silent server, and the time that it has to answer.
const KEEP_ALIVE: Duration = Duration::from_secs(5);
/// Flow-control window: limits the old snapshots that are buffered for a slow reader.
const STREAM_WINDOW_BYTES: u32 = 256 * 1024;
const CONNECTION_WINDOW_BYTES: u32 = 1024 * 1024;
/// A snapshot of some hundred objects fits into one frame, which the server sends with one write.
const MAX_FRAME_BYTES: u32 = 64 * 1024;
/// Limit for one message. A snapshot of 10,000 objects with covariances takes 5 MB.
const MAX_MESSAGE_BYTES: usize = 64 * 1024 * 1024;

/// A connection to a Roundel server, restored automatically when it is lost. Clones share it.
#[derive(Clone, Debug)]
pub struct Client {
    connector: Connector,
    channel: Channel,
    /// The value of the header `authorization`.
    authorization: Option<MetadataValue<Ascii>>,
    /// `None` stands for the default of each call.
    timeout: Option<Duration>,
}

impl Client {
    /// Connects to `http://HOST:PORT` or `https://HOST:PORT` and checks that a Roundel server answers.
    ///
    /// # Errors
    /// [`Error::InvalidAddress`], [`Error::Unreachable`], [`Error::NotRoundel`], [`Error::TimedOut`],
    /// [`Error::Untrusted`], [`Error::Unauthenticated`], or [`Error::Server`] if it serves its maximum number of clients.
    pub async fn connect(address: &str) -> Result<Self, Error> {
        Self::connect_with(address, &ConnectOptions::default()).await
    }

    /// Like [`Client::connect`], with trust in other authorities, a client certificate or a token.
    ///
    /// # Errors
    /// As for [`Client::connect`]; [`Error::InvalidOption`] and [`Error::WrongFingerprint`].
    pub async fn connect_with(address: &str, options: &ConnectOptions) -> Result<Self, Error> {
        let connector = Connector::new(address, options)?.configure(configure);
        let authorization = options.authorization()?;
        let channel = connector.connect().await;
        let channel = channel.map_err(|error| Error::from_transport(&connector.address, &error))?;
        let client = Self { connector, channel, authorization, timeout: None };
        client.verify_server().await?;
        Ok(client)
    }

    /// A client that connects on the first call, so its server may come up later.
    ///
    /// # Errors
    /// [`Error::InvalidAddress`].
    pub fn connect_lazily(address: &str) -> Result<Self, Error> {
        Self::connect_lazily_with(address, &ConnectOptions::default())
    }

    /// Like [`Client::connect_lazily`], with trust in other authorities, a client certificate or a token.
    ///
    /// # Errors
    /// [`Error::InvalidAddress`] and [`Error::InvalidOption`].
    pub fn connect_lazily_with(address: &str, options: &ConnectOptions) -> Result<Self, Error> {
        let connector = Connector::new(address, options)?.configure(configure);
        let authorization = options.authorization()?;
        let channel = connector.connect_lazily();
        Ok(Self { connector, channel, authorization, timeout: None })
    }

    /// The same connection with another timeout for unary calls, after which they end with [`Error::TimedOut`], also on the
    /// server. Streams have no timeout.
    ///
    /// The default is 15 s, and 60 s where the server opens, writes or searches something:
    /// [`test_source`](Self::test_source), [`add_camera`](Self::add_camera), [`change_camera`](Self::change_camera),
    /// [`remove_camera`](Self::remove_camera), [`apply_configuration`](Self::apply_configuration),
    /// [`stop_recording`](Self::stop_recording), [`history`](Self::history).
    pub fn with_timeout(mut self, timeout: Duration) -> Self {
        self.timeout = Some(timeout);
        self
    }

    /// Requests the server's name, to distinguish a wrong port from a server that cannot answer now.
    async fn verify_server(&self) -> Result<(), Error> {
        let Err(status) = self.service().get_server_info(v1::GetServerInfoRequest {}).await else {
            return Ok(());
        };
        let is_foreign =
            matches!(status.code(), Code::Unimplemented | Code::Unknown | Code::Internal)
                || (status.code() == Code::Unavailable
                    && std::error::Error::source(&status).is_none());
        if !is_tls_alert(&status) && (is_foreign || is_not_http2(&status)) {
            let reason = error_chain(&status);
            return Err(Error::NotRoundel { address: self.connector.address.clone(), reason });
        }
        Err(self.error(&status))
    }

    /// The server's address, as `http://HOST:PORT` or `https://HOST:PORT`.
    pub fn address(&self) -> &str {
        &self.connector.address
    }

    pub(crate) fn connector(&self) -> &Connector {
        &self.connector
    }

    /// Snapshots from the newest one on. Reconnects automatically.
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

    /// The newest snapshot with the filters of a subscription, once. Ignores its rate.
    ///
    /// # Errors
    /// [`Error::Server`] before the first one, and [`Error::Refused`] with the invalid field.
    pub async fn snapshot_of(&self, subscription: Subscription) -> Result<v1::Snapshot, Error> {
        self.response(self.service().get_snapshot(subscription.into_single_request()).await)
    }

    /// Every current object and those of the last minute, by id.
    ///
    /// # Errors
    /// Connection errors.
    pub async fn objects(&self) -> Result<Vec<v1::Object>, Error> {
        let answer = self.service().list_objects(v1::ListObjectsRequest {}).await;
        answer.map(|list| list.into_inner().objects).map_err(|status| self.error(&status))
    }

    /// Every camera, in the order of the configuration: its state, its `pose` (or `pose_status` and `pose_reason` while it
    /// is unknown), and the offset, skew and deviation of its `clock`. [`crate::camera_pose_at`] gives the pose of a
    /// camera that is mounted on an object.
    ///
    /// # Errors
    /// Connection errors.
    pub async fn cameras(&self) -> Result<Vec<v1::Camera>, Error> {
        let answer = self.service().list_cameras(v1::ListCamerasRequest {}).await;
        answer.map(|list| list.into_inner().cameras).map_err(|status| self.error(&status))
    }

    /// A camera's picture as a JPEG file with the detections drawn in. Waits up to a second for a new frame.
    ///
    /// # Errors
    /// [`Error::Refused`] if the camera does not exist, [`Error::Server`] without a frame, and connection errors.
    pub async fn picture(&self, camera: &str) -> Result<v1::CameraPicture, Error> {
        let request = v1::GetPictureRequest { camera: camera.to_owned() };
        self.response(self.service().get_picture(request).await)
    }

    /// Has the server open a source for about two seconds and report the frames it gives, or the `error`. Without a size,
    /// frames keep their own.
    ///
    /// # Errors
    /// [`Error::Refused`] for an invalid address, during another test, or if the server does not let clients test sources;
    /// and connection errors.
    pub async fn test_source(
        &self,
        source: &str,
        size: Option<[u32; 2]>,
    ) -> Result<v1::SourceTest, Error> {
        let [width, height] = size.unwrap_or_default();
        let request = v1::TestSourceRequest { source: source.to_owned(), width, height };
        self.response(self.long_service().test_source(request).await)
    }

    /// Name, version and state of the server.
    ///
    /// # Errors
    /// Connection errors.
    pub async fn info(&self) -> Result<v1::ServerInfo, Error> {
        self.response(self.service().get_server_info(v1::GetServerInfoRequest {}).await)
    }

    /// The newest `backlog` remembered events (up to 1000), then every new one. The stream ends with an error when the
    /// connection is lost. A gap in `sequence` means missed events.
    ///
    /// [`v1::EventKind`] lists the kinds of events; `message` describes one in a sentence. Kinds that a newer server has
    /// added appear as `Unspecified`.
    ///
    /// # Errors
    /// [`Error::Refused`] if the backlog is too long, and connection errors.
    pub async fn events(&self, backlog: u32) -> Result<Messages<v1::Event>, Error> {
        let request = v1::SubscribeEventsRequest { backlog };
        let answer = self.streams().subscribe_events(request).await;
        Ok(self.messages(answer.map_err(|status| self.error(&status))?.into_inner()))
    }

    /// Observations of these cameras, or of all, frame by frame. The stream ends with an error when the connection is lost.
    ///
    /// # Errors
    /// [`Error::Refused`] if a camera does not exist, and connection errors.
    pub async fn observations(
        &self,
        cameras: &[&str],
    ) -> Result<Messages<v1::FrameObservations>, Error> {
        let cameras = cameras.iter().map(|&name| name.to_owned()).collect();
        let request = v1::SubscribeObservationsRequest { cameras };
        let answer = self.streams().subscribe_observations(request).await;
        Ok(self.messages(answer.map_err(|status| self.error(&status))?.into_inner()))
    }

    /// Observations in the newest frames of these cameras, or of all, once. Omits cameras without a frame.
    ///
    /// # Errors
    /// As for [`Client::observations`].
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
        self.response(self.streams().subscribe_snapshots(request).await)
    }

    /// The stub for a unary call.
    pub(crate) fn service(&self) -> Service {
        self.stub(Deadline::unary(self.timeout))
    }

    /// The stub for a unary call for which the server opens, writes or searches something.
    pub(crate) fn long_service(&self) -> Service {
        self.stub(Deadline::long_unary(self.timeout))
    }

    /// The stub for a streaming call.
    pub(crate) fn streams(&self) -> Service {
        self.stub(Deadline::NONE)
    }

    fn stub(&self, deadline: Deadline) -> Service {
        let headers = self.headers(deadline);
        let service = RoundelClient::with_interceptor(self.channel.clone(), headers);
        service.max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub(crate) fn headers(&self, deadline: Deadline) -> CallHeaders {
        CallHeaders { deadline, authorization: self.authorization.clone() }
    }

    pub(crate) fn response<T>(&self, result: Result<Response<T>, Status>) -> Result<T, Error> {
        result.map(Response::into_inner).map_err(|status| self.error(&status))
    }

    pub(crate) fn error(&self, status: &Status) -> Error {
        Error::from_status(self.address(), status)
    }

    pub(crate) fn messages<T>(&self, received: Streaming<T>) -> Messages<T> {
        Messages { address: self.address().to_owned(), received }
    }
}

/// The messages of one streaming call. Ends with an error when the connection is lost.
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

fn configure(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_TIMEOUT)
        .tcp_nodelay(true)
        .http2_keep_alive_interval(KEEP_ALIVE)
        .keep_alive_timeout(KEEP_ALIVE)
        .keep_alive_while_idle(true)
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_frame_size(MAX_FRAME_BYTES)
}

/// A server that refuses the client's certificate sends an alert after the client has finished its handshake.
fn is_tls_alert(status: &Status) -> bool {
    error_chain(status).contains("received fatal alert")
}

/// Another kind of server closes the connection at the HTTP/2 preface, or sends other bytes.
fn is_not_http2(status: &Status) -> bool {
    let text = error_chain(status);
    text.contains("http2 error") || text.contains("frame with invalid size")
}

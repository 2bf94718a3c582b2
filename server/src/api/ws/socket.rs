//! The WebSocket handshake and the open socket (RFC 6455), on tungstenite.

use std::{future::Future, sync::Arc};

use axum::{
    body::Body,
    http::{HeaderValue, Request, Response, header},
};
use futures::{SinkExt as _, StreamExt as _};
use hyper::upgrade::{OnUpgrade, Upgraded};
use hyper_util::rt::TokioIo;
use tokio::io::AsyncWriteExt as _;
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        self, Message,
        handshake::server::create_response_with_body,
        protocol::{CloseFrame, Role, WebSocketConfig},
    },
};

use crate::api::listener::ConnectionSlot;

/// An upgrade request and its response.
pub(super) struct Handshake {
    upgraded: OnUpgrade,
    response: Response<Body>,
    slot: Option<Arc<ConnectionSlot>>,
}

impl Handshake {
    /// Checks the request. The error names what is missing.
    pub(super) fn new(mut request: Request<Body>) -> Result<Self, String> {
        let response =
            create_response_with_body(&request, Body::empty).map_err(|error| error.to_string())?;
        let slot = request.extensions_mut().remove();
        Ok(Self { upgraded: hyper::upgrade::on(&mut request), response, slot })
    }

    /// Chooses the first of the server's subprotocols that the client offers.
    pub(super) fn choose(
        &mut self,
        offered: &[String],
        supported: &[&'static str],
    ) -> Option<&'static str> {
        let chosen = supported.iter().find(|it| offered.iter().any(|offer| offer == *it))?;
        let value = HeaderValue::from_static(chosen);
        self.response.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, value);
        Some(chosen)
    }

    /// Returns the response, and serves the socket once it is sent.
    pub(super) fn answer<F: Future<Output = ()> + Send>(
        self,
        config: WebSocketConfig,
        serve: impl FnOnce(Socket) -> F + Send + 'static,
    ) -> Response<Body> {
        let Self { upgraded, slot, .. } = self;
        tokio::spawn(async move {
            match upgraded.await {
                Ok(connection) => {
                    let io = TokioIo::new(connection);
                    let stream =
                        WebSocketStream::from_raw_socket(io, Role::Server, Some(config)).await;
                    serve(Socket { stream, is_closing: false, _slot: slot }).await;
                }
                Err(error) => {
                    tracing::debug!(%error, "a client left during the WebSocket handshake")
                }
            }
        });
        self.response
    }
}

/// The subprotocols that a client offers.
pub(super) fn offered(request: &Request<Body>) -> Vec<String> {
    let values = request.headers().get_all(header::SEC_WEBSOCKET_PROTOCOL).iter();
    let lists = values.filter_map(|value| value.to_str().ok());
    lists.flat_map(|list| list.split(',').map(|one| one.trim().to_owned())).collect()
}

pub(super) struct Socket {
    stream: WebSocketStream<TokioIo<Upgraded>>,
    /// Whether the client has sent a close frame. Nothing may be sent after it.
    is_closing: bool,
    _slot: Option<Arc<ConnectionSlot>>,
}

impl Socket {
    /// The client's next message; `None` once it has left. Cancel safe.
    pub(super) async fn recv(&mut self) -> Option<Result<Message, tungstenite::Error>> {
        let message = self.stream.next().await;
        self.is_closing |= matches!(message, Some(Ok(Message::Close(_))));
        message
    }

    /// Sends a message. Not cancel safe: nothing may be sent after a cancelled call.
    pub(super) async fn send(&mut self, message: Message) -> Result<(), tungstenite::Error> {
        self.stream.send(message).await
    }

    /// Sends a close frame and reads until the client has answered or left: closing at once could reset the connection
    /// and lose the frame.
    pub(super) async fn close(&mut self, frame: CloseFrame) -> Result<(), tungstenite::Error> {
        self.send(Message::Close(Some(frame))).await?;
        while let Some(Ok(_)) = self.recv().await {}
        if self.is_closing {
            return Ok(());
        }
        // After a protocol error tungstenite reads no more.
        let connection = self.stream.get_mut();
        connection.shutdown().await?;
        tokio::io::copy(connection, &mut tokio::io::sink()).await?;
        Ok(())
    }
}

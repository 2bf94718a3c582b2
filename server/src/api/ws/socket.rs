//! A WebSocket (RFC 6455): tungstenite's, but that large messages go to the connection in the pieces that they are
//! kept in, or past both of them from memory that many share. A snapshot of 100 objects is 100 kB of JSON; copied for each
//! of 500 pages at 60 Hz that would be 3 GB a second.

use std::{future::Future, io};

use axum::{
    body::{Body, Bytes},
    http::{HeaderValue, Request, Response, header},
};
use futures::{SinkExt as _, StreamExt as _};
use hyper::upgrade::{OnUpgrade, Upgraded};
use hyper_util::rt::TokioIo;
use prost::bytes::Buf as _;
use tokio::io::AsyncWriteExt as _;
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        self, Message,
        handshake::server::create_response_with_body,
        protocol::{
            CloseFrame, Role, WebSocketConfig,
            frame::{
                FrameHeader,
                coding::{Data, OpCode},
            },
        },
    },
};

use crate::api::port::{Line, Sheet};

/// A message of a server to its client in pieces, behind one another.
#[derive(Clone, Debug)]
pub(super) struct Pieces {
    /// Whether it is text or binary.
    pub(super) kind: Data,
    /// What is one client's.
    pub(super) before: Bytes,
    /// What others get as well.
    pub(super) shared: Bytes,
    /// What ends it.
    pub(super) after: &'static [u8],
}

impl Pieces {
    /// The frame's header, which says how long they are together.
    fn head(&self) -> Vec<u8> {
        let length = (self.before.len() + self.shared.len() + self.after.len()) as u64;
        let header = FrameHeader { opcode: OpCode::Data(self.kind), ..FrameHeader::default() };
        let mut head = Vec::with_capacity(header.len(length));
        if let Err(error) = header.format(length, &mut head) {
            unreachable!("memory takes all: {error}");
        }
        head
    }

    /// All of it for many sockets.
    pub(super) fn sheet(&self) -> Sheet {
        Sheet::of([&self.head(), &self.before[..], &self.shared, self.after].concat())
    }
}

/// A request that can become a WebSocket, and the answer that makes it one.
pub(super) struct Handshake {
    upgraded: OnUpgrade,
    response: Response<Body>,
    line: Option<Line>,
}

impl Handshake {
    /// Of a request; an error says what it lacks.
    pub(super) fn of(mut request: Request<Body>) -> Result<Self, String> {
        let response =
            create_response_with_body(&request, Body::empty).map_err(|error| error.to_string())?;
        let line = request.extensions_mut().remove();
        Ok(Self { upgraded: hyper::upgrade::on(&mut request), response, line })
    }

    /// Takes the first of these subprotocols that the client, by its request's headers, speaks.
    pub(super) fn choose(
        &mut self,
        asked: &[String],
        known: &[&'static str],
    ) -> Option<&'static str> {
        let chosen = known.iter().find(|known| asked.iter().any(|asked| asked == *known))?;
        let value = HeaderValue::from_static(chosen);
        self.response.headers_mut().insert(header::SEC_WEBSOCKET_PROTOCOL, value);
        Some(chosen)
    }

    /// The answer; once it is sent, the socket is served.
    pub(super) fn answer<F: Future<Output = ()> + Send>(
        self,
        config: WebSocketConfig,
        serve: impl FnOnce(Socket) -> F + Send + 'static,
    ) -> Response<Body> {
        let Self { upgraded, line, .. } = self;
        tokio::spawn(async move {
            match upgraded.await {
                Ok(connection) => {
                    let io = TokioIo::new(connection);
                    let stream =
                        WebSocketStream::from_raw_socket(io, Role::Server, Some(config)).await;
                    serve(Socket { stream, line, is_closing: false }).await;
                }
                // The client left before it had the answer.
                Err(error) => tracing::debug!(%error, "a WebSocket did not begin"),
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

/// An open one.
pub(super) struct Socket {
    stream: WebSocketStream<TokioIo<Upgraded>>,
    /// What it goes over.
    line: Option<Line>,
    /// The client has said goodbye, after which nothing more may be sent.
    is_closing: bool,
}

impl Socket {
    /// What the client says next; `None` once it has gone. Can be given up and begun again without loss.
    pub(super) async fn recv(&mut self) -> Option<Result<Message, tungstenite::Error>> {
        let message = self.stream.next().await;
        self.is_closing |= matches!(message, Some(Ok(Message::Close(_))));
        message
    }

    /// What it goes over.
    pub(super) fn line(&self) -> Option<Line> {
        self.line.clone()
    }

    /// Says goodbye, and reads on until the client has answered, or has hung up without: otherwise the frame could be lost
    /// in a reset.
    pub(super) async fn close(&mut self, frame: CloseFrame) -> Result<(), tungstenite::Error> {
        self.send(Message::Close(Some(frame))).await?;
        while let Some(Ok(_)) = self.recv().await {}
        if self.is_closing {
            return Ok(());
        }
        // What comes is no WebSocket's, and tungstenite reads it no more.
        let connection = self.stream.get_mut();
        connection.shutdown().await?;
        tokio::io::copy(connection, &mut tokio::io::sink()).await?;
        Ok(())
    }

    /// Sends a message. To be awaited to its end, or never again.
    pub(super) async fn send(&mut self, message: Message) -> Result<(), tungstenite::Error> {
        self.stream.send(message).await
    }

    /// Sends a message that many get. To be awaited to its end, or never again.
    pub(super) async fn send_sheet(&mut self, sheet: &Sheet) -> Result<(), tungstenite::Error> {
        self.make_way().await?;
        match &self.line {
            Some(line) => line.send(sheet).await?,
            None => self.stream.get_mut().write_all(sheet.bytes()).await?,
        }
        Ok(())
    }

    /// Lets out what tungstenite has to say: answers to pings are its own, and must not end up within a message.
    async fn make_way(&mut self) -> Result<(), tungstenite::Error> {
        if self.is_closing {
            return Err(tungstenite::Error::ConnectionClosed);
        }
        self.stream.flush().await
    }

    /// Sends a message without copying its pieces. To be awaited to its end, or never again.
    pub(super) async fn send_pieces(&mut self, pieces: &Pieces) -> Result<(), tungstenite::Error> {
        self.make_way().await?;
        let head = pieces.head();
        let Pieces { before, shared, after, .. } = pieces;
        let mut whole = head.as_slice().chain(before.as_ref()).chain(shared.as_ref()).chain(*after);
        let connection = self.stream.get_mut();
        connection.write_all_buf(&mut whole).await?;
        connection.flush().await.map_err(|error: io::Error| error.into())
    }
}

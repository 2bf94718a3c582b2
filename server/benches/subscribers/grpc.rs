//! Subscribers by gRPC: one connection and one stream each, on the `h2` crate. They look into the first bytes of each
//! message and do not decode the rest.

use std::{net::SocketAddr, pin::pin, time::Duration};

use bytes::Bytes;
use h2::client::{Builder, Connection, ResponseFuture};
use hyper::Request;
use prost::Message as _;
use roundel_proto::v1;
use tokio::{net::TcpStream, time::timeout};

use crate::{Case, measure::Readings, messages::Messages};

/// The largest window: a run never uses it up, so no window updates are sent.
const WINDOW: u32 = 0x7fff_ffff;
const DEFAULT_WINDOW: u32 = 65_535;
/// A client that stops reading has sent its request by then.
const REQUEST_TIME: Duration = Duration::from_secs(1);

/// The request of one subscriber, as a gRPC message.
pub fn request(case: &Case, number: usize) -> Bytes {
    let side = 1e6 + number as f64;
    let corner = |side| Some(v1::Vector3 { x: side, y: side, z: side });
    let region = v1::Box { min: corner(-side), max: corner(side) };
    let request = v1::SubscribeSnapshotsRequest {
        omit_covariance: !case.covariances,
        region: case.differ.then_some(region),
        ..Default::default()
    };
    length_prefixed(&request.encode_to_vec()).into()
}

/// Adds gRPC's prefix: not compressed, and the length.
pub fn length_prefixed(message: &[u8]) -> Vec<u8> {
    [&[0], (message.len() as u32).to_be_bytes().as_slice(), message].concat()
}

/// Reads all snapshots.
pub async fn read(address: SocketAddr, request: Bytes, readings: Readings) {
    let (response, connection) = subscribe(address, request, WINDOW).await;
    let read = async {
        let mut body = response.await.expect("a response").into_body();
        let mut messages = Messages::new(readings);
        while let Some(bytes) = body.data().await {
            messages.add(&bytes.expect("a connection"));
        }
        panic!("the server ended the stream of a subscriber that reads");
    };
    tokio::select! {
        () = read => {}
        ended = connection => panic!("the server closed the connection of a subscriber that reads: {ended:?}"),
    }
}

/// Subscribes, and never reads.
pub async fn hold(address: SocketAddr, request: Bytes) {
    let (_response, connection) = subscribe(address, request, DEFAULT_WINDOW).await;
    let mut connection = pin!(connection);
    let _ = timeout(REQUEST_TIME, connection.as_mut()).await;
    // The connection stays open, and nothing drives it any more.
    std::future::pending().await
}

async fn subscribe(
    address: SocketAddr,
    request: Bytes,
    window: u32,
) -> (ResponseFuture, Connection<TcpStream>) {
    let stream = TcpStream::connect(address).await.expect("a connection");
    stream.set_nodelay(true).expect("an option");
    let (mut requests, connection) = Builder::new()
        .initial_window_size(window)
        .initial_connection_window_size(window)
        .handshake(stream)
        .await
        .expect("HTTP/2");
    let head = Request::post(format!("http://{address}/roundel.v1.Roundel/SubscribeSnapshots"))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(())
        .expect("a request");
    let (response, mut body) = requests.send_request(head, false).expect("a stream");
    body.send_data(request, true).expect("a stream");
    (response, connection)
}

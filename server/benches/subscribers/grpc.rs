//! gRPC subscribers, each with one connection and one stream, on the `h2` crate. They read the first fields of each
//! message and do not decode the rest.

use std::{net::SocketAddr, path::Path, pin::pin, sync::Arc, time::Duration};

use bytes::Bytes;
use h2::client::{Builder, Connection, ResponseFuture};
use hyper::Request;
use prost::Message as _;
use roundel_proto::v1;
use tokio::{net::TcpStream, time::timeout};
use tokio_rustls::{
    TlsConnector,
    client::TlsStream,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, ServerName, pem::PemObject},
    },
};
use tokio_util::either::Either;

use crate::{Case, measure::Readings, messages::Messages};

/// The largest window: a run never uses it up, so no window updates are sent.
const WINDOW: u32 = 0x7fff_ffff;
const DEFAULT_WINDOW: u32 = 65_535;
/// The frame size of Roundel's own clients.
const MAX_FRAME_BYTES: u32 = 64 * 1024;
/// Time after which a client that never reads has sent its request.
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

/// Adds gRPC's prefix: uncompressed, and the length.
pub fn length_prefixed(message: &[u8]) -> Vec<u8> {
    [&[0], (message.len() as u32).to_be_bytes().as_slice(), message].concat()
}

pub fn connector(certificate: &Path) -> TlsConnector {
    let mut roots = RootCertStore::empty();
    let certificate = CertificateDer::from_pem_file(certificate).expect("a certificate");
    roots.add(certificate).expect("a certificate");
    let mut config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("protocol versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    config.alpn_protocols = vec![b"h2".to_vec()];
    TlsConnector::from(Arc::new(config))
}

/// Reads all snapshots.
pub async fn read(
    address: SocketAddr,
    tls: Option<TlsConnector>,
    request: Bytes,
    readings: Readings,
) {
    let (response, connection) = subscribe(address, tls, request, WINDOW).await;
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

/// Subscribes and never reads.
pub async fn hold(address: SocketAddr, tls: Option<TlsConnector>, request: Bytes) {
    let (_response, connection) = subscribe(address, tls, request, DEFAULT_WINDOW).await;
    let mut connection = pin!(connection);
    let _ = timeout(REQUEST_TIME, connection.as_mut()).await;
    // The connection stays open, but is not polled any more.
    std::future::pending().await
}

type Stream = Either<TcpStream, Box<TlsStream<TcpStream>>>;

async fn subscribe(
    address: SocketAddr,
    tls: Option<TlsConnector>,
    request: Bytes,
    window: u32,
) -> (ResponseFuture, Connection<Stream>) {
    let stream = TcpStream::connect(address).await.expect("a connection");
    stream.set_nodelay(true).expect("an option");
    let stream = match tls {
        None => Either::Left(stream),
        Some(tls) => {
            let name = ServerName::try_from("localhost").expect("a name");
            let stream = tls.connect(name, stream).await.expect("a handshake");
            Either::Right(Box::new(stream))
        }
    };
    let (mut requests, connection) = Builder::new()
        .initial_window_size(window)
        .initial_connection_window_size(window)
        .max_frame_size(MAX_FRAME_BYTES)
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

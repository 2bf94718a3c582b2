//! The byte stream of a connection, plain or TLS, and its protocol.
//!
//! The first byte tells a TLS handshake from HTTP, and the first decrypted bytes tell HTTP/2 from HTTP/1.1. A write to
//! the socket that makes no progress within the write timeout fails with [`io::ErrorKind::TimedOut`], also below TLS,
//! which buffers at most 64 KiB of outgoing data.

use std::{
    io::{self, IoSlice},
    net::SocketAddr,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, ReadBuf},
    net::TcpStream,
    time::sleep,
};
use tokio_io_timeout::TimeoutStream;
use tokio_rustls::server::TlsStream;

use crate::api::{
    peer::Peer,
    tls::{Tls, client_name},
};

/// First bytes of an HTTP/2 connection (RFC 9113, section 3.4).
const HTTP2_PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// Polling interval while a plain connection's preface is incomplete.
const PREFACE_POLL: Duration = Duration::from_millis(50);
/// First byte of a TLS connection: the type of a handshake record.
const TLS_HANDSHAKE: u8 = 0x16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Protocol {
    /// HTTP/1.1, or bytes that hyper will reject.
    Http1,
    Http2,
}

/// An accepted connection whose protocol is known.
pub(super) struct Detected {
    pub(super) stream: Stream,
    pub(super) protocol: Protocol,
    pub(super) peer: Peer,
}

type TcpWithTimeout = Pin<Box<TimeoutStream<TcpStream>>>;

pub(super) enum Stream {
    Plain(TcpWithTimeout),
    Tls(Box<Decrypted>),
}

/// A TLS stream with the bytes that were read to detect its protocol.
pub(super) struct Decrypted {
    stream: TlsStream<TcpWithTimeout>,
    read_ahead: io::Cursor<Vec<u8>>,
}

/// Performs the TLS handshake if the client begins one, and waits until the first bytes identify the protocol. Returns
/// `None` if the client has left or its handshake failed.
pub(super) async fn detect(
    stream: TcpStream,
    address: SocketAddr,
    tls: &Tls,
    write_timeout: Duration,
) -> io::Result<Option<Detected>> {
    let mut first = [0];
    if stream.peek(&mut first).await? == 0 {
        return Ok(None);
    }
    let is_tls = first[0] == TLS_HANDSHAKE;
    if !is_tls {
        let Some(protocol) = detect_plain(&stream).await? else { return Ok(None) };
        let stream = Stream::Plain(with_write_timeout(stream, write_timeout));
        let peer = Peer { address, is_tls, certificate_name: None };
        return Ok(Some(Detected { stream, protocol, peer }));
    }
    let mut stream = tls.accept(with_write_timeout(stream, write_timeout), address).await?;
    let certificate_name = client_name(&stream);
    let peer = Peer { address, is_tls, certificate_name };
    let Some((protocol, read)) = detect_decrypted(&mut stream).await? else { return Ok(None) };
    let decrypted = Decrypted { stream, read_ahead: io::Cursor::new(read) };
    Ok(Some(Detected { stream: Stream::Tls(Box::new(decrypted)), protocol, peer }))
}

fn with_write_timeout(stream: TcpStream, timeout: Duration) -> TcpWithTimeout {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(timeout));
    Box::pin(stream)
}

/// `None` while the first bytes may still become an HTTP/2 preface. hyper would wait without a time limit for the rest of
/// an incomplete one.
fn protocol(first: &[u8]) -> Option<Protocol> {
    if !HTTP2_PREFACE.starts_with(first) {
        return Some(Protocol::Http1);
    }
    (first.len() == HTTP2_PREFACE.len()).then_some(Protocol::Http2)
}

async fn detect_plain(stream: &TcpStream) -> io::Result<Option<Protocol>> {
    let mut first = [0; HTTP2_PREFACE.len()];
    loop {
        let length = stream.peek(&mut first).await?;
        if length == 0 {
            return Ok(None);
        }
        if let Some(protocol) = protocol(&first[..length]) {
            return Ok(Some(protocol));
        }
        // `peek` does not wait for more bytes once there is one.
        sleep(PREFACE_POLL).await;
    }
}

/// Returns the bytes read, too.
async fn detect_decrypted(
    stream: &mut TlsStream<TcpWithTimeout>,
) -> io::Result<Option<(Protocol, Vec<u8>)>> {
    let mut first = Vec::with_capacity(HTTP2_PREFACE.len());
    loop {
        let missing = HTTP2_PREFACE.len() - first.len();
        if (&mut *stream).take(missing as u64).read_buf(&mut first).await? == 0 {
            return Ok(None);
        }
        if let Some(protocol) = protocol(&first) {
            return Ok(Some((protocol, first)));
        }
    }
}

impl AsyncRead for Stream {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_read(context, buffer),
            Self::Tls(decrypted) => {
                let before = buffer.filled().len();
                let read = Pin::new(&mut decrypted.read_ahead).poll_read(context, buffer);
                if buffer.filled().len() > before {
                    return read;
                }
                Pin::new(&mut decrypted.stream).poll_read(context, buffer)
            }
        }
    }
}

impl AsyncWrite for Stream {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_write(context, bytes),
            Self::Tls(decrypted) => Pin::new(&mut decrypted.stream).poll_write(context, bytes),
        }
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_write_vectored(context, bytes),
            Self::Tls(decrypted) => {
                Pin::new(&mut decrypted.stream).poll_write_vectored(context, bytes)
            }
        }
    }

    fn is_write_vectored(&self) -> bool {
        match self {
            Self::Plain(stream) => stream.is_write_vectored(),
            Self::Tls(decrypted) => decrypted.stream.is_write_vectored(),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_flush(context),
            Self::Tls(decrypted) => Pin::new(&mut decrypted.stream).poll_flush(context),
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_shutdown(context),
            Self::Tls(decrypted) => Pin::new(&mut decrypted.stream).poll_shutdown(context),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, sync::Arc};

    use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
    use tokio::net::TcpListener;
    use tokio_rustls::{
        TlsConnector,
        rustls::{
            ClientConfig, RootCertStore,
            crypto::ring,
            pki_types::{PrivateKeyDer, ServerName, pem::PemObject},
        },
    };

    use super::*;
    use crate::model::config::TlsConfig;

    #[test]
    fn an_incomplete_preface_is_not_decided() {
        assert_eq!(protocol(b"GET "), Some(Protocol::Http1));
        assert_eq!(protocol(b"PRI"), None);
        assert_eq!(protocol(HTTP2_PREFACE), Some(Protocol::Http2));
        assert_eq!(protocol(b"PRI * HTTP/1.1\r\n"), Some(Protocol::Http1));
    }

    /// Tls that asks for client certificates, and a client's settings with a certificate of this name.
    fn with_client(folder: &std::path::Path, name: &str) -> (Tls, ClientConfig) {
        let mut params = CertificateParams::default();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().unwrap();
        let authority = params.self_signed(&key).unwrap();
        let issuer = Issuer::new(params, key);
        let issue = |params: CertificateParams| {
            let key = KeyPair::generate().unwrap();
            (params.signed_by(&key, &issuer).unwrap(), key.serialize_pem())
        };
        let server = issue(CertificateParams::new(["localhost".to_owned()]).unwrap());
        let mut params = CertificateParams::default();
        params.distinguished_name = rcgen::DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, name);
        let client = issue(params);
        let [certificate, key, ca] = ["cert", "key", "ca"].map(|file| folder.join(file));
        fs::write(&certificate, server.0.pem()).unwrap();
        fs::write(&key, server.1).unwrap();
        fs::write(&ca, authority.pem()).unwrap();
        let files = TlsConfig { certificate, key, client_ca: Some(ca), self_signed: false };
        let mut roots = RootCertStore::empty();
        roots.add(authority.der().clone()).unwrap();
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_client_auth_cert(
                vec![client.0.der().clone()],
                PrivateKeyDer::from_pem_slice(client.1.as_bytes()).unwrap(),
            )
            .unwrap();
        (Tls::load(&files, [127, 0, 0, 1].into()).unwrap(), config)
    }

    #[tokio::test]
    async fn a_verified_certificate_names_the_peer() {
        let folder = tempfile::tempdir().unwrap();
        let (tls, config) = with_client(folder.path(), "robot 7");
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let server = listener.local_addr().unwrap();
        let client = tokio::spawn(async move {
            let stream = TcpStream::connect(server).await.unwrap();
            let address = stream.local_addr().unwrap();
            let name = ServerName::try_from("localhost").unwrap();
            let connector = TlsConnector::from(Arc::new(config));
            let mut stream = connector.connect(name, stream).await.unwrap();
            tokio::io::AsyncWriteExt::write_all(&mut stream, b"GET / HTTP/1.1\r\n").await.unwrap();
            (address, stream)
        });
        let (stream, address) = listener.accept().await.unwrap();
        let detected = detect(stream, address, &tls, Duration::from_secs(10)).await;
        let Detected { mut stream, protocol, peer } = detected.unwrap().unwrap();
        let (address, _open) = client.await.unwrap();
        let certificate_name = Some("robot 7".to_owned());
        assert_eq!(peer, Peer { address, is_tls: true, certificate_name });
        assert_eq!(protocol, Protocol::Http1);
        let mut read = [0; 16];
        stream.read_exact(&mut read).await.unwrap();
        assert_eq!(&read, b"GET / HTTP/1.1\r\n", "bytes of the detection are read again");
    }
}

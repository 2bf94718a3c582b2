//! Makes channels to one server, plain or encrypted.

use std::{io, sync::Arc};

use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio_rustls::{
    TlsConnector,
    client::TlsStream,
    rustls::{ClientConfig, pki_types::ServerName},
};
use tonic::{
    codegen::http::Uri,
    transport::{Channel, Endpoint},
};
use tower::{Service, service_fn};

use crate::{
    ConnectOptions, Error, address,
    tls::{client_config, handshake_error},
};

type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// Where and how to connect.
#[derive(Clone, Debug)]
pub(crate) struct Connector {
    /// As `http://HOST:PORT` or `https://HOST:PORT`.
    pub(crate) address: String,
    endpoint: Endpoint,
    /// `None` for `http://`.
    tls: Option<Arc<ClientConfig>>,
}

impl Connector {
    pub(crate) fn new(address: &str, options: &ConnectOptions) -> Result<Self, Error> {
        let (address, endpoint) = address::endpoint(address)?;
        let is_encrypted = endpoint.uri().scheme_str() == Some("https");
        let unused = [
            (options.ca.is_some(), "ca"),
            (options.fingerprint.is_some(), "fingerprint"),
            (options.certificate.is_some(), "certificate"),
        ];
        if let Some((_, option)) = unused.into_iter().find(|(is_set, _)| *is_set && !is_encrypted) {
            let reason = format!("needs an address that begins with https://, found {address}");
            return Err(Error::InvalidOption { option, reason });
        }
        let tls = if is_encrypted { Some(client_config(options)?) } else { None };
        Ok(Self { address, endpoint, tls })
    }

    /// With other settings of the transport.
    pub(crate) fn configure(self, configure: impl FnOnce(Endpoint) -> Endpoint) -> Self {
        Self { endpoint: configure(self.endpoint), ..self }
    }

    pub(crate) async fn connect(&self) -> Result<Channel, tonic::transport::Error> {
        match &self.tls {
            None => self.endpoint.connect().await,
            Some(tls) => self.endpoint.connect_with_connector(encrypted(tls.clone())).await,
        }
    }

    /// Connects on the first call.
    pub(crate) fn connect_lazily(&self) -> Channel {
        match &self.tls {
            None => self.endpoint.connect_lazy(),
            Some(tls) => self.endpoint.connect_with_connector_lazy(encrypted(tls.clone())),
        }
    }
}

fn encrypted(
    tls: Arc<ClientConfig>,
) -> impl Service<
    Uri,
    Response = TokioIo<TlsStream<TcpStream>>,
    Error = BoxError,
    Future = impl Future<Output = Result<TokioIo<TlsStream<TcpStream>>, BoxError>> + Send,
> + Send
+ 'static {
    service_fn(move |uri: Uri| connect(tls.clone(), uri))
}

async fn connect(
    tls: Arc<ClientConfig>,
    uri: Uri,
) -> Result<TokioIo<TlsStream<TcpStream>>, BoxError> {
    let missing = || io::Error::new(io::ErrorKind::InvalidInput, "the address has no host or port");
    let host = uri.host().ok_or_else(missing)?;
    let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
    let port = uri.port_u16().ok_or_else(missing)?;
    let stream = TcpStream::connect((host.as_str(), port)).await?;
    stream.set_nodelay(true)?;
    let name = ServerName::try_from(host)?;
    let stream = TlsConnector::from(tls).connect(name, stream).await.map_err(handshake_error)?;
    Ok(TokioIo::new(stream))
}

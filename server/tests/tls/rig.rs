//! A server with TLS around a hub, and a TLS client.

use std::{collections::BTreeMap, path::PathBuf, sync::Arc, time::Duration};

use roundel_server::{
    api::{self, ApiLimits, ApiState, tls::Tls},
    model::{
        clock::Clock,
        config::TlsConfig,
        hub::{Hub, Installation},
    },
};
use tempfile::TempDir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    task::JoinHandle,
    time::timeout,
};
use tokio_rustls::{
    TlsConnector,
    client::TlsStream,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, ServerName, pem::PemObject},
    },
};
use tokio_util::sync::CancellationToken;

use super::authority::{Authority, Issued};

/// Timeout of every wait; nothing here takes a tenth of it.
pub const TIMEOUT: Duration = Duration::from_secs(30);

pub struct Rig {
    pub authority: Authority,
    pub folder: TempDir,
    pub address: String,
    cancel: CancellationToken,
    server: JoinHandle<()>,
}

impl Rig {
    /// With a certificate for 127.0.0.1.
    pub async fn start() -> Self {
        Self::start_with(false, ApiLimits::default()).await
    }

    pub async fn start_with(asks_for_certificates: bool, limits: ApiLimits) -> Self {
        let (authority, folder) = (Authority::new("test authority"), tempfile::tempdir().unwrap());
        let files = TlsConfig {
            certificate: folder.path().join("cert.pem"),
            key: folder.path().join("key.pem"),
            client_ca: asks_for_certificates.then(|| folder.path().join("ca.pem")),
            self_signed: false,
        };
        std::fs::write(folder.path().join("ca.pem"), authority.pem()).unwrap();
        write(&folder, &authority.server());
        let tls = Tls::load(&files, [127, 0, 0, 1].into()).unwrap();
        let (address, cancel, server) = serve(tls, limits).await;
        Self { authority, folder, address, cancel, server }
    }

    pub fn url(&self) -> String {
        format!("https://{}", self.address)
    }

    pub fn ca(&self) -> PathBuf {
        self.folder.path().join("ca.pem")
    }

    /// Replaces the server's certificate and key.
    pub fn replace(&self, issued: &Issued) {
        write(&self.folder, issued);
    }

    pub async fn stop(self) {
        self.cancel.cancel();
        timeout(TIMEOUT, self.server).await.expect("the server does not shut down").unwrap();
    }
}

fn write(folder: &TempDir, issued: &Issued) {
    std::fs::write(folder.path().join("cert.pem"), &issued.certificate).unwrap();
    std::fs::write(folder.path().join("key.pem"), &issued.key).unwrap();
}

/// Starts a server on a free port.
pub async fn serve(tls: Tls, limits: ApiLimits) -> (String, CancellationToken, JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (clock, cancel) = (Clock::anchored_now(), CancellationToken::new());
    let hub = Arc::new(Hub::new(Installation {
        name: "lab".into(),
        source_id: "run".into(),
        started: clock.now(),
        snapshot_rate_hz: 60.0,
        cameras: Installation::number_cameras([]),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: vec![],
    }));
    let state = ApiState { tls, limits, cancel: cancel.clone(), ..ApiState::new(hub, clock) };
    (address, cancel, tokio::spawn(api::serve(listener, state)))
}

/// A client's settings: trusts the authority, presents a certificate if given.
pub fn client_config(authority: &str, certificate: Option<&Issued>, alpn: &[&str]) -> ClientConfig {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(authority.as_bytes()).unwrap()).unwrap();
    let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots);
    let mut config = match certificate {
        None => builder.with_no_client_auth(),
        Some(issued) => {
            let key = PrivateKeyDer::from_pem_slice(issued.key.as_bytes()).unwrap();
            builder.with_client_auth_cert(vec![issued.der.clone().into()], key).unwrap()
        }
    };
    config.alpn_protocols = alpn.iter().map(|name| name.as_bytes().to_vec()).collect();
    config
}

pub async fn connect(address: &str, config: ClientConfig) -> std::io::Result<TlsStream<TcpStream>> {
    let stream = TcpStream::connect(address).await?;
    let name = ServerName::try_from("127.0.0.1").unwrap();
    let connecting = TlsConnector::from(Arc::new(config)).connect(name, stream);
    timeout(TIMEOUT, connecting).await.expect("the handshake does not end")
}

/// The response to `GET /healthz` by HTTP/1.1; the error if the connection fails.
pub async fn get(
    stream: &mut (impl AsyncReadExt + AsyncWriteExt + Unpin),
) -> std::io::Result<String> {
    let request = b"GET /healthz HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n";
    stream.write_all(request).await?;
    let mut response = Vec::new();
    timeout(TIMEOUT, stream.read_to_end(&mut response)).await.expect("no response")?;
    Ok(String::from_utf8(response).unwrap())
}

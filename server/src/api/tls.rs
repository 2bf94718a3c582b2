//! TLS: the server's certificate, its reload, and the handshake of a connection.
//!
//! In: the PEM files of `[server] tls`. Out: encrypted streams, and the common name of a client's certificate. rustls on
//! ring speaks TLS 1.2 and 1.3 with its default cipher suites; ALPN offers `h2` and `http/1.1`.
//!
//! | module | purpose |
//! | --- | --- |
//! | `files` | reads and checks certificate, key and authorities of clients |
//! | `self_signed` | makes a certificate for a server that has none |
//!
//! The port serves plain connections as well: the first byte of a connection tells a TLS handshake from HTTP. Client
//! certificates are optional; one that is presented must be issued by `client_ca`. Changed files apply to new
//! connections within some seconds. If the new files are invalid, the old certificate stays in use, with a warning.
//! Without `[server] tls`, a handshake fails with an alert.

mod files;
mod self_signed;

use std::{
    io,
    net::{IpAddr, SocketAddr},
    sync::{Arc, Mutex, PoisonError, RwLock},
    time::{Duration, Instant},
};

use tokio::{
    io::{AsyncRead, AsyncWrite},
    task::spawn_blocking,
    time::sleep,
};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        server::{ClientHello, ResolvesServerCert},
        sign::CertifiedKey,
    },
    server::TlsStream,
};

pub use files::{CertificateSummary, TlsError};
use files::{Loaded, common_name, stamps};

use crate::model::config::TlsConfig;

/// Interval of looking for changed files.
const RELOAD_INTERVAL: Duration = Duration::from_secs(2);
/// Shortest time between two log lines about failed handshakes.
const LOG_INTERVAL: Duration = Duration::from_secs(1);

/// TLS on the server's port. The default has no certificate: every handshake fails with an alert.
pub struct Tls {
    files: Option<TlsConfig>,
    loaded: RwLock<Loaded>,
    failures: Mutex<FailureLog>,
}

impl Default for Tls {
    fn default() -> Self {
        let builder = files::server_config_builder().with_no_client_auth();
        let server = Arc::new(builder.with_cert_resolver(Arc::new(NoCertificate)));
        Self::new(None, Loaded { server, certificate: None })
    }
}

impl Tls {
    /// Reads the files. Makes a self-signed certificate first if that is configured and neither file exists; `listen` is
    /// one of its names.
    pub fn load(files: &TlsConfig, listen: IpAddr) -> Result<Self, TlsError> {
        if files.self_signed {
            self_signed::create_missing(files, listen)?;
        }
        Ok(Self::new(Some(files.clone()), files::load(files)?))
    }

    fn new(files: Option<TlsConfig>, loaded: Loaded) -> Self {
        Self { files, loaded: RwLock::new(loaded), failures: Mutex::default() }
    }

    /// The certificate in use; `None` if TLS is not configured.
    pub fn certificate(&self) -> Option<CertificateSummary> {
        self.loaded().certificate
    }

    fn loaded(&self) -> Loaded {
        self.loaded.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Performs the handshake. A failed one is answered with an alert.
    pub(super) async fn accept<S: AsyncRead + AsyncWrite + Unpin>(
        &self,
        stream: S,
        peer: SocketAddr,
    ) -> io::Result<TlsStream<S>> {
        let accepted = TlsAcceptor::from(self.loaded().server).accept(stream).await;
        accepted.inspect_err(|error| {
            let mut failures = self.failures.lock().unwrap_or_else(PoisonError::into_inner);
            failures.log(peer, error, self.files.is_some());
        })
    }

    /// Reads the files again whenever they have changed; never ends.
    pub(super) async fn follow_files(&self) {
        let Some(files) = &self.files else { return };
        let (mut read, mut seen) = (stamps(files), stamps(files));
        loop {
            sleep(RELOAD_INTERVAL).await;
            let watched = files.clone();
            let Ok(now) = spawn_blocking(move || stamps(&watched)).await else { return };
            // Files that still change, such as a certificate whose key is to follow, are read later.
            let is_settled = now == seen;
            seen = now;
            if !is_settled || seen == read {
                continue;
            }
            read.clone_from(&seen);
            let changed = files.clone();
            match spawn_blocking(move || files::load(&changed)).await {
                Ok(Ok(loaded)) => {
                    let certificate = loaded.certificate.as_ref().map(ToString::to_string);
                    tracing::info!(certificate, "using the changed TLS files");
                    *self.loaded.write().unwrap_or_else(PoisonError::into_inner) = loaded;
                }
                Ok(Err(error)) => {
                    tracing::warn!(
                        "the changed TLS files are not used, the old ones stay in use: {error}"
                    );
                }
                Err(error) => tracing::error!(%error, "cannot read the changed TLS files"),
            }
        }
    }
}

/// Common name of the client's certificate, if it has presented one.
pub(super) fn client_name<S>(stream: &TlsStream<S>) -> Option<String> {
    common_name(stream.get_ref().1.peer_certificates()?.first()?)
}

/// Ends every handshake with an alert.
#[derive(Debug)]
struct NoCertificate;

impl ResolvesServerCert for NoCertificate {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        None
    }
}

/// Logs failed handshakes, at most one in [`LOG_INTERVAL`].
#[derive(Default)]
struct FailureLog {
    logged: Option<Instant>,
    /// Failures since then.
    unlogged: u64,
}

impl FailureLog {
    fn log(&mut self, peer: SocketAddr, error: &io::Error, is_configured: bool) {
        if self.logged.is_some_and(|logged| logged.elapsed() < LOG_INTERVAL) {
            self.unlogged += 1;
            return;
        }
        let unlogged = std::mem::take(&mut self.unlogged);
        self.logged = Some(Instant::now());
        if is_configured {
            tracing::debug!(%peer, %error, unlogged, "a TLS handshake failed");
        } else {
            tracing::debug!(%peer, unlogged, "refused TLS, which [server] tls does not configure");
        }
    }
}

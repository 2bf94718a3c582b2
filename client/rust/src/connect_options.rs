//! Options of a connection: trust in the server, and identity of the client.

use std::{fmt, path::PathBuf};

use tonic::metadata::{Ascii, MetadataValue};

use crate::Error;

/// Trust in the server, and identity of the client. The default trusts the system's certificate authorities and has no
/// identity.
///
/// ```no_run
/// # use roundel_client::{Client, ConnectOptions};
/// # async fn example() -> Result<(), roundel_client::Error> {
/// let options = ConnectOptions::default().ca("ca.pem").token("rd_…");
/// let client = Client::connect_with("https://arena:7670", &options).await?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Default, PartialEq, Eq)]
pub struct ConnectOptions {
    pub(crate) ca: Option<PathBuf>,
    pub(crate) fingerprint: Option<String>,
    pub(crate) certificate: Option<[PathBuf; 2]>,
    pub(crate) token: Option<String>,
}

impl ConnectOptions {
    /// Trusts the authorities in this PEM file instead of the system's. A server's self-signed certificate is its own
    /// authority.
    pub fn ca(self, file: impl Into<PathBuf>) -> Self {
        Self { ca: Some(file.into()), ..self }
    }

    /// Trusts only the certificate with this SHA-256 fingerprint, with any name and date. The server prints it at start.
    /// 64 hexadecimal digits; colons are ignored.
    pub fn fingerprint(self, fingerprint: impl Into<String>) -> Self {
        Self { fingerprint: Some(fingerprint.into()), ..self }
    }

    /// Presents this client certificate. Two PEM files.
    pub fn certificate(self, certificate: impl Into<PathBuf>, key: impl Into<PathBuf>) -> Self {
        Self { certificate: Some([certificate.into(), key.into()]), ..self }
    }

    /// Sends this token with every call. Without `https://`, the network can read it.
    pub fn token(self, token: impl Into<String>) -> Self {
        Self { token: Some(token.into()), ..self }
    }

    /// The value of the header `authorization`.
    pub(crate) fn authorization(&self) -> Result<Option<MetadataValue<Ascii>>, Error> {
        let Some(token) = &self.token else { return Ok(None) };
        let value = MetadataValue::try_from(format!("Bearer {}", token.trim()));
        let mut value = value.map_err(|_| Error::InvalidOption {
            option: "token",
            reason: "expected printable ASCII letters without line breaks".to_owned(),
        })?;
        value.set_sensitive(true);
        Ok(Some(value))
    }
}

impl fmt::Debug for ConnectOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { ca, fingerprint, certificate, token } = self;
        let mut shown = f.debug_struct("ConnectOptions");
        shown.field("ca", ca).field("fingerprint", fingerprint).field("certificate", certificate);
        shown.field("token", &token.as_ref().map(|_| "…")).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_checked_and_not_shown() {
        let options = ConnectOptions::default().token("secret\n");
        assert_eq!(options.authorization().unwrap().unwrap(), "Bearer secret");
        assert!(!format!("{options:?}").contains("secret"));
        let error = options.token("two\nlines").authorization().unwrap_err().to_string();
        assert!(error.contains("`token`") && !error.contains("two"), "{error}");
        assert_eq!(ConnectOptions::default().authorization(), Ok(None));
    }
}

//! Options of the commands that connect to a server.

use std::path::PathBuf;

use clap::Args;
use roundel_client::{Client, ConnectOptions, Error};

use crate::model::config::NodeConfig;

/// Trust in the server, and identity of this program.
#[derive(Clone, Debug, Default, Args)]
pub(super) struct ConnectionArgs {
    /// Token that identifies this program [environment: ROUNDEL_TOKEN]
    #[arg(long, value_name = "TOKEN", env = "ROUNDEL_TOKEN", hide_env = true)]
    token: Option<String>,
    /// PEM file of the authority that has issued the server's certificate [default: the system's]
    #[arg(long, value_name = "FILE", conflicts_with = "fingerprint")]
    ca: Option<PathBuf>,
    /// Trust only the certificate with this SHA-256 fingerprint, which the server prints at start
    #[arg(long, value_name = "HEX")]
    fingerprint: Option<String>,
}

impl ConnectionArgs {
    /// Connects, and checks that a server answers.
    pub(super) async fn connect(&self, address: &str) -> Result<Client, Error> {
        Client::connect_with(address, &self.options()).await
    }

    fn options(&self) -> ConnectOptions {
        let mut options = ConnectOptions::default();
        if let Some(token) = self.token.as_ref().filter(|token| !token.is_empty()) {
            options = options.token(token);
        }
        if let Some(ca) = &self.ca {
            options = options.ca(ca);
        }
        if let Some(fingerprint) = &self.fingerprint {
            options = options.fingerprint(fingerprint);
        }
        options
    }

    /// The options of a node: these, then those of its file.
    pub(super) fn node_options(&self, node: Option<&NodeConfig>) -> ConnectOptions {
        let Some(node) = node else { return self.options() };
        let (token, ca) = (self.token.clone(), self.ca.clone());
        // One kind of trust replaces the other.
        let is_trust_given = ca.is_some() || self.fingerprint.is_some();
        let trust = if is_trust_given {
            (ca, self.fingerprint.clone())
        } else {
            (node.ca.clone(), node.fingerprint.clone())
        };
        let merged =
            Self { token: token.or_else(|| node.token.clone()), ca: trust.0, fingerprint: trust.1 };
        match &node.certificate {
            Some([certificate, key]) => merged.options().certificate(certificate, key),
            None => merged.options(),
        }
    }
}

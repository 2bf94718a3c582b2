//! The other end of a connection.

use std::net::SocketAddr;

/// The client of a connection, as an extension of each of its requests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peer {
    pub address: SocketAddr,
    /// Whether the connection is encrypted.
    pub is_tls: bool,
    /// Common name of the client's certificate, which `client_ca` has verified.
    pub certificate_name: Option<String>,
}

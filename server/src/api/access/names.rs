//! Names of this server in the `Host` header.
//!
//! A page whose name resolves to an address of this server (DNS rebinding) sends its own name as the host. Addresses
//! are therefore accepted, and names only if they are known to be this server's.

use std::net::IpAddr;

use axum::http::{Request, header, uri::Authority};

use crate::api::error::ApiError;

pub(super) struct HostNames {
    /// In lower case; `*` accepts all.
    names: Vec<String>,
}

impl HostNames {
    pub(super) fn new(listen: IpAddr, mut names: Vec<String>) -> Self {
        names.push("localhost".to_owned());
        // Other computers may know this one by its name.
        if !listen.is_loopback()
            && let Some(own) = own_name()
        {
            names.push(format!("{own}.local"));
            names.push(own);
        }
        Self { names }
    }

    pub(super) fn check(&self, host: &str) -> Result<(), ApiError> {
        if self.accepts(host) {
            return Ok(());
        }
        Err(ApiError::Misdirected(format!(
            "\"{}\" is not a name of this server: use its address, or add the name to [server] allow_hosts in its configuration",
            host.escape_debug()
        )))
    }

    fn accepts(&self, host: &str) -> bool {
        let Ok(authority) = host.parse::<Authority>() else { return false };
        let name = authority.host().to_ascii_lowercase();
        let address = name.trim_start_matches('[').trim_end_matches(']');
        let name = name.trim_end_matches('.');
        address.parse::<IpAddr>().is_ok()
            || name.ends_with(".localhost")
            || self.names.iter().any(|known| known == name || known == "*")
    }
}

/// The host that a request names. `None` in HTTP/1.0, which browsers do not speak.
pub(super) fn host<B>(request: &Request<B>) -> Option<&str> {
    // HTTP/2 has it in the URI. A header that is not ASCII is not a name of this server.
    let header = || request.headers().get(header::HOST);
    let uri = request.uri().authority().map(Authority::as_str);
    uri.or_else(|| header().map(|value| value.to_str().unwrap_or_default()))
}

fn own_name() -> Option<String> {
    let name = gethostname::gethostname().to_str()?.to_ascii_lowercase();
    Some(name).filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    #[test]
    fn addresses_and_own_names_are_accepted() {
        let names =
            |listen: Ipv4Addr| HostNames::new(listen.into(), vec!["lab.example.org".into()]);
        let hosts = names(Ipv4Addr::LOCALHOST);
        for host in [
            "127.0.0.1",
            "127.0.0.1:7670",
            "192.168.0.7:7670",
            "[::1]:7670",
            "localhost",
            "LOCALHOST:80",
            "localhost.:80",
            "app.localhost",
            "Lab.example.org:7670",
        ] {
            assert!(hosts.accepts(host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:7670",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "",
            "a b",
        ] {
            assert!(!hosts.accepts(host), "{host}");
        }
        let own = own_name().unwrap();
        assert_eq!(hosts.accepts(&own), own == "localhost");
        assert!(names(Ipv4Addr::UNSPECIFIED).accepts(&format!("{own}:7670")));
        assert!(
            HostNames::new(Ipv4Addr::LOCALHOST.into(), vec!["*".into()]).accepts("evil.example")
        );
    }
}

//! Where a server is.

use tonic::transport::Endpoint;

use crate::Error;

/// The address as `http://HOST:PORT`, and an endpoint for it. The scheme may be left out.
pub(crate) fn endpoint(address: &str) -> Result<(String, Endpoint), Error> {
    let invalid = |reason: &str| Error::InvalidAddress {
        address: address.to_owned(),
        reason: reason.to_owned(),
    };
    let trimmed = address.trim().trim_end_matches('/');
    let full = match trimmed.split_once("://") {
        None if trimmed.is_empty() => return Err(invalid("it is empty")),
        None => format!("http://{trimmed}"),
        Some(("http", _)) => trimmed.to_owned(),
        Some(("https", _)) => {
            return Err(invalid(
                "this client does not speak TLS; the server's port does not either",
            ));
        }
        Some((scheme, _)) => return Err(invalid(&format!("{scheme}:// is not http://"))),
    };
    let endpoint =
        Endpoint::from_shared(full.clone()).map_err(|error| invalid(&error.to_string()))?;
    match endpoint.uri().path() {
        "" | "/" => {}
        path => return Err(invalid(&format!("{path} stands after the port"))),
    }
    if endpoint.uri().port().is_none() {
        return Err(invalid("the port is missing"));
    }
    Ok((full, endpoint))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_with_and_without_a_scheme() {
        for address in ["127.0.0.1:7670", "http://127.0.0.1:7670", "http://127.0.0.1:7670/"] {
            assert_eq!(endpoint(address).unwrap().0, "http://127.0.0.1:7670");
        }
        assert_eq!(endpoint("[::1]:7670").unwrap().0, "http://[::1]:7670");
    }

    #[test]
    fn wrong_addresses_say_why() {
        for (address, why) in [
            ("", "it is empty"),
            ("127.0.0.1", "the port is missing"),
            ("https://arena:7670", "TLS"),
            ("ws://arena:7670", "ws:// is not http://"),
            ("http://arena:7670/api/v1", "/api/v1 stands after the port"),
            ("http://are na:7670", "invalid"),
        ] {
            let error = endpoint(address).unwrap_err().to_string();
            assert!(error.contains(why) && error.contains("http://HOST:PORT"), "{error}");
        }
    }
}

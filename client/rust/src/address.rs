//! Server addresses.

use tonic::transport::Endpoint;

use crate::Error;

/// The address as `http://HOST:PORT` with its endpoint. The scheme is optional.
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
            return Err(invalid("neither this client nor the server supports TLS"));
        }
        Some((scheme, _)) => return Err(invalid(&format!("{scheme}:// is not http://"))),
    };
    let endpoint =
        Endpoint::from_shared(full.clone()).map_err(|error| invalid(&error.to_string()))?;
    match endpoint.uri().path() {
        "" | "/" => {}
        path => return Err(invalid(&format!("unexpected {path} after the port"))),
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
    fn the_scheme_of_an_address_is_optional() {
        for address in ["127.0.0.1:7670", "http://127.0.0.1:7670", "http://127.0.0.1:7670/"] {
            assert_eq!(endpoint(address).unwrap().0, "http://127.0.0.1:7670");
        }
        assert_eq!(endpoint("[::1]:7670").unwrap().0, "http://[::1]:7670");
    }

    #[test]
    fn invalid_addresses_give_the_reason() {
        for (address, reason) in [
            ("", "it is empty"),
            ("127.0.0.1", "the port is missing"),
            ("https://arena:7670", "TLS"),
            ("ws://arena:7670", "ws:// is not http://"),
            ("http://arena:7670/api/v1", "unexpected /api/v1 after the port"),
            ("http://are na:7670", "invalid"),
        ] {
            let error = endpoint(address).unwrap_err().to_string();
            assert!(error.contains(reason) && error.contains("http://HOST:PORT"), "{error}");
        }
    }
}

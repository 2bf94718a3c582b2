//! Server addresses.

use tonic::transport::Endpoint;

use crate::Error;

/// The address as `http://HOST:PORT` or `https://HOST:PORT` with its endpoint. Without a scheme it is the former.
pub(crate) fn endpoint(address: &str) -> Result<(String, Endpoint), Error> {
    let invalid = |reason: &str| Error::InvalidAddress {
        address: address.to_owned(),
        reason: reason.to_owned(),
    };
    let trimmed = address.trim().trim_end_matches('/');
    let full = match trimmed.split_once("://") {
        None if trimmed.is_empty() => return Err(invalid("it is empty")),
        None => format!("http://{trimmed}"),
        Some(("http" | "https", _)) => trimmed.to_owned(),
        Some((scheme, _)) => {
            return Err(invalid(&format!("{scheme}:// is neither http:// nor https://")));
        }
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
        assert_eq!(endpoint("https://arena:7670").unwrap().0, "https://arena:7670");
        assert_eq!(endpoint("[::1]:7670").unwrap().0, "http://[::1]:7670");
    }

    #[test]
    fn invalid_addresses_give_the_reason() {
        for (address, reason) in [
            ("", "it is empty"),
            ("127.0.0.1", "the port is missing"),
            ("https://arena", "the port is missing"),
            ("ws://arena:7670", "ws:// is neither http:// nor https://"),
            ("http://arena:7670/api/v1", "unexpected /api/v1 after the port"),
            ("http://are na:7670", "invalid"),
        ] {
            let error = endpoint(address).unwrap_err().to_string();
            assert!(error.contains(reason) && error.contains("http://HOST:PORT"), "{error}");
        }
    }
}

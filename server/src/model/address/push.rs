//! `push:?stall=SECONDS`: frames or detections that a remote program sends.

use std::time::Duration;

use super::{
    AddressError,
    network::{STALL_S, stall},
    options,
};

const KEYS: [&str; 1] = ["stall"];

/// How long to wait for what is sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PushAddress {
    /// Nothing for so long is a failure.
    pub stall: Duration,
}

pub(super) fn push(path: &str, query: &str) -> Result<PushAddress, AddressError> {
    if !path.is_empty() {
        return Err(AddressError::Options(
            "`push:` takes no address: programs come to this server, and name the camera that they feed",
        ));
    }
    let mut address = PushAddress { stall: Duration::from_secs_f64(STALL_S) };
    for option in options("push", &KEYS, query) {
        let (_, value) = option?;
        address.stall = stall(value)?;
    }
    Ok(address)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::model::address::SourceAddress;

    #[test]
    fn addresses_are_read() {
        let read =
            |url| SourceAddress::parse(url, Path::new("")).map_err(|error| error.to_string());
        let of =
            |seconds| Ok(SourceAddress::Push(PushAddress { stall: Duration::from_secs(seconds) }));
        assert_eq!(read("push:"), of(1));
        assert_eq!(read("push:?stall=5"), of(5));
        assert!(read("push:?stall=0").unwrap_err().contains("seconds above 0"));
        assert!(read("push://robot7").unwrap_err().contains("programs come to this server"));
        assert!(read("push:?stal=5").unwrap_err().contains("did you mean `stall`?"));
    }
}

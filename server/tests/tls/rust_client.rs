//! The Rust client over TLS: authorities, pinned fingerprints, client certificates, tokens.

use std::time::Duration;

use roundel_client::{Client, ConnectOptions, Error, PushOptions};
use roundel_server::api::ApiLimits;
use sha2::{Digest, Sha256};
use tokio::time::timeout;

use super::{
    authority::Authority,
    rig::{Rig, TIMEOUT},
};

fn fingerprint(der: &[u8]) -> String {
    Sha256::digest(der).iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(":")
}

async fn connect(rig: &Rig, options: &ConnectOptions) -> Result<Client, Error> {
    timeout(TIMEOUT, Client::connect_with(&rig.url(), options)).await.expect("no result")
}

#[tokio::test]
async fn a_client_trusts_an_authority_or_a_fingerprint() {
    let rig = Rig::start().await;
    let client = connect(&rig, &ConnectOptions::default().ca(rig.ca())).await.unwrap();
    assert_eq!(client.info().await.unwrap().name, "lab");
    let issued = rig.authority.server();
    rig.replace(&issued);
    let pinned = ConnectOptions::default().fingerprint(fingerprint(&issued.der)).token("secret");
    let changed = async {
        loop {
            match connect(&rig, &pinned).await {
                Ok(client) => return client,
                Err(Error::WrongFingerprint { .. }) => {}
                Err(error) => panic!("{error}"),
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    let client = timeout(TIMEOUT, changed).await.expect("the changed certificate is not used");
    assert_eq!(client.info().await.unwrap().name, "lab");
    assert!(client.address().starts_with("https://"));
    rig.stop().await;
}

#[tokio::test]
async fn an_untrusted_server_is_a_typed_error() {
    let rig = Rig::start().await;
    let foreign = rig.folder.path().join("foreign.pem");
    std::fs::write(&foreign, Authority::new("test authority").pem()).unwrap();
    let error = connect(&rig, &ConnectOptions::default().ca(&foreign)).await.unwrap_err();
    assert!(matches!(error, Error::Untrusted { .. }) && !error.is_temporary(), "{error}");
    let expected = "ab".repeat(32);
    let pinned = ConnectOptions::default().fingerprint(&expected);
    let error = connect(&rig, &pinned).await.unwrap_err();
    let Error::WrongFingerprint { expected: pinned_one, found, .. } = &error else {
        panic!("{error}")
    };
    assert!(*pinned_one == expected && found.len() == 64 && !error.is_temporary());
    // The same error from a connection that is made by its first call.
    let lazy = Client::connect_lazily_with(&rig.url(), &pinned).unwrap();
    let error = lazy.info().await.unwrap_err();
    assert!(matches!(error, Error::WrongFingerprint { .. }), "{error}");
    rig.replace(&rig.authority.expired_server());
    let expired = async {
        loop {
            match connect(&rig, &ConnectOptions::default().ca(rig.ca())).await {
                Ok(_) => tokio::time::sleep(Duration::from_millis(100)).await,
                Err(error) => return error,
            }
        }
    };
    let error = timeout(TIMEOUT, expired).await.expect("the changed certificate is not used");
    let Error::Untrusted { reason, .. } = &error else { panic!("{error}") };
    assert!(reason.contains("expired"), "{error}");
    rig.stop().await;
}

#[tokio::test]
async fn options_of_tls_need_an_encrypted_address_and_tls_a_server_that_offers_it() {
    let rig = Rig::start().await;
    let plain = format!("http://{}", rig.address);
    let error = Client::connect_with(&plain, &ConnectOptions::default().ca(rig.ca())).await;
    assert!(matches!(error.unwrap_err(), Error::InvalidOption { option: "ca", .. }));
    Client::connect_with(&plain, &ConnectOptions::default().token("secret")).await.unwrap();
    let (address, cancel, server) =
        super::rig::serve(roundel_server::api::tls::Tls::default(), ApiLimits::default()).await;
    let options = ConnectOptions::default().ca(rig.ca());
    let error = Client::connect_with(&format!("https://{address}"), &options).await.unwrap_err();
    assert!(matches!(error, Error::Unreachable { .. }), "{error}");
    assert!(error.to_string().contains("begins with http://"), "{error}");
    cancel.cancel();
    server.await.unwrap();
    rig.stop().await;
}

#[tokio::test]
async fn a_client_certificate_is_presented() {
    let rig = Rig::start_with(true, ApiLimits::default()).await;
    let write = |name: &str, text: &str| {
        let path = rig.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let trusted = rig.authority.client("robot7");
    let foreign = Authority::new("another authority").client("robot7");
    let ca = ConnectOptions::default().ca(rig.ca());
    let own = [("own.pem", &trusted.certificate), ("own-key.pem", &trusted.key)];
    let [certificate, key] = own.map(|(name, text)| write(name, text));
    let client = connect(&rig, &ca.clone().certificate(certificate, key)).await.unwrap();
    assert_eq!(client.info().await.unwrap().name, "lab");
    let own = [("foreign.pem", &foreign.certificate), ("foreign-key.pem", &foreign.key)];
    let [certificate, key] = own.map(|(name, text)| write(name, text));
    let error = connect(&rig, &ca.certificate(certificate, key)).await.unwrap_err();
    // The alert arrives while the client connects, or with its first request.
    assert!(matches!(error, Error::Unreachable { .. } | Error::NotRoundel { .. }), "{error:?}");
    assert!(error.to_string().contains("alert"), "{error}");
    rig.stop().await;
}

#[tokio::test]
async fn a_pusher_uses_the_options_of_its_client() {
    let rig = Rig::start().await;
    for (options, expected) in [
        (ConnectOptions::default().ca(rig.ca()), "no camera"),
        (ConnectOptions::default().fingerprint("ab".repeat(32)), "fingerprint"),
    ] {
        let client = Client::connect_lazily_with(&rig.url(), &options).unwrap();
        let pusher = client.push(PushOptions::new("north")).unwrap();
        let mut statuses = pusher.statuses();
        let refused = statuses.wait_for(|status| !status.error.is_empty());
        let error = timeout(TIMEOUT, refused).await.expect("no status").unwrap().error.clone();
        assert!(error.contains(expected), "{error}");
    }
    rig.stop().await;
}

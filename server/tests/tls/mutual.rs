//! Client certificates.

use roundel_server::api::ApiLimits;

use super::{
    authority::Authority,
    rig::{Rig, client_config, connect, get},
};

#[tokio::test]
async fn client_certificates_are_optional_but_must_verify() {
    let rig = Rig::start_with(true, ApiLimits::default()).await;
    let trusted = rig.authority.client("robot7");
    let foreign = Authority::new("test authority").client("robot7");
    let server = rig.authority.server();
    for (certificate, is_accepted) in
        [(None, true), (Some(&trusted), true), (Some(&foreign), false), (Some(&server), false)]
    {
        let config = client_config(&rig.authority.pem(), certificate, &[]);
        // In TLS 1.3 the client completes its handshake before the server has verified its certificate.
        let answer = match connect(&rig.address, config).await {
            Ok(mut stream) => get(&mut stream).await,
            Err(error) => Err(error),
        };
        match answer {
            Ok(response) => {
                assert!(is_accepted && response.starts_with("HTTP/1.1 200"), "{response}");
            }
            Err(error) => assert!(!is_accepted && error.to_string().contains("alert"), "{error}"),
        }
    }
    rig.stop().await;
}

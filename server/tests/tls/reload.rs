//! Changed certificate files.

use std::{fs, time::Instant};

use super::rig::{Rig, TIMEOUT, client_config, connect, get};

/// The certificate that the server presents.
async fn presented(rig: &Rig) -> Vec<u8> {
    let config = client_config(&rig.authority.pem(), None, &[]);
    let stream = connect(&rig.address, config).await.unwrap();
    stream.get_ref().1.peer_certificates().unwrap()[0].to_vec()
}

#[tokio::test]
async fn a_changed_certificate_is_used_without_a_restart_and_a_broken_one_is_not() {
    let rig = Rig::start().await;
    let first = presented(&rig).await;
    let config = client_config(&rig.authority.pem(), None, &[]);
    let mut open = connect(&rig.address, config).await.unwrap();
    fs::write(rig.folder.path().join("cert.pem"), "no certificate").unwrap();
    // Longer than two intervals of the reload.
    let begin = Instant::now();
    while begin.elapsed().as_secs() < 5 {
        assert_eq!(presented(&rig).await, first, "a broken file has replaced the certificate");
        tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    }
    let second = rig.authority.server();
    rig.replace(&second);
    let begin = Instant::now();
    while presented(&rig).await != second.der {
        assert!(begin.elapsed() < TIMEOUT, "the changed certificate is not used");
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
    assert!(get(&mut open).await.unwrap().starts_with("HTTP/1.1 200"), "an open connection stays");
    rig.stop().await;
}

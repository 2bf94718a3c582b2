//! The configuration file: a change that cannot be saved is not applied.

use std::{fs, os::unix::fs::PermissionsExt, path::Path};

use axum::http::Method;
use roundel_server::{app::serve::Server, model::config::Config};
use serde_json::json;

use super::rig::{CONFIG, Rig, lab, third_camera};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_externally_edited_or_read_only_file_is_kept_and_no_change_is_applied() {
    let rig = Rig::start().await;
    let path = rig.folder.path().join("lab.toml");
    let mine = format!("{CONFIG}# mine\n");
    fs::write(&path, &mine).unwrap();
    for (method, path, body) in [
        (Method::POST, "/cameras", Some(third_camera())),
        (Method::PATCH, "/cameras/a", Some(json!({ "source": "push:" }))),
        (Method::DELETE, "/cameras/a", None),
    ] {
        let (status, message) = rig.rejected(method, path, body).await;
        assert_eq!(status, 409);
        assert!(message.contains("lab.toml has changed since this server read it"), "{message}");
    }
    assert_eq!(rig.file(), mine);
    assert_eq!(rig.server.hub().cameras().len(), 2);
    assert_eq!(rig.running("a").await.restarts, 0);

    fs::write(&path, CONFIG).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o444)).unwrap();
    let (status, message) = rig.rejected(Method::POST, "/cameras", Some(third_camera())).await;
    assert_eq!(status, 409);
    assert!(message.contains("read-only"), "{message}");
    assert_eq!(rig.file(), CONFIG);
    fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
    rig.accepted(Method::POST, "/cameras", Some(third_camera())).await;
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn saved_changes_are_read_at_the_next_start() {
    let rig = Rig::start().await;
    rig.accepted(Method::POST, "/cameras", Some(third_camera())).await;
    rig.accepted(Method::PATCH, "/cameras/b", Some(json!({ "name": "window", "mode": "fast" })))
        .await;
    rig.accepted(Method::DELETE, "/cameras/a", None).await;
    let Rig { server, folder } = rig;
    let names = |server: &Server| -> Vec<String> {
        server.hub().installation().cameras.values().map(|camera| camera.name.clone()).collect()
    };
    let before = names(&server);
    server.shutdown().await;
    let server =
        Server::start(Config::load(&folder.path().join("lab.toml")).unwrap()).await.unwrap();
    assert_eq!(
        (names(&server), &before),
        (vec!["window".to_owned(), "c".to_owned()], &names(&server))
    );
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_a_file_a_change_lasts_until_shutdown_and_the_response_says_so() {
    let folder = lab(CONFIG);
    let config = Config::parse(CONFIG, Path::new(folder.path())).unwrap();
    let rig = Rig { server: Server::start(config).await.unwrap(), folder };
    let answer = rig.accepted(Method::POST, "/cameras", Some(third_camera())).await;
    assert!(answer["kept"].as_str().unwrap().contains("not saved"), "{answer}");
    rig.running("c").await;
    assert_eq!(rig.file(), CONFIG);
    rig.server.shutdown().await;
}

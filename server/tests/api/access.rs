//! Host names, credentials and roles, in each protocol.

use std::time::Duration;

use axum::{
    body::Body,
    http::{Method, Request, StatusCode, header},
};
use futures::StreamExt as _;
use roundel_client::{Client, ConnectOptions, Error, PushOptions, Subscription};
use roundel_proto::v1::{self, push_client::PushClient};
use roundel_server::model::access::{AccessConfig, AccessEntry, Identity, Role, TokenHash};
use serde_json::json;
use tokio::time::timeout;
use tokio_tungstenite::{
    connect_async,
    tungstenite::{self, client::IntoClientRequest, protocol::frame::coding::CloseCode},
};
use tonic::Code;

use super::{
    grpc,
    rig::{Answer, Rig, TIMEOUT, objects},
    websocket,
};

/// Argon2id hash of "correct horse".
fn password_hash() -> String {
    use argon2::PasswordHasher;
    argon2::Argon2::default().hash_password(b"correct horse").unwrap().to_string()
}

fn entry(name: &str, role: Role) -> AccessEntry {
    let cameras = (role == Role::Feed).then(|| vec!["north".to_owned()]);
    AccessEntry {
        identity: Identity { name: name.to_owned(), role, cameras },
        token: Some(TokenHash::of(name)),
        password: None,
        certificate: None,
        forwarded: None,
        expires_s: None,
    }
}

/// Identities whose token is their name.
fn access() -> AccessConfig {
    AccessConfig {
        entries: vec![
            AccessEntry { password: Some(password_hash()), ..entry("viewer", Role::View) },
            entry("node", Role::Feed),
            entry("operator", Role::Operate),
            entry("admin", Role::Setup),
            AccessEntry { expires_s: Some(1_000_000_000), ..entry("former", Role::Setup) },
            AccessEntry {
                token: None,
                forwarded: Some("bob@example.org".to_owned()),
                ..entry("bob", Role::View)
            },
        ],
        trusted_proxies: vec!["127.0.0.1".parse().unwrap()],
        ..AccessConfig::default()
    }
}

async fn ask(rig: &Rig, method: Method, path: &str, headers: &[(&str, &str)]) -> Answer {
    let mut request = Request::builder().method(method).uri(format!("{}{path}", rig.url()));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    rig.request(request.body(Body::empty()).unwrap()).await
}

async fn ask_as(rig: &Rig, token: &str, method: Method, path: &str) -> Answer {
    ask(rig, method, path, &[("authorization", &format!("Bearer {token}"))]).await
}

fn with_token<T>(message: T, token: &str) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
    request
}

#[tokio::test]
async fn a_host_that_is_not_the_servers_is_misdirected() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let port = rig.address.rsplit_once(':').unwrap().1.to_owned();
    for host in ["127.0.0.1", "localhost", "192.168.1.7", "[::1]"] {
        let host = format!("{host}:{port}");
        let answer = ask(&rig, Method::GET, "/api/v1/snapshot", &[("host", &host)]).await;
        assert_eq!(answer.status, StatusCode::OK, "{host}");
    }
    for (method, path) in [
        (Method::GET, "/api/v1/snapshot"),
        (Method::POST, "/api/v1/recording"),
        (Method::GET, "/"),
        (Method::GET, "/healthz"),
    ] {
        let answer = ask(&rig, method, path, &[("host", "evil.example")]).await;
        assert_eq!(answer.status, StatusCode::MISDIRECTED_REQUEST, "{path}");
        let (code, message) = answer.error();
        assert_eq!(code, "misdirected");
        assert!(message.contains("evil.example") && message.contains("allow_hosts"), "{message}");
    }
    let rebound = [("host", "evil.example"), ("origin", "http://evil.example")];
    let answer = ask(&rig, Method::GET, "/api/v1/stream", &rebound).await;
    assert_eq!(answer.status, StatusCode::MISDIRECTED_REQUEST);
    rig.stop().await;
}

#[tokio::test]
async fn pages_of_other_sites_do_not_embed_responses() {
    let rig = Rig::start_with_own_origin().await;
    rig.publish(objects(1));
    for (site, mode, expected) in [
        ("cross-site", "no-cors", StatusCode::FORBIDDEN),
        ("same-site", "no-cors", StatusCode::FORBIDDEN),
        ("cross-site", "navigate", StatusCode::OK),
        ("same-origin", "no-cors", StatusCode::OK),
        ("none", "navigate", StatusCode::OK),
    ] {
        let headers = [("sec-fetch-site", site), ("sec-fetch-mode", mode)];
        let answer = ask(&rig, Method::GET, "/api/v1/snapshot", &headers).await;
        assert_eq!(answer.status, expected, "{site} {mode}");
    }
    // Browsers send these headers only to loopback and with TLS.
    let answer = rig.get("/api/v1/snapshot").await;
    assert_eq!(answer.header("cross-origin-resource-policy"), "same-origin");
    rig.stop().await;
}

#[tokio::test]
async fn json_routes_require_json() {
    let rig = Rig::start().await;
    for path in ["/api/v1/configuration/check", "/api/v1/recording", "/api/v1/calibration"] {
        for content_type in [Some("text/plain"), None] {
            let request = Request::post(format!("{}{path}", rig.url()));
            let request = match content_type {
                Some(content_type) => request.header(header::CONTENT_TYPE, content_type),
                None => request,
            };
            let answer = rig.request(request.body(Body::from("{}")).unwrap()).await;
            assert_eq!(
                answer.status,
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "{path} {content_type:?}"
            );
            assert_eq!(answer.error().0, "unsupported_media_type");
        }
    }
    rig.stop().await;
}

#[tokio::test]
async fn without_credentials_in_the_configuration_none_are_needed() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let session = rig.get("/api/v1/session").await.json();
    assert_eq!(session, json!({"needs_credentials": false, "name": "anonymous", "role": "setup"}));
    // A token of another server does no harm.
    assert_eq!(ask_as(&rig, "x", Method::GET, "/api/v1/snapshot").await.status, StatusCode::OK);
    rig.stop().await;
}

#[tokio::test]
async fn rest_checks_credentials_and_roles() {
    let rig = Rig::start_with_access(&access()).await;
    rig.publish(objects(1));
    for path in ["/", "/healthz", "/openapi.json", "/api/v1/session"] {
        assert_eq!(rig.get(path).await.status, StatusCode::OK, "{path}");
    }
    for path in ["/api/v1/snapshot", "/api/v1/info", "/metrics", "/api/v1/cameras/north/frame.jpg"]
    {
        let answer = rig.get(path).await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED, "{path}");
        assert_eq!(answer.header("www-authenticate"), "Bearer");
        assert_eq!(answer.error().0, "unauthenticated");
    }
    let cases = [
        (Method::GET, "/api/v1/snapshot", [200, 403, 200, 200]),
        (Method::HEAD, "/api/v1/snapshot", [200, 403, 200, 200]),
        (Method::GET, "/api/v1/info", [200, 200, 200, 200]),
        (Method::DELETE, "/api/v1/recording", [403, 403, 409, 409]),
        (Method::GET, "/api/v1/configuration", [403, 403, 403, 409]),
        (Method::DELETE, "/api/v1/cameras/north", [403, 403, 403, 409]),
    ];
    for (method, path, expected) in cases {
        for (token, status) in ["viewer", "node", "operator", "admin"].into_iter().zip(expected) {
            let answer = ask_as(&rig, token, method.clone(), path).await;
            assert_eq!(answer.status.as_u16(), status, "{token} {method} {path}");
        }
    }
    let refused = ask_as(&rig, "viewer", Method::DELETE, "/api/v1/recording").await.error();
    assert_eq!(refused.0, "permission_denied");
    assert!(refused.1.contains("\"operate\"") && refused.1.contains("\"view\""), "{}", refused.1);
    for token in ["wrong", "former", ""] {
        let answer = ask_as(&rig, token, Method::GET, "/api/v1/snapshot").await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED, "{token}");
    }
    let basic = [("authorization", "Basic dmlld2VyOng=")];
    let answer = ask(&rig, Method::GET, "/api/v1/snapshot", &basic).await;
    assert_eq!(answer.status, StatusCode::UNAUTHORIZED);
    rig.stop().await;
}

#[tokio::test]
async fn a_browser_signs_in_and_out() {
    let rig = Rig::start_with_access(&access()).await;
    rig.publish(objects(1));
    let sign_in = async |body: serde_json::Value| {
        let request = Request::post(format!("{}/api/v1/session", rig.url()));
        let request = request.header("content-type", "application/json");
        rig.request(request.body(Body::from(body.to_string())).unwrap()).await
    };
    for body in [
        json!({"name": "viewer", "password": "wrong"}),
        json!({"name": "stranger", "password": "correct horse"}),
        json!({"name": "operator", "password": ""}),
        json!({"token": "wrong"}),
        json!({"token": "former"}),
        json!({}),
    ] {
        let answer = sign_in(body.clone()).await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED, "{body}");
        assert_eq!(answer.header("set-cookie"), "", "{body}");
    }
    for (body, name) in [
        (json!({"name": "viewer", "password": "correct horse"}), "viewer"),
        (json!({"token": "admin"}), "admin"),
    ] {
        let answer = sign_in(body).await;
        assert_eq!(answer.status, StatusCode::OK);
        assert_eq!(answer.json()["name"], name);
        let cookie = answer.header("set-cookie").to_owned();
        assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Lax"), "{cookie}");
        let cookie = cookie.split(';').next().unwrap().to_owned();
        let cookie = [("cookie", cookie.as_str())];
        let answer = ask(&rig, Method::GET, "/api/v1/snapshot", &cookie).await;
        assert_eq!(answer.status, StatusCode::OK);
        let answer = ask(&rig, Method::DELETE, "/api/v1/session", &cookie).await;
        assert_eq!(answer.status, StatusCode::OK);
        assert!(answer.header("set-cookie").contains("Max-Age=0"));
        let answer = ask(&rig, Method::GET, "/api/v1/snapshot", &cookie).await;
        assert_eq!(answer.status, StatusCode::UNAUTHORIZED);
        // The page must load, so that its user can sign in again.
        assert_eq!(ask(&rig, Method::GET, "/", &cookie).await.status, StatusCode::OK);
    }
    rig.stop().await;
}

#[tokio::test]
async fn a_trusted_proxy_forwards_the_user() {
    let rig = Rig::start_with_access(&access()).await;
    rig.publish(objects(1));
    let forwarded = async |user: &str| {
        ask(&rig, Method::GET, "/api/v1/snapshot", &[("x-forwarded-user", user)]).await.status
    };
    assert_eq!(forwarded("bob@example.org").await, StatusCode::OK);
    assert_eq!(forwarded("viewer").await, StatusCode::UNAUTHORIZED);
    rig.stop().await;

    let rig = Rig::start_with_access(&AccessConfig { trusted_proxies: vec![], ..access() }).await;
    let answer =
        ask(&rig, Method::GET, "/api/v1/snapshot", &[("x-forwarded-user", "bob@example.org")])
            .await;
    assert_eq!(answer.status, StatusCode::UNAUTHORIZED);
    rig.stop().await;
}

#[tokio::test]
async fn grpc_checks_credentials_and_roles() {
    let rig = Rig::start_with_access(&access()).await;
    rig.publish(objects(1));
    let mut client = grpc::connect(&rig).await;
    let snapshot = v1::GetSnapshotRequest::default;
    let missing = client.get_snapshot(snapshot()).await.unwrap_err();
    assert_eq!(missing.code(), Code::Unauthenticated);
    for token in ["wrong", "former"] {
        let refused = client.get_snapshot(with_token(snapshot(), token)).await.unwrap_err();
        assert_eq!(refused.code(), Code::Unauthenticated, "{token}");
    }
    client.get_snapshot(with_token(snapshot(), "viewer")).await.unwrap();
    let refused = client.get_snapshot(with_token(snapshot(), "node")).await.unwrap_err();
    assert_eq!(refused.code(), Code::PermissionDenied);
    let stop = v1::StopRecordingRequest::default;
    let refused = client.stop_recording(with_token(stop(), "viewer")).await.unwrap_err();
    assert_eq!(refused.code(), Code::PermissionDenied);
    let refused = client.stop_recording(with_token(stop(), "operator")).await.unwrap_err();
    assert_eq!(refused.code(), Code::FailedPrecondition);
    let subscribe = v1::SubscribeSnapshotsRequest::default;
    let refused = client.subscribe_snapshots(subscribe()).await.unwrap_err();
    assert_eq!(refused.code(), Code::Unauthenticated);
    let stream = client.subscribe_snapshots(with_token(subscribe(), "viewer")).await.unwrap();
    assert!(stream.into_inner().message().await.unwrap().is_some());
    let request = Request::post(format!("{}/roundel.v1.Roundel/GetSnapshot", rig.url()));
    let request = request.header("content-type", "application/grpc-web+proto");
    let answer = rig.request(request.body(Body::from(vec![0; 5])).unwrap()).await;
    assert_eq!(answer.header("grpc-status"), "16");
    rig.stop().await;
}

#[tokio::test]
async fn the_rust_client_reports_refusals_as_errors_of_their_own_and_does_not_retry() {
    let rig = Rig::start_with_access(&access()).await;
    rig.publish(objects(1));
    let client = async |token: &str| {
        let options = match token {
            "" => ConnectOptions::default(),
            token => ConnectOptions::default().token(token),
        };
        Client::connect_with(&rig.url(), &options).await
    };
    for token in ["", "wrong", "former"] {
        let error = client(token).await.map(drop).unwrap_err();
        assert!(matches!(error, Error::Unauthenticated { .. }), "{token}: {error}");
        // A client that connects later reports it with its first call, and its stream ends.
        let options = ConnectOptions::default().token(if token.is_empty() { "x" } else { token });
        let lazy = Client::connect_lazily_with(&rig.url(), &options).unwrap();
        let error = lazy.snapshot().await.unwrap_err();
        assert!(matches!(error, Error::Unauthenticated { .. }), "{token}: {error}");
        let mut snapshots = lazy.snapshots(Subscription::default());
        let first = timeout(TIMEOUT, snapshots.next()).await.expect("the stream retries");
        assert!(matches!(first, Some(Err(Error::Unauthenticated { .. }))), "{first:?}");
        assert!(snapshots.next().await.is_none());
    }
    let viewer = client("viewer").await.unwrap();
    viewer.snapshot().await.unwrap();
    let error = viewer.stop_recording().await.unwrap_err();
    assert!(matches!(error, Error::PermissionDenied { .. }), "{error}");
    let node = client("node").await.unwrap();
    let first = node.snapshots(Subscription::default()).next().await;
    assert!(matches!(first, Some(Err(Error::PermissionDenied { .. }))), "{first:?}");
    let stranger = node.push(PushOptions::new("south side")).unwrap();
    let mut statuses = stranger.statuses();
    let refused = timeout(TIMEOUT, statuses.wait_for(|status| status.refused)).await.unwrap();
    assert!(refused.unwrap().error.contains("south side"));
    rig.stop().await;
}

#[tokio::test]
async fn streams_end_when_their_credentials_expire() {
    let expires = std::time::SystemTime::now() + Duration::from_secs(3);
    let since_epoch = expires.duration_since(std::time::UNIX_EPOCH).unwrap();
    let leaving = AccessEntry {
        expires_s: Some(since_epoch.as_secs() as i64),
        ..entry("leaving", Role::View)
    };
    let mut access = access();
    access.entries.push(leaving);
    let rig = Rig::start_with_access(&access).await;
    rig.publish(objects(1));
    let mut client = grpc::connect(&rig).await;
    let subscribe = v1::SubscribeSnapshotsRequest::default;
    let stream = client.subscribe_snapshots(with_token(subscribe(), "leaving")).await.unwrap();
    let mut stream = stream.into_inner();
    assert!(stream.message().await.unwrap().is_some());
    let mut request = format!("ws://{}/api/v1/stream", rig.address).into_client_request().unwrap();
    request.headers_mut().insert("authorization", "Bearer leaving".parse().unwrap());
    let (mut socket, _) = connect_async(request).await.unwrap();

    let ended = timeout(TIMEOUT, stream.message()).await.expect("the stream goes on").unwrap_err();
    assert_eq!(ended.code(), Code::Unauthenticated);
    assert!(ended.message().contains("have expired"), "{ended}");
    let closed = async {
        loop {
            if let Some(Ok(tungstenite::Message::Close(frame))) = socket.next().await {
                return frame.expect("a close code");
            }
        }
    };
    let frame = timeout(TIMEOUT, closed).await.expect("the WebSocket stays open");
    assert_eq!(frame.code, CloseCode::Policy);
    assert!(frame.reason.contains("have expired"), "{frame:?}");
    rig.stop().await;
}

#[tokio::test]
async fn an_identity_feeds_only_its_cameras() {
    let rig = Rig::start_with_access(&access()).await;
    let mut client = PushClient::new(grpc::channel(&rig).await);
    let mut feed = async |camera: &str, token: &str| {
        let greeting = v1::PushGreeting { camera: camera.into(), ..Default::default() };
        let message = v1::push_request::Message::Greeting(greeting);
        let messages = futures::stream::iter([v1::PushRequest { message: Some(message) }]);
        let answers = client.send(with_token(messages, token)).await?;
        answers.into_inner().message().await
    };
    let refused = feed("south side", "node").await.unwrap_err();
    assert_eq!(refused.code(), Code::PermissionDenied);
    assert!(refused.message().contains("south side"), "{}", refused.message());
    assert_eq!(feed("north", "operator").await.unwrap_err().code(), Code::PermissionDenied);
    // Past the check of the identity: this camera is not fed by programs.
    assert_eq!(feed("north", "node").await.unwrap_err().code(), Code::FailedPrecondition);
    assert_eq!(feed("north", "admin").await.unwrap_err().code(), Code::FailedPrecondition);
    rig.stop().await;
}

#[tokio::test]
async fn a_websocket_needs_credentials() {
    let rig = Rig::start_with_access(&access()).await;
    rig.publish(objects(1));
    let open = async |token: Option<&str>| {
        let url = format!("ws://{}/api/v1/stream", rig.address);
        let mut request = url.into_client_request().unwrap();
        if let Some(token) = token {
            let value = format!("Bearer {token}").parse().unwrap();
            request.headers_mut().insert("authorization", value);
        }
        connect_async(request).await.map(|(socket, _)| socket)
    };
    for (token, status) in [(None, 401), (Some("wrong"), 401), (Some("node"), 403)] {
        let tungstenite::Error::Http(response) = open(token).await.unwrap_err() else {
            panic!("{token:?}")
        };
        assert_eq!(response.status().as_u16(), status, "{token:?}");
    }
    let mut socket = open(Some("viewer")).await.unwrap();
    assert_eq!(websocket::next_snapshot(&mut socket).await.objects.len(), 1);
    rig.stop().await;
}

//! Attacks on a server at an address. Each is prepared when it is called, and its end is awaited later.

use std::time::Duration;

use axum::{
    body::Body,
    http::{Method, Request, Response, StatusCode, header},
};
use futures::future::{BoxFuture, join_all, ready};
use http_body_util::BodyExt as _;
use hyper_util::{client::legacy, rt::TokioExecutor};
use prost::Message as _;
use roundel_proto::v1::{self, push_request::Message};
use tokio::{
    io::AsyncWriteExt as _,
    net::TcpStream,
    task::JoinSet,
    time::{sleep, timeout},
};
use tonic::Code;

use super::attacked_server::{
    ATTACKED_CAMERAS, RawClient, TIMEOUT, detection, encoded, frame, greeting, push,
};

/// A page of 22 megapixels.
const LARGE_PRINT: &str = "/api/v1/print?format=png&page=2000x2000&marker=160:64&dpi=60";
/// Connections that are kept open and send no more than this.
pub const SLOW_HEADS: [(&str, &str); 3] = [
    (
        "2,100 slow request bodies",
        "POST /api/v1/recording HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n{",
    ),
    ("2,100 idle HTTP/2 connections", "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0"),
    ("2,100 idle HTTP/1.1 connections", "GET /api/v1/info HTTP/1.1\r\nHost: a\r\n\r\n"),
];

pub type Running = BoxFuture<'static, ()>;

fn url(address: &str, path: &str) -> String {
    format!("http://{address}{path}")
}

pub async fn get(url: String) -> Response<Vec<u8>> {
    send(Request::get(url).body(Body::empty()).unwrap()).await
}

async fn send(request: Request<Body>) -> Response<Vec<u8>> {
    let client = legacy::Client::builder(TokioExecutor::new()).build_http::<Body>();
    let response = timeout(TIMEOUT, client.request(request)).await.expect("no answer").unwrap();
    let (head, body) = response.into_parts();
    let body = body.collect().await.unwrap().to_bytes().to_vec();
    Response::from_parts(head, body)
}

/// Six prints of 22 megapixels at once.
pub async fn large_prints(address: &str) -> Running {
    let urls: Vec<String> = (0..6).map(|_| url(address, LARGE_PRINT)).collect();
    Box::pin(async move {
        let mut made = 0;
        for response in join_all(urls.into_iter().map(get)).await {
            match response.status() {
                StatusCode::OK => made += 1,
                StatusCode::SERVICE_UNAVAILABLE => {
                    assert_eq!(response.headers()[header::RETRY_AFTER], "1");
                    let text = String::from_utf8_lossy(response.body());
                    assert!(text.contains("the server is busy"), "{text}");
                }
                other => panic!("{other}"),
            }
        }
        assert!(made > 0);
    })
}

/// Fourteen senders with 40,000 detections in one frame.
pub async fn large_pushes(address: &str) -> Running {
    let large = frame((0..40_000).map(detection).collect());
    let large = v1::PushedObservations { sequence: 1, ..large };
    let message = encoded(Message::Observations(large));
    let address = address.to_owned();
    Box::pin(async move {
        let all = (0..ATTACKED_CAMERAS).map(|camera| {
            push(address.clone(), greeting(&format!("a{camera}")), vec![message.clone()])
        });
        for end in join_all(all).await {
            let status = end.expect("the message is accepted");
            assert_eq!(status.code(), Code::InvalidArgument);
            let expected = "observations.detections: expected at most 400 in a frame ([limits] \
                            max_roundels_per_camera of the server), found 40000";
            assert_eq!(status.message(), expected);
        }
    })
}

/// A sender with an error text of 15 MB.
pub async fn long_text(address: &str) -> Running {
    let error = format!("no cable\n2026-01-01 INFO forged \u{1b}[31m{}", "x".repeat(15_000_000));
    let trouble = Message::Trouble(v1::PushedTrouble { error });
    let address = address.to_owned();
    Box::pin(async move {
        let end = push(address, greeting("a0"), vec![encoded(trouble)]).await;
        assert!(end.is_none(), "a long reason is no error: {end:?}");
    })
}

/// 3,840 subscriptions, each with another selection.
pub async fn many_selections(address: &str) -> Running {
    const CONNECTIONS: u64 = 30;
    const STREAMS: u64 = 128;
    let mut readers = JoinSet::new();
    for connection in 0..CONNECTIONS {
        let client = RawClient::connect(address).await;
        for stream in 0..STREAMS {
            let mut client = client.clone();
            readers.spawn(async move {
                // All objects, and one that does not exist, so that no two selections are equal.
                let other = 1_000_000 + connection * STREAMS + stream;
                let object_ids = (1..=100).chain([other]).collect();
                let request = v1::SubscribeSnapshotsRequest { object_ids, ..Default::default() };
                let request = futures::stream::once(ready(request.encode_to_vec().into()));
                let path = "/roundel.v1.Roundel/SubscribeSnapshots";
                let mut snapshots = client.call(path, request).await.unwrap();
                while snapshots.message().await.is_ok_and(|it| it.is_some()) {}
            });
        }
    }
    // The subscriptions begin meanwhile.
    sleep(Duration::from_secs(3)).await;
    Box::pin(async move {
        sleep(Duration::from_secs(5)).await;
        readers.shutdown().await;
    })
}

/// 2,100 connections that send the beginning of a request.
pub async fn slow_connections(address: &str, head: &str) -> Running {
    const SLOW: usize = 2100;
    let mut slow = Vec::new();
    for number in 0..SLOW {
        let Ok(mut stream) = TcpStream::connect(address).await else { break };
        let _ = stream.write_all(head.as_bytes()).await;
        slow.push(stream);
        if number % 100 == 99 {
            sleep(Duration::from_millis(20)).await;
        }
    }
    let url = url(address, "/api/v1/info");
    Box::pin(async move {
        sleep(Duration::from_secs(1)).await;
        for _ in 0..10 {
            assert_eq!(get(url.clone()).await.status(), StatusCode::OK);
            sleep(Duration::from_millis(200)).await;
        }
        drop(slow);
    })
}

/// Configurations that name devices which never end or never answer, as a page of another origin and as a client sends them.
pub async fn endless_files(address: &str) -> Running {
    let url = url(address, "/api/v1/configuration/check");
    Box::pin(async move {
        for device in ["/dev/zero", "/dev/ptmx", "/dev/stdin"] {
            let text = format!(
                "[[camera]]\nname = \"a\"\nsource = \"push:\"\ncalibration = \"{device}\"\n"
            );
            let body = serde_json::json!({ "toml": text }).to_string();
            for (content_type, origin, expected) in [
                ("text/plain", None, StatusCode::UNSUPPORTED_MEDIA_TYPE),
                ("application/json", Some("http://attacker.example"), StatusCode::FORBIDDEN),
                ("application/json", None, StatusCode::OK),
            ] {
                let mut request = Request::builder()
                    .method(Method::POST)
                    .uri(&url)
                    .header(header::CONTENT_TYPE, content_type);
                if let Some(origin) = origin {
                    request = request.header(header::ORIGIN, origin);
                }
                let response = send(request.body(Body::from(body.clone())).unwrap()).await;
                assert_eq!(response.status(), expected, "{device} {content_type}");
            }
        }
    })
}

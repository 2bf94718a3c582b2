//! Requests and WebSockets from web pages of other origins.

use axum::{
    body::Body,
    http::{Method, Request, StatusCode},
};

use tokio_tungstenite::{
    connect_async,
    tungstenite::{self, client::IntoClientRequest},
};

use super::{
    rig::{Answer, ORIGIN, Rig, objects},
    websocket,
};

async fn ask(rig: &Rig, method: Method, path: &str, origin: &str) -> Answer {
    let request = Request::builder()
        .method(&method)
        .uri(format!("{}{path}", rig.url()))
        .header("origin", origin);
    let request = if method == Method::OPTIONS {
        let request = request.header("access-control-request-method", "PATCH");
        request.header("access-control-request-headers", "content-type,x-grpc-web,grpc-timeout")
    } else {
        request
    };
    let request = if method == Method::POST {
        request.header("content-type", "application/grpc-web+proto").body(Body::from(vec![0; 5]))
    } else {
        request.body(Body::empty())
    };
    rig.request(request.unwrap()).await
}

#[tokio::test]
async fn only_pages_of_allowed_origins_may_call_rest_and_grpc_web() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let (rest, web) = ("/api/v1/snapshot", "/roundel.v1.Roundel/GetSnapshot");
    for (method, path) in [(Method::GET, rest), (Method::POST, web)] {
        let answer = ask(&rig, method.clone(), path, ORIGIN).await;
        assert_eq!(answer.status, StatusCode::OK);
        assert_eq!(answer.header("access-control-allow-origin"), ORIGIN, "{path}");
        assert!(answer.header("access-control-expose-headers").contains("grpc-status"), "{path}");
        assert!(answer.header("vary").to_lowercase().contains("origin"), "{path}");
        for other in ["https://elsewhere.example.org", "http://lab.example.org", "null"] {
            let answer = ask(&rig, method.clone(), path, other).await;
            assert_eq!(answer.header("access-control-allow-origin"), "", "{path} {other}");
            if method == Method::GET {
                assert_eq!(answer.status, StatusCode::FORBIDDEN, "{path} {other}");
            } else {
                assert_eq!(answer.header("grpc-status"), "7", "{path} {other}");
            }
        }
    }
    for path in [rest, web, "/api/v1/cameras/north"] {
        let answer = ask(&rig, Method::OPTIONS, path, ORIGIN).await;
        assert!(answer.status.is_success(), "{path} {}", answer.status);
        assert_eq!(answer.header("access-control-allow-origin"), ORIGIN);
        assert!(answer.header("access-control-allow-methods").contains("PATCH"), "{path}");
        let headers = answer.header("access-control-allow-headers");
        assert!(headers.contains("x-grpc-web") && headers.contains("grpc-timeout"), "{headers}");
    }
    // Programs send no origin, and get no CORS headers.
    let answer = rig.get(rest).await;
    assert_eq!((answer.status, answer.header("access-control-allow-origin")), (StatusCode::OK, ""));
    rig.stop().await;
}

#[tokio::test]
async fn only_pages_of_its_own_and_allowed_origins_may_open_a_websocket() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let open = async |origin: Option<&str>| {
        let url = format!("ws://{}/api/v1/stream", rig.address);
        let mut request = url.into_client_request().unwrap();
        if let Some(origin) = origin {
            request.headers_mut().insert("origin", origin.parse().unwrap());
        }
        connect_async(request).await.map(|(socket, _)| socket)
    };
    // Its own origin, also behind a TLS proxy; an allowed origin in other capitals; a program, which sends no origin.
    let (own, secure) = (rig.url(), format!("https://{}", rig.address));
    let spelled = ORIGIN.replace("lab", "Lab");
    for origin in [Some(own.as_str()), Some(&secure), Some(ORIGIN), Some(&spelled), None] {
        let mut socket = open(origin).await.unwrap_or_else(|error| panic!("{origin:?}: {error}"));
        assert_eq!(websocket::next_snapshot(&mut socket).await.objects.len(), 1);
    }
    let port = rig.address.rsplit_once(':').unwrap().1;
    let elsewhere = [
        "https://elsewhere.example.org".to_owned(),
        "http://lab.example.org".to_owned(),
        format!("{ORIGIN}:8443"),
        format!("http://elsewhere.example.org:{port}"),
        "null".to_owned(),
        String::new(),
    ];
    for origin in &elsewhere {
        let refused =
            open(Some(origin)).await.err().unwrap_or_else(|| panic!("{origin} was accepted"));
        let tungstenite::Error::Http(response) = refused else { panic!("{origin}: {refused}") };
        assert_eq!(response.status(), StatusCode::FORBIDDEN, "{origin}");
        let body: serde_json::Value =
            serde_json::from_slice(response.body().as_ref().unwrap()).unwrap();
        assert_eq!(body["error"]["code"], "permission_denied");
        assert!(body["error"]["message"].as_str().unwrap().contains("allow_origins"), "{body}");
    }
    rig.stop().await;
}

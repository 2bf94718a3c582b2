//! Pages of other servers.

use axum::{
    body::Body,
    http::{Method, Request, StatusCode},
};

use crate::rig::{Answer, ORIGIN, Rig, objects};

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
async fn pages_of_allowed_origins_may_ask_and_no_others() {
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
    // Programs send no origin, and notice nothing.
    let answer = rig.get(rest).await;
    assert_eq!((answer.status, answer.header("access-control-allow-origin")), (StatusCode::OK, ""));
    rig.stop().await;
}

//! Pictures of cameras whose frames are processed on a node or in another program, requested through the server.

use std::time::Duration;

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use http_body_util::BodyExt;
use hyper_util::{client::legacy, rt::TokioExecutor};
use roundel_client::{Client, PushOptions, v1};

use super::rig::{Rig, SIZE, TestNode, picture, wait_for};

/// Requests a picture; returns status, capture time and body.
async fn request_picture(rig: &Rig, camera: &str) -> (StatusCode, Option<i64>, Vec<u8>) {
    let client = legacy::Client::builder(TokioExecutor::new()).build_http();
    let path = format!("{}/api/v1/cameras/{camera}/frame.jpg", rig.url());
    let response = client.request(Request::get(path).body(Body::empty()).unwrap()).await.unwrap();
    let (head, body) = response.into_parts();
    let time = head.headers.get("roundel-capture-time-ns");
    let time = time.and_then(|time| time.to_str().ok()?.parse().ok());
    (head.status, time, body.collect().await.unwrap().to_bytes().to_vec())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_sends_a_picture_and_the_server_draws_the_detections() {
    let rig = Rig::start().await;
    let sender = TestNode::start("north", &rig.url(), Duration::from_millis(20));
    sender.connected().await;
    sender.switch.set(true);
    rig.until("frames", 0, |state| state.frames > 5).await;
    let (status, time_ns, file) = request_picture(&rig, "north").await;
    assert_eq!(status, StatusCode::OK, "{}", String::from_utf8_lossy(&file));
    let age_s = (rig.server.clock().now().as_ns() - time_ns.unwrap()) as f64 * 1e-9;
    assert!((-0.01..2.0).contains(&age_s), "captured {age_s} s ago by the server's clock");
    let options = zune_core::options::DecoderOptions::default()
        .jpeg_set_out_colorspace(zune_core::colorspace::ColorSpace::RGB);
    let mut decoder =
        zune_jpeg::JpegDecoder::new_with_options(std::io::Cursor::new(&file), options);
    let rgb = decoder.decode().unwrap();
    assert_eq!(rgb.len(), SIZE.0 * SIZE.1 * 3);
    let coloured = rgb.chunks(3).filter(|it| it[0].abs_diff(it[1]) > 60).count();
    assert!(coloured > 50, "the detection must be drawn: {coloured} pixels");
    let grey = rgb.chunks(3).map(|it| f64::from(it[1])).sum::<f64>() / (SIZE.0 * SIZE.1) as f64;
    let sent = picture().iter().map(|level| f64::from(*level)).sum::<f64>();
    let sent = sent / (SIZE.0 * SIZE.1) as f64;
    assert!((grey - sent).abs() < 10.0, "{grey} for {sent}");
    sender.node.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reports_why_a_sender_has_no_picture() {
    let rig = Rig::start().await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let pusher = client.push(PushOptions::new("north").sender("robot 7")).unwrap();
    let mut requests = pusher.picture_requests();
    let observations = || v1::PushedObservations {
        observations: Some(v1::FrameObservations::default()),
        ..v1::PushedObservations::default()
    };
    let sending = async {
        loop {
            pusher.observations(observations());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let requesting = async {
        rig.until("frames", 0, |state| state.frames > 2).await;
        let (status, _, body) = request_picture(&rig, "north").await;
        assert_eq!(status, StatusCode::SERVICE_UNAVAILABLE);
        let body = String::from_utf8(body).unwrap();
        assert!(body.contains("sent no picture on request"), "{body}");
        requests.wait_for(|requests| *requests > 0).await.unwrap();
        // The sender reports an error instead of a picture.
        let error = "its lens is covered".to_owned();
        pusher.picture(v1::PushedPicture { error, ..v1::PushedPicture::default() });
        rig.until("the reason", 0, |state| {
            state.link.as_ref().is_some_and(|link| !link.no_picture.is_empty())
        })
        .await;
        let (status, _, body) = request_picture(&rig, "north").await;
        assert_eq!(status, StatusCode::SERVICE_UNAVAILABLE);
        let body = String::from_utf8(body).unwrap();
        assert!(body.contains("its lens is covered"), "{body}");
        // A picture whose size differs from the camera file is rejected, since detections could not be drawn.
        let grey = v1::GreyPicture { width: 2, height: 1, pixels: vec![1, 2] };
        let picture = Some(v1::pushed_picture::Picture::Grey(grey));
        pusher.picture(v1::PushedPicture { picture, ..v1::PushedPicture::default() });
        let wrong = || rig.camera(0).link.filter(|link| link.no_picture.contains("2 x 1 pixels"));
        wait_for("the reason", wrong, || rig.camera(0)).await;
    };
    tokio::select! {
        () = requesting => {}
        () = sending => {}
    }
}

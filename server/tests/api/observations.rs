//! Observations over REST and the WebSocket, and the server's clock over REST.

use std::{sync::Arc, time::Duration};

use axum::http::StatusCode;
use futures::{SinkExt, StreamExt};
use prost::Message as _;
use roundel_core::{id::CameraId, world::FrameObservations};
use roundel_proto::v1::{self, stream_message::Message as Alternative};
use roundel_server::model::hub::CameraInfo;
use serde_json::Value;
use tokio::time::timeout;
use tokio_tungstenite::{
    connect_async,
    tungstenite::{Message, client::IntoClientRequest},
};

use super::{
    grpc,
    rig::{Rig, TIMEOUT},
    websocket::{Socket, open},
};

fn publish(rig: &Rig, camera: u32, frame: u64) {
    let time = rig.clock.now();
    rig.hub.publish_observations(Arc::new(FrameObservations {
        camera: CameraId(camera),
        frame,
        capture_time: time,
        received_time: time,
        calibration_version: 3,
        detections: Vec::new(),
    }));
}

async fn next(socket: &mut Socket) -> Value {
    loop {
        let message = timeout(TIMEOUT, socket.next()).await.expect("no message arrives");
        if let Message::Text(text) = message.unwrap().unwrap() {
            return serde_json::from_str(&text).unwrap();
        }
    }
}

#[tokio::test]
async fn rest_serves_the_newest_frame_of_each_camera() {
    let rig = Rig::start().await;
    let frames = |answer: Value| -> Vec<(String, u64)> {
        let frames = answer["frames"].as_array().unwrap().clone();
        let of = |frame: &Value| {
            (frame["camera"].as_str().unwrap().to_owned(), frame["frame"].as_u64().unwrap())
        };
        frames.iter().map(of).collect()
    };
    assert_eq!(frames(rig.get("/api/v1/observations").await.json()), []);
    (1..4).for_each(|frame| publish(&rig, 1, frame));
    publish(&rig, 0, 7);
    let all = frames(rig.get("/api/v1/observations").await.json());
    assert_eq!(all, [("north".to_owned(), 7), ("south side".to_owned(), 3)]);
    let some = rig.get("/api/v1/observations?cameras=south%20side").await;
    assert_eq!(frames(some.json()), [("south side".to_owned(), 3)]);
    let request = v1::GetObservationsRequest { cameras: vec!["north".into()] };
    let newest = grpc::connect(&rig).await.get_observations(request).await.unwrap().into_inner();
    assert_eq!((newest.frames.len(), newest.frames[0].frame), (1, 7));
    let unknown = rig.get("/api/v1/observations?cameras=west").await;
    assert_eq!(unknown.status, StatusCode::NOT_FOUND);
    assert!(unknown.error().1.contains("there are: north, south side"), "{:?}", unknown.error());
    rig.hub.remove_camera(CameraId(0));
    let left = frames(rig.get("/api/v1/observations").await.json());
    assert_eq!(left, [("south side".to_owned(), 3)]);
    rig.stop().await;
}

#[tokio::test]
async fn a_websocket_streams_observations() {
    let rig = Rig::start().await;
    let mut socket = open(&rig, "?include=observations&cameras=north").await;
    let mut all = open(&rig, "").await;
    all.send(Message::text(r#"{"observations": {}}"#)).await.unwrap();
    // The server has processed the request as soon as it sends a frame.
    let subscribed = async {
        loop {
            publish(&rig, 1, 5);
            if let Ok(Some(Ok(Message::Text(text)))) =
                timeout(Duration::from_millis(10), all.next()).await
            {
                break text;
            }
        }
    };
    let text = timeout(TIMEOUT, subscribed).await.expect("no message arrives");
    assert!(text.starts_with(r#"{"observations":{"camera":"south side","#), "{text}");
    publish(&rig, 0, 8);
    publish(&rig, 0, 10);
    let first = next(&mut socket).await;
    assert_eq!(
        (&first["observations"]["camera"], &first["observations"]["frame"]),
        (&"north".into(), &8.into())
    );
    assert_eq!(next(&mut socket).await["observations"]["missed"], 1);

    // Losing its last camera ends the observations, but not the socket.
    rig.hub.set_camera(CameraId(0), CameraInfo { name: "renamed".into(), ..CameraInfo::default() });
    let error = next(&mut socket).await;
    assert_eq!(error["error"]["code"], "not_found", "{error}");
    socket.send(Message::text(r#"{"observations": {"cameras": ["north"]}}"#)).await.unwrap();
    let error = next(&mut socket).await;
    assert!(error["error"]["message"].as_str().unwrap().contains("no camera \"north\""), "{error}");

    let mut request = format!("ws://{}/api/v1/stream?include=observations", rig.address)
        .into_client_request()
        .unwrap();
    let protocol = "roundel.v1.protobuf".parse().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocol);
    let mut binary = connect_async(request).await.unwrap().0;
    publish(&rig, 0, 11);
    let Message::Binary(bytes) = timeout(TIMEOUT, binary.next()).await.unwrap().unwrap().unwrap()
    else {
        panic!("no binary message")
    };
    let message = v1::StreamMessage::decode(bytes).unwrap().message;
    let Some(Alternative::Observations(frame)) = message else { panic!("{message:?}") };
    assert_eq!((frame.camera.as_str(), frame.frame), ("renamed", 11));
    rig.stop().await;
}

#[tokio::test]
async fn rest_serves_the_clock() {
    let rig = Rig::start().await;
    let before_ns = rig.clock.now().as_ns();
    let time = rig.get("/api/v1/time?sent_time_ns=-12").await.json();
    let ns = |key: &str| time[key].as_str().unwrap().parse::<i64>().unwrap();
    assert_eq!(ns("sent_time_ns"), -12);
    assert!(before_ns <= ns("received_time_ns") && ns("received_time_ns") <= ns("replied_time_ns"));
    assert!(ns("replied_time_ns") <= rig.clock.now().as_ns());
    let (_, message) = rig.get("/api/v1/time?sent_time_ns=noon").await.error();
    assert!(message.starts_with("sent_time_ns: expected whole nanoseconds"), "{message}");
    rig.stop().await;
}

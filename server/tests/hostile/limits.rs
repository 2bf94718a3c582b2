//! Attacks on memory, processor time and connections of a server, with an honest client beside them.
//!
//! `cargo test -p roundel-server --all-features --test main hostile::limits -- --nocapture` prints the share of its rate
//! that the honest client keeps, and how much the server's memory grows.

// An attack begins when it is called, and its end is awaited later.
#![allow(clippy::async_yields_async)]

mod attacked_server;
mod attacks;

use std::time::Duration;

use axum::http::StatusCode;
use futures::{StreamExt as _, future::pending};
use roundel_proto::v1::{self, push_request::Message};
use serde_json::Value;
use tokio::{
    io::AsyncWriteExt as _,
    net::TcpStream,
    time::{sleep, timeout},
};
use tonic::Code;

use self::attacked_server::{AttackedServer, TIMEOUT, detection, encoded, frame, greeting, push};

/// A page of 97 megapixels.
const LARGEST_PRINT: &str = "/api/v1/print?format=png&page=2000x2000&marker=160:64&dpi=125";

async fn get_json(server: &AttackedServer, path: &str) -> Value {
    serde_json::from_slice(attacks::get(server.url(path)).await.body()).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_prints_share_a_budget() {
    let mut server = AttackedServer::start().await;
    server
        .withstands("six prints of 22 megapixels", async |server| {
            attacks::large_prints(&server.address).await
        })
        .await;
    let response =
        attacks::get(server.url("/api/v1/print?format=png&page=2000x2000&marker=160:64&dpi=300"))
            .await;
    let text = String::from_utf8_lossy(response.body());
    assert_eq!(response.status(), StatusCode::BAD_REQUEST);
    assert!(text.contains("exceeds the limit of 100000000 pixels"), "{text}");
    let response =
        attacks::get(server.url("/api/v1/print?marker=20&code=16:1&copies=1000&page=A2")).await;
    let text = String::from_utf8_lossy(response.body());
    assert_eq!(response.status(), StatusCode::BAD_REQUEST);
    assert!(text.contains("expected at most 5000 roundels"), "{text}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn work_stops_when_its_client_goes() {
    let server = AttackedServer::start().await;
    for _ in 0..6 {
        let mut stream = TcpStream::connect(&server.address).await.unwrap();
        let head = format!("GET {LARGEST_PRINT} HTTP/1.1\r\nHost: {}\r\n\r\n", server.address);
        stream.write_all(head.as_bytes()).await.unwrap();
        // Long enough for the work to begin, and far shorter than it takes.
        sleep(Duration::from_millis(300)).await;
    }
    // With work that goes on, threads and bytes would be taken for a minute.
    let small = server.url("/api/v1/print?format=svg&marker=160:64");
    let free = async { while attacks::get(small.clone()).await.status() != StatusCode::OK {} };
    timeout(Duration::from_secs(15), free).await.expect("the work goes on");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pushed_frame_has_a_limited_number_of_detections() {
    let mut server = AttackedServer::start().await;
    server
        .withstands("14 messages of 40,000 detections", async |server| {
            attacks::large_pushes(&server.address).await
        })
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn texts_of_senders_are_short_single_lines() {
    let server = AttackedServer::start().await;
    let address = || server.address.clone();
    let troubled = tokio::spawn(attacks::long_text(&server.address).await);
    let named = v1::Detection { roundel: "y".repeat(100_000), ..detection(0) };
    let named = v1::PushedObservations { sequence: 1, ..frame(vec![named]) };
    let named = vec![encoded(Message::Observations(named))];
    let status = push(address(), greeting("a1"), named).await.unwrap();
    let expected =
        "observations.detections[0].roundel: expected at most 1024 bytes, found 100000 bytes";
    assert_eq!((status.code(), status.message()), (Code::InvalidArgument, expected));
    for (length, expected) in [
        (20_000, "greeting.camera: expected at most 1024 bytes, found 20000 bytes"),
        (100_000, "greeting: expected at most 65536 bytes before its welcome, found more"),
    ] {
        let status = push(address(), greeting(&"z".repeat(length)), vec![]).await.unwrap();
        assert_eq!((status.code(), status.message()), (Code::InvalidArgument, expected));
    }
    troubled.await.unwrap();

    let events = get_json(&server, "/api/v1/events?backlog=1000").await;
    let messages: Vec<&str> = events["events"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["message"].as_str().unwrap())
        .collect();
    let failed = messages.iter().find(|message| message.contains("no cable")).expect("an event");
    assert!(failed.contains(r"no cable\n2026-01-01 INFO forged \u{1b}[31mxxx"), "{failed}");
    assert!(messages.iter().all(|message| message.len() < 1200 && !message.contains('\n')));
    let log = server.log();
    assert!(log.contains("no cable") && log.lines().all(|line| line.len() < 2000));
    assert!(!log.lines().any(|line| line.starts_with("2026-01-01 INFO forged")));
    let cameras = get_json(&server, "/api/v1/cameras").await.to_string();
    assert!(cameras.len() < 100_000, "{}", cameras.len());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn numbers_of_senders_do_not_overflow() {
    let mut server = AttackedServer::start().await;
    let figures = v1::PushedFigures {
        width: u32::MAX,
        height: u32::MAX,
        dropped: u64::MAX,
        broken: u64::MAX,
        ..Default::default()
    };
    let seen = |sequence| {
        Message::Observations(v1::PushedObservations {
            sequence,
            figures: Some(figures),
            ..frame(vec![detection(0)])
        })
    };
    let probe =
        |next_sequence| Message::Probe(v1::PushProbe { next_sequence, ..Default::default() });
    let messages = vec![seen(5), probe(u64::MAX), seen(u64::MAX), probe(u64::MAX), seen(u64::MAX)];
    let first = v1::PushGreeting { next_sequence: u64::MAX, dropped: u64::MAX, ..greeting("a0") };
    let again = v1::PushGreeting { run_id: "second".into(), ..first.clone() };
    for (greeting, messages) in [
        (greeting("a1"), messages.clone()),
        (first, vec![probe(u64::MAX)]),
        (again, vec![seen(u64::MAX)]),
        (greeting("a1"), messages),
    ] {
        let messages = messages.into_iter().map(encoded).collect();
        let end = push(server.address.clone(), greeting, messages).await;
        assert!(end.is_none(), "{end:?}");
    }
    assert!(server.is_alive() && !server.log().contains("panic"), "{}", server.log());
    let cameras = get_json(&server, "/api/v1/cameras").await;
    let a1 = cameras["cameras"].as_array().unwrap().iter().find(|it| it["name"] == "a1").unwrap();
    assert_eq!(a1["dropped"], u64::MAX, "{a1}");
    // The history and the clock take any time.
    for query in
        ["from=-9223372036854775808&until=9223372036854775807", "until=-9223372036854775808"]
    {
        assert_ne!(
            attacks::get(server.url(&format!("/api/v1/history?{query}"))).await.status(),
            500
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn many_selections_do_not_slow_an_honest_client() {
    let mut server = AttackedServer::start().await;
    server
        .withstands("3,840 different selections", async |server| {
            attacks::many_selections(&server.address).await
        })
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn slow_connections_do_not_lock_out_new_ones() {
    let mut server = AttackedServer::start().await;
    for (name, head) in attacks::SLOW_HEADS {
        server
            .withstands(name, async |server| attacks::slow_connections(&server.address, head).await)
            .await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn all_attacks_in_turn_leave_the_server_as_it_was() {
    let mut server = AttackedServer::start().await;
    let in_turn = async |server: &AttackedServer| {
        let address = server.address.clone();
        let attacks: attacks::Running = Box::pin(async move {
            for (_, head) in attacks::SLOW_HEADS {
                attacks::slow_connections(&address, head).await.await;
            }
            attacks::large_prints(&address).await.await;
            attacks::large_pushes(&address).await.await;
            attacks::endless_files(&address).await.await;
            attacks::long_text(&address).await.await;
            attacks::many_selections(&address).await.await;
        });
        attacks
    };
    server.withstands("all attacks in turn", in_turn).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_of_events_are_limited_per_connection() {
    let server = AttackedServer::start().await;
    let mut client = server.roundel().await;
    let mut open = Vec::new();
    for _ in 0..16 {
        let request = v1::SubscribeEventsRequest { backlog: 1000 };
        open.push(client.subscribe_events(request).await.unwrap());
    }
    let status = client.subscribe_events(v1::SubscribeEventsRequest::default()).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.message().contains("all 16 streams of events"), "{status}");
    client.subscribe_snapshots(v1::SubscribeSnapshotsRequest::default()).await.unwrap();
    open.pop();
    let free = async {
        while client.subscribe_events(v1::SubscribeEventsRequest::default()).await.is_err() {}
    };
    timeout(TIMEOUT, free).await.expect("a closed stream still counts");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_sender_without_a_greeting_sends_little() {
    let server = AttackedServer::start().await;
    let jpeg = Some(v1::pushed_frame::Picture::Jpeg(vec![0; 10_000_000]));
    let frame = v1::PushedFrame { sequence: 1, picture: jpeg, ..Default::default() };
    let request = v1::PushRequest { message: Some(Message::Frame(frame)) };
    let mut client = v1::push_client::PushClient::new(server.channel().await);
    let requests = futures::stream::iter([request]).chain(futures::stream::once(pending()));
    let status = match client.send(requests).await {
        Ok(answers) => answers.into_inner().message().await.unwrap_err(),
        Err(status) => status,
    };
    assert_eq!(status.code(), Code::InvalidArgument, "{status}");
    assert!(status.message().contains("at most 65536 bytes before its welcome"), "{status}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_picture_of_another_size_is_not_decoded() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("large.png");
    let mut encoder = png::Encoder::new(std::fs::File::create(&picture).unwrap(), 7000, 7000);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().unwrap();
    let mut rows = writer.stream_writer().unwrap();
    for _ in 0..7000 {
        std::io::Write::write_all(&mut rows, &[0; 7000 * 8]).unwrap();
    }
    rows.finish().unwrap();
    let more = format!(
        "[[camera]]\nname = \"files\"\nsource = \"images:{}\"\ncalibration = \"camera.yaml\"\n\
         pose = {{ position_m = [0.0, 9.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }}\n",
        picture.display()
    );
    let mut server = AttackedServer::start_with(&more).await;
    let retries = async |_: &AttackedServer| sleep(Duration::from_secs(4));
    server.withstands("a picture of 49 megapixels, 16 bits RGBA", retries).await;
    let cameras = get_json(&server, "/api/v1/cameras").await.to_string();
    assert!(cameras.contains("expected an image of 320 x 240 pixels"), "{cameras}");
}

//! Messages of remote programs that feed a camera.

use std::{
    path::Path,
    sync::{
        Arc, LazyLock,
        atomic::{AtomicU64, Ordering},
        mpsc::sync_channel,
    },
};

use axum::{
    Router,
    body::Body,
    http::{HeaderMap, Request, Version},
};
use bytes::Bytes;
use futures::stream;
use http_body_util::BodyExt as _;
use prost::Message as _;
use roundel_core::{time::Timestamp, world::FrameObservations};
use roundel_proto::v1::{self, push_request::Message, push_response::Message as Answer};
use roundel_server::{
    api::{ApiState, grpc, picture},
    capture::{
        source::{OpenSource as _, Playback, SourceOpener, SourceOutput},
        worker::WorkerOutput,
    },
    fusion::{FusionTask, setup::fusion_machine},
    model::{address::SourceAddress, config::Config, convert, hub::Picture, stop::StopSignal},
};
use tokio::runtime::Runtime;
use tower::ServiceExt as _;

use super::lab::{self, MAX_DETECTIONS, PUSHED, SIZE};

/// Answered last, if the message before it was accepted.
const MARKER_NS: i64 = 4_711_471_147_114_711;
/// The kinds of [`lab::api`], and an object with several roundels.
const CONFIG: &str = r#"
[[roundel]]
name = "robot"
outer_mm = 160
inner_mm = 64
[[roundel]]
name = "cart"
outer_mm = 160
code = { bits = 8, min_distance = 2 }
[[object]]
name = "carrier"
roundel = [
  { kind = "cart", code = 1, position_m = [0.2, 0.0, 0.3] },
  { kind = "cart", code = 2, position_m = [-0.2, 0.0, 0.3], yaw_deg = 90.0 },
]
[[camera]]
name = "north"
source = "sim:"
"#;

struct Lab {
    runtime: Runtime,
    api: Arc<ApiState>,
    router: Router,
    config: Config,
    runs: AtomicU64,
}

static LAB: LazyLock<Lab> = LazyLock::new(|| {
    let (runtime, api) = (lab::runtime(), Arc::new(lab::api()));
    let (router, _) = runtime.block_on(async { grpc::router(&api) });
    let config = Config::parse(CONFIG, Path::new("")).unwrap();
    Lab { runtime, api, router, config, runs: AtomicU64::new(0) }
});

/// A message is answered whether it comes first or later, and whatever it brings can be decoded, fused and drawn.
pub fn run(data: &[u8]) {
    LAB.send(&[data]);
    let times = v1::PushTimes::try_from(data.len() as i32 % 4).unwrap_or_default();
    let greeting = v1::PushGreeting {
        camera: PUSHED.1.into(),
        sender: "fuzz".into(),
        run_id: LAB.runs.fetch_add(1, Ordering::Relaxed).to_string(),
        times: times.into(),
        ..v1::PushGreeting::default()
    };
    let marker = v1::PushProbe { sent_time_ns: MARKER_NS, ..v1::PushProbe::default() };
    let [greeting, marker] = [Message::Greeting(greeting), Message::Probe(marker)]
        .map(|message| v1::PushRequest { message: Some(message) }.encode_to_vec());
    let (answers, status) = LAB.send(&[&greeting, data, &marker]);
    assert!(matches!(answers.first(), Some(Answer::Welcome(_))), "{answers:?}");
    if status == "0" {
        let last = answers.iter().rev().find_map(|answer| match answer {
            Answer::ProbeAnswer(answer) => Some(answer.sent_time_ns),
            _ => None,
        });
        assert_eq!(last, Some(MARKER_NS), "{answers:?}");
    }
    LAB.take_items();
    LAB.show_picture();
}

impl Lab {
    /// The answers to these messages, and the status with which the stream ends.
    fn send(&self, messages: &[&[u8]]) -> (Vec<Answer>, String) {
        let framed = |message: &&[u8]| {
            let length = (message.len() as u32).to_be_bytes();
            Ok::<_, std::io::Error>(Bytes::from([&[0], &length[..], message].concat()))
        };
        let body: Vec<_> = messages.iter().map(framed).collect();
        let request = Request::post("/roundel.v1.Push/Send")
            .version(Version::HTTP_2)
            .header("content-type", "application/grpc")
            .header("te", "trailers")
            .body(Body::from_stream(stream::iter(body)))
            .unwrap();
        let answer = async {
            let response = self.router.clone().oneshot(request).await.unwrap();
            let headers = response.headers().clone();
            let body = response.into_body().collect().await.unwrap();
            let trailers = body.trailers().cloned();
            (headers, trailers, body.to_bytes())
        };
        let (headers, trailers, body) = self.runtime.block_on(answer);
        let status =
            |headers: &HeaderMap| Some(headers.get("grpc-status")?.to_str().ok()?.to_owned());
        let status = trailers.as_ref().and_then(status).or_else(|| status(&headers));
        (answers(&body), status.expect("a stream ends with a status"))
    }

    /// Takes what has arrived, as the camera's worker does.
    fn take_items(&self) {
        let (clock, origin) = (self.api.clock, Timestamp::default());
        let playback = Playback { origin, zero: None, cycle_ns: 0 };
        let address = SourceAddress::parse("push:", Path::new("")).unwrap();
        let endpoint = self.api.ports.get(PUSHED.0).unwrap();
        let opener = SourceOpener::new(address, SIZE, clock, playback, StopSignal::default());
        let Ok(mut source) = opener.with_push_endpoint(endpoint).open() else { return };
        while let Ok(item) = source.next() {
            match item {
                SourceOutput::Frame(lent) => {
                    assert_eq!((lent.frame.width(), lent.frame.height()), SIZE);
                }
                SourceOutput::Detections(remote) => {
                    let frame = FrameObservations { camera: PUSHED.0, ..remote.observations };
                    assert!(frame.detections.len() <= MAX_DETECTIONS);
                    self.use_detections(Arc::new(frame));
                }
            }
        }
    }

    fn use_detections(&self, frame: Arc<FrameObservations>) {
        let installation = self.api.hub.installation();
        serde_json::to_vec(&convert::observations(&installation, &frame)).unwrap();
        let pixels = vec![128; SIZE.0 * SIZE.1];
        picture::encode(&Picture::new(SIZE, pixels, frame.clone()), &[]).unwrap();
        let fusion = fusion_machine(&self.config).unwrap();
        let hub = self.api.hub.clone();
        let mut task = FusionTask::new(fusion, hub, self.api.clock, sync_channel(1).1);
        let again = FrameObservations {
            frame: frame.frame.wrapping_add(1),
            capture_time: frame.capture_time.plus_seconds(0.02),
            received_time: frame.received_time.plus_seconds(0.02),
            ..FrameObservations::clone(&frame)
        };
        let pose_time = again.capture_time;
        for (observations, placement) in [(frame, Some(lab::placement())), (Arc::new(again), None)]
        {
            task.observe(&WorkerOutput { observations, placement });
        }
        task.publish(pose_time, None);
        let fused = self.api.hub.snapshots().borrow().clone();
        for object in &fused.snapshot.objects {
            let numbers = object.position_m.iter().chain(object.velocity_m_s.iter());
            let numbers = numbers.chain(object.orientation.coords.iter());
            let mut numbers = numbers.chain(object.covariance.iter());
            assert!(numbers.all(|number| number.is_finite()), "{object:?}");
        }
    }

    /// Draws the newest picture that was sent to be shown.
    fn show_picture(&self) {
        let Some(pictures) = self.api.hub.request_picture(PUSHED.0) else { return };
        let newest = pictures.borrow().clone();
        if let Some(newest) = newest {
            picture::encode(&newest, &[]).unwrap();
        }
    }
}

fn answers(mut body: &[u8]) -> Vec<Answer> {
    let mut answers = Vec::new();
    while let Some((head, rest)) = body.split_first_chunk::<5>() {
        let length = u32::from_be_bytes([head[1], head[2], head[3], head[4]]) as usize;
        let (message, rest) = rest.split_at(length);
        answers.extend(v1::PushResponse::decode(message).unwrap().message);
        body = rest;
    }
    answers
}

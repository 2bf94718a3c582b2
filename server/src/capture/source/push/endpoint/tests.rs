use roundel_core::{time::Timestamp, world::FrameObservations};

use super::*;
use crate::capture::source::push::SentPicture;

fn item(what: Payload) -> PushedItem {
    PushedItem { what, times: SenderClock::Server, clock: None, arrived: Timestamp::default() }
}

fn detections() -> PushedItem {
    let time = Timestamp::default();
    let observations = FrameObservations {
        camera: CameraId(0),
        frame: 0,
        capture_time: time,
        received_time: time,
        calibration_version: 0,
        detections: vec![],
    };
    item(Payload::Detections(Box::new(observations), None))
}

fn hello(run_id: &str, next_sequence: u64) -> SenderHello {
    SenderHello {
        sender: format!("node {run_id}"),
        address: "here".into(),
        run_id: run_id.into(),
        next_sequence,
        ..SenderHello::default()
    }
}

fn next(endpoint: &PushEndpoint) -> Result<u64, SourceError> {
    let taken = endpoint.next(Instant::now(), Duration::from_millis(30), &StopSignal::default());
    taken.map(|(_, skipped)| skipped)
}

fn failure(endpoint: &PushEndpoint) -> String {
    match next(endpoint) {
        Err(SourceError::Failed(message)) => message,
        other => panic!("{other:?}"),
    }
}

fn counts(endpoint: &PushEndpoint) -> [u64; 3] {
    let link = endpoint.link();
    [link.received, link.missing, link.repeated]
}

#[tokio::test]
async fn items_dropped_before_the_first_connection_are_counted() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&SenderHello { dropped: 7, ..hello("a", 10) }).unwrap();
    assert_eq!(counts(&endpoint), [0, 7, 0]);
    sender.put(10, detections()).await.unwrap();
    assert_eq!(next(&endpoint).unwrap(), 7);
    drop(sender);
    // Within a run the sequence numbers tell, and the count is capped.
    endpoint.connect(&SenderHello { dropped: 9, ..hello("a", 11) }).unwrap();
    assert_eq!(counts(&endpoint), [1, 7, 0]);
    endpoint.connect(&SenderHello { dropped: 90, ..hello("b", 3) }).unwrap();
    assert_eq!(counts(&endpoint), [1, 9, 0]);
}

#[tokio::test]
async fn repeated_items_count_once_and_missing_ones_are_counted() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&hello("a", 4)).unwrap();
    assert_eq!(sender.newest_sequence, 0);
    for sequence in [4, 5, 5, 4, 9] {
        sender.put(sequence, detections()).await.unwrap();
    }
    assert_eq!(counts(&endpoint), [3, 3, 2]);
    assert_eq!([next(&endpoint), next(&endpoint), next(&endpoint)], [Ok(3), Ok(0), Ok(0)]);
    // The sender reconnects before the old connection is known to be dead.
    let again = endpoint.connect(&hello("a", 9)).unwrap();
    assert_eq!(again.newest_sequence, 9);
    assert_eq!(sender.put(10, detections()).await, Err(PushError::Superseded));
    drop(sender);
    assert!(endpoint.link().connected, "the old session is superseded");
    again.put(10, detections()).await.unwrap();
    assert_eq!(next(&endpoint), Ok(0));
    again.keep_alive(13, [1.0, 0.3]).unwrap();
    assert_eq!(counts(&endpoint), [4, 5, 2]);
    assert_eq!([endpoint.take_skipped(), endpoint.take_skipped()], [2, 0]);
    assert_eq!(again.put(0, detections()).await, Err(PushError::Sequence));
    // Another run has its own sequence numbers.
    drop(again);
    let other = endpoint.connect(&hello("b", 1)).unwrap();
    other.put(1, detections()).await.unwrap();
    assert_eq!((counts(&endpoint), other.newest_sequence), ([5, 5, 2], 0));
}

#[tokio::test]
async fn two_senders_do_not_share_a_camera() {
    let endpoint = Arc::new(PushEndpoint::default());
    let first = endpoint.connect(&hello("a", 1)).unwrap();
    let error = endpoint.connect(&hello("b", 1)).err().unwrap();
    assert!(error.to_string().contains("node a (here) is feeding this camera"), "{error}");
    drop(first);
    assert!(endpoint.connect(&hello("b", 1)).is_ok());
}

#[tokio::test]
async fn the_newest_frame_wins_and_the_others_are_counted() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&hello("a", 1)).unwrap();
    for sequence in 1..=5 {
        let picture = SentPicture::Grey(vec![0], (1, 1));
        let frame = item(Payload::Frame(picture, Timestamp::default()));
        sender.put(sequence, frame).await.unwrap();
    }
    assert_eq!(next(&endpoint), Ok(4));
    assert_eq!(counts(&endpoint), [5, 0, 0]);
}

#[tokio::test]
async fn detections_wait_for_space() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&hello("a", 1)).unwrap();
    let all = async {
        for sequence in 1..=200 {
            sender.put(sequence, detections()).await.unwrap();
        }
    };
    let taking = async {
        let mut skipped = 0;
        for _ in 0..200 {
            tokio::task::yield_now().await;
            skipped += next(&endpoint).unwrap();
        }
        skipped
    };
    let ((), skipped) = tokio::join!(all, taking);
    assert_eq!((skipped, counts(&endpoint)), (0, [200, 0, 0]));
}

#[tokio::test]
async fn a_failure_has_a_reason() {
    let endpoint = Arc::new(PushEndpoint::default());
    assert!(failure(&endpoint).contains("no program feeds it yet: start `roundel node`"));
    let sender = endpoint.connect(&hello("a", 1)).unwrap();
    assert!(endpoint.ready().is_ok());
    assert!(failure(&endpoint).contains("nothing from node a (here) for 0.0 s"));
    sender.report_failure("unplugged").unwrap();
    assert_eq!(failure(&endpoint), "at node a: unplugged");
    // The first item clears the failure, and is delivered even if its sender has disconnected.
    sender.put(1, detections()).await.unwrap();
    drop(sender);
    assert_eq!(next(&endpoint), Ok(0));
    assert!(failure(&endpoint).contains("node a (here) has disconnected"));
}

#[tokio::test]
async fn a_pause_ends_with_a_connection() {
    let endpoint = Arc::new(PushEndpoint::default());
    assert!(endpoint.ready().is_err());
    let waiting = endpoint.clone();
    let pause = std::thread::spawn(move || waiting.pause(Duration::ZERO, &StopSignal::default()));
    let _sender = endpoint.connect(&hello("a", 1)).unwrap();
    assert!(!pause.join().unwrap());
    let stop = StopSignal::default();
    stop.stop();
    let _ = failure(&endpoint);
    assert!(endpoint.pause(Duration::from_secs(3600), &stop));
}

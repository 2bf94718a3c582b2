use roundel_core::{id::CameraId, time::Timestamp, world::FrameObservations};

use super::*;

fn seen() -> PushedItem {
    let time = Timestamp::default();
    let observations = FrameObservations {
        camera: CameraId(0),
        frame: 0,
        capture_time: time,
        received_time: time,
        calibration_version: 0,
        detections: vec![],
    };
    let what = Payload::Detections(Box::new(observations), None);
    PushedItem { what, times: SenderClock::Server, clock: None, arrived: time }
}

fn picture() -> PushedItem {
    let what = Payload::Grey(vec![0], (1, 1), Timestamp::default());
    PushedItem { what, times: SenderClock::Server, clock: None, arrived: Timestamp::default() }
}

fn greeting(run_id: &str, next_sequence: u64) -> SenderHello {
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
async fn what_was_dropped_before_the_first_connection_is_known() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&SenderHello { dropped: 7, ..greeting("a", 10) }).unwrap();
    assert_eq!(counts(&endpoint), [0, 7, 0]);
    sender.put(10, seen()).await.unwrap();
    assert_eq!(next(&endpoint).unwrap(), 7, "the worker hears of them");
    drop(sender);
    // Of the same run all is known by its numbers, and nobody drops more than there was.
    endpoint.connect(&SenderHello { dropped: 9, ..greeting("a", 11) }).unwrap();
    assert_eq!(counts(&endpoint), [1, 7, 0]);
    endpoint.connect(&SenderHello { dropped: 90, ..greeting("b", 3) }).unwrap();
    assert_eq!(counts(&endpoint), [1, 9, 0]);
}

#[tokio::test]
async fn what_comes_twice_counts_once_and_what_never_comes_is_known() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&greeting("a", 4)).unwrap();
    assert_eq!(sender.newest_sequence, 0, "nothing was taken of it yet");
    for sequence in [4, 5, 5, 4, 9] {
        sender.put(sequence, seen()).await.unwrap();
    }
    assert_eq!(counts(&endpoint), [3, 3, 2]);
    assert_eq!([next(&endpoint), next(&endpoint), next(&endpoint)], [Ok(3), Ok(0), Ok(0)]);
    // It comes back over another connection, while the old one is not known to be dead.
    let again = endpoint.connect(&greeting("a", 9)).unwrap();
    assert_eq!(again.newest_sequence, 9);
    assert_eq!(sender.put(10, seen()).await, Err(PushError::Superseded));
    drop(sender);
    assert!(endpoint.link().connected, "the old connection's end ends nothing");
    again.put(10, seen()).await.unwrap();
    assert_eq!(next(&endpoint), Ok(0));
    again.keep_alive(13, [1.0, 0.3]).unwrap();
    assert_eq!(counts(&endpoint), [4, 5, 2]);
    assert_eq!(
        [endpoint.take_skipped(), endpoint.take_skipped()],
        [2, 0],
        "no later frame tells of them"
    );
    assert_eq!(again.put(0, seen()).await, Err(PushError::Sequence));
    // Another run of it counts anew.
    drop(again);
    let other = endpoint.connect(&greeting("b", 1)).unwrap();
    other.put(1, seen()).await.unwrap();
    assert_eq!((counts(&endpoint), other.newest_sequence), ([5, 5, 2], 0));
}

#[tokio::test]
async fn two_senders_do_not_share_a_camera() {
    let endpoint = Arc::new(PushEndpoint::default());
    let first = endpoint.connect(&greeting("a", 1)).unwrap();
    let error = endpoint.connect(&greeting("b", 1)).err().unwrap();
    assert!(error.to_string().contains("node a (here) is feeding this camera"), "{error}");
    drop(first);
    assert!(endpoint.connect(&greeting("b", 1)).is_ok());
}

#[tokio::test]
async fn the_newest_frame_wins_and_the_others_are_counted() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&greeting("a", 1)).unwrap();
    for sequence in 1..=5 {
        sender.put(sequence, picture()).await.unwrap();
    }
    assert_eq!(next(&endpoint), Ok(4));
    assert_eq!(counts(&endpoint), [5, 0, 0]);
}

#[tokio::test]
async fn detections_wait_for_room() {
    let endpoint = Arc::new(PushEndpoint::default());
    let sender = endpoint.connect(&greeting("a", 1)).unwrap();
    let all = async {
        for sequence in 1..=200 {
            sender.put(sequence, seen()).await.unwrap();
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
async fn why_nothing_comes_is_told() {
    let endpoint = Arc::new(PushEndpoint::default());
    assert!(failure(&endpoint).contains("no program feeds it yet: start `roundel node`"));
    let sender = endpoint.connect(&greeting("a", 1)).unwrap();
    assert!(endpoint.ready().is_ok());
    assert!(failure(&endpoint).contains("nothing from node a (here) for 0.0 s"));
    sender.report_failure("unplugged".into()).unwrap();
    assert_eq!(failure(&endpoint), "at node a: unplugged");
    // The first frame takes it back, and one that is there is given even if its sender has gone.
    sender.put(1, seen()).await.unwrap();
    drop(sender);
    assert_eq!(next(&endpoint), Ok(0));
    assert!(failure(&endpoint).contains("node a (here) has gone"));
}

#[tokio::test]
async fn a_pause_ends_when_somebody_sends() {
    let endpoint = Arc::new(PushEndpoint::default());
    assert!(endpoint.ready().is_err());
    let waiting = endpoint.clone();
    let pause = std::thread::spawn(move || waiting.pause(Duration::ZERO, &StopSignal::default()));
    let _sender = endpoint.connect(&greeting("a", 1)).unwrap();
    assert!(!pause.join().unwrap());
    let stop = StopSignal::default();
    stop.stop();
    let _ = failure(&endpoint);
    assert!(endpoint.pause(Duration::from_secs(3600), &stop));
}

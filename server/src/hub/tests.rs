use super::*;

fn hub() -> Hub {
    Hub::new(Installation {
        name: "lab".into(),
        source_id: "s".into(),
        started: Timestamp::default(),
        snapshot_rate_hz: 60.0,
        cameras: Installation::numbered([CameraInfo {
            name: "north".into(),
            ..CameraInfo::default()
        }]),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: vec![],
    })
}

#[test]
fn a_slow_reader_finds_the_newest_snapshot_and_the_gap() {
    let hub = hub();
    let reader = hub.snapshots();
    for _ in 0..5 {
        hub.publish_snapshot(Snapshot::default(), Timestamp::default());
    }
    assert_eq!(reader.borrow().sequence, 5);
}

#[test]
fn events_are_neither_lost_nor_doubled_between_backlog_and_stream() {
    let hub = hub();
    let happening = Happening::Camera(CameraId(0), CameraStatus::Running);
    for _ in 0..3 {
        hub.publish_event(Timestamp::default(), happening, String::new());
    }
    let (backlog, mut stream) = hub.events(2);
    hub.publish_event(Timestamp::default(), happening, String::new());
    assert_eq!(backlog.iter().map(|e| e.sequence).collect::<Vec<_>>(), [2, 3]);
    assert_eq!(stream.try_recv().unwrap().sequence, 4);
}

#[test]
fn a_picture_is_made_once_for_each_request() {
    let hub = hub();
    assert!(!hub.take_picture_request(CameraId(0)));
    assert!(hub.request_picture(CameraId(0)).is_some());
    assert!(hub.take_picture_request(CameraId(0)));
    assert!(!hub.take_picture_request(CameraId(0)));
    assert!(hub.request_picture(CameraId(9)).is_none());
}

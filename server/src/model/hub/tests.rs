use roundel_core::world::LifeStage;
use roundel_proto::v1;

use super::*;
use crate::archive::replay::from_recording::read_snapshot;

fn hub() -> Hub {
    Hub::new(Installation {
        name: "lab".into(),
        source_id: "s".into(),
        started: Timestamp::default(),
        snapshot_rate_hz: 60.0,
        cameras: Installation::number_cameras([CameraInfo {
            name: "north".into(),
            ..CameraInfo::default()
        }]),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: vec![],
    })
}

#[test]
fn a_slow_reader_skips_to_the_newest_snapshot() {
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
    let publish =
        || hub.publish_event(Timestamp::default(), EventKind::CamerasAgree, String::new());
    (0..3).for_each(|_| publish());
    let (backlog, mut stream) = hub.events(2);
    publish();
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

#[test]
fn a_lost_object_is_listed_for_a_minute_or_until_it_is_recovered() {
    let hub = hub();
    let listed = |second: i64, ids: &[u64]| {
        let state = |&object_id: &u64| v1::ObjectState {
            object_id,
            stage: v1::LifeStage::Tracked.into(),
            ..v1::ObjectState::default()
        };
        let objects = ids.iter().map(state).collect();
        let pose_time_ns = second * 1_000_000_000;
        let message = v1::Snapshot { pose_time_ns, objects, ..v1::Snapshot::default() };
        hub.publish_snapshot(read_snapshot(&hub, &message), Timestamp::default());
        let each = hub.objects().into_iter();
        each.map(|it| (it.id.0, it.stage == LifeStage::Lost)).collect::<Vec<_>>()
    };
    assert_eq!(listed(0, &[1, 2]), [(1, false), (2, false)]);
    assert_eq!(listed(1, &[2]), [(1, true), (2, false)]);
    assert_eq!(listed(30, &[2, 3]), [(1, true), (2, false), (3, false)]);
    assert_eq!(listed(59, &[2]), [(1, true), (2, false), (3, true)]);
    assert_eq!(listed(60, &[2]), [(2, false), (3, true)]);
    assert_eq!(listed(61, &[2, 3]), [(2, false), (3, false)]);
    assert_eq!(listed(62, &[2]), [(2, false), (3, true)]);
    assert_eq!(listed(119, &[2]), [(2, false), (3, true)]);
    assert_eq!(listed(122, &[2]), [(2, false)]);
    hub.clear_objects();
    assert!(hub.objects().is_empty());
}

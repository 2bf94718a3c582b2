//! Replays of recordings: served as if live, fused again, and detected and fused again.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use prost::Message;
use roundel_client::{Client, v1};
use roundel_server::{
    app::{replay_server::ReplayServer, serve::Server},
    archive::{
        record::{
            RecordingOptions,
            file_reader::{Channel, FileReader, RecordedMessage},
            schema::Topic,
        },
        replay::{
            self, ReplayFrom,
            copy::copy,
            session::{ReplaySession, initial_status},
        },
    },
    model::config::Config,
};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
const TIMEOUT: Duration = Duration::from_secs(120);

/// Robots that are tracked at the same time, of six; the others may be out of sight.
const MIN_TRACKED: usize = 3;

/// Records two simulated cameras from the start of the server, with every frame.
async fn recorded(folder: &Path) -> PathBuf {
    recorded_while(folder, async |_| {}).await
}

/// Like [`recorded`], but runs `change` against the server as soon as robots are tracked.
async fn recorded_while(folder: &Path, change: impl AsyncFnOnce(Client)) -> PathBuf {
    let mut text = "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\nsnapshot_rate_hz = 30.0\n\
                    [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n\
                    [[object]]\nname = \"the robot\"\nroundel = \"robot\"\n\
                    [recording]\nstart = true\nmin_free_mb = 0\nframes_every = 1\nframes_format = \"png\"\n"
        .to_owned();
    for camera in 0..2 {
        text += &format!(
            "[[camera]]\nname = \"c{camera}\"\nsource = \"sim:?seed=1&robots=6&camera={camera}\"\nmode = \"fast\"\n"
        );
    }
    let server = Server::start(Config::parse(&text, folder).unwrap()).await.unwrap();
    let recorder = server.recorder().clone();
    let is_tracking = || server.hub().snapshots().borrow().snapshot.objects.len() >= MIN_TRACKED;
    until("robots", is_tracking).await;
    change(Client::connect(&format!("http://{}", server.local_addr())).await.unwrap()).await;
    let begun = server.hub().snapshots().borrow().sequence;
    until("two seconds", || server.hub().snapshots().borrow().sequence > begun + 60).await;
    until("robots", is_tracking).await;
    server.shutdown().await;
    Path::new(&recorder.status().folder).join(recorder.status().file)
}

async fn until(what: &str, is_reached: impl Fn() -> bool) {
    let look = async {
        while !is_reached() {
            sleep(Duration::from_millis(10)).await;
        }
    };
    timeout(TIMEOUT, look).await.unwrap_or_else(|_| panic!("{what} did not happen"));
}

fn open(file: &Path, from: ReplayFrom) -> ReplaySession {
    let file = file.to_owned();
    ReplaySession::open(&replay::session::ReplayOptions { file, from, config: None }).unwrap()
}

fn read<M: Message + Default>(path: &Path, topic: Topic) -> Vec<M> {
    let mut reader = FileReader::open(path).unwrap();
    let mut all: Vec<RecordedMessage> = Vec::new();
    while let Some(messages) = reader.next_chunk().unwrap() {
        all.extend(messages.into_iter().filter(|raw| raw.channel == Channel::Topic(topic)));
    }
    all.iter().map(|raw| M::decode(raw.data.as_slice()).unwrap()).collect()
}

/// The content of snapshots without sequence numbers, server and processing times.
fn contents(snapshots: &[v1::Snapshot]) -> Vec<(i64, i64, Vec<v1::ObjectState>)> {
    let each = snapshots.iter();
    each.map(|it| (it.pose_time_ns, it.capture_time_ns, it.objects.clone())).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fusing_again_reproduces_the_live_snapshots_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = recorded(folder.path()).await;
    let outputs = [1, 2, 3].map(|run| {
        let to = folder.path().join(format!("outputs{run}.mcap"));
        let copied = copy(open(&file, ReplayFrom::Observations), &to, |_| {}).unwrap();
        assert_eq!(copied.invalid_messages, 0, "{copied:?}");
        to
    });
    let bytes = outputs.each_ref().map(|path| fs::read(path).unwrap());
    assert!(bytes[0] == bytes[1] && bytes[1] == bytes[2], "three runs must write identical files");

    let live: Vec<v1::Snapshot> = read(&file, Topic::Snapshots);
    let fused: Vec<v1::Snapshot> = read(&outputs[0], Topic::Snapshots);
    assert!(
        live.iter().map(|it| it.objects.len()).max() >= Some(MIN_TRACKED),
        "robots must have been tracked"
    );
    // The recording covers the whole run, so fusion starts from the same state as live.
    assert_eq!(contents(&fused), contents(&live));
    let kinds = |path| {
        let events: Vec<v1::Event> = read(path, Topic::Events);
        let of_objects = events.into_iter().filter(|event| event.object_id > 0);
        of_objects.map(|event| (event.kind, event.object_id, event.time_ns)).collect::<Vec<_>>()
    };
    assert_eq!(kinds(&outputs[0]), kinds(&file));
    // The output is a recording itself.
    let again = folder.path().join("again.mcap");
    copy(open(&outputs[0], ReplayFrom::Observations), &again, |_| {}).unwrap();
    assert_eq!(contents(&read::<v1::Snapshot>(&again, Topic::Snapshots)), contents(&live));

    // Detecting again finds the same in each frame.
    let redetected = folder.path().join("redetected.mcap");
    let copied = copy(open(&file, ReplayFrom::Frames), &redetected, |_| {}).unwrap();
    assert_eq!(copied.invalid_messages, 0, "{copied:?}");
    let before: Vec<v1::FrameObservations> = read(&file, Topic::Observations);
    let after: Vec<v1::FrameObservations> = read(&redetected, Topic::Observations);
    let mut compared = 0;
    for camera in ["c0", "c1"] {
        // On a slow machine the recorder drops frames; after such a gap tracks continue differently.
        let found = after.iter().filter(|it| it.camera == camera);
        let without_gap = (1..).zip(found).take_while(|(number, found)| found.frame == *number);
        for (_, found) in without_gap {
            let is_same =
                |it: &&v1::FrameObservations| it.camera == camera && it.frame == found.frame;
            assert_eq!(Some(found), before.iter().find(is_same));
            compared += found.detections.len();
        }
    }
    assert!(compared > 20, "{compared} detections of {} frames", after.len());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_replay_repeats_configuration_changes_at_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let change = async |client: Client| {
        let offset_m = Some(v1::Vector3 { x: 0.05, y: 0.0, z: -0.3 });
        let named = v1::ObjectSetup { name: "rover".into(), offset_m, ..Default::default() };
        client.change_object("the robot", named, &["name", "offset_m"]).await.unwrap();
        let now = client.configuration().await.unwrap().toml;
        let text =
            format!("[fusion]\nacceleration_m_s2 = 6.0\n{}", now.split_once('\n').unwrap().1);
        let text = format!("name = \"lab\"\n{text}");
        client.apply_configuration(&text, "").await.unwrap();
    };
    let file = recorded_while(folder.path(), change).await;
    let configurations: Vec<v1::RecordedConfiguration> = read(&file, Topic::Configuration);
    let renamed: Vec<&str> = configurations.iter().map(|it| it.renamed_to.as_str()).collect();
    assert_eq!(renamed, ["", "rover", ""], "{configurations:?}");
    assert_eq!(configurations.iter().map(|it| it.fused).collect::<Vec<_>>(), [false, true, true]);

    let output = folder.path().join("fused.mcap");
    assert_eq!(
        copy(open(&file, ReplayFrom::Observations), &output, |_| {}).unwrap().invalid_messages,
        0
    );
    let live: Vec<v1::Snapshot> = read(&file, Topic::Snapshots);
    let fused: Vec<v1::Snapshot> = read(&output, Topic::Snapshots);
    // Live snapshots had the new name slightly earlier than fusion applied it.
    let nameless = |mut snapshots: Vec<v1::Snapshot>| {
        let objects = snapshots.iter_mut().flat_map(|it| &mut it.objects);
        objects.for_each(|object| object.name.clear());
        contents(&snapshots)
    };
    let live = nameless(live);
    assert_eq!(nameless(fused.clone()), live);
    let name = |it: Option<&v1::Snapshot>| it.unwrap().objects[0].name.clone();
    let tracked = || fused.iter().filter(|it| !it.objects.is_empty());
    assert_eq!([name(tracked().next()), name(tracked().next_back())], ["the robot", "rover"]);
    // The output can be fused again, too.
    let again = folder.path().join("again.mcap");
    copy(open(&output, ReplayFrom::Observations), &again, |_| {}).unwrap();
    assert_eq!(nameless(read(&again, Topic::Snapshots)), live);

    // Seeking near the end applies all earlier changes, and seeking to the start applies none.
    let session = open(&file, ReplayFrom::Observations);
    let begin = initial_status(&session, &file, ReplayFrom::Observations);
    let server = ReplayServer::start(session, "127.0.0.1:0".parse().unwrap(), begin).await.unwrap();
    let has_name = |what| {
        let installation = server.hub().installation();
        installation.object_names.values().any(|name| name == what)
    };
    until("the end", || server.replay().status().ended).await;
    assert!(has_name("rover"));
    let (begin, end) = server.replay().status().span;
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    for (second, name) in [(0.0, "the robot"), (end.seconds_since(begin) - 0.2, "rover")] {
        let request = v1::ControlReplayRequest {
            paused: Some(true),
            position_s: Some(second),
            ..v1::ControlReplayRequest::default()
        };
        client.control_replay(request).await.unwrap();
        until(name, || has_name(name)).await;
    }
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_replay_is_served_as_if_live_and_controllable() {
    let folder = tempfile::tempdir().unwrap();
    let file = recorded(folder.path()).await;
    let session = open(&file, ReplayFrom::Snapshots);
    let begin = initial_status(&session, &file, ReplayFrom::Snapshots);
    let length_s = begin.span.1.seconds_since(begin.span.0);
    let server = ReplayServer::start(session, "127.0.0.1:0".parse().unwrap(), begin).await.unwrap();
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    assert_eq!(client.info().await.unwrap().name, "lab");
    until("the end", || server.replay().status().ended).await;

    let live: Vec<v1::Snapshot> = read(&file, Topic::Snapshots);
    let last = client.snapshot().await.unwrap();
    assert_eq!(last.pose_time_ns, live.last().unwrap().pose_time_ns);
    let expected = &live.last().unwrap().objects[0];
    assert_eq!(&last.objects[0], expected, "states must be as recorded");
    let cameras = client.cameras().await.unwrap();
    assert_eq!(cameras.len(), 2);
    assert!(cameras.iter().all(|it| it.pose.is_some() && it.intrinsics.is_some()), "{cameras:?}");
    let replay = client.replay().await.unwrap();
    assert!(replay.ended && (replay.position_s - replay.duration_s).abs() < 1e-9, "{replay:?}");

    // Seeking works while paused.
    let request = v1::ControlReplayRequest {
        paused: Some(true),
        position_s: Some(length_s / 2.0),
        ..v1::ControlReplayRequest::default()
    };
    client.control_replay(request).await.unwrap();
    let middle_ns = replay.begin_time_ns + (length_s / 2.0 * 1e9) as i64;
    let is_there = || {
        let shown = server.hub().snapshots().borrow().snapshot.pose_time.as_ns();
        (shown - middle_ns).abs() < 300_000_000
    };
    until("the middle", is_there).await;
    let sequence = server.hub().snapshots().borrow().sequence;
    sleep(Duration::from_millis(200)).await;
    assert_eq!(
        server.hub().snapshots().borrow().sequence,
        sequence,
        "a paused replay must not publish"
    );
    let request = v1::ControlReplayRequest {
        paused: Some(false),
        speed: Some(50.0),
        looping: Some(true),
        ..v1::ControlReplayRequest::default()
    };
    assert_eq!(client.control_replay(request).await.unwrap().speed, 50.0);
    until("some rounds", || server.hub().snapshots().borrow().sequence > 5 * live.len() as u64)
        .await;

    let wrong =
        v1::ControlReplayRequest { speed: Some(0.0), ..v1::ControlReplayRequest::default() };
    let error = client.control_replay(wrong).await.unwrap_err().to_string();
    assert!(error.contains("speed: expected 0.01 to 100, found 0"), "{error}");
    let error = client.start_recording(v1::StartRecordingRequest::default()).await.unwrap_err();
    assert!(error.to_string().contains("plays a recording"), "{error}");
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reports_what_a_recording_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let config = "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\n[recording]\nmin_free_mb = 0\n\
                  [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n\
                  [[camera]]\nname = \"c0\"\nsource = \"sim:?seed=1&robots=2&camera=0\"\n";
    let server = Server::start(Config::parse(config, folder.path()).unwrap()).await.unwrap();
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    let error = client.replay().await.unwrap_err().to_string();
    assert!(error.contains("this server is live"), "{error}");
    let recorder = server.recorder().clone();
    let length = Some(Duration::from_millis(300));
    recorder.start(&RecordingOptions { length, ..RecordingOptions::default() }).unwrap();
    until("the end of the recording", || recorder.status().state() == v1::RecordingState::Stopped)
        .await;
    server.shutdown().await;
    let file = Path::new(&recorder.status().folder).join(recorder.status().file);
    let options =
        |from, config| replay::session::ReplayOptions { file: file.clone(), from, config };
    let error = ReplaySession::open(&options(ReplayFrom::Frames, None)).err().unwrap().to_string();
    assert!(error.contains("has no frames; record with --frames-every 1"), "{error}");
    let other = folder.path().join("other.toml");
    fs::write(&other, "name = 3\n").unwrap();
    let error = ReplaySession::open(&options(ReplayFrom::Observations, Some(other)))
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("other.toml cannot be used") && error.contains("`name` must be"),
        "{error}"
    );
}

//! Recording: the real pipeline over simulated cameras, into files that the test reads back.

use std::{collections::BTreeMap, fs, path::Path, time::Duration};

use prost::Message;
use roundel_proto::v1;
use roundel_server::{
    app::serve::Server,
    archive::record::{
        RecordError, RecordingOptions,
        file_reader::{Channel, FileReader, RecordedMessage},
        schema::Topic,
    },
    model::config::Config,
};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
const TIMEOUT: Duration = Duration::from_secs(60);

fn text(cameras: usize, recording: &str) -> String {
    let mut text = "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\nsnapshot_rate_hz = 30.0\n\
                    [detection]\nmode = \"fast\"\n\
                    [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n"
        .to_owned();
    for camera in 0..cameras {
        text += &format!(
            "[[camera]]\nname = \"c{camera}\"\nsource = \"sim:?seed=1&robots=8&camera={camera}\"\n"
        );
    }
    text + "[recording]\nmin_free_mb = 0\n" + recording
}

async fn start(folder: &Path, recording: &str) -> Server {
    Server::start(Config::parse(&text(2, recording), folder).unwrap()).await.unwrap()
}

async fn until(what: &str, is_reached: impl Fn() -> bool) {
    let look = async {
        while !is_reached() {
            sleep(Duration::from_millis(10)).await;
        }
    };
    timeout(TIMEOUT, look).await.unwrap_or_else(|_| panic!("{what} did not happen"));
}

/// All messages of a file, in order; the file must be undamaged.
fn read(path: &Path) -> Vec<RecordedMessage> {
    let mut reader = FileReader::open(path).unwrap();
    let mut all = Vec::new();
    while let Some(messages) = reader.next_chunk().unwrap() {
        all.extend(messages);
    }
    assert_eq!(reader.damage().sentences, Vec::<String>::new());
    all
}

fn of<M: Message + Default>(raws: &[RecordedMessage], topic: Topic) -> Vec<M> {
    let ours = raws.iter().filter(|raw| raw.channel == Channel::Topic(topic));
    ours.map(|raw| M::decode(raw.data.as_slice()).unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn records_everything_into_a_file_that_is_complete_after_shutdown() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path(), "frames_every = 5\nfolder = \"kept\"\n").await;
    let recorder = server.recorder().clone();
    assert_eq!(recorder.status().state(), v1::RecordingState::Idle);
    until("objects", || !server.hub().snapshots().borrow().snapshot.objects.is_empty()).await;
    recorder
        .start(&RecordingOptions { name: "trial".into(), ..RecordingOptions::default() })
        .unwrap();
    let busy = recorder.start(&RecordingOptions::default()).unwrap_err();
    assert!(matches!(&busy, RecordError::Busy(file) if file.starts_with("trial-")), "{busy}");
    until("messages", || recorder.status().messages > 200).await;
    let before = server.hub().snapshots().borrow().sequence;
    server.shutdown().await;
    let status = recorder.status();
    assert_eq!(
        (status.state(), status.dropped, status.files),
        (v1::RecordingState::Stopped, 0, 1),
        "{status:?}"
    );

    let path = folder.path().join("kept").join(&status.file);
    assert_eq!(fs::metadata(&path).unwrap().len(), status.bytes);
    let raws = read(&path);
    assert_eq!(raws.len() as u64, status.messages);
    let snapshots: Vec<v1::Snapshot> = of(&raws, Topic::Snapshots);
    let sequences: Vec<u64> = snapshots.iter().map(|snapshot| snapshot.sequence).collect();
    let (first, last) = (sequences[0], *sequences.last().unwrap());
    assert!(
        sequences.iter().copied().eq(first..=last) && last >= before,
        "expected snapshots without gaps up to shutdown"
    );
    let object = &snapshots.last().unwrap().objects[0];
    assert_eq!((object.covariance.len(), object.velocity_covariance.len()), (21, 6));
    let mut frames: BTreeMap<String, Vec<u64>> = BTreeMap::new();
    for seen in of::<v1::FrameObservations>(&raws, Topic::Observations) {
        frames.entry(seen.camera).or_default().push(seen.frame);
    }
    assert!(frames.keys().eq(["c0", "c1"]), "{frames:?}");
    for numbers in frames.values() {
        assert!(numbers.windows(2).all(|pair| pair[1] > pair[0]), "{numbers:?}");
    }
    // Camera poses that fusion received before the recording precede its first observation.
    let cameras: Vec<v1::FusedCamera> = of(&raws, Topic::Calibration);
    assert!(cameras.iter().any(|it| it.camera == "c1" && it.pose.is_some()), "{cameras:?}");
    let place = |topic| raws.iter().position(|raw| raw.channel == Channel::Topic(topic)).unwrap();
    assert!(place(Topic::Calibration) < place(Topic::Observations));
    let configuration: Vec<v1::RecordedConfiguration> = of(&raws, Topic::Configuration);
    assert_eq!(configuration.len(), 1);
    assert!(configuration[0].text.contains("name = \"c1\""), "{}", configuration[0].text);
    let health: Vec<v1::ListCamerasResponse> = of(&raws, Topic::Health);
    assert!(health.iter().all(|list| list.cameras.len() == 2) && health.len() > 1);
    let pictures = raws.iter().filter(|raw| raw.channel == Channel::Frame("c0".into()));
    let numbers: Vec<u32> = pictures.map(|raw| raw.sequence).collect();
    assert!(!numbers.is_empty() && numbers.iter().all(|number| number % 5 == 0), "{numbers:?}");
    let events: Vec<v1::Event> = of(&raws, Topic::Events);
    assert!(events.iter().any(|event| event.kind() == v1::EventKind::RecordingBegun), "{events:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rotates_files_within_the_disk_budget() {
    let folder = tempfile::tempdir().unwrap();
    // File sizes are checked once a second, so a file may exceed twice the limit.
    let limits = "start = true\nrotate_mb = 0.1\nbudget_gb = 0.0006\n";
    let server = start(folder.path(), limits).await;
    let recorder = server.recorder().clone();
    until("two deleted files", || recorder.status().deleted >= 2).await;
    server.shutdown().await;
    let status = recorder.status();
    assert_eq!((status.state(), status.dropped), (v1::RecordingState::Stopped, 0), "{status:?}");
    let files = recorder.list().unwrap();
    assert_eq!(files.len() as u32 + status.deleted, status.files, "{files:?}");
    assert!(files.iter().map(|file| file.bytes).sum::<u64>() < 900_000, "{files:?}");
    // Each file is readable alone: it repeats the configuration and calibration of those before it.
    assert!(files.len() >= 2, "{files:?}");
    let mut next = None;
    for file in files {
        let raws = read(&Path::new(&status.folder).join(file.name));
        let snapshots: Vec<v1::Snapshot> = of(&raws, Topic::Snapshots);
        // The last file may have been opened after the last snapshot.
        if let (Some(first), Some(last)) = (snapshots.first(), snapshots.last()) {
            assert_eq!(next.unwrap_or(first.sequence), first.sequence);
            next = Some(last.sequence + 1);
        }
        assert_eq!(of::<v1::RecordedConfiguration>(&raws, Topic::Configuration).len(), 1);
        let cameras: Vec<v1::FusedCamera> = of(&raws, Topic::Calibration);
        assert!(cameras.iter().filter(|it| it.pose.is_some()).count() >= 2, "{cameras:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_unwritable_folder_is_reported_and_the_server_keeps_running() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("taken"), "").unwrap();
    let server = start(folder.path(), "start = true\nfolder = \"taken/here\"\n").await;
    let (events, _) = server.hub().events(100);
    let messages: Vec<&str> = events.iter().map(|event| event.message.as_str()).collect();
    assert!(
        messages.iter().any(|it| it.contains("The recording was not started: cannot record into")),
        "{messages:?}"
    );
    until("snapshots", || server.hub().snapshots().borrow().sequence > 5).await;
    let recorder = server.recorder().clone();
    let error = recorder.start(&RecordingOptions::default()).unwrap_err().to_string();
    assert!(error.contains("taken/here") && error.contains("`folder` in [recording]"), "{error}");
    let error = recorder
        .start(&RecordingOptions { name: "../a".into(), ..RecordingOptions::default() })
        .unwrap_err();
    assert!(error.to_string().contains("found '/'"), "{error}");
    assert!(matches!(recorder.stop(), Err(RecordError::NotRecording)));
    server.shutdown().await;
}

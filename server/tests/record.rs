//! A server that records: the real pipeline over simulated cameras, into files that are read again.

use std::{collections::BTreeMap, fs, path::Path, time::Duration};

use prost::Message;
use roundel_proto::v1;
use roundel_server::{
    app::serve::Server,
    archive::record::{
        RecordError, RecordingOptions, RecordingState,
        file_reader::{Channel, FileReader, RecordedMessage},
        schema::Topic,
    },
    model::config::Config,
};
use tokio::time::{sleep, timeout};

/// Nothing here takes so long but on a machine that stands still.
const PATIENCE: Duration = Duration::from_secs(60);

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

async fn until(what: &str, wanted: impl Fn() -> bool) {
    let look = async {
        while !wanted() {
            sleep(Duration::from_millis(10)).await;
        }
    };
    timeout(PATIENCE, look).await.unwrap_or_else(|_| panic!("{what} did not come about"));
}

/// What is in a file, in its order.
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
async fn everything_goes_into_a_file_that_is_whole_at_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let server = start(folder.path(), "frames_every = 5\nfolder = \"kept\"\n").await;
    let recorder = server.recorder().unwrap().clone();
    assert_eq!(recorder.status().state, RecordingState::Idle);
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
        (status.state, status.dropped, status.files),
        (RecordingState::Stopped, 0, 1),
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
        "without gaps, to the end"
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
    // What fusion was told before the recording began is in it, ahead of what it saw.
    let told: Vec<v1::FusedCamera> = of(&raws, Topic::Calibration);
    assert!(told.iter().any(|told| told.camera == "c1" && told.pose.is_some()), "{told:?}");
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
async fn files_follow_one_another_within_the_budget() {
    let folder = tempfile::tempdir().unwrap();
    // A file is looked at once a second, so it may be more than twice as long as it was to be.
    let limits = "start = true\nrotate_mb = 0.1\nbudget_gb = 0.0006\n";
    let server = start(folder.path(), limits).await;
    let recorder = server.recorder().unwrap().clone();
    until("room made", || recorder.status().deleted >= 2).await;
    server.shutdown().await;
    let status = recorder.status();
    assert_eq!((status.state, status.dropped), (RecordingState::Stopped, 0), "{status:?}");
    let files = recorder.list().unwrap();
    assert_eq!(files.len() as u32 + status.deleted, status.files, "{files:?}");
    assert!(files.iter().map(|file| file.bytes).sum::<u64>() < 900_000, "{files:?}");
    // Each can be read by itself, and none lacks what the ones before have.
    assert!(files.len() >= 2, "{files:?}");
    let mut next = None;
    for file in files {
        let raws = read(&status.folder.join(file.name));
        let snapshots: Vec<v1::Snapshot> = of(&raws, Topic::Snapshots);
        // The last one may have begun when all was over.
        if let (Some(first), Some(last)) = (snapshots.first(), snapshots.last()) {
            assert_eq!(next.unwrap_or(first.sequence), first.sequence);
            next = Some(last.sequence + 1);
        }
        assert_eq!(of::<v1::RecordedConfiguration>(&raws, Topic::Configuration).len(), 1);
        let told: Vec<v1::FusedCamera> = of(&raws, Topic::Calibration);
        assert!(told.iter().filter(|told| told.pose.is_some()).count() >= 2, "{told:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_cannot_be_written_is_told_and_the_service_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("taken"), "").unwrap();
    let server = start(folder.path(), "start = true\nfolder = \"taken/here\"\n").await;
    let (events, _) = server.hub().events(100);
    let told: Vec<&str> = events.iter().map(|event| event.message.as_str()).collect();
    assert!(
        told.iter().any(|it| it.contains("Nothing is recorded: cannot record into")),
        "{told:?}"
    );
    until("snapshots", || server.hub().snapshots().borrow().sequence > 5).await;
    let recorder = server.recorder().unwrap().clone();
    let error = recorder.start(&RecordingOptions::default()).unwrap_err().to_string();
    assert!(error.contains("taken/here") && error.contains("`folder` in [recording]"), "{error}");
    let error = recorder
        .start(&RecordingOptions { name: "../a".into(), ..RecordingOptions::default() })
        .unwrap_err();
    assert!(error.to_string().contains("found '/'"), "{error}");
    assert!(matches!(recorder.stop(), Err(RecordError::NotRecording)));
    server.shutdown().await;
}

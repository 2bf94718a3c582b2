//! Failing disks, damaged files and hanging requests: localization goes on, the failure is shown, and the process can be
//! ended.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use roundel_client::Client;
use roundel_core::time::Timestamp;
use roundel_proto::v1::{self, EventKind, RecordingState};
use roundel_server::{
    app::serve::Server,
    archive::{
        history::store::{HistoryObject, HistoryPoint, Store},
        record::{RecordingOptions, file_reader::FileReader},
    },
    model::config::Config,
};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
const TIMEOUT: Duration = Duration::from_secs(60);
/// Time limit of a shutdown, and time for a slow machine.
const END_TIMEOUT: Duration = Duration::from_secs(15);

/// A configuration with a simulated camera, in a folder of its own.
pub struct Lab {
    pub folder: tempfile::TempDir,
}

impl Lab {
    /// `more`: the keys of `[recording]`, and further tables.
    pub fn new(more: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let text = format!(
            "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\nsnapshot_rate_hz = 30.0\n\
             [detection]\nmode = \"fast\"\n\
             [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n\
             [[camera]]\nname = \"c0\"\nsource = \"sim:?seed=1&robots=4&camera=0\"\n[recording]\n{more}"
        );
        fs::write(folder.path().join("lab.toml"), text).unwrap();
        Self { folder }
    }

    pub fn file(&self) -> PathBuf {
        self.folder.path().join("lab.toml")
    }

    pub async fn start(&self) -> Server {
        Server::start(Config::load(&self.file()).unwrap()).await.unwrap()
    }
}

/// The file of a recording of the lab, whose configuration starts one.
pub async fn recorded(lab: &Lab) -> PathBuf {
    let server = lab.start().await;
    let recorder = server.recorder().clone();
    until("a recording", || recorder.status().messages > 120).await;
    server.shutdown().await;
    only_recording(lab.folder.path())
}

async fn until(what: &str, is_reached: impl Fn() -> bool) {
    let look = async {
        while !is_reached() {
            sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(TIMEOUT, look).await.unwrap_or_else(|_| panic!("{what} did not happen"));
}

fn events(server: &Server, kind: EventKind) -> Vec<String> {
    let (events, _) = server.hub().events(1000);
    let wanted = events.iter().filter(|event| event.kind() == kind);
    wanted.map(|event| event.message.clone()).collect()
}

async fn localizes(server: &Server) {
    let before = server.hub().snapshots().borrow().sequence;
    until("snapshots", || server.hub().snapshots().borrow().sequence > before + 5).await;
}

/// A change of a file's bytes.
type Damage = fn(&mut Vec<u8>);

/// A history with enough points for several pages.
fn write_history(path: &Path) {
    let mut store = Store::open(path).unwrap();
    let identity = HistoryObject { run: "old".into(), id: 1, ..HistoryObject::default() };
    let key = store.key(&identity, Timestamp::from_ns(1)).unwrap();
    let point = |number: i64| HistoryPoint {
        time: Timestamp::from_ns(1_700_000_000_000_000_000 + number * 100_000_000),
        position_m: [1.0, 2.0, 3.0],
        yaw_rad: None,
    };
    let points: Vec<_> = (0..2000).map(|number| (0, key, point(number))).collect();
    store.add(&points).unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_damaged_history_is_set_aside_and_a_new_one_begun() {
    let damages: [(&str, Damage); 4] = [
        ("text", |bytes| *bytes = b"no database ".repeat(100)),
        ("zeros", |bytes| bytes.fill(0)),
        ("a damaged page", |bytes| bytes[4096..].fill(0xa5)),
        ("truncated", |bytes| bytes.truncate(6000)),
    ];
    for (what, damage) in damages {
        let lab = Lab::new("[history]\n");
        let path = lab.folder.path().join("history.sqlite");
        write_history(&path);
        let mut bytes = fs::read(&path).unwrap();
        assert!(bytes.len() > 20_000);
        damage(&mut bytes);
        fs::write(&path, &bytes).unwrap();

        let server = lab.start().await;
        localizes(&server).await;
        until(what, || !events(&server, EventKind::HistoryReplaced).is_empty()).await;
        let message = &events(&server, EventKind::HistoryReplaced)[0];
        assert!(message.contains("is damaged. It was kept as"), "{message}");
        let kept = message.split("kept as ").nth(1).unwrap().split(',').next().unwrap();
        assert!(kept.contains("history.sqlite.damaged-2"), "{kept}");
        assert_eq!(fs::read(kept).unwrap().len(), bytes.len(), "{what}");
        let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
        let stored = async {
            loop {
                let answer = client.history(v1::QueryHistoryRequest::default()).await;
                if answer.is_ok_and(|answer| answer.points > 0) {
                    return;
                }
                sleep(Duration::from_millis(50)).await;
            }
        };
        timeout(TIMEOUT, stored).await.unwrap_or_else(|_| panic!("{what}: nothing is stored"));
        assert_eq!(client.info().await.unwrap().history_error, "");
        server.shutdown().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_disk_that_fails_disables_history_and_recording_until_it_works() {
    let more = "start = true\nmin_free_mb = 0\nfolder = \"disk/recordings\"\n\
                [history]\nfile = \"disk/history.sqlite\"\n";
    let lab = Lab::new(more);
    let disk = lab.folder.path().join("disk");
    fs::write(&disk, "not a folder").unwrap();
    let server = lab.start().await;
    localizes(&server).await;
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    let error = client.info().await.unwrap().history_error;
    assert!(error.contains("disk/history.sqlite"), "{error}");
    let error = client.history(v1::QueryHistoryRequest::default()).await.unwrap_err().to_string();
    assert!(error.contains("the history is not available"), "{error}");
    let recording = client.recording().await.unwrap();
    assert_eq!(recording.state(), RecordingState::Failed);
    assert!(recording.error.contains("disk/recordings"), "{}", recording.error);
    assert_eq!(events(&server, EventKind::HistoryFailed).len(), 1);
    assert_eq!(events(&server, EventKind::RecordingFailed).len(), 1);

    fs::remove_file(&disk).unwrap();
    fs::create_dir(&disk).unwrap();
    until("a history", || !events(&server, EventKind::HistoryRestored).is_empty()).await;
    until("a recording", || !events(&server, EventKind::RecordingBegun).is_empty()).await;
    assert_eq!(client.info().await.unwrap().history_error, "");
    assert_eq!(client.recording().await.unwrap().state(), RecordingState::Recording);
    server.shutdown().await;
}

/// A full disk of 2 MB, unmounted when dropped; `None` without the right to mount one.
struct FullDisk(PathBuf);

impl FullDisk {
    fn mount(folder: PathBuf) -> Option<Self> {
        fs::create_dir(&folder).unwrap();
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", "size=2m", "roundel-test"]).arg(&folder);
        let mounted = mount.stderr(Stdio::null()).status().is_ok_and(|it| it.success());
        if !mounted {
            return None;
        }
        let disk = Self(folder);
        // Fails when the disk is full.
        let _ = fs::write(disk.0.join("ballast"), vec![0; 4 << 20]);
        Some(disk)
    }
}

impl Drop for FullDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_at_the_start_affects_nothing_but_history_and_recording() {
    let more =
        "start = true\nmin_free_mb = 0\nfolder = \"disk\"\n[history]\nfile = \"disk/a.sqlite\"\n";
    let lab = Lab::new(more);
    let Some(disk) = FullDisk::mount(lab.folder.path().join("disk")) else {
        println!("skipped: a_full_disk_at_the_start_… needs to mount a tmpfs");
        return;
    };
    let server = lab.start().await;
    localizes(&server).await;
    until("a failure", || !events(&server, EventKind::HistoryFailed).is_empty()).await;
    until("a failure", || !events(&server, EventKind::RecordingFailed).is_empty()).await;
    fs::remove_file(disk.0.join("ballast")).unwrap();
    until("a history", || !events(&server, EventKind::HistoryRestored).is_empty()).await;
    localizes(&server).await;
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_cannot_push_out_recent_recordings() {
    // A file of 0.1 MB, and a budget of two and a half.
    let lab = Lab::new("min_free_mb = 0\nrotate_mb = 0.1\nbudget_gb = 0.00025\n");
    let server = lab.start().await;
    let client = Client::connect(&format!("http://{}", server.local_addr())).await.unwrap();
    let options = RecordingOptions { name: "first".into(), ..RecordingOptions::default() };
    server.recorder().start(&options).unwrap();
    until("a recording", || server.recorder().status().bytes > 60_000).await;
    server.recorder().stop().unwrap();
    let first = server.recorder().list().unwrap();
    let error = client.start_recording(v1::StartRecordingRequest::default()).await.unwrap_err();
    let error = error.to_string();
    assert!(error.contains("`keep_hours` = 24") && error.contains("chmod a-w"), "{error}");
    assert_eq!(server.recorder().list().unwrap(), first);
    // A pinned one does not count.
    let path = lab.folder.path().join("recordings").join(&first[0].name);
    let mut permissions = fs::metadata(&path).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&path, permissions).unwrap();
    if first.len() == 1 {
        client.start_recording(v1::StartRecordingRequest::default()).await.unwrap();
        until("deleted files", || server.recorder().status().deleted >= 1).await;
        assert!(path.exists());
    }
    server.shutdown().await;
}

/// A server process, killed when dropped.
struct Process {
    child: Child,
    address: String,
}

impl Process {
    fn start(config: &Path) -> Self {
        Self::with_stderr(config, Stdio::null())
    }

    fn with_stderr(config: &Path, stderr: impl Into<Stdio>) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_roundel"))
            .args(["serve", "--config"])
            .arg(config)
            .stdout(Stdio::piped())
            .stderr(stderr)
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").expect(&line).to_owned();
        Self { child, address }
    }

    /// Sends a request and does not wait for the answer.
    fn post(&self, path: &str, json: &str) -> TcpStream {
        let mut socket = TcpStream::connect(&self.address).unwrap();
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n{json}",
            self.address,
            json.len()
        );
        socket.write_all(head.as_bytes()).unwrap();
        socket
    }

    fn signal(&mut self, signal: &str) -> ExitStatus {
        let sent = Command::new("kill").arg(signal).arg(self.child.id().to_string()).status();
        assert!(sent.unwrap().success());
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(begun.elapsed() < END_TIMEOUT, "{signal} does not end the process");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn only_recording(folder: &Path) -> PathBuf {
    let files = fs::read_dir(folder.join("recordings")).unwrap().flatten();
    files.map(|entry| entry.path()).next().expect("a recording")
}

/// The recording is finished by every signal, even while a request hangs that has locked the configuration.
#[test]
fn signals_end_the_process_with_a_finished_recording_whatever_hangs() {
    for (signal, hangs) in [("-HUP", false), ("-TERM", true), ("-INT", true)] {
        let lab = Lab::new("start = true\nmin_free_mb = 0\n");
        let fifo = lab.folder.path().join("fifo.yaml");
        assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        let mut process = Process::start(&lab.file());
        let recordings = lab.folder.path().join("recordings");
        let begun = Instant::now();
        while fs::read_dir(&recordings).map_or(0, |it| it.count()) == 0 {
            assert!(begun.elapsed() < TIMEOUT, "no recording");
            std::thread::sleep(Duration::from_millis(20));
        }
        let text = fs::read_to_string(lab.file()).unwrap();
        let text = text.replace("[recording]", "calibration = \"fifo.yaml\"\n[recording]");
        let text = text.replace("sim:?seed=1&robots=4&camera=0", "http://127.0.0.1:9/");
        let body = serde_json::json!({ "toml": text }).to_string();
        let path = "/api/v1/configuration/check";
        let requests: Vec<TcpStream> =
            (0..if hangs { 8 } else { 0 }).map(|_| process.post(path, &body)).collect();
        std::thread::sleep(Duration::from_millis(1500));
        let status = process.signal(signal);
        drop(requests);
        assert!(status.code().is_some(), "{signal}: {status}");
        assert!(hangs || status.success(), "{signal}: {status}");
        let mut reader = FileReader::open(&only_recording(lab.folder.path())).unwrap();
        while reader.next_chunk().unwrap().is_some() {}
        assert_eq!(reader.damage().sentences, Vec::<String>::new(), "{signal}");
    }
}

/// As with a paused terminal, or a program that does not read what it starts.
#[test]
fn a_log_that_cannot_be_written_blocks_nothing() {
    let lab = Lab::new("");
    let (_reader, mut log) = std::io::pipe().unwrap();
    // The capacity of a pipe.
    log.write_all(&[b' '; 65536]).unwrap();
    let mut process = Process::with_stderr(&lab.file(), log);
    let rejected = process.post("/api/v1/configuration/check", "{}");
    rejected.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut answer = String::new();
    BufReader::new(rejected).read_line(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 "), "{answer}");
    assert!(process.signal("-TERM").success());
}

/// `nohup` ignores SIGHUP for a program that must survive its terminal.
#[test]
fn a_hangup_that_was_ignored_at_the_start_stays_ignored() {
    let lab = Lab::new("");
    let mut child = Command::new("sh")
        .args([
            "-c",
            "trap '' HUP; exec \"$0\" serve --config \"$1\"",
            env!("CARGO_BIN_EXE_roundel"),
        ])
        .arg(lab.file())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let mut process = Process { child, address: line };
    let kill = |signal: &str, process: &Process| {
        Command::new("kill").arg(signal).arg(process.child.id().to_string()).status().unwrap()
    };
    assert!(kill("-HUP", &process).success());
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(process.child.try_wait().unwrap(), None);
    assert!(process.signal("-TERM").success());
}

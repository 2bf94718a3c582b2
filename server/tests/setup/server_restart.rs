//! A server process that is killed and restarted on the same port while a client stays subscribed, with printed
//! roundels.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
    time::Instant,
};

use futures::StreamExt;
use roundel_client::{Client, Error, LinkState, Snapshots, Subscription, Update, named};
use roundel_proto::v1;
use tokio::time::timeout;

use super::{coded_robots, rig::TIMEOUT};

const NAMES: &str = r#"
[[object]]
name = "bee"
roundel = "shuttle"
code = 5
[[object]]
name = "wasp"
roundel = "shuttle"
code = 9
"#;

/// An object that is detected before the others, so that they get other IDs.
const FIRST: &str = r#"
[[object]]
name = "ant"
roundel = "shuttle"
code = 3
"#;

/// A `roundel serve` process; killed when dropped.
struct Process {
    child: Child,
    address: String,
    // Keeps the pipe open, so that the process can write.
    _stdout: BufReader<ChildStdout>,
}

impl Process {
    fn start(config: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_roundel"))
            .args(["serve", "--config"])
            .arg(config)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").expect(&line).to_owned();
        Self { child, address, _stdout: stdout }
    }

    /// Kills the process like `kill -9`, without a shutdown.
    fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process may already be dead.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

async fn next(snapshots: &mut Snapshots) -> Update {
    timeout(TIMEOUT, snapshots.next()).await.expect("no update arrives").unwrap().unwrap()
}

/// The object of the first snapshot that has exactly one tracked object.
async fn followed(snapshots: &mut Snapshots) -> v1::ObjectState {
    loop {
        if let Update::Snapshot(snapshot) = next(snapshots).await
            && let [state] = &snapshot.objects[..]
            && state.stage() == v1::LifeStage::Tracked
        {
            return state.clone();
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_subscription_by_name_survives_a_killed_server() {
    let folder = coded_robots::lab();
    let config = folder.path().join("lab.toml");
    fs::write(&config, format!("{}{NAMES}", coded_robots::TEXT)).unwrap();
    let mut server = Process::start(&config);
    let address = server.address.clone();
    let client = Client::connect(&address).await.unwrap();
    let bee = || Subscription::default().names(["bee"]);
    let subscribed = Instant::now();
    let (mut snapshots, mut latest) = (client.snapshots(bee()), client.latest(bee()));
    let before = followed(&mut snapshots).await;
    assert_eq!((before.name.as_str(), before.code.unwrap().number), ("bee", 5));
    while latest.link().state != LinkState::Connected {
        timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    }

    server.kill();
    let lost = loop {
        match next(&mut snapshots).await {
            Update::Snapshot(_) => {}
            Update::Disconnected { tries: 0, reason, .. } => break reason,
            other => panic!("{other:?}"),
        }
    };
    assert!(!lost.is_empty());
    let lost_at = Instant::now();
    while latest.link().state != LinkState::Lost {
        timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    }
    let stale = latest.recent(std::time::Duration::ZERO).unwrap_err();
    assert!(matches!(&stale, Error::Stale { link, .. } if link.reason.is_some()), "{stale}");

    // The new process detects another robot first, which gets the ID of the one before.
    coded_robots::draw(folder.path(), [3, 5]);
    let text = format!("{}{FIRST}{NAMES}", coded_robots::TEXT.replace("127.0.0.1:0", &address));
    fs::write(&config, text).unwrap();
    let restarted_at = Instant::now();
    let server = Process::start(&config);
    assert_eq!(server.address, address);
    let back = loop {
        match next(&mut snapshots).await {
            Update::Disconnected { .. } => {}
            update => break update,
        }
    };
    let Update::Reconnected { gap, restarted: true, missed: None } = back else {
        panic!("{back:?}")
    };
    assert!(gap >= restarted_at - lost_at, "the gap of {gap:?} is shorter than the outage");
    assert!(gap <= subscribed.elapsed(), "the gap of {gap:?} is longer than the subscription");
    let after = followed(&mut snapshots).await;
    assert_eq!((after.name.as_str(), after.code.unwrap().number), ("bee", 5));
    let recent = timeout(TIMEOUT, latest.next()).await.unwrap().unwrap();
    assert!(recent.objects.len() <= 1, "{recent:?}");
    while latest.link().state != LinkState::Connected {
        timeout(TIMEOUT, latest.link_changed()).await.unwrap();
    }
    assert_eq!((latest.link().losses, latest.link().restarts), (1, 1));

    // A subscription by ID would now follow the other robot.
    let all = client.snapshot().await.unwrap();
    assert_eq!(named(&all, "bee").map(|it| it.object_id), Some(after.object_id));
    let same_id = all.objects.iter().find(|it| it.object_id == before.object_id);
    assert_eq!(same_id.map(|it| it.name.as_str()), Some("ant"), "{all:?}");
    drop(server);
}

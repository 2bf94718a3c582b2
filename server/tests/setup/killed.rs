//! A server that is killed and started again on the same port, and a client that goes on: real processes, real prints.

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

use crate::{coded, rig::PATIENCE};

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

/// Found before the others, so that ids are another's from then on.
const FIRST: &str = r#"
[[object]]
name = "ant"
roundel = "shuttle"
code = 3
"#;

/// `roundel serve`; killed when dropped.
struct Process {
    child: Child,
    address: String,
    // While it is open, the process can write.
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

    /// As by `kill -9`: it says nothing to anybody.
    fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have been killed already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

async fn next(snapshots: &mut Snapshots) -> Update {
    timeout(PATIENCE, snapshots.next()).await.expect("no update comes").unwrap().unwrap()
}

/// The first snapshot with exactly one object, which is followed.
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
async fn who_follows_a_robot_by_name_follows_it_on_when_the_server_was_killed() {
    let folder = coded::lab();
    let config = folder.path().join("lab.toml");
    fs::write(&config, format!("{}{NAMES}", coded::TEXT)).unwrap();
    let mut server = Process::start(&config);
    let address = server.address.clone();
    let client = Client::connect(&address).await.unwrap();
    let bee = || Subscription::default().names(["bee"]);
    let subscribed = Instant::now();
    let (mut snapshots, mut latest) = (client.snapshots(bee()), client.latest(bee()));
    let before = followed(&mut snapshots).await;
    assert_eq!((before.name.as_str(), before.code.unwrap().number), ("bee", 5));
    while latest.link().state != LinkState::Connected {
        timeout(PATIENCE, latest.link_changed()).await.unwrap();
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
        timeout(PATIENCE, latest.link_changed()).await.unwrap();
    }
    let stale = latest.recent(std::time::Duration::ZERO).unwrap_err();
    assert!(matches!(&stale, Error::Stale { link, .. } if link.reason.is_some()), "{stale}");

    // It finds another robot first, which has the id of the one before.
    coded::draw(folder.path(), [3, 5]);
    let text = format!("{}{FIRST}{NAMES}", coded::TEXT.replace("127.0.0.1:0", &address));
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
    assert!(gap >= restarted_at - lost_at, "{gap:?}, and there was none for longer");
    assert!(gap <= subscribed.elapsed(), "{gap:?}, and it is not so long ago that all began");
    let after = followed(&mut snapshots).await;
    assert_eq!((after.name.as_str(), after.code.unwrap().number), ("bee", 5));
    let recent = timeout(PATIENCE, latest.next()).await.unwrap().unwrap();
    assert!(recent.objects.len() <= 1, "{recent:?}");
    while latest.link().state != LinkState::Connected {
        timeout(PATIENCE, latest.link_changed()).await.unwrap();
    }
    assert_eq!((latest.link().losses, latest.link().restarts), (1, 1));

    // Who had followed the number follows the other robot now.
    let all = client.snapshot().await.unwrap();
    assert_eq!(named(&all, "bee").map(|it| it.object_id), Some(after.object_id));
    let same_id = all.objects.iter().find(|it| it.object_id == before.object_id);
    assert_eq!(same_id.map(|it| it.name.as_str()), Some("ant"), "{all:?}");
    drop(server);
}

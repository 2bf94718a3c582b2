//! Adds, changes and removes many cameras: sequential changes leak no threads or memory, and concurrent ones are all
//! applied. This is a test program of its own because threads and memory are counted per process.

#[path = "setup/rig.rs"]
#[allow(dead_code, reason = "the other tests use the rest")]
mod rig;

use std::fs;

use axum::http::Method;
use roundel_server::model::config::Config;
use serde_json::json;

use rig::{CONFIG, Rig, third_camera, wait_for};

fn threads() -> usize {
    fs::read_dir("/proc/self/task").unwrap().count()
}

/// Number of worker threads, recognised by their names.
fn workers() -> usize {
    let names = fs::read_dir("/proc/self/task").unwrap().flatten();
    let name =
        |task: fs::DirEntry| fs::read_to_string(task.path().join("comm")).unwrap_or_default();
    names.map(name).filter(|name| name.starts_with("camera ")).count()
}

/// Resident memory of this process.
fn memory_kb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fifty_sequential_changes_leak_nothing_and_concurrent_ones_are_all_applied() {
    let rig = Rig::start().await;
    rig.running("a").await;
    let once = async |round: usize| {
        let mut camera = third_camera();
        camera["name"] = json!(format!("c{}", round % 3));
        rig.accepted(Method::POST, "/cameras", Some(camera)).await;
        let name = format!("c{}", round % 3);
        rig.until("frames", &name, |state| state.frames > 0).await;
        rig.send(Method::GET, &format!("/cameras/{name}/frame.jpg"), None).await;
        rig.accepted(Method::DELETE, &format!("/cameras/{name}"), None).await;
    };
    for round in 0..10 {
        once(round).await;
    }
    let (before, kb) = (workers(), memory_kb());
    for round in 0..50 {
        once(round).await;
    }
    assert_eq!(workers(), before, "of {} threads", threads());
    // A camera's worker, pictures and buffers take about a megabyte, so leaking fifty of them would show.
    let grown_kb = memory_kb().saturating_sub(kb);
    println!("{grown_kb} kB more after fifty cameras, {} threads", threads());
    assert!(grown_kb < 16 * 1024, "{grown_kb} kB more after fifty cameras");
    assert_eq!(rig.file(), CONFIG, "the configuration file must be unchanged");
    assert_eq!(rig.server.hub().cameras().len(), 2);
    let running = rig.running("a").await;
    assert_eq!(running.restarts, 0);

    let edits = (0..8).map(|number| {
        let mut camera = third_camera();
        camera["name"] = json!(format!("n{number}"));
        rig.accepted(Method::POST, "/cameras", Some(camera))
    });
    let modes = ["a", "b"].map(|name| {
        let path = format!("/cameras/{name}");
        async { rig.accepted(Method::PATCH, &{ path }, Some(json!({ "mode": "fast" }))).await }
    });
    futures::future::join(futures::future::join_all(edits), futures::future::join_all(modes)).await;
    let config = Config::load(&rig.folder.path().join("lab.toml")).unwrap();
    assert_eq!(config.cameras.len(), 10);
    assert_eq!(rig.file().matches("mode = \"fast\"").count(), 2);
    let all = || Some(()).filter(|()| rig.server.hub().cameras().values().all(|it| it.frames > 3));
    wait_for("frames of all cameras", all, || rig.server.hub().cameras()).await;
    rig.server.shutdown().await;
    assert_eq!(workers(), 0);
}

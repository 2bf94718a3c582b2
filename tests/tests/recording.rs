//! Recordings by the real binary: killed, on a full disk, read by common packages, and scored as by `evo`.

use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
    thread,
    time::{Duration, Instant},
};

use roundel_tests::{
    process::{Server, roundel},
    python::Python,
};
use serde_json::Value;

/// Only a stalled machine takes this long.
const PATIENCE: Duration = Duration::from_secs(90);

fn lab(folder: &Path, recording: &str) -> PathBuf {
    let mut text = "name = \"lab\"\n[server]\nlisten = \"127.0.0.1:0\"\nsnapshot_rate_hz = 30.0\n\
                    [detection]\nmode = \"fast\"\n\
                    [[roundel]]\nname = \"robot\"\nouter_mm = 160.0\ninner_mm = 64.0\n"
        .to_owned();
    for camera in 0..2 {
        let source = format!("sim:?seed=1&robots=8&camera={camera}");
        let _ = write!(text, "[[camera]]\nname = \"c{camera}\"\nsource = \"{source}\"\n");
    }
    text += &format!("[recording]\nstart = true\n{recording}");
    let path = folder.join("lab.toml");
    fs::write(&path, text).unwrap();
    path
}

fn run(arguments: &[&str]) -> Output {
    Command::new(roundel().unwrap()).args(arguments).output().unwrap()
}

fn info(file: &Path) -> Value {
    let output = run(&["info", "--format", "json", &file.to_string_lossy()]);
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)))
}

fn only_file(folder: &Path) -> Option<PathBuf> {
    let mut files = fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    files.find(|path| path.extension().is_some_and(|it| it == "mcap"))
}

fn until<T>(what: &str, mut wanted: impl FnMut() -> Option<T>) -> T {
    let started = Instant::now();
    loop {
        if let Some(found) = wanted() {
            return found;
        }
        assert!(started.elapsed() < PATIENCE, "{what} did not come about");
        thread::sleep(Duration::from_millis(20));
    }
}

/// Waits until a recording has this many bytes.
fn grown(folder: &Path, bytes: u64) -> PathBuf {
    until("a recording", || {
        only_file(folder).filter(|path| fs::metadata(path).is_ok_and(|data| data.len() > bytes))
    })
}

#[test]
fn a_killed_server_loses_at_most_a_second() {
    let folder = tempfile::tempdir().unwrap();
    let mut server = Server::serve(&lab(folder.path(), "min_free_mb = 0\n")).unwrap();
    let kept = folder.path().join("recordings");
    let file = grown(&kept, 100_000);
    // An arbitrary time.
    thread::sleep(Duration::from_millis(731));
    let killed_ns =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos()
            as i64;
    server.signal("KILL").unwrap();
    server.wait(PATIENCE).unwrap();
    let report = info(&file);
    let end_ns: i64 = report["end_time_ns"].as_str().unwrap().parse().unwrap();
    let lost_s = (killed_ns - end_ns) as f64 * 1e-9;
    assert!(lost_s < 1.0, "{lost_s} s are lost: {report}");
    assert_eq!(report["complete"], false);
    assert!(report["damage"][0].as_str().unwrap().contains("the file has no end"), "{report}");
    let snapshots =
        report["topics"].as_array().unwrap().iter().find(|it| it["topic"] == "/snapshots");
    assert!(snapshots.unwrap()["messages"].as_u64().unwrap() > 10, "{report}");
    // The remaining part can be run through fusion again.
    let copy = folder.path().join("copy.mcap");
    let arguments = [
        "replay",
        &file.to_string_lossy(),
        "--from",
        "observations",
        "--to",
        &copy.to_string_lossy(),
    ];
    let output = run(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(info(&copy)["complete"], true);
}

/// A disk of one megabyte, removed with the test.
struct Disk(PathBuf);

impl Disk {
    fn new(folder: PathBuf) -> Option<Self> {
        fs::create_dir(&folder).unwrap();
        let mount = ["-t", "tmpfs", "-o", "size=1m", "none"];
        let mounted = Command::new("mount").args(mount).arg(&folder).output();
        mounted.is_ok_and(|output| output.status.success()).then_some(Self(folder))
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).output();
    }
}

#[test]
fn a_full_disk_ends_the_recording_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::new(folder.path().join("small")) else {
        println!("skipped: a_full_disk_ends_the_recording_and_nothing_else needs to mount a tmpfs");
        return;
    };
    let settings = "folder = \"small\"\nmin_free_mb = 0\n";
    let server = Server::serve(&lab(folder.path(), settings)).unwrap();
    until("a full disk", || server.log().contains("The recording failed").then_some(()));
    assert!(server.log().contains("nothing else is affected"), "{}", server.log());
    // Later files are attempts to resume.
    let files = fs::read_dir(&disk.0).unwrap().flatten();
    let file = files.max_by_key(|file| file.metadata().map_or(0, |data| data.len())).unwrap();
    let report = info(&file.path());
    assert!(report["duration_s"].as_f64().unwrap() > 0.1, "what there is can be read: {report}");
    // The server continues.
    let local = folder.path().join("local.mcap");
    let arguments = [
        "record",
        "--server",
        &server.url(),
        "--output",
        &local.to_string_lossy(),
        "--seconds",
        "1",
    ];
    let output = run(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report = info(&local);
    assert_eq!(report["complete"], true, "{report}");
    assert_eq!(report["can_be_fused_anew"], false);
}

#[test]
fn common_packages_read_recordings() {
    let tmp = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let Some(python) = Python::new("common_packages_read_recordings", &tmp) else { return };
    let folder = tempfile::tempdir().unwrap();
    let settings = "min_free_mb = 0\nframes_every = 10\nframes_format = \"png\"\n";
    let mut server = Server::serve(&lab(folder.path(), settings)).unwrap();
    let file = grown(&folder.path().join("recordings"), 500_000);
    server.signal("INT").unwrap();
    assert!(server.wait(PATIENCE).unwrap().success());
    let script = roundel_tests::process::workspace_root().join("tests/python/recording.py");
    let output = Command::new(python.program()).arg(script).arg(&file).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let report = info(&file);
    assert_eq!(report["complete"], true, "{report}");
    let mut all = 0;
    for topic in report["topics"].as_array().unwrap() {
        let name = topic["topic"].as_str().unwrap();
        assert_eq!(found["counts"][name], topic["messages"], "{name}: {found}");
        all += topic["messages"].as_u64().unwrap();
    }
    assert_eq!(found["promised"], all);
    assert_eq!((&found["objects"], &found["ascending"]), (&report["objects"], &Value::Bool(true)));
    assert_eq!(found["cameras"], serde_json::json!(["c0", "c1"]));
    assert!(found["images"]["png"].as_u64().unwrap() > 0, "{found}");
}

/// A trajectory, and the same in another frame, later, and with errors: as a recording and as ground truth.
fn judged(folder: &Path) -> (PathBuf, PathBuf) {
    use nalgebra::{Isometry3, UnitQuaternion, Vector3};
    use roundel_core::time::Timestamp;
    use roundel_proto::v1;
    use roundel_server::archive::record::{
        file_writer::{FileWriter, MessageStamp},
        schema::Topic,
    };
    let recording = folder.join("run.mcap");
    let mut file = FileWriter::create(&recording, &Default::default()).unwrap();
    let turn = UnitQuaternion::from_euler_angles(0.02, -0.01, 0.7);
    let frame = Isometry3::from_parts(Vector3::new(1.5, -0.4, 0.1).into(), turn);
    let mut truth = "time_ns,object,x,y,z,qx,qy,qz,qw\n".to_owned();
    for step in 0..1500i64 {
        let time_s = step as f64 / 60.0;
        let ns = 1_700_000_000_000_000_000 + step * 16_666_667;
        let course = |s: f64| {
            let place = Vector3::new((0.5 * s).cos(), (0.9 * s).sin(), 0.1 * (0.3 * s).sin());
            Isometry3::from_parts(
                place.into(),
                UnitQuaternion::from_euler_angles(0.0, 0.0, 0.4 * s),
            )
        };
        let error =
            Vector3::new((37.0 * time_s).sin(), (41.0 * time_s).cos(), (29.0 * time_s).sin());
        let seen = course(time_s);
        let (p, q) = (seen.translation.vector + error * 2e-3, seen.rotation);
        let state = v1::ObjectState {
            object_id: 7,
            name: "cart".into(),
            stage: v1::LifeStage::Tracked.into(),
            position: Some(v1::Vector3 { x: p.x, y: p.y, z: p.z }),
            orientation: Some(v1::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
            yaw_observed: true,
            ..v1::ObjectState::default()
        };
        let snapshot =
            v1::Snapshot { pose_time_ns: ns, objects: vec![state], ..v1::Snapshot::default() };
        let stamp = MessageStamp::at(Timestamp::from_ns(ns), step as u64);
        file.write(Topic::Snapshots, stamp, &snapshot).unwrap();
        // The other system's clock is 80 ms ahead.
        let there = frame * seen;
        let (p, q) = (there.translation.vector, there.rotation);
        let line = [p.x, p.y, p.z, q.i, q.j, q.k, q.w].map(|it| it.to_string()).join(",");
        let _ = writeln!(truth, "{},cart,{line}", ns + 80_000_000);
    }
    file.finish().unwrap();
    let path = folder.join("truth.csv");
    fs::write(&path, truth).unwrap();
    (recording, path)
}

#[test]
fn scores_match_evo() {
    let folder = tempfile::tempdir().unwrap();
    let (recording, truth) = judged(folder.path());
    let (pictures, out) = (folder.path().join("pictures"), folder.path().join("out"));
    let [recording, truth, drawn, exported] =
        [&recording, &truth, &pictures, &out].map(|path| path.to_string_lossy().into_owned());
    let arguments = ["eval", &recording, "--truth", &truth, "--format", "json"];
    let folders = ["--delta", "30", "--draw", &drawn, "--export", &exported];
    let output = run(&[&arguments[..], &folders].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let ours: Value = serde_json::from_slice(&output.stdout).unwrap();
    let offset_s = ours["offset_s"].as_f64().unwrap();
    assert!((offset_s - 0.08).abs() < 2e-4, "{offset_s}");
    let rms_m = ours["ate_m"]["rms"].as_f64().unwrap();
    assert!((rms_m - 2e-3 * 1.5f64.sqrt()).abs() < 2e-4, "{rms_m}");
    for name in ["above.svg", "error.svg"] {
        let picture = fs::read_to_string(pictures.join(name)).unwrap();
        // One path is the trajectory.
        let is_curve = |path: &str| path.matches('L').count() > 20;
        assert!(picture.split("<path").any(is_curve) && picture.contains("</svg>"), "{name}");
    }
    let tmp = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let Some(python) = Python::new("scores_match_evo", &tmp) else { return };
    let script = roundel_tests::process::workspace_root().join("tests/python/evo_figures.py");
    let files = ["7-cart.truth.tum", "7-cart.estimate.tum"].map(|name| out.join(name));
    let output = Command::new(python.program()).arg(script).args(files).arg("30").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let evo: Value = serde_json::from_slice(&output.stdout).unwrap();
    let object = &ours["objects"][0];
    for (mine, its) in [("ate_m", "ate"), ("rpe_m", "rpe"), ("ate_deg", "ate_deg")] {
        for (word, name) in [
            ("rms", "rmse"),
            ("mean", "mean"),
            ("median", "median"),
            ("std", "std"),
            ("max", "max"),
        ] {
            let [mine, its] = [&object[mine][word], &evo[its][name]].map(|it| it.as_f64().unwrap());
            assert!((mine - its).abs() < 1e-6, "{name}: {mine} here, {its} by evo");
        }
    }
    assert_eq!(object["ate_m"]["count"], evo["samples"]);
}

//! `gst:aravissrc` with Aravis' fake GigE Vision camera in a network namespace. Skipped, with a message, where
//! namespaces or Aravis are not available.

use std::{
    process::{Child, Command, Stdio},
    time::Instant,
};

use roundel_server::{
    capture::source::{FrameSource, SourceError},
    model::capture_clock::TimeBase,
};

use super::{TIMEOUT, failure, open_again, opener, run_exclusively};

const NAME: &str = "media::aravis::receives_a_gige_camera_and_recovers_from_faults";
/// Environment variable that is set in the process inside the namespace.
const INSIDE: &str = "ROUNDEL_TEST_NETWORK";
const FAKE_CAMERA: &str = "arv-fake-gv-camera-0.8";
/// Image size of the fake camera.
const SIZE: (usize, usize) = (512, 512);
const PERIOD_NS: i64 = 40_000_000;
const URL: &str = "gst:aravissrc camera-name=127.0.0.1 ! video/x-raw,format=GRAY8,width=512,height=512,framerate=25/1";

/// The fake camera's process; killed when dropped.
struct FakeCamera(Child);

impl FakeCamera {
    fn start() -> Self {
        let child =
            Command::new(FAKE_CAMERA).args(["-i", "127.0.0.1"]).stdout(Stdio::null()).spawn();
        Self(child.unwrap())
    }

    fn signal(&self, name: &str) {
        let pid = self.0.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().unwrap().success());
    }
}

impl Drop for FakeCamera {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn works(program: &str, arguments: &[&str]) -> bool {
    let mut run = Command::new(program);
    let run = run.args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    run.is_ok_and(|status| status.success())
}

/// Runs this test again in a network namespace; returns whether that is possible.
fn run_inside() -> bool {
    let made = ["-n", "-rn"]
        .into_iter()
        .find(|how| works("unshare", &[how, "ip", "link", "set", "lo", "up"]));
    let aravis = works(FAKE_CAMERA, &["--help"]) && works("gst-inspect-1.0", &["aravissrc"]);
    let Some(how) = made.filter(|_| aravis) else { return false };
    let script = "ip link set lo up && exec \"$0\" --exact \"$1\" --nocapture";
    let this = std::env::current_exe().unwrap();
    let mut inside = Command::new("unshare");
    inside.args([how, "sh", "-c", script]).arg(this).arg(NAME).env(INSIDE, "1");
    let output = inside.output().unwrap();
    print!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    true
}

/// Reads frames until the source fails, and returns its error.
fn until_the_end(source: &mut dyn FrameSource) -> String {
    let begun = Instant::now();
    while begun.elapsed() < TIMEOUT {
        match source.next_frame() {
            Ok(_) => {}
            Err(SourceError::Failed(reason)) => return reason,
            Err(other) => panic!("{other:?}"),
        }
    }
    panic!("the source does not end");
}

#[test]
fn receives_a_gige_camera_and_recovers_from_faults() {
    let _guard = run_exclusively();
    if std::env::var_os(INSIDE).is_none() {
        if !run_inside() {
            println!(
                "skipped: {NAME} needs network namespaces (unshare -n), aravis-tools and libaravis-0.8-0"
            );
        }
        return;
    }
    let unreachable = failure(URL, SIZE);
    assert!(unreachable.contains("(`arv-tool-0.8` lists those that answer)"), "{unreachable}");

    let camera = FakeCamera::start();
    let (mut opener, clock) = opener(URL, SIZE);
    let mut source = open_again(&mut opener);
    let (mut numbers, mut skipped, mut off_ms) = (Vec::new(), 0, Vec::new());
    while numbers.len() < 75 {
        let lent = source.next_frame().unwrap();
        // The first pixel contains the frame number.
        numbers.push(lent.frame.row(0)[0]);
        skipped += lent.info.skipped;
        assert_eq!(lent.info.clock.base, TimeBase::Camera);
        let age_s = clock.now().seconds_since(lent.info.capture_time);
        assert!((0.0..1.0).contains(&age_s), "{age_s} s old");
        // The fake camera captures when Unix time is a multiple of its period.
        let phase_ns = (lent.info.capture_time.as_ns() + PERIOD_NS / 2).rem_euclid(PERIOD_NS);
        // Skips the first frames, while the shortest delay is not yet known.
        if numbers.len() > 25 {
            off_ms.push((phase_ns - PERIOD_NS / 2) as f64 * 1e-6);
        }
    }
    assert_eq!(source.promised_hz(), Some(25.0));
    let sent: u64 = numbers.windows(2).map(|pair| u64::from(pair[1].wrapping_sub(pair[0]))).sum();
    assert!(numbers.windows(2).all(|pair| pair[0] != pair[1]), "no frame may repeat: {numbers:?}");
    println!("{} of {} frames received", numbers.len() as u64 + skipped, sent + 1);
    off_ms.sort_by(f64::total_cmp);
    println!("off by {:.2} ms median, {:.2} to {:.2}", off_ms[25], off_ms[0], off_ms[49]);
    // All are late by the same delay of the quickest frame, with little jitter.
    assert!(off_ms[3] > -1.0 && off_ms[45] < 15.0, "{off_ms:?}");
    assert!(off_ms[45] - off_ms[3] < 5.0, "{off_ms:?}");

    camera.signal("STOP");
    let stalled = until_the_end(&mut *source);
    assert!(stalled.contains("stalled: no picture for 1.0 s"), "{stalled}");
    drop(source);
    camera.signal("CONT");
    let mut source = open_again(&mut opener);
    source.next_frame().unwrap();

    drop(camera);
    let killed = until_the_end(&mut *source);
    assert!(killed.starts_with("gst:aravissrc"), "{killed}");
    println!("killed: {killed}");
    drop(source);
    let _camera = FakeCamera::start();
    let mut source = open_again(&mut opener);
    for _ in 0..5 {
        source.next_frame().unwrap();
    }
}

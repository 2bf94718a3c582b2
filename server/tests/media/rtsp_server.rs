//! Runs `rtsp_server.py` as a child process.

use std::{
    collections::HashMap,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex},
    thread,
};

/// Capture time of each frame, in ns since the Unix epoch.
type Taken = Arc<Mutex<HashMap<u64, i64>>>;

/// The server's process; killed when dropped.
pub struct RtspServer {
    child: Child,
    pub port: u16,
    taken: Taken,
}

impl RtspServer {
    /// Starts the server; prints a message and returns `None` if that is not possible.
    pub fn start(test: &str, arguments: &[&str]) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/media/rtsp_server.py");
        // Debian's interpreter finds Debian's bindings.
        let mut child = Command::new("/usr/bin/python3")
            .arg(script)
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .ok()?;
        let mut lines = BufReader::new(child.stdout.take()?).lines().map_while(Result::ok);
        let Some(port) = lines.next().and_then(|line| line.trim().parse().ok()) else {
            println!("skipped: {test} needs python3-gi and gir1.2-gst-rtsp-server-1.0");
            let _ = child.wait();
            return None;
        };
        let taken = Taken::default();
        let times = taken.clone();
        thread::spawn(move || {
            for line in lines {
                let mut words = line.split_whitespace().map(str::parse::<i64>);
                if let (Some(Ok(number)), Some(Ok(ns))) = (words.next(), words.next()) {
                    times.lock().unwrap().insert(number as u64, ns);
                }
            }
        });
        Some(Self { child, port, taken })
    }

    pub fn url(&self) -> String {
        format!("rtsp://127.0.0.1:{}/stream", self.port)
    }

    /// The capture time of a frame, if the server has already printed it.
    pub fn taken_ns(&self, number: u64) -> Option<i64> {
        self.taken.lock().unwrap().get(&number).copied()
    }

    /// Forgets the times of the current stream: the next one numbers its frames from zero again.
    pub fn forget_times(&self) {
        self.taken.lock().unwrap().clear();
    }

    /// Suspends the process until [`Self::thaw`].
    pub fn freeze(&self) {
        self.signal("STOP");
    }

    pub fn thaw(&self) {
        self.signal("CONT");
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().unwrap().success());
    }
}

impl Drop for RtspServer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

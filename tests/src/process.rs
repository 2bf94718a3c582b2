//! Server processes: builds the binary if necessary, starts it on a free port, captures its output, and ends it with
//! the test.

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex, OnceLock,
        mpsc::{RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant, SystemTime},
};

use anyhow::{Context, bail, ensure};

/// Printed by a server once it accepts connections, followed by its address.
const LISTENING: &str = "listening on http://";

pub fn workspace_root() -> PathBuf {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    manifest.parent().unwrap_or(manifest).to_path_buf()
}

/// The `roundel` binary of this test's profile, built if it is missing or older than its sources.
pub fn roundel() -> anyhow::Result<PathBuf> {
    static BINARY: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let found = BINARY.get_or_init(|| find_or_build().map_err(|error| format!("{error:#}")));
    found.clone().map_err(anyhow::Error::msg)
}

/// An example of the Rust client in this test's profile, built if it is missing or older than its sources.
pub fn example(name: &str) -> anyhow::Result<PathBuf> {
    let file = format!("examples/{name}{}", std::env::consts::EXE_SUFFIX);
    up_to_date(&file, &["-p", "roundel-client", "-p", "roundel-tests", "--example", name])
}

fn find_or_build() -> anyhow::Result<PathBuf> {
    let file = format!("roundel{}", std::env::consts::EXE_SUFFIX);
    // Naming this crate too selects the same features, so that most of the build is reused.
    up_to_date(&file, &["-p", "roundel-server", "-p", "roundel-tests", "--bin", "roundel"])
}

/// A file of this test's profile, built from these targets if necessary.
fn up_to_date(file: &str, targets: &[&str]) -> anyhow::Result<PathBuf> {
    // target/PROFILE/deps/test-HASH
    let test = std::env::current_exe()?;
    let profile_folder =
        test.ancestors().nth(2).context("expected the test in target/PROFILE/deps")?;
    let binary = profile_folder.join(file);
    let built = fs::metadata(&binary).and_then(|data| data.modified()).ok();
    if built.is_some_and(|built| newest_source(&workspace_root()) <= built) {
        return Ok(binary);
    }
    let profile = match profile_folder.file_name().and_then(|name| name.to_str()) {
        Some("debug") | None => "dev",
        Some(name) => name,
    };
    let target = profile_folder.parent().context("expected target/PROFILE")?;
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .current_dir(workspace_root())
        .arg("build")
        .args(targets)
        .args(["--profile", profile, "--target-dir"])
        .arg(target)
        .output()
        .context("cargo could not be started to build what the test runs")?;
    ensure!(
        output.status.success() && binary.exists(),
        "expected cargo to build {}, found:\n{}",
        binary.display(),
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(binary)
}

/// Modification time of the newest file that the binary is built from.
fn newest_source(root: &Path) -> SystemTime {
    fn newest(path: &Path) -> SystemTime {
        let Ok(data) = fs::metadata(path) else { return SystemTime::UNIX_EPOCH };
        if !data.is_dir() {
            return data.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        }
        let entries = fs::read_dir(path).into_iter().flatten().flatten();
        entries.map(|entry| newest(&entry.path())).max().unwrap_or(SystemTime::UNIX_EPOCH)
    }
    let parts = [
        "Cargo.toml",
        "proto",
        "core/Cargo.toml",
        "core/src",
        "core/docs",
        "core/vision/Cargo.toml",
        "core/vision/src",
        "core/fusion/Cargo.toml",
        "core/fusion/src",
        "core/calib/Cargo.toml",
        "core/calib/src",
        "core/sim/Cargo.toml",
        "core/sim/src",
        "core/plan/Cargo.toml",
        "core/plan/src",
        "server/Cargo.toml",
        "server/src",
        "client/rust/Cargo.toml",
        "client/rust/src",
        "client/rust/examples",
        "client/dashboard",
    ];
    parts.iter().map(|part| newest(&root.join(part))).max().unwrap_or(SystemTime::UNIX_EPOCH)
}

/// A running `roundel serve` or `roundel demo`; killed when dropped.
pub struct Server {
    child: Child,
    address: String,
    stdout: Arc<Mutex<String>>,
    stderr: Arc<Mutex<String>>,
}

impl Server {
    /// Starts `roundel ARGS…` in `folder` and waits until it prints its address.
    ///
    /// The arguments or the configuration must select port 0. Fails with the server's output if it ends first or
    /// prints no address within a minute.
    pub fn start(args: &[&str], folder: &Path) -> anyhow::Result<Server> {
        Self::start_with(args, folder, &[])
    }

    /// Like [`Server::start`], with additional environment variables.
    pub fn start_with(
        args: &[&str],
        folder: &Path,
        environment: &[(&str, &Path)],
    ) -> anyhow::Result<Server> {
        let mut child = Command::new(roundel()?)
            .args(args)
            .envs(environment.iter().copied())
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .context("the roundel binary could not be started")?;
        let (stdout, stderr) = (Arc::<Mutex<String>>::default(), Arc::<Mutex<String>>::default());
        let (say, heard) = channel();
        capture(child.stdout.take(), stdout.clone(), move |line| {
            if let Some((_, address)) = line.split_once(LISTENING) {
                let word = address.split_whitespace().next().unwrap_or_default();
                // Only the first address is received.
                let _ = say.send(word.trim_end_matches('/').to_owned());
            }
        });
        capture(child.stderr.take(), stderr.clone(), |_| {});
        let mut server = Server { child, address: String::new(), stdout, stderr };
        match heard.recv_timeout(Duration::from_secs(60)) {
            Ok(address) => server.address = address,
            Err(RecvTimeoutError::Disconnected) => {
                let status = server.child.wait()?;
                bail!(
                    "expected `roundel {}` to listen, but it ended with {status}:\n{}",
                    args.join(" "),
                    server.log()
                );
            }
            Err(RecvTimeoutError::Timeout) => bail!(
                "expected `roundel {}` to print `{LISTENING}ADDRESS` within a minute, found:\n{}",
                args.join(" "),
                server.log()
            ),
        }
        Ok(server)
    }

    /// `roundel serve --config CONFIG`.
    pub fn serve(config: &Path) -> anyhow::Result<Server> {
        let folder = config.parent().unwrap_or(Path::new("."));
        Self::start(&["serve", "--config", &config.to_string_lossy()], folder)
    }

    /// HOST:PORT.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// `http://HOST:PORT`, for gRPC and REST.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Output so far: standard output, then standard error.
    pub fn log(&self) -> String {
        let text = |part: &Mutex<String>| part.lock().map(|text| text.clone()).unwrap_or_default();
        format!("{}\n{}", text(&self.stdout), text(&self.stderr))
    }

    /// Sends the process a signal by name, e.g. `INT` or `TERM` (Unix).
    pub fn signal(&self, name: &str) -> anyhow::Result<()> {
        let status =
            Command::new("kill").args(["-s", name, &self.child.id().to_string()]).status()?;
        ensure!(status.success(), "expected `kill -s {name}` to reach the server, found {status}");
        Ok(())
    }

    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().is_ok_and(|status| status.is_some())
    }

    /// Waits until the process ends. Fails if it still runs after `longest`.
    pub fn wait(&mut self, longest: Duration) -> anyhow::Result<ExitStatus> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            ensure!(
                start.elapsed() < longest,
                "expected the server to end within {longest:?}, but it runs; its log:\n{}",
                self.log()
            );
            thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Fails harmlessly if it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if thread::panicking() {
            eprintln!("the server's log:\n{}", self.log());
        }
    }
}

/// Copies a pipe's lines into `text` and passes each to `see`, on a thread that ends with the pipe.
fn capture(
    pipe: Option<impl Read + Send + 'static>,
    text: Arc<Mutex<String>>,
    mut see: impl FnMut(&str) + Send + 'static,
) {
    let Some(pipe) = pipe else { return };
    thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            see(&line);
            if let Ok(mut text) = text.lock() {
                text.push_str(&line);
                text.push('\n');
            }
        }
    });
}

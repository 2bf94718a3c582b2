//! Load of a server with 500 and 1,000 subscribers: 100 objects at 60 Hz, with the clients in another process on the
//! same machine.
//!
//! ```sh
//! cargo bench -p roundel-server --bench subscribers                             # every case, 10 s each
//! cargo bench -p roundel-server --bench subscribers -- --case lean --seconds 600
//! ```
//!
//! The server process runs the APIs of `roundel serve` around a hub that is fed with snapshots. Clients read the first
//! fields of each message without decoding the rest. *Latency* is from the end of fusion to the last byte read; both
//! processes use the same clock. *bare* sends the same messages by plain writes to plain TCP connections. *reencoded*
//! gives every subscriber its own region, which contains all objects, so that no encoding can be shared. *tls* encrypts
//! the connections.
//!
//! Bars, for 500 subscribers in one run: all served, p99 at most twice that of plain writes, and encoding for each
//! subscriber takes the server at least twice the processor time a message.

mod arrival;
mod grpc;
mod measure;
mod messages;
#[path = "../shared/object.rs"]
mod object;
mod raw_sockets;
mod serve;
mod websocket;

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader},
    net::SocketAddr,
    path::Path,
    process::{Child, Command, Stdio},
    time::Duration,
};

use measure::{Readings, Usage};
use tempfile::TempDir;

/// The allocator of the `roundel` command.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// One server and its subscribers.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    name: &'static str,
    grpc: usize,
    websockets: usize,
    /// gRPC subscribers that never read.
    stuck: usize,
    covariances: bool,
    /// Whether WebSockets use protobuf instead of JSON.
    protobuf: bool,
    /// Whether every subscriber has a different selection.
    differ: bool,
    /// Whether the messages are sent by plain writes.
    bare: bool,
    /// Whether the gRPC connections are encrypted.
    tls: bool,
}

const LEAN: Case = Case {
    name: "lean",
    grpc: 500,
    websockets: 0,
    stuck: 0,
    covariances: false,
    protobuf: false,
    differ: false,
    bare: false,
    tls: false,
};
const FULL: Case = Case { name: "full", covariances: true, ..LEAN };
const CASES: [Case; 22] = [
    Case { name: "few", grpc: 20, ..FULL },
    Case { name: "few-tls", grpc: 20, tls: true, ..FULL },
    LEAN,
    Case { name: "lean-bare", bare: true, ..LEAN },
    Case { name: "lean-reencoded", differ: true, ..LEAN },
    Case { name: "lean-tls", tls: true, ..LEAN },
    FULL,
    Case { name: "full-bare", bare: true, ..FULL },
    Case { name: "full-reencoded", differ: true, ..FULL },
    Case { name: "full-tls", tls: true, ..FULL },
    Case { name: "lean-stuck", stuck: 100, ..LEAN },
    Case { name: "full-stuck", stuck: 100, ..FULL },
    Case { name: "lean-1000", grpc: 1000, ..LEAN },
    Case { name: "lean-1000-bare", grpc: 1000, bare: true, ..LEAN },
    Case { name: "lean-1000-reencoded", grpc: 1000, differ: true, ..LEAN },
    Case { name: "full-1000", grpc: 1000, ..FULL },
    Case { name: "full-1000-bare", grpc: 1000, bare: true, ..FULL },
    Case { name: "full-1000-reencoded", grpc: 1000, differ: true, ..FULL },
    Case { name: "websocket-lean", grpc: 100, websockets: 500, ..LEAN },
    Case { name: "websocket-full", grpc: 100, websockets: 500, ..FULL },
    Case { name: "protobuf-lean", grpc: 100, websockets: 500, protobuf: true, ..LEAN },
    Case { name: "protobuf-full", grpc: 100, websockets: 500, protobuf: true, ..FULL },
];
/// Time until all subscribers are connected and have received some snapshots.
const WARM_UP: Duration = Duration::from_secs(3);

fn main() {
    let (mut seconds, mut wanted) = (10.0, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--serve" => return serve::run(Path::new(&arguments.next().expect("a folder"))),
            "--serve-bare" => return serve::run_bare(arguments.next().as_deref() == Some("full")),
            "--seconds" => {
                let number = arguments.next().and_then(|value| value.parse().ok());
                seconds = number.expect("--seconds takes a number");
            }
            "--case" => wanted = arguments.next(),
            // Passed by cargo.
            "--bench" => {}
            other => panic!("unknown option {other}: expected --seconds or --case"),
        }
    }
    let names = CASES.map(|case| case.name).join(", ");
    let is_wanted = |case: &&Case| wanted.as_deref().is_none_or(|name| name == case.name);
    let cases: Vec<&Case> = CASES.iter().filter(is_wanted).collect();
    assert!(!cases.is_empty(), "--case: expected one of {names}");
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    let mut figures = BTreeMap::new();
    for case in cases {
        let length = Duration::from_secs_f64(seconds);
        figures.insert(case.name.to_owned(), runtime.block_on(run(*case, length)));
    }
    for (name, shared) in &figures {
        if let Some(bare) = figures.get(&format!("{name}-bare")) {
            let ratio = shared.p99_ms / bare.p99_ms;
            println!("{name}: p99 is {ratio:.2} times that of plain writes");
        }
        if let Some(tls) = figures.get(&format!("{name}-tls")) {
            let ratio = tls.p50_ms / shared.p50_ms;
            println!("{name}: p50 with TLS is {ratio:.2} times that without");
        }
        if let Some(reencoded) = figures.get(&format!("{name}-reencoded")) {
            let ratio = reencoded.us_per_message / shared.us_per_message;
            println!(
                "{name}: encoding for each subscriber takes {ratio:.1} times the processor time a message"
            );
        }
    }
}

struct Figures {
    p50_ms: f64,
    p99_ms: f64,
    /// Processor time of the server.
    us_per_message: f64,
}

/// A server in another process; killed when dropped.
struct ServerProcess {
    process: Child,
    address: SocketAddr,
    /// Has its certificate, which is self-signed.
    folder: TempDir,
}

impl ServerProcess {
    fn start(case: &Case) -> Self {
        let program = std::env::current_exe().expect("this program");
        let folder = tempfile::tempdir().expect("a folder");
        let arguments = match (case.bare, case.covariances) {
            (false, _) => ["--serve", folder.path().to_str().expect("UTF-8")],
            (true, false) => ["--serve-bare", "lean"],
            (true, true) => ["--serve-bare", "full"],
        };
        let mut process = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a second process of this program");
        let mut line = String::new();
        let stdout = process.stdout.take().expect("a pipe");
        BufReader::new(stdout).read_line(&mut line).expect("the server's first line");
        let address = line.trim().parse().expect("an address");
        Self { process, address, folder }
    }
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Pauses after every few connections: all at once would overflow the listener's accept queue, and the kernel would
/// reset the surplus.
async fn pace_connections(number: usize) {
    const BATCH: usize = 20;
    const PAUSE: Duration = Duration::from_millis(20);
    if number % BATCH == BATCH - 1 {
        tokio::time::sleep(PAUSE).await;
    }
}

/// Measures a case.
async fn run(case: Case, length: Duration) -> Figures {
    let server = ServerProcess::start(&case);
    let readings = Readings::default();
    let tls = case.tls.then(|| grpc::connector(&serve::files(server.folder.path()).certificate));
    let mut clients = tokio::task::JoinSet::new();
    for number in 0..case.grpc {
        pace_connections(number).await;
        let request = grpc::request(&case, number);
        if case.bare {
            clients.spawn(raw_sockets::read(server.address, readings.clone()));
        } else if number < case.stuck {
            clients.spawn(grpc::hold(server.address, tls.clone(), request));
        } else {
            clients.spawn(grpc::read(server.address, tls.clone(), request, readings.clone()));
        }
    }
    for number in 0..case.websockets {
        pace_connections(number).await;
        clients.spawn(websocket::read(server.address, case, readings.clone()));
    }
    tokio::time::sleep(WARM_UP).await;
    readings.clear();
    let begin = Usage::of(server.process.id());
    let mut most_mb = begin.memory_mb;
    let steps = (length.as_secs_f64().ceil() as u32).max(1);
    for _ in 0..steps {
        tokio::time::sleep(length / steps).await;
        most_mb = most_mb.max(Usage::of(server.process.id()).memory_mb);
    }
    let end = Usage::of(server.process.id());
    let readers = case.grpc + case.websockets - case.stuck;
    let summary = readings.summary(readers, length);
    println!("{}: {}", case.name, summary.line);
    let cores = end.cores_since(&begin);
    let us_per_message = 1e6 * cores * length.as_secs_f64() / readings.count() as f64;
    println!(
        "    server {cores:.2} cores, {us_per_message:.1} us a message; clients {:.2}; memory {:.0} MB at the start, {:.0} at the end, {:.0} at most",
        end.others_since(&begin),
        begin.memory_mb,
        end.memory_mb,
        most_mb,
    );
    clients.shutdown().await;
    Figures { p50_ms: summary.p50_ms, p99_ms: summary.p99_ms, us_per_message }
}

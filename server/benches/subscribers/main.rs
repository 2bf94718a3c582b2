//! A server of 500 and of 1,000 subscribers: 100 objects at 60 Hz, to clients in another process on the same machine.
//!
//! ```sh
//! cargo bench -p roundel-server --bench subscribers                             # every case, 10 s each
//! cargo bench -p roundel-server --bench subscribers -- --case lean --seconds 600
//! ```
//!
//! The server is a process of its own: the APIs of `roundel serve` around a hub that is fed with snapshots. Clients look
//! into the first bytes of each message without decoding the rest. *Latency* is from the end of fusion to the last byte
//! read; both processes read one clock. *bare* sends the same messages by plain writes to plain TCP connections.
//! *reencoded* gives every subscriber its own region, which holds all objects, so that nothing can be shared.
//!
//! Bars, for 500 subscribers in one run: all served, p99 at most twice that of plain writes, and encoding for each
//! subscriber takes the server at least twice the processor time a message.

mod arrival;
mod bare;
mod grpc;
mod measure;
mod messages;
#[path = "../shared/object.rs"]
mod object;
mod serve;
mod websocket;

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader},
    net::SocketAddr,
    process::{Child, Command, Stdio},
    time::Duration,
};

use measure::{Readings, Usage};

/// As of the `roundel` command.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// One server, its subscribers, and what they want.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    name: &'static str,
    grpc: usize,
    websockets: usize,
    /// gRPC subscribers that never read.
    stuck: usize,
    covariances: bool,
    /// Whether pages take protobuf instead of JSON.
    protobuf: bool,
    /// Whether no two want the same.
    differ: bool,
    /// Whether the same bytes come by plain writes.
    bare: bool,
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
};
const FULL: Case = Case { name: "full", covariances: true, ..LEAN };
const CASES: [Case; 18] = [
    LEAN,
    Case { name: "lean-bare", bare: true, ..LEAN },
    Case { name: "lean-reencoded", differ: true, ..LEAN },
    FULL,
    Case { name: "full-bare", bare: true, ..FULL },
    Case { name: "full-reencoded", differ: true, ..FULL },
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
/// Until everybody is there and has had some snapshots.
const WARM_UP: Duration = Duration::from_secs(3);

fn main() {
    let (mut seconds, mut wanted) = (10.0, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--serve" => return serve::run(None),
            "--serve-bare" => return serve::run(Some(arguments.next().as_deref() == Some("full"))),
            "--seconds" => {
                let number = arguments.next().and_then(|value| value.parse().ok());
                seconds = number.expect("--seconds takes a number");
            }
            "--case" => wanted = arguments.next(),
            // Cargo's own.
            "--bench" => {}
            other => panic!("unknown option {other}: there are --seconds and --case"),
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
        if let Some(reencoded) = figures.get(&format!("{name}-reencoded")) {
            let ratio = reencoded.us_per_message / shared.us_per_message;
            println!(
                "{name}: encoding for each subscriber takes {ratio:.1} times the processor time a message"
            );
        }
    }
}

struct Figures {
    p99_ms: f64,
    /// The server's processor time.
    us_per_message: f64,
}

/// A server in another process; it ends with this.
struct ServerProcess {
    process: Child,
    address: SocketAddr,
}

impl ServerProcess {
    fn start(case: &Case) -> Self {
        let program = std::env::current_exe().expect("this program");
        let arguments: &[&str] = match (case.bare, case.covariances) {
            (false, _) => &["--serve"],
            (true, false) => &["--serve-bare", "lean"],
            (true, true) => &["--serve-bare", "full"],
        };
        let mut process = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("this program once more");
        let mut line = String::new();
        let stdout = process.stdout.take().expect("a pipe");
        BufReader::new(stdout).read_line(&mut line).expect("the server's first line");
        let address = line.trim().parse().expect("an address");
        Self { process, address }
    }
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Pauses after every few connections: all at once would overflow the listener's accept queue, and the kernel would reset
/// those that do not fit.
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
    let mut clients = tokio::task::JoinSet::new();
    for number in 0..case.grpc {
        pace_connections(number).await;
        let request = grpc::request(&case, number);
        if case.bare {
            clients.spawn(bare::read(server.address, readings.clone()));
        } else if number < case.stuck {
            clients.spawn(grpc::hold(server.address, request));
        } else {
            clients.spawn(grpc::read(server.address, request, readings.clone()));
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
        "    server {cores:.2} cores, {us_per_message:.1} us a message; clients {:.2}; memory {:.0} MB at the begin, {:.0} at the end, {:.0} at most",
        end.others_since(&begin),
        begin.memory_mb,
        end.memory_mb,
        most_mb,
    );
    clients.shutdown().await;
    Figures { p99_ms: summary.p99_ms, us_per_message }
}

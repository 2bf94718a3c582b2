//! A server of a thousand subscribers: 100 objects at 60 Hz, to clients in another process on the same machine.
//!
//! ```sh
//! cargo bench -p roundel-server --bench subscribers                             # every case, 10 s each
//! cargo bench -p roundel-server --bench subscribers -- --case lean --seconds 600
//! ```
//!
//! The server is a process of its own, the APIs of `roundel serve` around a hub that is fed with snapshots, so that its
//! processor time and memory are its alone. Clients are as cheap as can be, so that the machine measures the server and
//! not them: they read frames of HTTP/2 or of WebSockets and look into the first bytes of each message, without
//! decoding the rest. *Latency* is from when fusion was done with a snapshot to when its last byte was read; both
//! processes read one clock. *Re-encoded* gives every subscriber a region of its own that holds all objects, so that
//! nothing can be shared, and everything else is the same.

mod arrival;
mod bare;
mod grpc;
mod measure;
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
    /// Of those by gRPC, how many never read.
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
    grpc: 1000,
    websockets: 0,
    stuck: 0,
    covariances: false,
    protobuf: false,
    differ: false,
    bare: false,
};
const CASES: [Case; 12] = [
    LEAN,
    Case { name: "lean-bare", bare: true, ..LEAN },
    Case { name: "full", covariances: true, ..LEAN },
    Case { name: "full-bare", covariances: true, bare: true, ..LEAN },
    Case { name: "lean-stuck", stuck: 100, ..LEAN },
    Case { name: "full-stuck", stuck: 100, covariances: true, ..LEAN },
    Case { name: "websocket-lean", grpc: 100, websockets: 500, ..LEAN },
    Case { name: "websocket-full", grpc: 100, websockets: 500, covariances: true, ..LEAN },
    Case { name: "protobuf-lean", grpc: 100, websockets: 500, protobuf: true, ..LEAN },
    Case {
        name: "protobuf-full",
        grpc: 100,
        websockets: 500,
        covariances: true,
        protobuf: true,
        ..LEAN
    },
    Case { name: "lean-reencoded", differ: true, ..LEAN },
    Case { name: "full-reencoded", differ: true, covariances: true, ..LEAN },
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
    let mut us = BTreeMap::new();
    for case in cases {
        us.insert(case.name, runtime.block_on(run(*case, Duration::from_secs_f64(seconds))));
    }
    for (shared, reencoded) in [("lean", "lean-reencoded"), ("full", "full-reencoded")] {
        if let (Some(shared_us), Some(reencoded_us)) = (us.get(shared), us.get(reencoded)) {
            let ratio = reencoded_us / shared_us;
            println!(
                "{shared}: encoded anew for each, a message takes the server {ratio:.1} times as long"
            );
        }
    }
}

/// A server in another process; it ends with this.
struct Served {
    process: Child,
    address: SocketAddr,
}

impl Served {
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

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Measures a case; how much of a processor's time a message took the server, microseconds.
async fn run(case: Case, length: Duration) -> f64 {
    let server = Served::start(&case);
    let readings = Readings::default();
    let mut clients = tokio::task::JoinSet::new();
    for number in 0..case.grpc {
        let request = grpc::request(&case, number);
        if number < case.stuck {
            clients.spawn(grpc::hold(server.address, request));
        } else {
            clients.spawn(grpc::read(server.address, request, readings.clone()));
        }
    }
    for _ in 0..case.websockets {
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
    println!("{}: {}", case.name, readings.line(readers, length));
    let cores = end.cores_since(&begin);
    let us = 1e6 * cores * length.as_secs_f64() / readings.count() as f64;
    println!(
        "    server {cores:.2} cores, {us:.1} us a message; clients {:.2}; memory {:.0} MB at the begin, {:.0} at the end, {:.0} at most",
        end.others_since(&begin),
        begin.memory_mb,
        end.memory_mb,
        most_mb,
    );
    clients.shutdown().await;
    us
}

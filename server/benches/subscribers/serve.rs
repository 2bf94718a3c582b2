//! The server process: the APIs, and a hub that receives a snapshot 60 times a second.

use std::{
    collections::BTreeMap,
    io::{self, Read, Write},
    net::TcpListener,
    path::Path,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use roundel_core::world::Snapshot;
use roundel_server::{
    api::{self, ApiLimits, ApiState, encoding_budget::EncodingBudget, tls::Tls},
    model::{
        clock::Clock,
        config::TlsConfig,
        hub::{CameraInfo, Hub, Installation},
    },
};

use crate::{object::object, raw_sockets};

pub const RATE_HZ: f64 = 60.0;
const OBJECTS: u64 = 100;

/// The files of the certificate that the server makes.
pub fn files(folder: &Path) -> TlsConfig {
    let (certificate, key) = (folder.join("certificate.pem"), folder.join("key.pem"));
    TlsConfig { certificate, key, client_ca: None, self_signed: true }
}

/// Prints its address, and serves until its standard input ends, with a self-signed certificate in this folder.
pub fn run(folder: &Path) {
    let tls = Tls::load(&files(folder), [127, 0, 0, 1].into()).expect("a certificate");
    let (listener, hub, clock) = start();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        listener.set_nonblocking(true).expect("an option");
        let listener = tokio::net::TcpListener::from_std(listener).expect("a port");
        let (max_clients, max_connections_per_peer) = (4000, 4000);
        let limits = ApiLimits { max_clients, max_connections_per_peer, ..ApiLimits::default() };
        // *reencoded* measures every encoding.
        let encoding_budget = Arc::new(EncodingBudget::new(f64::INFINITY));
        let state = ApiState { limits, encoding_budget, tls, ..ApiState::new(hub, clock) };
        api::serve(listener, state).await;
    });
}

/// Like [`run`], for [`raw_sockets`] with or without covariances.
pub fn run_bare(covariances: bool) {
    let (listener, hub, clock) = start();
    raw_sockets::run(listener, &hub, clock, covariances);
}

fn start() -> (TcpListener, Arc<Hub>, Clock) {
    let clock = Clock::anchored_now();
    let hub = Arc::new(Hub::new(installation(clock)));
    let feeding = hub.clone();
    thread::spawn(move || feed(&feeding, clock));
    // Exits with the parent process.
    thread::spawn(|| {
        let _ = io::stdin().read(&mut [0]);
        std::process::exit(0);
    });
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    println!("{}", listener.local_addr().expect("an address"));
    io::stdout().flush().expect("a pipe");
    (listener, hub, clock)
}

fn installation(clock: Clock) -> Installation {
    let camera =
        |place: usize| CameraInfo { name: format!("camera {place}"), ..CameraInfo::default() };
    Installation {
        name: "bench".into(),
        source_id: "0123456789abcdef".into(),
        started: clock.now(),
        snapshot_rate_hz: RATE_HZ,
        cameras: Installation::number_cameras((0..4).map(camera)),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: vec![],
    }
}

fn feed(hub: &Hub, clock: Clock) {
    let begin = Instant::now();
    for number in 1_u64.. {
        let due = begin + Duration::from_secs_f64(number as f64 / RATE_HZ);
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let now = clock.now();
        let objects = (1..=OBJECTS).map(|id| object(id, number as f64 * 0.01, now)).collect();
        let snapshot = Snapshot { pose_time: now, capture_time: Some(now), objects };
        hub.publish_snapshot(snapshot, clock.now());
    }
}

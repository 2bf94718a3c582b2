//! The process with the server: the APIs, and a hub that gets a snapshot each sixtieth of a second.

use std::{
    collections::BTreeMap,
    io::{self, Read, Write},
    net::TcpListener,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use roundel_core::world::Snapshot;
use roundel_server::{
    api::{self, ApiLimits, ApiState},
    model::{
        clock::Clock,
        hub::{CameraInfo, Hub, Installation},
    },
};

use crate::{bare, object::object};

pub const RATE_HZ: f64 = 60.0;
const OBJECTS: u64 = 100;

/// Serves until its standard input ends; prints its address first. `bare`: as [`bare`], with covariances or without.
pub fn run(bare: Option<bool>) {
    let clock = Clock::anchored_now();
    let hub = Arc::new(Hub::new(installation(clock)));
    let feeding = hub.clone();
    thread::spawn(move || feed(&feeding, clock));
    // Ends with the parent process.
    thread::spawn(|| {
        let _ = io::stdin().read(&mut [0]);
        std::process::exit(0);
    });
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    println!("{}", listener.local_addr().expect("an address"));
    io::stdout().flush().expect("a pipe");
    if let Some(covariances) = bare {
        return bare::run(listener, &hub, clock, covariances);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        listener.set_nonblocking(true).expect("an option");
        let listener = tokio::net::TcpListener::from_std(listener).expect("a port");
        let limits = ApiLimits { max_clients: 4000, ..ApiLimits::default() };
        api::serve(listener, ApiState { limits, ..ApiState::new(hub, clock) }).await;
    });
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

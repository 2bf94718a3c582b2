//! The baseline: the same messages to the same number of TCP connections, by plain blocking writes from two threads.
//!
//! Nothing is requested, selected, skipped or timed out; a full socket blocks its thread.

use std::{
    io::Write,
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{Arc, Mutex, PoisonError},
    thread,
};

use roundel_server::{
    api::{
        selection::{MESSAGE_FIELDS, Selection},
        snapshot_encoder::{Encoding, SnapshotEncoder, SubscriberFields},
    },
    model::{clock::Clock, hub::Hub},
};

use crate::{arrival::read_some, grpc::length_prefixed, measure::Readings, messages::Messages};

const THREADS: usize = 2;

type Connections = Arc<Mutex<Vec<TcpStream>>>;

/// Writes all snapshots of the hub to every connection.
pub fn run(listener: TcpListener, hub: &Arc<Hub>, clock: Clock, covariances: bool) {
    let shares: [Connections; THREADS] = std::array::from_fn(|_| Connections::default());
    let encoder = Arc::new(SnapshotEncoder::default());
    for share in &shares {
        let (share, encoder, hub) = (share.clone(), encoder.clone(), hub.clone());
        thread::spawn(move || send(&share, &encoder, &hub, clock, covariances));
    }
    for number in 0.. {
        let Ok((stream, _)) = listener.accept() else { return };
        stream.set_nodelay(true).expect("an option");
        lock(&shares[number % THREADS]).push(stream);
    }
}

fn lock(share: &Connections) -> std::sync::MutexGuard<'_, Vec<TcpStream>> {
    share.lock().unwrap_or_else(PoisonError::into_inner)
}

fn send(
    share: &Connections,
    encoder: &SnapshotEncoder,
    hub: &Hub,
    clock: Clock,
    covariances: bool,
) {
    let wanted = roundel_proto::v1::SubscribeSnapshotsRequest {
        omit_covariance: !covariances,
        ..Default::default()
    };
    let filter = Selection::new(wanted, &[], &MESSAGE_FIELDS).expect("a request").filter;
    let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
    let mut snapshots = hub.snapshots();
    while runtime.block_on(snapshots.changed()).is_ok() {
        let fused = snapshots.borrow_and_update().clone();
        let shared = encoder.shared(hub, &fused, &filter, Encoding::Protobuf);
        let own = SubscriberFields { sent_time_ns: clock.now().as_ns(), missed: 0 }.protobuf();
        let bytes = length_prefixed(&[own, shared.to_vec()].concat());
        lock(share).retain_mut(|stream| stream.write_all(&bytes).is_ok());
    }
}

/// Reads all snapshots like a client.
pub async fn read(address: SocketAddr, readings: Readings) {
    let mut stream = tokio::net::TcpStream::connect(address).await.expect("a connection");
    let (mut messages, mut rest) = (Messages::new(readings), Vec::new());
    loop {
        let take = |bytes: &[u8]| {
            messages.add(bytes);
            bytes.len()
        };
        read_some(&mut stream, &mut rest, take).await;
    }
}

//! What the system alone takes: the same bytes to as many connections, by plain writes of two threads.
//!
//! No request is read, nothing is chosen, missed or timed out; a connection without room for a message holds up its
//! thread. Whatever a server does more than this shows beside it.

use std::{
    io::Write,
    net::{TcpListener, TcpStream},
    sync::{Arc, Mutex, PoisonError},
    thread,
};

use roundel_server::{
    api::{
        encoded::{Encoder, Form, Own},
        selection::{MESSAGE_FIELDS, Selection},
    },
    clock::Clock,
    hub::Hub,
};

use crate::grpc;

const THREADS: usize = 2;

type Connections = Arc<Mutex<Vec<TcpStream>>>;

/// Serves whoever connects to `listener` with all snapshots of the hub.
pub fn run(listener: TcpListener, hub: &Arc<Hub>, clock: Clock, covariances: bool) {
    let shares: [Connections; THREADS] = std::array::from_fn(|_| Connections::default());
    let encoder = Arc::new(Encoder::default());
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

fn send(share: &Connections, encoder: &Encoder, hub: &Hub, clock: Clock, covariances: bool) {
    let wanted = roundel_proto::v1::SubscribeSnapshotsRequest {
        omit_covariance: !covariances,
        ..Default::default()
    };
    let filter = Selection::new(wanted, &[], &MESSAGE_FIELDS).expect("a request").filter;
    let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
    let mut snapshots = hub.snapshots();
    while runtime.block_on(snapshots.changed()).is_ok() {
        let fused = snapshots.borrow_and_update().clone();
        let shared = encoder.shared(hub, &fused, &filter, Form::Protobuf);
        let own = Own { sent_time_ns: clock.now().as_ns(), missed: 0 }.protobuf();
        let bytes = grpc::message(&[own, shared.to_vec()].concat());
        lock(share).retain_mut(|stream| stream.write_all(&bytes).is_ok());
    }
}

//! A TCP link to the server that can be stalled, or broken in the middle of a message. Leads to the server's current
//! address, also after a restart.

use std::{
    net::{Ipv4Addr, SocketAddr},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    task::JoinHandle,
    time::sleep,
};

/// Where the server listens now.
#[derive(Clone, Debug)]
pub struct CurrentAddress(Arc<Mutex<SocketAddr>>);

impl Default for CurrentAddress {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(SocketAddr::from((Ipv4Addr::LOCALHOST, 1)))))
    }
}

impl CurrentAddress {
    /// Where the server listens now.
    pub fn get(&self) -> SocketAddr {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The server listens there from now on.
    pub fn set(&self, address: SocketAddr) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = address;
    }
}

#[derive(Debug, Default)]
struct LinkState {
    is_stalled: AtomicBool,
    breaks: AtomicU64,
}

/// One link; ends when it is dropped.
#[derive(Debug)]
pub struct Link {
    address: SocketAddr,
    state: Arc<LinkState>,
    task: JoinHandle<()>,
}

impl Link {
    /// Opens a port that leads to the server.
    pub async fn to(server: CurrentAddress) -> std::io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await?;
        let address = listener.local_addr()?;
        let state = Arc::<LinkState>::default();
        let shared = state.clone();
        let task = tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                tokio::spawn(connect(near, server.get(), shared.clone()));
            }
        });
        Ok(Self { address, state, task })
    }

    /// URL whose connections go through this link.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// A stalled link keeps its connections, and carries everything late.
    pub fn set_stalled(&self, is_stalled: bool) {
        self.state.is_stalled.store(is_stalled, Ordering::Relaxed);
    }

    /// Closes all connections after half of the next bytes.
    pub fn break_now(&self) {
        self.state.breaks.fetch_add(1, Ordering::Relaxed);
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn connect(near: TcpStream, server: SocketAddr, state: Arc<LinkState>) {
    let Ok(far) = TcpStream::connect(server).await else { return };
    let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
    tokio::select! {
        () = forward(near_in, far_out, &state) => {}
        () = forward(far_in, near_out, &state) => {}
    }
}

async fn forward(
    mut from: impl AsyncRead + Unpin,
    mut to: impl AsyncWrite + Unpin,
    state: &LinkState,
) {
    let breaks = state.breaks.load(Ordering::Relaxed);
    let mut bytes = vec![0; 16 * 1024];
    while let Ok(count @ 1..) = from.read(&mut bytes).await {
        while state.is_stalled.load(Ordering::Relaxed) {
            sleep(Duration::from_millis(5)).await;
        }
        let is_broken = state.breaks.load(Ordering::Relaxed) != breaks;
        let count = if is_broken { count / 2 } else { count };
        if to.write_all(&bytes[..count]).await.is_err() || is_broken {
            return;
        }
    }
}

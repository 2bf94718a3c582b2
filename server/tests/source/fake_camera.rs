//! Fake HTTP cameras on loopback, which answer like real ones, correctly or not.

use std::{
    io::{BufRead, BufReader, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use jpeg_encoder::{ColorType, Encoder};

/// A JPEG of one grey level, in colour as most cameras send it.
pub fn jpeg(size: (u16, u16), level: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let pixels = vec![level; 3 * usize::from(size.0) * usize::from(size.1)];
    Encoder::new(&mut bytes, 80).encode(&pixels, size.0, size.1, ColorType::Rgb).unwrap();
    bytes
}

/// One part of an MJPEG stream, formatted like that of an ESP32-CAM.
pub fn part(jpeg: &[u8], stamp: &str) -> Vec<u8> {
    let header = format!(
        "\r\n--123456789000000000000987654321\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n{stamp}\r\n",
        jpeg.len()
    );
    [header.as_bytes(), jpeg].concat()
}

/// The response header of an MJPEG stream.
pub const STREAM: &str =
    "HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=frame\r\n\r\n";

/// Handles a connection: its number, the request, and the socket.
pub type Serve = dyn Fn(usize, &str, &mut TcpStream) -> std::io::Result<()> + Send + Sync;

/// A fake camera, which runs until it is dropped.
pub struct FakeCamera {
    address: SocketAddr,
    stopping: Arc<AtomicBool>,
    served: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

impl FakeCamera {
    /// Starts a camera on a free port.
    pub fn start(
        serve: impl Fn(usize, &str, &mut TcpStream) -> std::io::Result<()> + Send + Sync + 'static,
    ) -> Self {
        Self::start_at("127.0.0.1:0".parse().unwrap(), serve)
    }

    /// Starts a camera on this port, which may have been in use just before.
    pub fn start_at(
        address: SocketAddr,
        serve: impl Fn(usize, &str, &mut TcpStream) -> std::io::Result<()> + Send + Sync + 'static,
    ) -> Self {
        let listener = bind(address);
        let address = listener.local_addr().unwrap();
        listener.set_nonblocking(true).unwrap();
        let (stopping, served) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
        let thread = thread::spawn({
            let (stopping, served) = (stopping.clone(), served.clone());
            let serve: Arc<Serve> = Arc::new(serve);
            move || listen(&listener, &serve, &stopping, &served)
        });
        Self { address, stopping, served, thread: Some(thread) }
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Number of connections so far.
    pub fn served(&self) -> usize {
        self.served.load(Ordering::SeqCst)
    }
}

/// Binds the port, retrying while the sockets of a killed camera are still closing.
fn bind(address: SocketAddr) -> TcpListener {
    for _ in 0..500 {
        match TcpListener::bind(address) {
            Ok(listener) => return listener,
            Err(_) => thread::sleep(Duration::from_millis(10)),
        }
    }
    panic!("{address} does not become free");
}

fn listen(
    listener: &TcpListener,
    serve: &Arc<Serve>,
    stopping: &Arc<AtomicBool>,
    served: &AtomicUsize,
) {
    let mut sockets: Vec<TcpStream> = Vec::new();
    let mut threads = Vec::new();
    while !stopping.load(Ordering::SeqCst) {
        let Ok((socket, _)) = listener.accept() else {
            thread::sleep(Duration::from_millis(2));
            continue;
        };
        socket.set_nonblocking(false).unwrap();
        sockets.push(socket.try_clone().unwrap());
        let number = served.fetch_add(1, Ordering::SeqCst);
        let serve = serve.clone();
        threads.push(thread::spawn(move || handle(number, socket, &*serve)));
    }
    for socket in &sockets {
        // The socket may already be closed.
        let _ = socket.shutdown(Shutdown::Both);
    }
    for thread in threads {
        thread.join().unwrap();
    }
}

/// Reads the request and handles it; errors are ignored, since the client may have disconnected.
fn handle(number: usize, mut socket: TcpStream, serve: &Serve) {
    let mut request = String::new();
    let mut reader = BufReader::new(socket.try_clone().unwrap());
    while !request.ends_with("\r\n\r\n") {
        match reader.read_line(&mut request) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
    }
    let _ = serve(number, &request, &mut socket);
    let _ = socket.flush();
    // Otherwise the listener's clone keeps the connection open.
    let _ = socket.shutdown(Shutdown::Both);
}

impl Drop for FakeCamera {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

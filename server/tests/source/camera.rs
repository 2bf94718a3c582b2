//! Network cameras of the tests: HTTP on loopback, answering as real ones do, well or badly.

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

/// A picture of one grey level, as colour cameras send it.
pub fn jpeg(size: (u16, u16), level: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let pixels = vec![level; 3 * usize::from(size.0) * usize::from(size.1)];
    Encoder::new(&mut bytes, 80).encode(&pixels, size.0, size.1, ColorType::Rgb).unwrap();
    bytes
}

/// A part of a stream, as ESP32-CAM sends it.
pub fn part(jpeg: &[u8], stamp: &str) -> Vec<u8> {
    let header = format!(
        "\r\n--123456789000000000000987654321\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n{stamp}\r\n",
        jpeg.len()
    );
    [header.as_bytes(), jpeg].concat()
}

/// What a stream begins with.
pub const STREAM: &str =
    "HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=frame\r\n\r\n";

/// What a camera does with a connection: number, request, and the socket.
pub type Serve = dyn Fn(usize, &str, &mut TcpStream) -> std::io::Result<()> + Send + Sync;

/// A camera that runs until it is dropped.
pub struct NetworkCamera {
    address: SocketAddr,
    ends: Arc<AtomicBool>,
    served: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
}

impl NetworkCamera {
    /// On a free port.
    pub fn start(
        serve: impl Fn(usize, &str, &mut TcpStream) -> std::io::Result<()> + Send + Sync + 'static,
    ) -> Self {
        Self::start_at("127.0.0.1:0".parse().unwrap(), serve)
    }

    /// On that port, which may have been in use a moment ago.
    pub fn start_at(
        address: SocketAddr,
        serve: impl Fn(usize, &str, &mut TcpStream) -> std::io::Result<()> + Send + Sync + 'static,
    ) -> Self {
        let listener = bind(address);
        let address = listener.local_addr().unwrap();
        listener.set_nonblocking(true).unwrap();
        let (ends, served) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
        let thread = thread::spawn({
            let (ends, served) = (ends.clone(), served.clone());
            let serve: Arc<Serve> = Arc::new(serve);
            move || listen(&listener, &serve, &ends, &served)
        });
        Self { address, ends, served, thread: Some(thread) }
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Connections so far.
    pub fn served(&self) -> usize {
        self.served.load(Ordering::SeqCst)
    }
}

/// The port of a camera that was killed is free at once: sockets of tests do not linger.
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
    ends: &Arc<AtomicBool>,
    served: &AtomicUsize,
) {
    let mut sockets: Vec<TcpStream> = Vec::new();
    let mut threads = Vec::new();
    while !ends.load(Ordering::SeqCst) {
        let Ok((socket, _)) = listener.accept() else {
            thread::sleep(Duration::from_millis(2));
            continue;
        };
        socket.set_nonblocking(false).unwrap();
        sockets.push(socket.try_clone().unwrap());
        let number = served.fetch_add(1, Ordering::SeqCst);
        let serve = serve.clone();
        threads.push(thread::spawn(move || answer(number, socket, &*serve)));
    }
    for socket in &sockets {
        // It may be closed already.
        let _ = socket.shutdown(Shutdown::Both);
    }
    for thread in threads {
        thread.join().unwrap();
    }
}

/// Reads the request and serves it; whoever asked may be gone meanwhile.
fn answer(number: usize, mut socket: TcpStream, serve: &Serve) {
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
    // The listener's copy would keep it open.
    let _ = socket.shutdown(Shutdown::Both);
}

impl Drop for NetworkCamera {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

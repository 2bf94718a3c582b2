//! The socket of one connection: it holds its place among the connections for as long as it is open, also when a WebSocket
//! has taken it over, and can be written to past whoever speaks on it.

use std::{
    io,
    pin::Pin,
    sync::{Arc, atomic::Ordering},
    task::{Context, Poll},
};

use tokio::{
    io::{AsyncRead, AsyncWrite, Interest, ReadBuf},
    net::TcpStream,
    sync::OwnedSemaphorePermit,
};

use super::sheet::Sheet;
use crate::api::Api;

/// What can be written to at once or not at all.
pub(in crate::api) trait Socket: AsyncRead + AsyncWrite + Unpin {
    /// How many bytes it took; an error of [`WouldBlock`](io::ErrorKind::WouldBlock) says that there is no room.
    fn try_write(&self, bytes: &[u8]) -> io::Result<usize>;

    /// The same with the bytes of a sheet from a place on.
    fn try_send(&self, sheet: &Sheet, from: usize) -> io::Result<usize>;

    /// Whether there is room; if not, the task is woken when there is.
    fn poll_writable(&self, context: &mut Context<'_>) -> Poll<io::Result<()>>;
}

/// A connection's socket.
pub(in crate::api) struct Counted {
    pub(super) stream: TcpStream,
    api: Arc<Api>,
    _permit: OwnedSemaphorePermit,
}

impl Counted {
    pub(super) fn new(stream: TcpStream, permit: OwnedSemaphorePermit, api: Arc<Api>) -> Self {
        api.counters.connections.fetch_add(1, Ordering::Relaxed);
        Self { stream, api, _permit: permit }
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.api.counters.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Socket for Counted {
    fn try_write(&self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.try_write(bytes)
    }

    fn try_send(&self, sheet: &Sheet, from: usize) -> io::Result<usize> {
        #[cfg(target_os = "linux")]
        if let Some(pages) = sheet.pages() {
            let (mut begin, length) = (from as u64, sheet.bytes().len() - from);
            return self.stream.try_io(Interest::WRITABLE, || {
                let sent = rustix::fs::sendfile(&self.stream, pages, Some(&mut begin), length);
                Ok(sent?)
            });
        }
        self.stream.try_write(&sheet.bytes()[from..])
    }

    fn poll_writable(&self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream.poll_write_ready(context)
    }
}

impl AsyncRead for Counted {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Counted {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, parts)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

//! Reads sockets into one buffer per thread.
//!
//! A thousand separate buffers would exceed the processor's cache, so that the benchmark would measure cache misses that
//! a single client on its own machine does not have.

use std::{
    cell::RefCell,
    future::poll_fn,
    pin::Pin,
    task::{Poll, ready},
};

use tokio::{
    io::{AsyncRead, ReadBuf},
    net::TcpStream,
};

/// More than the longest message, and more than a socket usually holds.
const BUFFER_BYTES: usize = 512 * 1024;

thread_local! {
    static BUFFER: RefCell<Vec<u8>> = RefCell::new(vec![0; BUFFER_BYTES]);
}

/// Reads once and passes all unused bytes, those of the last call in `rest` first, to `take`, which returns how many it
/// has used.
pub async fn read_some(
    stream: &mut TcpStream,
    rest: &mut Vec<u8>,
    mut take: impl FnMut(&[u8]) -> usize,
) {
    poll_fn(|context| {
        BUFFER.with_borrow_mut(|buffer| {
            let (kept, free) = buffer.split_at_mut(rest.len());
            assert!(!free.is_empty(), "a message of at most {BUFFER_BYTES} bytes");
            let mut read = ReadBuf::new(free);
            ready!(Pin::new(&mut *stream).poll_read(context, &mut read)).expect("a connection");
            let count = read.filled().len();
            assert!(count > 0, "the server closed the connection of a subscriber that reads");
            kept.copy_from_slice(rest);
            let filled = rest.len() + count;
            let used = take(&buffer[..filled]);
            rest.clear();
            rest.extend_from_slice(&buffer[used..filled]);
            Poll::Ready(())
        })
    })
    .await;
}

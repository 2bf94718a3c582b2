//! Bytes as they arrive, read into one piece of memory a thread.
//!
//! A thousand buffers would be more than a processor's cache holds, and a machine would measure them; a client of its
//! own has its one.

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

/// More than the longest message, and than a socket holds as a rule.
const BUFFER_BYTES: usize = 512 * 1024;

thread_local! {
    static BUFFER: RefCell<Vec<u8>> = RefCell::new(vec![0; BUFFER_BYTES]);
}

/// Reads once, and gives `take` what there is: what it left the last time, and what has come. It says how many bytes it
/// has used; the others stay in `rest`.
pub async fn arrive(
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
            assert!(count > 0, "the server hung up on a subscriber that reads");
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

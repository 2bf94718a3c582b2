use std::{future::poll_fn, io::IoSlice, pin::pin, task::Waker};

use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

use super::{super::wire::Wire, *};

impl super::Socket for DuplexStream {
    fn try_write(&self, _: &[u8]) -> io::Result<usize> {
        Err(io::ErrorKind::WouldBlock.into())
    }

    fn try_send(&self, _: &Sheet, _: usize) -> io::Result<usize> {
        unreachable!("nothing goes past the library")
    }

    fn poll_writable(&self, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

fn socket(room: usize) -> Gather<Wire> {
    Gather::new(Wire::new(room), false)
}

/// Writes as hyper's HTTP/2 does, in one poll: each frame is written and flushed. How many were taken.
fn write_frames(gather: &Gather<Wire>, frames: &[&[u8]]) -> usize {
    let mut context = Context::from_waker(Waker::noop());
    let (mut handle, mut count) = (gather.clone(), 0);
    let connection = pin!(poll_fn(|context| {
        let taken = frames.iter().take_while(|frame| {
            let parts = [IoSlice::new(&frame[..1]), IoSlice::new(&frame[1..])];
            let written = Pin::new(&mut handle).poll_write_vectored(context, &parts);
            written.is_ready() && Pin::new(&mut handle).poll_flush(context).is_ready()
        });
        count = taken.count();
        Poll::<()>::Pending
    }));
    assert!(gather.poll_through(connection, &mut context).is_pending());
    count
}

#[test]
fn what_one_poll_writes_is_one_write() {
    let gather = socket(usize::MAX);
    assert_eq!(write_frames(&gather, &[&[1; 10], &[2; 16_384], &[3; 400]]), 3);
    assert_eq!(write_frames(&gather, &[&[4; 7]]), 1);
    assert_eq!(gather.inner().stream.ends().writes, [16_794, 7]);
}

#[test]
fn more_than_is_held_goes_out_at_once() {
    let gather = socket(usize::MAX);
    let frame = [1; 16_384];
    assert_eq!(write_frames(&gather, &[frame.as_slice(); 9]), 9);
    let inner = gather.inner();
    let writes = &inner.stream.ends().writes;
    assert_eq!(writes.iter().sum::<usize>(), 9 * frame.len());
    assert!(writes.len() <= 4, "{writes:?}");
    assert!(inner.held.is_empty());
}

#[test]
fn for_a_full_socket_nothing_is_taken() {
    let gather = socket(5);
    assert_eq!(write_frames(&gather, &[&[1; 10]]), 1);
    // Five of its bytes wait; a newer message is to come instead of what would wait behind them.
    assert_eq!(write_frames(&gather, &[&[2; 10]]), 0);
    gather.inner().stream.ends().room = 100;
    assert_eq!(write_frames(&gather, &[&[3; 10], &[4; 10]]), 2);
    assert_eq!(gather.inner().stream.ends().writes, [5, 5, 10, 10]);
    assert_eq!(write_frames(&gather, &[&[5; 10], &[6; 10]]), 2);
    assert_eq!(gather.inner().stream.ends().writes.last(), Some(&20));
}

#[tokio::test]
async fn all_bytes_come_in_order_through_a_narrow_socket_also_after_the_connection() {
    let (stream, mut client) = duplex(1000);
    let gather = Gather::new(stream, false);
    let bytes: Vec<u8> = (0..300_000_u32).map(|place| (place % 251) as u8).collect();
    let (first, rest) = bytes.split_at(200_000);
    let writing = async {
        let mut handle = gather.clone();
        let mut connection = pin!(async {
            for chunk in first.chunks(777) {
                handle.write_all(chunk).await.unwrap();
            }
        });
        poll_fn(|context| gather.poll_through(connection.as_mut(), context)).await;
        // As a WebSocket that has taken it over.
        let mut upgraded = gather.clone();
        for chunk in rest.chunks(999) {
            upgraded.write_all(chunk).await.unwrap();
            upgraded.flush().await.unwrap();
        }
        upgraded.shutdown().await.unwrap();
    };
    let mut come = Vec::new();
    let (_, read) = tokio::join!(writing, client.read_to_end(&mut come));
    read.unwrap();
    assert!(come == bytes);
}

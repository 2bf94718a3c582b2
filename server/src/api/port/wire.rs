//! A socket of tests.

use std::{
    collections::VecDeque,
    io::{self, IoSlice},
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard},
    task::{Context, Poll},
};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::{
    frames::{DATA, HEAD_BYTES, Head},
    sheet::Sheet,
    socket::Socket,
};

/// A socket, with its client's end.
#[derive(Clone, Default)]
pub(super) struct Wire(Arc<Mutex<Ends>>);

#[derive(Default)]
pub(super) struct Ends {
    said: VecDeque<u8>,
    come: Vec<u8>,
    /// How many bytes each write brought.
    pub writes: Vec<usize>,
    /// Bytes that it takes.
    pub room: usize,
    pub is_broken: bool,
}

impl Wire {
    /// One that takes so many bytes at first.
    pub(super) fn new(room: usize) -> Self {
        let wire = Self::default();
        wire.ends().room = room;
        wire
    }

    pub(super) fn ends(&self) -> MutexGuard<'_, Ends> {
        self.0.lock().unwrap()
    }

    pub(super) fn say(&self, bytes: &[u8]) {
        self.ends().said.extend(bytes);
    }

    fn write(&self, parts: &[IoSlice<'_>]) -> io::Result<usize> {
        let mut ends = self.ends();
        let bytes: Vec<u8> = parts.iter().flat_map(|part| part.iter().copied()).collect();
        if ends.is_broken {
            return Err(io::ErrorKind::ConnectionReset.into());
        }
        let taken = bytes.len().min(ends.room);
        if taken == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        ends.room -= taken;
        ends.writes.push(taken);
        ends.come.extend(&bytes[..taken]);
        Ok(taken)
    }

    pub(super) fn come(&self) -> Vec<(Head, Vec<u8>)> {
        let come = self.ends().come.clone();
        let (mut rest, mut frames) = (come.as_slice(), Vec::new());
        while let Some((head, behind)) = rest.split_first_chunk::<HEAD_BYTES>() {
            let head = Head::of(*head);
            let Some((payload, behind)) = behind.split_at_checked(head.length) else { break };
            frames.push((head, payload.to_vec()));
            rest = behind;
        }
        frames
    }

    /// What has come of a stream.
    pub(super) fn data(&self, number: u32) -> Vec<u8> {
        let come = self.come().into_iter();
        come.filter(|(head, _)| (head.kind, head.stream) == (DATA, number))
            .flat_map(|(_, payload)| payload)
            .collect()
    }
}

impl Socket for Wire {
    fn try_write(&self, bytes: &[u8]) -> io::Result<usize> {
        self.write(&[IoSlice::new(bytes)])
    }

    fn try_send(&self, sheet: &Sheet, from: usize) -> io::Result<usize> {
        self.try_write(&sheet.bytes()[from..])
    }

    fn poll_writable(&self, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        if self.ends().room > 0 { Poll::Ready(Ok(())) } else { Poll::Pending }
    }
}

impl AsyncRead for Wire {
    fn poll_read(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let mut ends = self.ends();
        if ends.said.is_empty() {
            return Poll::Pending;
        }
        let count = buffer.remaining().min(ends.said.len());
        buffer.put_slice(&ends.said.drain(..count).collect::<Vec<u8>>());
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Wire {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.poll_write_vectored(context, &[IoSlice::new(bytes)])
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match self.write(parts) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Poll::Pending,
            written => Poll::Ready(written),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

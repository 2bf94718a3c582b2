use std::{
    collections::{BTreeMap, VecDeque},
    pin::{Pin, pin},
    task::{Context, Waker},
    time::Duration,
};

use proptest::prelude::*;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::{
    super::{
        frames::{
            DATA, END_STREAM, HEAD_BYTES, HEADERS, Head, MAX_PAYLOAD, PREFACE, RST_STREAM,
            SETTINGS, increment, window_update,
        },
        http2::MOST_EARLY,
        wire::Wire,
    },
    *,
};

/// The stream, as the library knows it.
const NUMBER: u32 = 3;

/// A connection, with what stands for the library that speaks on it.
struct Rig {
    wire: Wire,
    gather: Gather<Wire>,
    /// What the library has still to write, and what it has read.
    queue: VecDeque<u8>,
    read: Vec<u8>,
}

impl Rig {
    /// The client grants so much beyond what HTTP/2 begins with.
    fn new(granted: u32) -> Self {
        let wire = Wire::new(usize::MAX);
        wire.say(PREFACE);
        wire.say(&window_update(0, granted));
        let gather = Gather::new(wire.clone(), true);
        let mut rig = Self { wire, gather, queue: VecDeque::new(), read: Vec::new() };
        rig.turn();
        rig
    }

    /// The library has a frame to write.
    fn write(&mut self, kind: u8, flags: u8, stream: u32, payload: &[u8]) {
        let head = Head { length: payload.len(), kind, flags, stream };
        self.queue.extend(head.bytes());
        self.queue.extend(payload);
    }

    /// The connection is polled: the library reads and writes what it can.
    fn turn(&mut self) {
        let mut context = Context::from_waker(Waker::noop());
        let mut handle = self.gather.clone();
        let (queue, read) = (&mut self.queue, &mut self.read);
        let connection = pin!(poll_fn(|context| {
            let mut space = [0; 1000];
            let mut buffer = ReadBuf::new(&mut space);
            while Pin::new(&mut handle).poll_read(context, &mut buffer).is_ready() {
                read.extend_from_slice(buffer.filled());
                buffer.clear();
            }
            while !queue.is_empty() {
                let bytes: Vec<u8> = queue.iter().copied().take(10_000).collect();
                let written = Pin::new(&mut handle).poll_write(context, &bytes);
                let Poll::Ready(Ok(count)) = written else { break };
                queue.drain(..count);
            }
            Poll::<()>::Pending
        }));
        let _ = self.gather.poll_through(connection, &mut context);
    }

    /// A stream whose first message has gone through the library.
    fn stream(&mut self) -> Direct<Wire> {
        let direct = Direct::new(&self.gather, b"first");
        self.write(HEADERS, 4, NUMBER, b"head");
        self.write(DATA, 0, NUMBER, b"first message");
        self.turn();
        direct
    }

    fn taken_over(&mut self) -> Direct<Wire> {
        let direct = self.stream();
        assert_eq!(direct.take_over(13), Some(NUMBER));
        direct
    }
}

fn send(direct: &Direct<Wire>, byte: u8, length: usize) -> Result<bool, Gone> {
    direct.send(Bytes::from_static(b"own"), vec![byte; length].into(), None)
}

fn is_ready(direct: &Direct<Wire>) -> Poll<Result<(), Gone>> {
    let mut context = Context::from_waker(Waker::noop());
    pin!(direct.ready()).poll(&mut context)
}

#[test]
fn a_stream_is_taken_over_once_the_library_has_written_all_of_it() {
    let mut rig = Rig::new(1 << 20);
    let direct = rig.stream();
    assert_eq!(direct.take_over(14), None, "a byte is to come");
    rig.write(DATA, 0, NUMBER, b"!");
    rig.turn();
    assert_eq!(direct.take_over(14), Some(NUMBER));
    assert_eq!(send(&direct, 7, 40_000), Ok(true));
    let expected = [b"first message!own".as_slice(), &[7; 40_000]].concat();
    assert!(rig.wire.data(NUMBER) == expected);
    assert!(rig.wire.come().iter().all(|(head, _)| head.length <= MAX_PAYLOAD));
    let other = Direct::new(&rig.gather, b"first");
    assert_eq!(other.take_over(0), None, "it has not begun");
}

#[test]
fn a_client_that_grants_little_is_left_to_the_library() {
    let mut rig = Rig::new(100_000);
    assert_eq!(rig.stream().take_over(13), None);
}

#[test]
fn a_message_waits_for_room_on_its_stream_of_which_the_library_does_not_hear() {
    let mut rig = Rig::new(1 << 20);
    let direct = rig.taken_over();
    assert_eq!(send(&direct, 1, 60_000), Ok(true));
    assert_eq!(send(&direct, 2, 60_000), Ok(false));
    assert!(is_ready(&direct).is_pending());
    assert_eq!(rig.wire.data(NUMBER).len(), 65_535);
    std::thread::sleep(Duration::from_millis(2));
    assert!(rig.gather.stuck_for() >= Duration::from_millis(2));
    let read = rig.read.len();
    rig.wire.say(&window_update(NUMBER, 1 << 20));
    rig.turn();
    assert_eq!(is_ready(&direct), Poll::Ready(Ok(())));
    assert_eq!(rig.wire.data(NUMBER).len(), 13 + 2 * 60_003);
    assert_eq!((rig.gather.stuck_for(), rig.read.len()), (Duration::ZERO, read));
    // What it sets for streams counts for those that are there.
    rig.wire.say(&[0, 0, 6, SETTINGS, 0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0]);
    rig.turn();
    assert_eq!(rig.read.len(), read + 15);
    assert_eq!(is_ready(&direct), Poll::Ready(Ok(())), "it has granted more than that");
}

#[test]
fn what_a_client_grants_before_the_first_message_counts() {
    let mut rig = Rig::new(1 << 20);
    rig.wire.say(&window_update(NUMBER, 500_000));
    rig.turn();
    let direct = rig.taken_over();
    assert_eq!(send(&direct, 1, 500_000), Ok(true));
    assert_eq!(rig.wire.data(NUMBER).len(), 13 + 500_003);
    // Of more streams than may be open it is kept for the newest.
    for (first, taken) in [(NUMBER, None), (1, Some(NUMBER))] {
        let mut rig = Rig::new(1 << 20);
        for number in 0..MOST_EARLY as u32 {
            rig.wire.say(&window_update(100 + number, 1));
        }
        rig.wire.say(&window_update(first, 1));
        rig.turn();
        assert_eq!(rig.stream().take_over(13), taken);
    }
}

#[test]
fn a_broken_socket_is_found_by_the_library() {
    let mut rig = Rig::new(1 << 20);
    let direct = rig.taken_over();
    rig.wire.ends().is_broken = true;
    assert_eq!(send(&direct, 1, 100), Err(Gone));
    let mut context = Context::from_waker(Waker::noop());
    let mut space = [0; 10];
    let mut buffer = ReadBuf::new(&mut space);
    let read = Pin::new(&mut rig.gather.clone()).poll_read(&mut context, &mut buffer);
    let Poll::Ready(Err(error)) = read else { panic!("{read:?}") };
    assert_eq!(error.kind(), io::ErrorKind::ConnectionReset);
}

#[test]
fn nothing_is_written_to_a_stream_that_the_library_has_ended() {
    for end in [(HEADERS, 4 | END_STREAM), (RST_STREAM, 0), (DATA, END_STREAM)] {
        let mut rig = Rig::new(1 << 20);
        let direct = rig.taken_over();
        rig.write(end.0, end.1, NUMBER, b"ends");
        rig.turn();
        let come = rig.wire.come().len();
        assert_eq!(send(&direct, 1, 100), Err(Gone));
        assert_eq!(is_ready(&direct), Poll::Ready(Err(Gone)));
        assert_eq!(rig.wire.come().len(), come);
    }
    let mut rig = Rig::new(1 << 20);
    let direct = rig.taken_over();
    rig.wire.say(&[0, 0, 4, RST_STREAM, 0, 0, 0, 0, NUMBER as u8, 0, 0, 0, 8]);
    rig.turn();
    assert_eq!(send(&direct, 1, 100), Err(Gone), "its client has given it up");
    let mut rig = Rig::new(1 << 20);
    let direct = rig.taken_over();
    rig.gather.end();
    assert_eq!(send(&direct, 1, 100), Err(Gone));
}

#[test]
fn a_stream_is_stopped_behind_the_message_that_is_under_way() {
    let mut rig = Rig::new(1 << 20);
    let direct = rig.taken_over();
    assert_eq!(send(&direct, 1, 70_000), Ok(false));
    let mut context = Context::from_waker(Waker::noop());
    assert!(pin!(direct.stop()).poll(&mut context).is_pending());
    assert!(is_ready(&direct).is_pending(), "the message is under way");
    rig.wire.say(&window_update(NUMBER, 1 << 20));
    rig.turn();
    assert!(pin!(direct.stop()).poll(&mut context).is_ready());
    assert_eq!(is_ready(&direct), Poll::Ready(Err(Gone)));
    assert_eq!(rig.wire.data(NUMBER).len(), 13 + 70_003);
    assert_eq!(send(&direct, 1, 100), Err(Gone));
}

#[test]
fn what_a_socket_does_not_take_of_a_sheet_goes_before_all_else() {
    let mut rig = Rig::new(1 << 20);
    let direct = rig.taken_over();
    rig.wire.ends().room = 500;
    let sheet = Sheet::frames(NUMBER, b"own", &[5; 20_000]);
    let (own, shared) = (Bytes::from_static(b"own"), Bytes::from(vec![5; 20_000]));
    assert_eq!(direct.send(own, shared, Some(&sheet)), Ok(false));
    assert!(is_ready(&direct).is_pending());
    rig.write(6, 0, 0, b"a ping..");
    rig.wire.ends().room = usize::MAX;
    rig.turn();
    assert_eq!(is_ready(&direct), Poll::Ready(Ok(())));
    let expected = [b"first messageown".as_slice(), &[5; 20_000]].concat();
    assert!(rig.wire.data(NUMBER) == expected);
    assert_eq!(rig.wire.come().last().unwrap().0.kind, 6);
    // One that is laid out for another stream is not for this.
    let other = Sheet::frames(NUMBER + 2, b"own", b"other");
    let (own, shared) = (Bytes::from_static(b"own"), Bytes::from_static(b"shared"));
    assert_eq!(direct.send(own, shared, Some(&other)), Ok(true));
    assert!(rig.wire.data(NUMBER).ends_with(b"ownshared"));
}

#[test]
fn nothing_goes_into_a_frame_of_the_library() {
    let mut rig = Rig::new(1 << 20);
    let direct = rig.taken_over();
    rig.write(6, 0, 0, b"a ping..");
    let end = rig.queue.split_off(12);
    rig.turn();
    assert!(is_ready(&direct).is_pending());
    assert_eq!(send(&direct, 1, 100), Ok(false));
    rig.queue = end;
    rig.turn();
    let kinds: Vec<u8> = rig.wire.come().iter().map(|(head, _)| head.kind).collect();
    assert!(kinds.ends_with(&[6, DATA]), "{kinds:?}");
    assert!(rig.wire.data(NUMBER).ends_with(&[1; 100]));
}

#[test]
fn the_library_is_lent_room_and_told_of_it() {
    let mut rig = Rig::new(1 << 20);
    let read = rig.read.len();
    for _ in 0..3 {
        rig.write(DATA, 0, 1, &[0; 16_000]);
    }
    rig.turn();
    rig.turn();
    assert_eq!(rig.read.len(), read + HEAD_BYTES + 4);
    assert!(increment(&rig.read[read + HEAD_BYTES..]) > 65_535);
}

/// What happens on a connection.
#[derive(Clone, Debug)]
enum Step {
    /// A message, where there is room for one.
    Message(usize),
    /// The library writes to a stream of its own.
    Library(usize),
    /// The client makes room.
    Room(usize),
    /// The socket takes some.
    Socket(usize),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = (0..4, 1..50_000_usize).prop_map(|(kind, amount)| match kind {
        0 => Step::Message(amount),
        1 => Step::Library(amount % 9000),
        2 => Step::Room(amount),
        _ => Step::Socket(amount),
    });
    prop::collection::vec(step, 1..80)
}

proptest! {
    #[test]
    fn frames_and_messages_stay_whole_and_no_window_is_overdrawn(steps in steps(), is_sheet: bool) {
        let mut rig = Rig::new(300_000);
        let direct = rig.taken_over();
        rig.wire.ends().room = 0;
        let (mut sent, mut libraries) = (b"first message".to_vec(), 0_usize);
        let mut rooms = BTreeMap::from([(0, 365_535_i64), (NUMBER, 65_535), (1, i64::MAX)]);
        for (place, step) in steps.into_iter().enumerate() {
            match step {
                Step::Message(length) if is_ready(&direct).is_ready() => {
                    let shared = Bytes::from(vec![place as u8; length]);
                    let sheet = Sheet::frames(NUMBER, b"own", &shared);
                    sent.extend_from_slice(b"own");
                    sent.extend_from_slice(&shared);
                    let sheet = is_sheet.then_some(&sheet);
                    prop_assert!(direct.send(Bytes::from_static(b"own"), shared, sheet).is_ok());
                }
                Step::Message(_) => {}
                Step::Library(length) if libraries + length < 60_000 => {
                    libraries += length;
                    rig.write(DATA, 0, 1, &vec![0; length]);
                }
                Step::Library(_) => {}
                Step::Room(by) => {
                    for number in [0, NUMBER] {
                        rig.wire.say(&window_update(number, by as u32));
                        *rooms.get_mut(&number).unwrap() += by as i64;
                    }
                }
                Step::Socket(by) => rig.wire.ends().room += by,
            }
            rig.turn();
            let come = rig.wire.come();
            let data: usize = come.iter().filter(|it| it.0.kind == DATA).map(|it| it.0.length).sum();
            prop_assert!(data as i64 <= rooms[&0]);
            prop_assert!(rig.wire.data(NUMBER).len() as i64 <= rooms[&NUMBER]);
            prop_assert!(sent.starts_with(&rig.wire.data(NUMBER)));
        }
        rig.wire.ends().room = usize::MAX;
        for number in [0, NUMBER] {
            rig.wire.say(&window_update(number, 10_000_000));
        }
        rig.turn();
        prop_assert!(rig.wire.data(NUMBER) == sent);
        prop_assert_eq!(rig.wire.data(1).len(), libraries);
    }
}

//! Streams that are cut and damaged at random.

use jpeg_encoder::{ColorType, Encoder};
use proptest::{collection::vec, prelude::*, sample::Index};
use roundel_core::time::Timestamp;

use super::{JpegSplitter, StampedJpeg};

fn jpeg(level: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let pixels: Vec<u8> = (0..32 * 24u32).map(|i| (i * 7 % 97) as u8 ^ level).collect();
    Encoder::new(&mut bytes, 90).encode(&pixels, 32, 24, ColorType::Luma).unwrap();
    bytes
}

/// What is found in a stream that arrives in pieces of these lengths, over and over.
fn found(stream: &[u8], lengths: &[usize]) -> (Vec<StampedJpeg>, u64) {
    let (mut parts, mut found, mut at) = (JpegSplitter::default(), Vec::new(), 0);
    for length in lengths.iter().cycle() {
        let end = (at + length).min(stream.len());
        parts.push(&stream[at..end], Timestamp::from_ns(at as i64));
        while let Some(part) = parts.pop() {
            // Which piece a picture begins in depends on the cuts.
            found.push(StampedJpeg { arrival: Timestamp::default(), ..part });
        }
        at = end;
        if at == stream.len() {
            break;
        }
    }
    (found, parts.take_broken())
}

/// What happens to bytes on their way.
#[derive(Clone, Debug)]
enum Damage {
    Set(Index, u8),
    Lose(Index, usize),
    Insert(Index, Vec<u8>),
}

fn damage() -> impl Strategy<Value = Damage> {
    prop_oneof![
        (any::<Index>(), any::<u8>()).prop_map(|(at, byte)| Damage::Set(at, byte)),
        (any::<Index>(), 1..400_usize).prop_map(|(at, count)| Damage::Lose(at, count)),
        (any::<Index>(), vec(any::<u8>(), 1..400)).prop_map(|(at, it)| Damage::Insert(at, it)),
    ]
}

fn damaged(mut bytes: Vec<u8>, by: &[Damage]) -> Vec<u8> {
    for damage in by {
        if bytes.is_empty() {
            return bytes;
        }
        match damage {
            Damage::Set(at, byte) => *at.get_mut(&mut bytes) = *byte,
            Damage::Lose(at, count) => {
                let at = at.index(bytes.len());
                let end = (at + count).min(bytes.len());
                bytes.drain(at..end);
            }
            Damage::Insert(at, inserted) => {
                let at = at.index(bytes.len());
                bytes.splice(at..at, inserted.iter().copied());
            }
        }
    }
    bytes
}

fn stream(pictures: &[Vec<u8>], between: &str) -> Vec<u8> {
    pictures.iter().flat_map(|it| [between.as_bytes(), it].concat()).collect()
}

proptest! {
    #[test]
    fn what_is_found_does_not_depend_on_how_the_stream_is_cut(
        levels in vec(any::<u8>(), 1..5),
        between in "(\r\n--[a-z]{0,8}\r\n(Content-Length: [0-9]{1,5}\r\n)?\r\n)?",
        faults in vec(damage(), 0..4),
        lengths in vec(1..700_usize, 1..20),
    ) {
        let pictures: Vec<Vec<u8>> = levels.iter().map(|level| jpeg(*level)).collect();
        let whole = stream(&pictures, &between);
        let as_sent: Vec<Vec<u8>> = found(&whole, &lengths).0.into_iter().map(|it| it.jpeg).collect();
        prop_assert_eq!(as_sent, pictures);
        let bytes = damaged(whole, &faults);
        prop_assert_eq!(found(&bytes, &lengths), found(&bytes, &[bytes.len().max(1)]));
    }

    /// A damaged picture may say that a segment of it is 64 kB long, and take what follows with it; but no more.
    #[test]
    fn damage_ends(faults in vec(damage(), 1..6), lengths in vec(1..2000_usize, 1..10)) {
        let good = jpeg(3);
        let many = vec![good.clone(); 2 * 65_536 / good.len() + 3];
        let bytes = [damaged(jpeg(1), &faults), stream(&many, "\r\n--frame\r\n\r\n")].concat();
        let (parts, broken) = found(&bytes, &lengths);
        prop_assert_eq!(&parts.last().unwrap().jpeg, &good);
        prop_assert!(parts.len() >= many.len() / 3, "{} of {}", parts.len(), many.len());
        prop_assert!(broken <= 1 + many.len() as u64);
    }
}

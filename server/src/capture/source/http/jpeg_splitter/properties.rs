//! Streams with random damage, in chunks of random lengths.

use proptest::{collection::vec, prelude::*, sample::Index};

use super::tests::{jpeg, split};

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
    fn pictures_do_not_depend_on_the_chunks(
        levels in vec(any::<u8>(), 1..5),
        between in "(\r\n--[a-z]{0,8}\r\n(Content-Length: [0-9]{1,5}\r\n)?\r\n)?",
        faults in vec(damage(), 0..4),
        lengths in vec(1..700_usize, 1..20),
    ) {
        let pictures: Vec<Vec<u8>> = levels.iter().map(|level| jpeg(*level)).collect();
        let whole = stream(&pictures, &between);
        let as_sent: Vec<Vec<u8>> = split(&whole, &lengths).0.into_iter().map(|it| it.jpeg).collect();
        prop_assert_eq!(as_sent, pictures);
        let bytes = damaged(whole, &faults);
        prop_assert_eq!(split(&bytes, &lengths), split(&bytes, &[bytes.len().max(1)]));
    }

    /// A damaged picture may claim a segment of 64 kB and consume as many bytes behind it, but no more.
    #[test]
    fn damage_is_limited(faults in vec(damage(), 1..6), lengths in vec(1..2000_usize, 1..10)) {
        let good = jpeg(3);
        let many = vec![good.clone(); 2 * 65_536 / good.len() + 3];
        let bytes = [damaged(jpeg(1), &faults), stream(&many, "\r\n--frame\r\n\r\n")].concat();
        let (parts, broken) = split(&bytes, &lengths);
        prop_assert_eq!(&parts.last().unwrap().jpeg, &good);
        prop_assert!(parts.len() >= many.len() / 3, "{} of {}", parts.len(), many.len());
        prop_assert!(broken <= 1 + many.len() as u64);
    }
}

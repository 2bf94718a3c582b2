//! Snapshots as whole messages, for those of whom many want the same.
//!
//! A [`Sheet`] says the same to all whom it is sent to: that nothing was missed, and one time of sending, which is that of
//! the first; therefore it is replaced by a new one after a millisecond. Where fewer want the same, or have missed
//! something, each gets what is its own.
//!
//! PERF: `cargo bench -p roundel-server --bench subscribers -- --case lean`, 1,000 subscribers, in turns with messages
//! that went through HTTP/2's library one by one: p99 8.9, 9.0, 11.1 ms instead of 12.5, 12.9, 13.4, the server at 0.56
//! to 0.61 cores instead of 0.84 to 0.90.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use super::{encoded::Form, port::Sheet, selection::Filter};

/// A sheet says when it was sent to within this.
const MOST_AGE: Duration = Duration::from_millis(1);
/// So many have to want the same.
const MANY: usize = 24;
/// For so many snapshots it is known how many wanted something: with a limit of the rate not each one is wanted.
const REMEMBERED: u64 = 16;
/// A longer message goes to each by itself, in pieces as there is room.
const MOST_BYTES: usize = 256 * 1024;

/// How a message is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Way {
    /// By a stream of this number.
    Grpc(u32),
    /// In this form.
    WebSocket(Form),
}

/// The sheets of the newest snapshot.
#[derive(Debug, Default)]
pub struct Sheets(Mutex<All>);

#[derive(Debug, Default)]
struct All {
    /// The newest snapshot's.
    sequence: u64,
    of: HashMap<(Filter, Way), Wanted>,
}

/// What some choose of snapshots, and want sent one way.
#[derive(Debug, Default)]
struct Wanted {
    sequence: u64,
    /// By how many, of this snapshot and of the one before of which it was.
    now: usize,
    before: usize,
    sheet: Option<Arc<Sheet>>,
}

impl Wanted {
    /// Whether, at the snapshot of this number, it is still known by how many it was.
    fn is_known(&self, sequence: u64) -> bool {
        sequence - self.sequence <= REMEMBERED
    }

    fn begin(&mut self, sequence: u64) {
        self.before = if self.is_known(sequence) { self.now } else { 0 };
        (self.sequence, self.now, self.sheet) = (sequence, 0, None);
    }
}

impl Sheets {
    /// A message of so many bytes about the snapshot of this number, if as many wanted the same of one before that it
    /// is worth while.
    pub(super) fn sheet(
        &self,
        (sequence, bytes): (u64, usize),
        (filter, way): (&Filter, Way),
        make: impl FnOnce() -> Sheet,
    ) -> Option<Arc<Sheet>> {
        let key = (filter.clone(), way);
        let mut all = self.lock();
        if all.sequence < sequence {
            all.sequence = sequence;
            all.of.retain(|_, wanted| wanted.is_known(sequence));
        }
        if all.sequence > sequence {
            return None;
        }
        let wanted = all.of.entry(key).or_default();
        if wanted.sequence < sequence {
            wanted.begin(sequence);
        }
        wanted.now += 1;
        if wanted.before < MANY || bytes > MOST_BYTES {
            return None;
        }
        // Made by the first one, while the others wait: by themselves they would take longer.
        let sheet = wanted.sheet.take().filter(|sheet| sheet.age() < MOST_AGE);
        let sheet = sheet.unwrap_or_else(|| Arc::new(make()));
        wanted.sheet = Some(sheet.clone());
        Some(sheet)
    }

    fn lock(&self) -> MutexGuard<'_, All> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_get_one_sheet_and_few_none() {
        let sheets = Sheets::default();
        let filter = Filter::default();
        let make = || Sheet::frames(1, b"own", b"shared");
        let want =
            |sequence, stream| sheets.sheet((sequence, 9), (&filter, Way::Grpc(stream)), make);
        for sequence in [1, 2] {
            for _ in 0..MANY {
                assert_eq!(want(sequence, 1).is_some(), sequence == 2, "not known before");
                if sequence == 1 {
                    assert!(want(sequence, 3).is_none());
                }
            }
        }
        // By a stream of another number nobody has wanted it.
        assert!(want(3, 1).is_some() && want(3, 7).is_none());
        // One that is behind gets none.
        assert!(want(2, 1).is_none());
        let [a, b] = [want(3, 1), want(3, 1)].map(Option::unwrap);
        assert!(Arc::ptr_eq(&a, &b));
        let long = sheets.sheet((3, MOST_BYTES + 1), (&filter, Way::Grpc(1)), make);
        assert!(long.is_none());
        // Of whom a limit of the rate has them want every other one, that is known as well.
        let every_other = |sequence| (0..MANY).fold(None, |_, _| want(sequence, 5));
        assert!(every_other(4).is_none() && every_other(6).is_some());
        // Once nobody has wanted one for long, it is not known any more how many will.
        assert!(want(6 + REMEMBERED + 1, 1).is_none());
        assert_eq!(sheets.lock().of.len(), 1);
    }
}

//! Room on an HTTP/2 connection (RFC 9113, section 5.2), shared between the library that speaks it and what is sent past
//! the library.
//!
//! The client says how much may be sent on the connection in all. The library keeps its own count of it, which it would
//! overdraw if others used it too; so it hears of a share only. It has what HTTP/2 begins with, 65,535 bytes; what the
//! client grants beyond goes to what is sent past it, and a quarter of it is lent to the library when that runs dry. No
//! more: a client may give nothing back until half of what it grants is used up, and what the library does not use would
//! be missing then.

/// What HTTP/2 begins with, for the connection and for each stream.
const FIRST_BYTES: i64 = 65_535;
/// The library is lent some when it has less, and who has less comes first.
const LITTLE_BYTES: i64 = FIRST_BYTES / 2;
/// Largest step that there may be.
const MOST_BYTES: i64 = 0x7fff_ffff;

/// Room on one connection.
#[derive(Debug)]
pub(super) struct Windows {
    /// On a new stream.
    initial: i64,
    /// As the library counts.
    library: i64,
    /// For what is sent past it.
    direct: i64,
    /// Sent past it, and not yet given back by the client.
    owed: i64,
}

impl Default for Windows {
    fn default() -> Self {
        Self { initial: FIRST_BYTES, library: FIRST_BYTES, direct: 0, owed: 0 }
    }
}

impl Windows {
    /// On a new stream.
    pub(super) fn initial(&self) -> i64 {
        self.initial
    }

    /// Notes what the client has set for streams.
    pub(super) fn set_initial(&mut self, bytes: u32) {
        self.initial = i64::from(bytes);
    }

    /// What may be sent past the library.
    pub(super) fn direct(&self) -> i64 {
        self.direct
    }

    /// Whether the client grants at least so much for that.
    pub(super) fn is_wide(&self, bytes: i64) -> bool {
        self.direct + self.owed >= bytes
    }

    /// Notes what was.
    pub(super) fn direct_sent(&mut self, bytes: usize) {
        self.direct -= bytes as i64;
        self.owed += bytes as i64;
    }

    /// Notes what the library has sent; what it is lent, of which something is left if the room `is_used` past it.
    pub(super) fn library_sent(&mut self, bytes: usize, is_used: bool) -> u32 {
        self.library -= bytes as i64;
        let most = self.direct - if is_used { FIRST_BYTES } else { 0 };
        if self.library >= LITTLE_BYTES || most <= 0 {
            return 0;
        }
        let lent = (self.direct / 4).max(FIRST_BYTES).min(most);
        self.direct -= lent;
        self.library += lent;
        lent as u32
    }

    /// Notes that the client makes so much more room on the connection; of how much of it the library is to hear.
    pub(super) fn grant(&mut self, increment: u32) -> u32 {
        let increment = i64::from(increment);
        if self.library + self.direct + increment > MOST_BYTES {
            // That is an error, and the library is to find it.
            return MOST_BYTES as u32;
        }
        let short = (FIRST_BYTES - self.library).max(0);
        let first = match (self.library < LITTLE_BYTES, self.direct < LITTLE_BYTES) {
            (false, _) => 0,
            (true, false) => increment.min(short),
            (true, true) => (increment - increment / 2).min(short),
        };
        let returned = (increment - first).min(self.owed);
        let heard = first + (increment - first - returned).min(short - first);
        self.owed -= returned;
        self.direct += increment - heard;
        self.library += heard;
        heard as u32
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::*;

    #[test]
    fn a_client_that_grants_nothing_more_leaves_all_to_the_library() {
        let mut windows = Windows::default();
        assert_eq!(windows.library_sent(60_000, false), 0);
        assert_eq!(windows.grant(60_000), 60_000);
        assert_eq!(windows.direct(), 0);
    }

    #[test]
    fn what_is_given_back_goes_to_who_had_it() {
        let mut windows = Windows::default();
        assert_eq!(windows.grant(1_000_000), 0);
        windows.direct_sent(400_000);
        assert_eq!(windows.library_sent(20_000, true), 0);
        assert_eq!(windows.grant(420_000), 20_000);
        assert_eq!(windows.direct(), 1_000_000);
    }

    #[test]
    fn the_library_is_lent_what_a_long_answer_needs_and_gives_it_back() {
        let mut windows = Windows::default();
        windows.grant(1_000_000);
        let (mut sent, mut heard) = (0, FIRST_BYTES);
        while heard > 0 && sent < 1_065_535 {
            let piece = heard.min(16_384);
            sent += piece;
            heard += i64::from(windows.library_sent(piece as usize, false)) - piece;
        }
        assert_eq!((sent, windows.direct()), (1_065_535, 0), "all that the client grants");
        assert_eq!(windows.grant(sent as u32), FIRST_BYTES as u32);
        assert_eq!(windows.direct(), 1_000_000);
    }

    #[test]
    fn neither_is_left_without_room_while_the_other_has_much_to_send() {
        let mut windows = Windows::default();
        windows.grant(500_000);
        windows.direct_sent(500_000);
        assert_eq!(windows.library_sent(65_535, true), 0, "there is nothing to lend");
        assert!(windows.grant(10_000) == 5_000 && windows.direct() == 5_000);
        let mut windows = Windows::default();
        windows.grant(500_000);
        while windows.library_sent(1000, true) > 0 || windows.library > 0 {}
        assert_eq!(windows.direct(), FIRST_BYTES);
    }

    #[test]
    fn more_room_than_there_may_be_is_an_error_to_the_library_too() {
        let mut windows = Windows::default();
        windows.grant(0x7fff_0000);
        assert!(FIRST_BYTES + i64::from(windows.grant(0x7fff_0000)) > MOST_BYTES);
    }

    proptest! {
        #[test]
        fn both_together_never_have_more_than_the_client_grants(
            steps in vec((0..3_u8, 0..200_000_u32), 1..60)
        ) {
            let (mut windows, mut room, mut library) = (Windows::default(), FIRST_BYTES, FIRST_BYTES);
            for (kind, amount) in steps {
                match kind {
                    0 => {
                        library += i64::from(windows.grant(amount));
                        room += i64::from(amount);
                    }
                    1 => {
                        let sent = i64::from(amount).min(library);
                        library += i64::from(windows.library_sent(sent as usize, amount % 2 == 0)) - sent;
                        room -= sent;
                    }
                    _ => {
                        let sent = i64::from(amount).min(windows.direct());
                        windows.direct_sent(sent as usize);
                        room -= sent;
                    }
                }
                prop_assert_eq!(library + windows.direct(), room);
                prop_assert!(room >= 0 && windows.direct() >= 0);
            }
        }
    }
}

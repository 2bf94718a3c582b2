//! Connections until it is known what they speak. A client takes a place only then: whoever holds the line without a
//! word keeps nobody out.

use std::{
    collections::VecDeque,
    io,
    time::{Duration, Instant},
};

use tokio::{net::TcpStream, time::sleep};
use tokio_util::sync::CancellationToken;

use super::frames::PREFACE;

/// How often a client is looked at that has begun to say this.
const LOOK: Duration = Duration::from_millis(50);
/// Connections that have said nothing yet: when there are more, the oldest ones are closed that had this long to.
const MAX_SILENT: usize = 256;
const SILENCE: Duration = Duration::from_secs(1);

/// Those who have connected and said nothing yet, the oldest first; a token that is cancelled is of one who has, or has
/// gone.
#[derive(Default)]
pub(super) struct Silent(VecDeque<(Instant, CancellationToken)>);

impl Silent {
    /// Of a new one, which is closed when its token is cancelled. Makes room by closing old ones.
    pub(super) fn add(&mut self) -> CancellationToken {
        if self.0.len() >= MAX_SILENT {
            self.0.retain(|(_, token)| !token.is_cancelled());
        }
        while self.0.len() >= MAX_SILENT
            && let Some((since, token)) = self.0.front()
            && since.elapsed() > SILENCE
        {
            token.cancel();
            self.0.pop_front();
        }
        let token = CancellationToken::new();
        self.0.push_back((Instant::now(), token.clone()));
        token
    }
}

/// What a client speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Language {
    /// HTTP/1.1, or something that will turn out to be none.
    Http1,
    Http2,
}

/// Waits until it is known what a client speaks; `None` if it has gone. hyper would wait for the rest of a begun preface
/// for ever.
pub(super) async fn language(stream: &TcpStream) -> io::Result<Option<Language>> {
    let mut head = [0; PREFACE.len()];
    loop {
        let said = stream.peek(&mut head).await?;
        if said == 0 {
            return Ok(None);
        }
        if !PREFACE.starts_with(&head[..said]) {
            return Ok(Some(Language::Http1));
        }
        if said == PREFACE.len() {
            return Ok(Some(Language::Http2));
        }
        sleep(LOOK).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_who_had_time_to_speak_make_room() {
        let mut silent = Silent::default();
        let first: Vec<_> = (0..MAX_SILENT + 10).map(|_| silent.add()).collect();
        assert!(first.iter().all(|token| !token.is_cancelled()), "nobody had the time");
        let long_ago = Instant::now() - 2 * SILENCE;
        silent.0.iter_mut().take(20).for_each(|(since, _)| *since = long_ago);
        // One of them speaks.
        first[3].cancel();
        let newest = silent.add();
        assert!(!newest.is_cancelled());
        let closed = first.iter().take_while(|token| token.is_cancelled()).count();
        assert_eq!(closed, 11, "as many as there were too many, and the one that spoke");
        assert_eq!(silent.0.len(), MAX_SILENT);
    }
}

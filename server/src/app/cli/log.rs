//! The log: one line on stderr for each event, filtered by `RUST_LOG`.
//!
//! Texts in it may come from clients, nodes, cameras and files. Control characters are escaped, so that none of them can
//! begin a line or control a terminal, and passwords are redacted.
//!
//! A thread of its own writes it, so that a paused terminal, a full pipe or a hung disk blocks nothing else.

use std::{
    fmt,
    io::{IsTerminal, stderr},
    sync::{Mutex, PoisonError},
};

use tracing::field::Field;
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::{
    Layer,
    field::MakeExt,
    filter::Targets,
    fmt::{
        MakeWriter,
        format::{Writer, debug_fn},
        layer,
    },
    layer::SubscriberExt,
    registry::LookupSpan,
    util::SubscriberInitExt,
};

use crate::model::redact::redact;

/// Default of RUST_LOG. The ChArUco detector warns of every picture without a board.
const DEFAULT: &str = "info,calib_targets_charuco=error";

/// Lines that wait to be written; further ones are dropped.
const QUEUE_LINES: usize = 4096;

/// The writing thread, until the process ends.
static WRITER: Mutex<Option<WorkerGuard>> = Mutex::new(None);

/// Starts the log. `RUST_LOG` is a level, or `target=level` separated by commas.
pub(super) fn start() {
    let wanted = std::env::var("RUST_LOG").unwrap_or_default();
    let parsed = if wanted.is_empty() { DEFAULT } else { &wanted }.parse::<Targets>();
    let invalid = parsed.as_ref().err().map(ToString::to_string);
    let filter = parsed.unwrap_or_else(|_| DEFAULT.parse().expect("the default is valid"));
    let builder = NonBlockingBuilder::default().buffered_lines_limit(QUEUE_LINES);
    let (writer, guard) = builder.thread_name("log").finish(stderr());
    *WRITER.lock().unwrap_or_else(PoisonError::into_inner) = Some(guard);
    let lines = lines(writer, stderr().is_terminal());
    tracing_subscriber::registry().with(lines.with_filter(filter)).init();
    if let Some(error) = invalid {
        tracing::warn!(
            "RUST_LOG is ignored: expected a level such as debug, or target=level, found {wanted:?}: {error}"
        );
    }
}

/// Ends the log. Waits about a second at most for lines to be written.
pub(super) fn finish() {
    drop(WRITER.lock().unwrap_or_else(PoisonError::into_inner).take());
}

fn lines<S, W>(writer: W, is_coloured: bool) -> impl Layer<S>
where
    S: tracing::Subscriber + for<'a> LookupSpan<'a>,
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    let fields = debug_fn(write_field).delimited(" ");
    layer().fmt_fields(fields).with_ansi(is_coloured).with_writer(writer)
}

fn write_field(writer: &mut Writer<'_>, field: &Field, value: &dyn fmt::Debug) -> fmt::Result {
    if field.name() != "message" {
        write!(writer, "{}=", field.name())?;
    }
    for character in redact(&format!("{value:?}")).chars() {
        if character.is_control() {
            write!(writer, "{}", character.escape_default())?;
        } else {
            writer.write_char(character)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct Output(Arc<Mutex<Vec<u8>>>);

    impl std::io::Write for Output {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn no_text_begins_a_line_controls_a_terminal_or_shows_a_password() {
        let output = Output::default();
        let shared = output.clone();
        let log = tracing_subscriber::registry().with(lines(move || shared.clone(), true));
        let hostile = "x\n2026-01-01T00:00:00Z  INFO all is well\r\u{1b}[2J\u{9b}1m";
        tracing::subscriber::with_default(log, || {
            let error = std::io::Error::other(hostile);
            tracing::warn!(camera = hostile, other = %hostile, %error, "camera {hostile}");
            tracing::info!("http://user:secret@camera/stream?pwd=secret");
        });
        let text = String::from_utf8(output.0.lock().unwrap().clone()).unwrap();
        assert_eq!(text.lines().count(), 2, "{text}");
        assert!(text.lines().all(|line| !line.contains('\r')), "{text:?}");
        assert!(!text.contains("\u{1b}[2J") && !text.contains('\u{9b}'), "{text:?}");
        assert!(text.contains("camera x\\n2026") && text.contains("other=x\\n"), "{text}");
        assert!(text.contains("http://camera/stream") && !text.contains("secret"), "{text}");
    }
}

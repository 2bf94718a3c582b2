//! `roundel watch`: the stream of snapshots as a live table, or as lines of JSON.

use std::{
    io::{self, IsTerminal, Write},
    process::ExitCode,
};

use clap::Args;
use futures::StreamExt;
use roundel_client::{Client, Subscription, Update, position_sigma_m, speed_m_s};
use roundel_proto::{json, v1};

use super::{Format, connection::ConnectionArgs, signals::signal_or_after};

/// Default rate of the table, hertz.
const TABLE_RATE_HZ: f64 = 10.0;
/// Rows of a terminal that does not report its size.
const DEFAULT_ROWS: u16 = 24;
/// Rows above the first object.
const HEADER_ROWS: usize = 3;

/// Watch the poses of all objects.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel watch\n  \
    roundel watch --server http://arena:7670 --name drone --code 12\n  \
    roundel watch --format json --count 600 > run.jsonl\n\n\
    Columns: id: the server's number for the object; code: number of its coded print; position in metres\n\
    (world frame); speed in m/s; sigma: standard deviation of the position, root mean square over the\n\
    axes, in millimetres; age: of the newest observation at the pose's time; residual: about 1 when the\n\
    covariances are right.")]
pub struct WatchArgs {
    /// Address of the server
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:7670")]
    server: String,
    #[command(flatten)]
    connection: ConnectionArgs,
    /// Most snapshots per second [default: 10 for the table, all for json]
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Only this object; may be repeated
    #[arg(long = "id", value_name = "N")]
    ids: Vec<u64>,
    /// Only the object of this configured name; may be repeated
    #[arg(long = "name", value_name = "NAME")]
    names: Vec<String>,
    /// Only the object with the code of this number; may be repeated
    #[arg(long = "code", value_name = "N")]
    codes: Vec<u32>,
    /// A table, refreshed in place on a terminal, or one snapshot per line, as in REST
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
    /// Stop after this many snapshots
    #[arg(long, value_name = "N")]
    count: Option<u64>,
}

/// Prints snapshots until `--count`, a signal, or a closed output. Fails if there is no server at the start, or if it
/// rejects the subscription; a connection that is lost later is retried.
pub(super) async fn run(args: WatchArgs) -> anyhow::Result<ExitCode> {
    let signal = signal_or_after(None)?;
    let client = args.connection.connect(&args.server).await?;
    let info = client.info().await?;
    let screen = match args.format {
        Format::Json => Screen::Lines,
        Format::Table if io::stdout().is_terminal() => Screen::open_terminal()?,
        Format::Table => Screen::Blocks,
    };
    let view = View { address: client.address().to_owned(), info, ..View::default() };
    let ended = tokio::select! {
        // Drops the screen before an error is printed, which restores the terminal.
        ended = follow(&client, &args, view, screen) => ended,
        () = signal => Ok(()),
    };
    match ended {
        Err(error) if is_broken_pipe(&error) => Ok(ExitCode::SUCCESS),
        ended => ended.map(|()| ExitCode::SUCCESS),
    }
}

fn subscription(args: &WatchArgs) -> Subscription {
    let subscription = Subscription::default()
        .ids(args.ids.iter().copied())
        .names(&args.names)
        .codes(args.codes.iter().copied());
    let default_rate_hz = (args.format == Format::Table).then_some(TABLE_RATE_HZ);
    match args.rate.or(default_rate_hz) {
        Some(rate_hz) => subscription.max_rate_hz(rate_hz),
        None => subscription,
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let cause = error.downcast_ref::<io::Error>();
    cause.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

async fn follow(
    client: &Client,
    args: &WatchArgs,
    mut view: View,
    screen: Screen,
) -> anyhow::Result<()> {
    let mut snapshots = client.snapshots(subscription(args));
    let mut printed = 0;
    while args.count.is_none_or(|count| printed < count) {
        let Some(update) = snapshots.next().await else { break };
        match update? {
            Update::Snapshot(snapshot) => {
                view.take(snapshot, snapshots.missed());
                screen.show(&view)?;
                printed += 1;
            }
            Update::Disconnected { reason, retry_in, .. } => {
                let retry_s = retry_in.as_secs_f64();
                view.notice = format!("connection lost ({reason}); next try in {retry_s:.1} s");
                screen.show_notice(&view)?;
            }
            Update::Reconnected { gap, missed, .. } => {
                let missed = match missed {
                    Some(missed) => format!("missed {missed} snapshots"),
                    None => "the server has restarted".to_owned(),
                };
                view.notice = format!("reconnected after {:.1} s; {missed}", gap.as_secs_f64());
                screen.show_notice(&view)?;
                // A restarted server may have another version or name.
                if let Ok(info) = client.info().await {
                    view.info = info;
                }
            }
            _ => {}
        }
    }
    Ok(())
}

#[derive(Default)]
struct View {
    address: String,
    info: v1::ServerInfo,
    snapshot: v1::Snapshot,
    /// Snapshots that the server makes per second, smoothed.
    rate_hz: Option<f64>,
    missed: u64,
    /// State of the connection; empty while there is nothing to say.
    notice: String,
}

impl View {
    fn take(&mut self, snapshot: v1::Snapshot, missed: u64) {
        let before = &self.snapshot;
        let elapsed_ns = snapshot.fused_time_ns.saturating_sub(before.fused_time_ns);
        self.rate_hz = if snapshot.source_id == before.source_id && elapsed_ns > 0 {
            let made = snapshot.sequence.saturating_sub(before.sequence) as f64;
            let newest_hz = made / (elapsed_ns as f64 * 1e-9);
            Some(self.rate_hz.map_or(newest_hz, |rate_hz| 0.9 * rate_hz + 0.1 * newest_hz))
        } else {
            None
        };
        self.snapshot = snapshot;
        self.missed = missed;
    }

    fn header(&self) -> String {
        let snapshot = &self.snapshot;
        let name = if self.info.name.is_empty() { "roundel" } else { &self.info.name };
        let mut parts = vec![format!("{name} at {} (version {})", self.address, self.info.version)];
        parts.extend(self.rate_hz.map(|rate_hz| format!("{rate_hz:.1} snapshots/s")));
        if snapshot.capture_time_ns != 0 {
            let age_ms = milliseconds(snapshot.sent_time_ns - snapshot.capture_time_ns);
            parts.push(format!("{age_ms:.0} ms from capture"));
        }
        parts.push(format!("{} objects", snapshot.objects.len()));
        if self.missed > 0 {
            parts.push(format!("{} missed", self.missed));
        }
        parts.join("  ")
    }

    /// Header, notice (may be empty), column titles, and at most `rows` objects.
    fn lines(&self, rows: usize) -> Vec<String> {
        let mut lines = vec![self.header(), self.notice.clone()];
        let objects = &self.snapshot.objects;
        let name_width = objects.iter().map(|o| o.name.chars().count()).max().unwrap_or(0).max(4);
        lines.push(format!(
            "{:>5}  {:>5}  {:name_width$}  {:9}  {:>8} {:>8} {:>8}  {:>6}  {:>6}  {:>7}  {:>8}  cameras",
            "id", "code", "name", "stage", "x m", "y m", "z m", "m/s", "sig mm", "age ms", "residual"
        ));
        let is_cut = objects.len() > rows;
        let shown = if is_cut { rows.saturating_sub(1) } else { objects.len() };
        lines.extend(objects[..shown].iter().map(|state| row(state, name_width)));
        if is_cut {
            lines.push(format!("{:>5}  and {} more", "", objects.len() - shown));
        }
        lines
    }
}

fn row(state: &v1::ObjectState, name_width: usize) -> String {
    let position = state.position.unwrap_or_default();
    let code = state.code.map_or("-".to_owned(), |code| code.number.to_string());
    let sigma = position_sigma_m(state).map_or("-".to_owned(), |[x, y, z]| {
        format!("{:.1}", ((x * x + y * y + z * z) / 3.0).sqrt() * 1e3)
    });
    format!(
        "{:>5}  {:>5}  {:name_width$}  {:9}  {:8.3} {:8.3} {:8.3}  {:6.2}  {:>6}  {:7.0}  {:8.2}  {}",
        state.object_id,
        code,
        state.name,
        json::life_stage::word(state.stage),
        position.x,
        position.y,
        position.z,
        speed_m_s(state),
        sigma,
        milliseconds(state.observation_age_ns),
        state.residual,
        state.cameras.join(","),
    )
}

fn milliseconds(ns: i64) -> f64 {
    ns as f64 * 1e-6
}

enum Screen {
    /// A terminal's alternate screen, redrawn in place.
    Terminal,
    /// One table after the other.
    Blocks,
    /// One snapshot per line.
    Lines,
}

impl Screen {
    /// Switches to the terminal's alternate screen, without cursor and without line wrapping.
    fn open_terminal() -> io::Result<Self> {
        write_now("\x1b[?1049h\x1b[?25l\x1b[?7l").map(|()| Self::Terminal)
    }

    fn show(&self, view: &View) -> anyhow::Result<()> {
        let text = match self {
            Self::Terminal => {
                let rows = terminal_size::terminal_size().map_or(DEFAULT_ROWS, |(_, rows)| rows.0);
                let lines = view.lines(usize::from(rows).saturating_sub(HEADER_ROWS));
                format!("\x1b[H{}\x1b[K\x1b[J", lines.join("\x1b[K\r\n"))
            }
            Self::Blocks => {
                let mut text = String::new();
                for line in view.lines(usize::MAX).iter().filter(|line| !line.is_empty()) {
                    text.push_str(line.trim_end());
                    text.push('\n');
                }
                text + "\n"
            }
            Self::Lines => serde_json::to_string(&view.snapshot)? + "\n",
        };
        Ok(write_now(&text)?)
    }

    fn show_notice(&self, view: &View) -> anyhow::Result<()> {
        match self {
            Self::Terminal => self.show(view),
            Self::Blocks | Self::Lines => {
                Ok(writeln!(io::stderr(), "{}: {}", view.address, view.notice)?)
            }
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if let Self::Terminal = self {
            // A terminal that has gone needs no restoring.
            let _ = write_now("\x1b[?7h\x1b[?25h\x1b[?1049l");
        }
    }
}

fn write_now(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes())?;
    stdout.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot(sequence: u64, source_id: &str) -> v1::Snapshot {
        let state = |object_id, name: &str| v1::ObjectState {
            object_id,
            name: name.to_owned(),
            stage: v1::LifeStage::Tracked as i32,
            position: Some(v1::Vector3 { x: 1.25, y: -2.5, z: 0.3 }),
            velocity: Some(v1::Vector3 { x: 0.6, y: 0.8, z: 0.0 }),
            cameras: vec!["north".into(), "east".into()],
            observation_age_ns: 12_400_000,
            residual: 1.07,
            code: (object_id == 1).then_some(v1::Code { bits: 8, number: 12 }),
            ..Default::default()
        };
        v1::Snapshot {
            sequence,
            source_id: source_id.to_owned(),
            fused_time_ns: sequence as i64 * 20_000_000,
            capture_time_ns: 1_000_000,
            sent_time_ns: 31_000_000,
            objects: (1..=5).map(|id| state(id, if id == 1 { "robot one" } else { "" })).collect(),
            ..Default::default()
        }
    }

    fn view() -> View {
        let info = v1::ServerInfo { name: "lab".into(), version: "9".into(), ..Default::default() };
        let mut view = View { address: "http://127.0.0.1:1".into(), info, ..View::default() };
        view.take(snapshot(10, "a"), 0);
        view
    }

    #[test]
    fn a_row_holds_every_number_in_its_column() {
        let lines = view().lines(10);
        assert_eq!(lines.len(), HEADER_ROWS + 5);
        assert_eq!(
            lines[HEADER_ROWS],
            "    1     12  robot one  tracked       1.250   -2.500    0.300    1.00       -       12      1.07  north,east"
        );
        let titles: Vec<&str> = lines[2].split_whitespace().collect();
        assert_eq!(&titles[..4], ["id", "code", "name", "stage"]);
        assert!(lines[HEADER_ROWS + 1].starts_with("    2      -  "), "{}", lines[HEADER_ROWS + 1]);
        assert!(lines[0].contains("30 ms from capture"), "{}", lines[0]);
    }

    #[test]
    fn a_small_terminal_says_how_many_rows_it_hides() {
        let lines = view().lines(3);
        assert_eq!(lines.len(), HEADER_ROWS + 3);
        assert!(lines.last().unwrap().contains("and 3 more"));
    }

    #[test]
    fn the_rate_is_that_of_the_server_and_resets_when_it_restarts() {
        let mut view = view();
        // Five snapshots in a tenth of a second, one of which was received.
        view.take(snapshot(15, "a"), 0);
        assert!((view.rate_hz.unwrap() - 50.0).abs() < 1e-9);
        view.take(snapshot(1, "b"), 0);
        assert_eq!(view.rate_hz, None);
    }
}

//! How fast a recording is fused anew: the reference installations are recorded by a server that runs, in real time,
//! and then played from their observations as fast as it goes, and copied into files, three times each, on one core.
//!
//! ```sh
//! cargo run --release -p roundel-tests --bin replays                # R4 and R16, 20 s each
//! cargo run --release -p roundel-tests --bin replays -- 60
//! ```
//!
//! Told is how many times faster than it was recorded, and whether all three files are the same to the last bit.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use anyhow::bail;
use roundel_server::app::replay_server::ReplayServer;
use roundel_server::archive::replay::{
    ReplayFrom, ReplayStatus,
    copy::copy,
    session::{ReplayOptions, ReplaySession, initial_status},
};
use roundel_tests::{
    arena::Arena,
    recorded::{Recorded, record},
    scenario::swarm::PRECISE,
    sensor::Stream,
};

/// As of the `roundel` command.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const RUNS: usize = 3;
/// What a replay can be asked for at most.
const FASTEST: f64 = 100.0;

fn main() -> anyhow::Result<()> {
    let seconds = std::env::args().skip(1).find_map(|it| it.parse().ok()).unwrap_or(20.0);
    for (name, arena) in [("R4", Arena::r4(1)), ("R16", Arena::r16(1))] {
        measure(name, &arena, seconds)?;
    }
    Ok(())
}

fn measure(name: &str, arena: &Arena, seconds: f64) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let Recorded { file, dropped } =
        record(arena, Stream::new(arena, PRECISE, seconds), folder.path(), &[])?;
    if dropped > 0 {
        bail!("{dropped} messages found no room: this machine is too slow to record that");
    }
    let wanted = ReplayOptions { file: file.clone(), from: ReplayFrom::Observations, config: None };
    let (mut played, mut times, mut files) = (Vec::new(), Vec::new(), Vec::new());
    for run in 0..RUNS {
        played.push(play(ReplaySession::open(&wanted)?, &file)?);
        let session = ReplaySession::open(&wanted)?;
        let to = folder.path().join(format!("anew{run}.mcap"));
        let begun = Instant::now();
        let copied = copy(session, &to, |_| {})?;
        times.push(copied.seconds / begun.elapsed().as_secs_f64());
        files.push((fs::read(&to)?, copied));
    }
    let [first, others @ ..] = &files[..] else { bail!("nothing was fused") };
    let are_same = others.iter().all(|other| other.0 == first.0);
    let best = |times: &[f64]| times.iter().copied().fold(0.0, f64::max);
    println!(
        "{name}: {} snapshots of {:.1} s, {:.1} MB; played {:.1} times faster than recorded, copied {:.1} times, {} to \
         the last bit",
        first.1.snapshots,
        first.1.seconds,
        fs::metadata(&file)?.len() as f64 * 1e-6,
        best(&played),
        best(&times),
        if are_same { "the same" } else { "NOT the same" }
    );
    Ok(())
}

/// Plays it as fast as it goes, as a server does: how many times faster than it was recorded.
fn play(session: ReplaySession, file: &Path) -> anyhow::Result<f64> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let begin = ReplayStatus {
            speed: FASTEST,
            ..initial_status(&session, file, ReplayFrom::Observations)
        };
        let seconds = begin.span.1.seconds_since(begin.span.0);
        let begun = Instant::now();
        let server = ReplayServer::start(session, "127.0.0.1:0".parse()?, begin).await?;
        while !server.replay().status().ended {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        let took_s = begun.elapsed().as_secs_f64();
        server.shutdown().await;
        Ok(seconds / took_s)
    })
}

//! Speed of history queries: `cargo bench -p roundel-server --bench history -- [HOURS]`.
//!
//! Writes the positions of 100 objects over HOURS, in all tiers, one second at a time, as a server does. The default of
//! 24 hours takes minutes and 5 GB in the folder for temporary files. Then runs each query several times and prints the
//! least and the median time.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use roundel_core::time::Timestamp;
use roundel_server::archive::history::{
    TIERS,
    store::{HistoryObject, HistoryPoint, HistoryQuery, MAX_POINTS, Store},
};

const OBJECTS: u64 = 100;
const NS_PER_S: i64 = 1_000_000_000;
const HOUR_NS: i64 = 3600 * NS_PER_S;
/// 2027-01-15, 08:00 UTC.
const BEGIN_NS: i64 = 1_800_000_000 * NS_PER_S;
const ROUNDS: usize = 9;

fn main() {
    let hours = std::env::args().skip(1).find_map(|it| it.parse::<i64>().ok()).unwrap_or(24).max(1);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("history.sqlite");
    let end_ns = BEGIN_NS + hours * HOUR_NS;
    let begun = Instant::now();
    let rows = fill(&path, end_ns);
    let bytes = std::fs::metadata(&path).expect("the file").len();
    println!(
        "{rows} points of {OBJECTS} objects over {hours} h, {:.2} GB, written in {:.0} s",
        bytes as f64 * 1e-9,
        begun.elapsed().as_secs_f64()
    );
    let store = Store::open(&path).expect("the file");
    let all = HistoryQuery {
        objects: Vec::new(),
        region_m: None,
        from: Timestamp::from_ns(BEGIN_NS),
        until: Timestamp::from_ns(end_ns),
        max_points: MAX_POINTS,
        step_s: None,
    };
    let last = |ns: i64| HistoryQuery { from: Timestamp::from_ns(end_ns - ns), ..all.clone() };
    let one = || vec!["robot-7".to_owned()];
    let corner = Some([[0.0, 0.0, 0.0], [5.0, 4.0, 1.0]]);
    ask(&store, "everything, all objects", &all);
    ask(&store, "the last hour, all objects", &last(HOUR_NS));
    ask(&store, "the last minute, all objects", &last(60 * NS_PER_S));
    ask(&store, "everything, one object", &HistoryQuery { objects: one(), ..all.clone() });
    ask(&store, "the last hour, one object", &HistoryQuery { objects: one(), ..last(HOUR_NS) });
    ask(&store, "everything, within a corner", &HistoryQuery { region_m: corner, ..all.clone() });
}

/// Writes the history; returns the number of points.
fn fill(path: &Path, end_ns: i64) -> u64 {
    let mut store = Store::open(path).expect("a file");
    let begin = Timestamp::from_ns(BEGIN_NS);
    let key = |id: u64| {
        let identity = HistoryObject {
            run: "bench".into(),
            id,
            name: format!("robot-{id}"),
            kind: "robot".into(),
            code: id as u32,
        };
        store.key(&identity, begin).expect("a key")
    };
    let keys: Vec<i64> = (1..=OBJECTS).map(key).collect();
    let (mut rows, mut points) = (0, Vec::new());
    for second_ns in (BEGIN_NS..end_ns).step_by(NS_PER_S as usize) {
        points.clear();
        for time_ns in (second_ns..second_ns + NS_PER_S).step_by(TIERS[0].step_ns as usize) {
            for (tier, grade) in TIERS.iter().enumerate() {
                if (time_ns - BEGIN_NS) % grade.step_ns == 0 {
                    points.extend(keys.iter().map(|&key| (tier, key, place(key, time_ns))));
                }
            }
        }
        rows += points.len() as u64;
        store.add(&points).expect("enough disk space");
    }
    rows
}

fn place(key: i64, time_ns: i64) -> HistoryPoint {
    let phase = (time_ns - BEGIN_NS) as f64 * 1e-9 * 0.05 + key as f64;
    HistoryPoint {
        time: Timestamp::from_ns(time_ns),
        position_m: [5.0 + 4.5 * phase.sin(), 4.0 + 3.5 * (0.7 * phase).cos(), 0.3],
        yaw_rad: Some(phase.sin()),
    }
}

fn ask(store: &Store, what: &str, query: &HistoryQuery) {
    let mut times: Vec<Duration> = Vec::new();
    let mut answer = Default::default();
    for _ in 0..ROUNDS {
        let begun = Instant::now();
        answer = store.query(query).expect("an answer");
        times.push(begun.elapsed());
    }
    times.sort_unstable();
    let points: usize = answer.objects.iter().map(|(_, points)| points.len()).sum();
    println!(
        "{what}: {points} points {} s apart; least {:.1} ms, median {:.1} ms",
        answer.step_s,
        times[0].as_secs_f64() * 1e3,
        times[ROUNDS / 2].as_secs_f64() * 1e3
    );
}

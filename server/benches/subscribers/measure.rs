//! What subscribers received, and the resources that the server used.

use std::{
    fs,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use crate::serve::RATE_HZ;

/// Clock ticks of `/proc/PID/stat`.
const TICKS_PER_S: f64 = 100.0;

/// Messages that all subscribers have received so far.
#[derive(Clone, Default)]
pub struct Readings(Arc<Mutex<Received>>);

#[derive(Default)]
struct Received {
    latencies_us: Vec<u32>,
    missed: u64,
}

impl Readings {
    /// Records a completely received message.
    pub fn add(&self, fused_time_ns: i64, missed: u64) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
        let latency_us = (now as i64 - fused_time_ns).max(0) / 1000;
        let mut received = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        received.latencies_us.push(latency_us.min(i64::from(u32::MAX)) as u32);
        received.missed += missed;
    }

    pub fn clear(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Received::default();
    }

    /// Number of messages so far.
    pub fn count(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).latencies_us.len()
    }

    /// Summarises the latencies of `readers` subscribers.
    pub fn summary(&self, readers: usize, length: Duration) -> Summary {
        let mut received = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        received.latencies_us.sort_unstable();
        let count = received.latencies_us.len();
        let at = |share: f64| {
            let index = ((count as f64 * share) as usize).min(count.saturating_sub(1));
            received.latencies_us.get(index).map_or(f64::NAN, |us| f64::from(*us) * 1e-3)
        };
        let expected = readers as f64 * length.as_secs_f64() * RATE_HZ;
        let (p50_ms, p99_ms) = (at(0.5), at(0.99));
        let line = format!(
            "{readers} readers, {:.1} % of {expected:.0} snapshots received, {} skipped; fused to received p50 {p50_ms:.2} ms, p99 {p99_ms:.2}, max {:.1}",
            100.0 * count as f64 / expected,
            received.missed,
            at(1.0),
        );
        Summary { line, p50_ms, p99_ms }
    }
}

pub struct Summary {
    pub line: String,
    pub p50_ms: f64,
    pub p99_ms: f64,
}

/// Resources used so far by the server process and by this process.
pub struct Usage {
    at: Instant,
    processor_s: f64,
    own_s: f64,
    pub memory_mb: f64,
}

impl Usage {
    pub fn of(process: u32) -> Self {
        let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let kb = resident.and_then(|rest| rest.split_whitespace().next()?.parse::<f64>().ok());
        Self {
            at: Instant::now(),
            processor_s: processor_s(&process.to_string()),
            own_s: processor_s("self"),
            memory_mb: kb.unwrap_or(f64::NAN) / 1024.0,
        }
    }

    /// Average number of cores used by the server process.
    pub fn cores_since(&self, before: &Self) -> f64 {
        (self.processor_s - before.processor_s) / (self.at - before.at).as_secs_f64()
    }

    /// Average number of cores used by this process.
    pub fn others_since(&self, before: &Self) -> f64 {
        (self.own_s - before.own_s) / (self.at - before.at).as_secs_f64()
    }
}

fn processor_s(process: &str) -> f64 {
    let line = fs::read_to_string(format!("/proc/{process}/stat")).expect("Linux' /proc/PID/stat");
    // Fields are counted after the name: utime and stime are the 14th and 15th.
    let fields = line.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks: f64 = fields.skip(11).take(2).filter_map(|field| field.parse::<f64>().ok()).sum();
    ticks / TICKS_PER_S
}

//! The file of a history.
//!
//! `object` has a row for each object of each run of the server, `point` a row for each point. The key of a point is tier,
//! object and time, so that an object's points of a tier are adjacent on the disk.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
    time::Duration,
};

use roundel_core::time::Timestamp;
use rusqlite::{Connection, Result as SqlResult, Row, params};

use super::{HistoryError, TIERS, Tier};
use crate::model::{stop::StopSignal, text_file};

const FORMAT_VERSION: i64 = 1;
/// Maximum number of points of a query.
pub const MAX_POINTS: usize = 5000;
/// Maximum number of rows of an export.
pub const MAX_EXPORT_ROWS: usize = 2_000_000;
/// Maximum number of points deleted at a time.
const DELETE_BATCH: i64 = 20_000;
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

const TABLES: &str = "
    CREATE TABLE IF NOT EXISTS object (
        key INTEGER PRIMARY KEY, run TEXT NOT NULL, id INTEGER NOT NULL, name TEXT NOT NULL, kind TEXT NOT NULL,
        code INTEGER NOT NULL, first_ns INTEGER NOT NULL, last_ns INTEGER NOT NULL, UNIQUE (run, id));
    CREATE TABLE IF NOT EXISTS point (
        tier INTEGER NOT NULL, object INTEGER NOT NULL, time_ns INTEGER NOT NULL, x REAL NOT NULL, y REAL NOT NULL,
        z REAL NOT NULL, yaw REAL, PRIMARY KEY (tier, object, time_ns)) WITHOUT ROWID;
";

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HistoryObject {
    /// The run of the server that assigned the id.
    pub run: String,
    pub id: u64,
    /// Configured name; empty: none.
    pub name: String,
    pub kind: String,
    /// Code number; 0: none.
    pub code: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistoryPoint {
    pub time: Timestamp,
    /// World frame, metres.
    pub position_m: [f64; 3],
    /// About the world's z axis; `None`: not observed.
    pub yaw_rad: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct HistoryQuery {
    /// Ids, names or code numbers; empty: all.
    pub objects: Vec<String>,
    /// Smallest and largest corner.
    pub region_m: Option<[[f64; 3]; 2]>,
    pub from: Timestamp,
    pub until: Timestamp,
    /// Total over all objects.
    pub max_points: usize,
    /// `Some`: the points of the coarsest tier with at most this step, or an error if there are more than `max_points`.
    /// `None`: thinned to `max_points`.
    pub step_s: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct HistoryResult {
    /// Objects with their points in order of time.
    pub objects: Vec<(HistoryObject, Vec<HistoryPoint>)>,
    /// Step between points, seconds.
    pub step_s: f64,
    /// Times of the oldest and the newest stored point.
    pub kept: Option<(Timestamp, Timestamp)>,
}

pub struct Store {
    path: PathBuf,
    connection: Connection,
}

impl Store {
    /// Opens a file, or creates it.
    pub fn open(path: &Path) -> Result<Self, HistoryError> {
        let failed = |source| HistoryError::Store { path: path.to_owned(), source };
        let connection = Connection::open(path).map_err(failed)?;
        match prepare(&connection).map_err(failed)? {
            found if found > FORMAT_VERSION => {
                Err(HistoryError::Newer { path: path.to_owned(), found })
            }
            _ => Ok(Self { path: path.to_owned(), connection }),
        }
    }

    /// Renames a damaged file, with what SQLite keeps beside it, to `….damaged-20261122T221055Z`; returns the new name.
    pub(super) fn set_aside(path: &Path, now: Timestamp) -> Result<PathBuf, HistoryError> {
        let beside = |ending: &str| {
            let mut name = path.as_os_str().to_owned();
            name.push(ending);
            PathBuf::from(name)
        };
        let seconds = now.as_ns().div_euclid(1_000_000_000);
        let time = prost_types::Timestamp { seconds, nanos: 0 }.to_string();
        let kept = beside(&format!(".damaged-{}", time.replace(['-', ':'], "")));
        let failed = |source| HistoryError::SetAside { path: path.to_owned(), source };
        fs::rename(path, &kept).map_err(failed)?;
        // The new file must not begin with the journal of the damaged one.
        for ending in ["-wal", "-shm"] {
            let mut journal = kept.as_os_str().to_owned();
            journal.push(ending);
            match fs::rename(beside(ending), journal) {
                Err(source) if source.kind() != io::ErrorKind::NotFound => {
                    return Err(failed(source));
                }
                _ => {}
            }
        }
        text_file::sync_folder_of(path);
        Ok(kept)
    }

    pub(super) fn failed(&self, source: rusqlite::Error) -> HistoryError {
        HistoryError::Store { path: self.path.clone(), source }
    }

    /// Adds or updates an object, and returns its key.
    pub fn key(&self, object: &HistoryObject, time: Timestamp) -> SqlResult<i64> {
        let HistoryObject { run, id, name, kind, code } = object;
        let id = i64::try_from(*id).unwrap_or(i64::MAX);
        self.connection.query_row(
            "INSERT INTO object (run, id, name, kind, code, first_ns, last_ns) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?6)
             ON CONFLICT (run, id) DO UPDATE SET name = ?3, kind = ?4, code = ?5
             RETURNING key",
            params![run, id, name, kind, code, time.as_ns()],
            |row| row.get(0),
        )
    }

    /// Adds points with their tiers and keys, in one transaction.
    pub fn add(&mut self, points: &[(usize, i64, HistoryPoint)]) -> SqlResult<()> {
        let transaction = self.connection.transaction()?;
        let mut newest = BTreeMap::new();
        for (tier, key, point) in points {
            let [x, y, z] = point.position_m;
            let time_ns = point.time.as_ns();
            transaction
                .prepare_cached("INSERT OR REPLACE INTO point VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")?
                .execute(params![*tier as i64, key, time_ns, x, y, z, point.yaw_rad])?;
            newest.insert(key, time_ns);
        }
        for (key, time_ns) in newest {
            transaction
                .prepare_cached("UPDATE object SET last_ns = max(last_ns, ?2) WHERE key = ?1")?
                .execute(params![key, time_ns])?;
        }
        transaction.commit()
    }

    /// Deletes a batch of expired points; returns whether there may be more.
    pub fn expire(&self, now: Timestamp, keep: Duration) -> SqlResult<bool> {
        let keep_ns = i64::try_from(keep.as_nanos()).unwrap_or(i64::MAX);
        let mut more = false;
        for (tier, Tier { retention, .. }) in TIERS.iter().enumerate() {
            let before_ns = now.as_ns().saturating_sub(keep_ns.saturating_mul(*retention));
            let mut keys =
                self.connection.prepare_cached("SELECT key FROM object WHERE first_ns < ?1")?;
            let keys: Vec<i64> =
                keys.query_map([before_ns], |row| row.get(0))?.collect::<SqlResult<_>>()?;
            // By object, since that is their order on the disk.
            for key in keys {
                let deleted = self.connection.execute(
                    "DELETE FROM point WHERE tier = ?1 AND object = ?2 AND time_ns IN (
                         SELECT time_ns FROM point WHERE tier = ?1 AND object = ?2 AND time_ns < ?3
                         ORDER BY time_ns LIMIT ?4)",
                    params![tier as i64, key, before_ns, DELETE_BATCH],
                )?;
                more |= deleted as i64 == DELETE_BATCH;
            }
            if tier == TIERS.len() - 1 {
                self.connection.execute(
                    "DELETE FROM object WHERE last_ns < ?2
                     AND NOT EXISTS (SELECT 1 FROM point WHERE object = key AND tier = ?1)",
                    params![tier as i64, before_ns],
                )?;
            }
        }
        Ok(more)
    }

    pub fn query(&self, query: &HistoryQuery) -> Result<HistoryResult, HistoryError> {
        self.query_until(query, &StopSignal::default())
    }

    /// Like [`Self::query`], and ends early when the signal comes.
    pub fn query_until(
        &self,
        query: &HistoryQuery,
        stop: &StopSignal,
    ) -> Result<HistoryResult, HistoryError> {
        let result = self.select(query, stop).map_err(|error| self.failed(error))?;
        if stop.is_stopped() {
            return Err(HistoryError::Stopped);
        }
        result.ok_or(HistoryError::TooManyPoints { max_points: query.max_points })
    }

    /// `None`: there are too many points, or the signal came.
    fn select(&self, query: &HistoryQuery, stop: &StopSignal) -> SqlResult<Option<HistoryResult>> {
        let objects = self.objects(query)?;
        let length_ns = query.until.ns_since(query.from).max(1);
        let wanted_ns = match query.step_s {
            Some(step_s) => (step_s * 1e9) as i64,
            // With this step all points fit, if each object existed all the time.
            None => length_ns / (query.max_points / objects.len().max(1)).max(1) as i64,
        };
        let tier = TIERS.iter().rposition(|tier| tier.step_ns <= wanted_ns).unwrap_or(0);
        let mut all = Vec::new();
        let (mut count, mut coarsest) = (0, tier);
        for (key, first_ns, object) in objects {
            let since_ns = first_ns.max(query.from.as_ns());
            let tier = match query.step_s {
                Some(_) => tier,
                None => self.tier_since(tier, key, since_ns)?,
            };
            coarsest = coarsest.max(tier);
            let most = if query.step_s.is_some() { query.max_points } else { MAX_EXPORT_ROWS };
            // One more than fits shows that there are too many.
            let points = self.points(tier, key, query, (most - count + 1, stop))?;
            count += points.len();
            if count > most || stop.is_stopped() {
                return Ok(None);
            }
            if !points.is_empty() {
                all.push((object, points));
            }
        }
        let every = if query.step_s.is_some() { 1 } else { thin(&mut all, query.max_points) };
        let step_s = TIERS[coarsest].step_ns as f64 * 1e-9 * every as f64;
        Ok(Some(HistoryResult { objects: all, step_s, kept: self.kept()? }))
    }

    /// The finest tier from `tier` on that still has an object's points of that time.
    fn tier_since(&self, tier: usize, key: i64, since_ns: i64) -> SqlResult<usize> {
        let mut oldest = self
            .connection
            .prepare_cached("SELECT min(time_ns) FROM point WHERE tier = ?1 AND object = ?2")?;
        for (tier, Tier { step_ns, .. }) in TIERS.iter().enumerate().skip(tier) {
            let first: Option<i64> =
                oldest.query_row(params![tier as i64, key], |row| row.get(0))?;
            if first.is_some_and(|first_ns| first_ns <= since_ns.saturating_add(*step_ns)) {
                return Ok(tier);
            }
        }
        Ok(TIERS.len() - 1)
    }

    /// The selected objects with their keys and first times.
    fn objects(&self, query: &HistoryQuery) -> SqlResult<Vec<(i64, i64, HistoryObject)>> {
        let read = |row: &Row<'_>| {
            let id: i64 = row.get(2)?;
            let (run, name, kind, code) = (row.get(1)?, row.get(3)?, row.get(4)?, row.get(5)?);
            Ok((row.get(0)?, row.get(6)?, HistoryObject { run, id: id as u64, name, kind, code }))
        };
        let is_selected = |object: &HistoryObject| {
            query.objects.is_empty()
                || query.objects.iter().any(|it| {
                    *it == object.name
                        || *it == object.id.to_string()
                        || (object.code > 0 && *it == object.code.to_string())
                })
        };
        self.connection
            .prepare_cached(
                "SELECT key, run, id, name, kind, code, first_ns FROM object WHERE first_ns <= ?2 AND last_ns >= ?1
                 ORDER BY first_ns, id",
            )?
            .query_map([query.from.as_ns(), query.until.as_ns()], read)?
            .filter(|found| found.as_ref().map_or(true, |(_, _, object)| is_selected(object)))
            .collect()
    }

    /// The first `most` points of an object; fewer if the signal comes.
    fn points(
        &self,
        tier: usize,
        key: i64,
        query: &HistoryQuery,
        (most, stop): (usize, &StopSignal),
    ) -> SqlResult<Vec<HistoryPoint>> {
        let read = |row: &Row<'_>| {
            Ok(HistoryPoint {
                time: Timestamp::from_ns(row.get(0)?),
                position_m: [row.get(1)?, row.get(2)?, row.get(3)?],
                yaw_rad: row.get(4)?,
            })
        };
        let is_inside = |point: &HistoryPoint| {
            query.region_m.is_none_or(|[min, max]| {
                (0..3).all(|axis| (min[axis]..=max[axis]).contains(&point.position_m[axis]))
            })
        };
        self.connection
            .prepare_cached(
                "SELECT time_ns, x, y, z, yaw FROM point
                 WHERE tier = ?1 AND object = ?2 AND time_ns BETWEEN ?3 AND ?4 ORDER BY time_ns",
            )?
            .query_map(params![tier as i64, key, query.from.as_ns(), query.until.as_ns()], read)?
            .take_while(|_| !stop.is_stopped())
            .filter(|point| point.as_ref().map_or(true, is_inside))
            .take(most)
            .collect()
    }

    fn kept(&self) -> SqlResult<Option<(Timestamp, Timestamp)>> {
        let read = |row: &Row<'_>| Ok(row.get::<_, Option<i64>>(0)?.zip(row.get(1)?));
        let kept = self.connection.query_row(
            "SELECT min(first_ns), max(last_ns) FROM object",
            [],
            read,
        )?;
        Ok(kept.map(|(first, last)| (Timestamp::from_ns(first), Timestamp::from_ns(last))))
    }
}

/// Sets up a connection, creates missing tables, and returns the file's version.
fn prepare(connection: &Connection) -> SqlResult<i64> {
    connection.busy_timeout(BUSY_TIMEOUT)?;
    // A power failure may lose the last second, and nothing else.
    connection.pragma_update(None, "journal_mode", "WAL")?;
    connection.pragma_update(None, "synchronous", "NORMAL")?;
    let found = connection.query_row("PRAGMA user_version", [], |row| row.get(0))?;
    if found < FORMAT_VERSION {
        connection.execute_batch(TABLES)?;
        connection.pragma_update(None, "user_version", FORMAT_VERSION)?;
    }
    Ok(found)
}

/// Keeps every n-th point, so that at most `most` remain; returns n.
fn thin(all: &mut [(HistoryObject, Vec<HistoryPoint>)], most: usize) -> usize {
    let count =
        |every: usize| all.iter().map(|(_, points)| points.len().div_ceil(every)).sum::<usize>();
    let mut every = 1;
    while count(every) > most && every < count(1) {
        every += 1;
    }
    for (_, points) in all.iter_mut() {
        *points = points.iter().copied().step_by(every).collect();
    }
    every
}

#[cfg(test)]
mod tests;

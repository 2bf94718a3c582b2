//! The file of a history.
//!
//! `object` has a row for each object of each run of the server, `point` one for each point: tier, object, time, place.
//! That is also the key, so that an object's course in a tier lies together on the disk.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Duration,
};

use roundel_core::time::Timestamp;
use rusqlite::{Connection, OptionalExtension, params};

use super::{HistoryError, TIERS};

const FORMAT_VERSION: i64 = 1;
/// Points that one query may be answered with.
pub const MAX_POINTS: usize = 5000;
/// Rows that one export may have.
pub const MAX_EXPORT_ROWS: usize = 2_000_000;
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
    /// The run of the server that gave the id.
    pub run: String,
    pub id: u64,
    /// Its configured name, or empty.
    pub name: String,
    pub kind: String,
    /// Number of its code; 0: none.
    pub code: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistoryPoint {
    pub time: Timestamp,
    /// World frame, metres.
    pub position_m: [f64; 3],
    /// About the world's z, where it was observed.
    pub yaw_rad: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct HistoryQuery {
    /// Ids, names or codes' numbers; empty: all.
    pub objects: Vec<String>,
    /// Smallest and largest corner.
    pub region_m: Option<[[f64; 3]; 2]>,
    pub from: Timestamp,
    pub until: Timestamp,
    /// No more points than this, of all objects together.
    pub max_points: usize,
    /// `Some`: not thinned, but so many seconds apart, or the next finer that there is; more than `max_points` is an
    /// error.
    pub step_s: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct HistoryResult {
    /// Each object with its points, in the order of time.
    pub objects: Vec<(HistoryObject, Vec<HistoryPoint>)>,
    /// From one point to the next, seconds.
    pub step_s: f64,
    /// Times of the first and the last point that are kept of anything.
    pub kept: Option<(Timestamp, Timestamp)>,
}

pub struct Store {
    path: PathBuf,
    connection: Connection,
}

impl Store {
    /// Opens a file, which is made if it is not there.
    pub fn open(path: &Path) -> Result<Self, HistoryError> {
        let failed = |source| HistoryError::Store { path: path.to_owned(), source };
        let connection = Connection::open(path).map_err(failed)?;
        connection.busy_timeout(BUSY_TIMEOUT).map_err(failed)?;
        // A power failure may lose the last second, and nothing else.
        connection.pragma_update(None, "journal_mode", "WAL").map_err(failed)?;
        connection.pragma_update(None, "synchronous", "NORMAL").map_err(failed)?;
        let found: i64 =
            connection.query_row("PRAGMA user_version", [], |row| row.get(0)).map_err(failed)?;
        if found > FORMAT_VERSION {
            return Err(HistoryError::Newer { path: path.to_owned(), found });
        }
        if found < FORMAT_VERSION {
            connection.execute_batch(TABLES).map_err(failed)?;
            connection.pragma_update(None, "user_version", FORMAT_VERSION).map_err(failed)?;
        }
        Ok(Self { path: path.to_owned(), connection })
    }

    fn failed(&self, source: rusqlite::Error) -> HistoryError {
        HistoryError::Store { path: self.path.clone(), source }
    }

    /// The key of an object, which is known from then on.
    pub fn key(&self, object: &HistoryObject, time: Timestamp) -> Result<i64, HistoryError> {
        let put = "INSERT INTO object (run, id, name, kind, code, first_ns, last_ns) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?6)
                   ON CONFLICT (run, id) DO UPDATE SET name = ?3, kind = ?4, code = ?5
                   RETURNING key";
        let HistoryObject { run, id, name, kind, code } = object;
        let id = i64::try_from(*id).unwrap_or(i64::MAX);
        let values = params![run, id, name, kind, code, time.as_ns()];
        self.connection.query_row(put, values, |row| row.get(0)).map_err(|it| self.failed(it))
    }

    /// Adds points to tiers, all or none of them.
    pub fn add(&mut self, points: &[(usize, i64, HistoryPoint)]) -> Result<(), HistoryError> {
        let path = self.path.clone();
        let failed = |source| HistoryError::Store { path: path.clone(), source };
        let transaction = self.connection.transaction().map_err(failed)?;
        {
            let mut put = transaction
                .prepare_cached("INSERT OR REPLACE INTO point VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)")
                .map_err(failed)?;
            let mut seen = transaction
                .prepare_cached("UPDATE object SET last_ns = max(last_ns, ?2) WHERE key = ?1")
                .map_err(failed)?;
            let mut newest = BTreeMap::new();
            for (tier, key, point) in points {
                let [x, y, z] = point.position_m;
                let tier = *tier as i64;
                put.execute(params![tier, key, point.time.as_ns(), x, y, z, point.yaw_rad])
                    .map_err(failed)?;
                newest.insert(*key, point.time.as_ns());
            }
            for (key, time_ns) in newest {
                seen.execute(params![key, time_ns]).map_err(failed)?;
            }
        }
        transaction.commit().map_err(failed)
    }

    /// Forgets what is older than it is kept, a part of it at a time; says whether there may be more.
    pub fn forget(&self, now: Timestamp, keep: Duration) -> Result<bool, HistoryError> {
        const PART: i64 = 20_000;
        let keep_ns = i64::try_from(keep.as_nanos()).unwrap_or(i64::MAX);
        let mut more = false;
        for (tier, grade) in TIERS.iter().enumerate() {
            let before_ns = now.as_ns().saturating_sub(keep_ns.saturating_mul(grade.kept));
            // By object, as that is how they lie.
            let delete = "DELETE FROM point WHERE tier = ?1 AND object = ?2 AND time_ns < ?3 AND time_ns <= (
                              SELECT time_ns FROM point WHERE tier = ?1 AND object = ?2 ORDER BY time_ns
                              LIMIT 1 OFFSET ?4)";
            let whole = "DELETE FROM point WHERE tier = ?1 AND object = ?2 AND time_ns < ?3";
            for key in self.keys_before(before_ns)? {
                let part = params![tier as i64, key, before_ns, PART];
                let deleted =
                    self.connection.execute(delete, part).map_err(|it| self.failed(it))?;
                more |= deleted as i64 > PART;
                if deleted == 0 {
                    let rest = params![tier as i64, key, before_ns];
                    self.connection.execute(whole, rest).map_err(|it| self.failed(it))?;
                }
            }
        }
        let empty = "DELETE FROM object WHERE NOT EXISTS (SELECT 1 FROM point WHERE object = key AND tier = ?1)
                     AND last_ns < ?2";
        let coarsest = TIERS.len() - 1;
        let before_ns = now.as_ns().saturating_sub(keep_ns.saturating_mul(TIERS[coarsest].kept));
        self.connection
            .execute(empty, params![coarsest as i64, before_ns])
            .map_err(|it| self.failed(it))?;
        Ok(more)
    }

    fn keys_before(&self, time_ns: i64) -> Result<Vec<i64>, HistoryError> {
        let mut ask = self
            .connection
            .prepare_cached("SELECT key FROM object WHERE first_ns < ?1")
            .map_err(|it| self.failed(it))?;
        let keys = ask.query_map([time_ns], |row| row.get(0)).map_err(|it| self.failed(it))?;
        keys.collect::<Result<_, _>>().map_err(|it| self.failed(it))
    }

    pub fn query(&self, query: &HistoryQuery) -> Result<HistoryResult, HistoryError> {
        let objects = self.objects(query)?;
        let length_ns = query.until.ns_since(query.from).max(1);
        let wanted_ns = match query.step_s {
            Some(step_s) => (step_s * 1e9) as i64,
            // So far apart all fit, if each object was there all the time.
            None => length_ns / (query.max_points / objects.len().max(1)).max(1) as i64,
        };
        let tier = TIERS.iter().rposition(|tier| tier.step_ns <= wanted_ns).unwrap_or(0);
        let mut all = Vec::new();
        let (mut count, mut coarsest) = (0, tier);
        for (key, first_ns, identity) in objects {
            let since_ns = first_ns.max(query.from.as_ns());
            let tier = match query.step_s {
                Some(_) => tier,
                None => self.tier_since(tier, key, since_ns)?,
            };
            coarsest = coarsest.max(tier);
            let points = self.points(tier, key, query)?;
            count += points.len();
            if query.step_s.is_some() && count > query.max_points {
                return Err(HistoryError::TooManyPoints(format!(
                    "expected at most {} points, found more: ask for fewer objects, a shorter time, a region, or a \
                     larger step_s",
                    query.max_points
                )));
            }
            if !points.is_empty() {
                all.push((identity, points));
            }
        }
        let every = if query.step_s.is_some() { 1 } else { thin(&mut all, query.max_points) };
        let step_s = TIERS[coarsest].step_ns as f64 * 1e-9 * every as f64;
        Ok(HistoryResult { objects: all, step_s, kept: self.kept()? })
    }

    /// The finest tier from `tier` on in which an object's points of that time have not been forgotten.
    fn tier_since(&self, tier: usize, key: i64, since_ns: i64) -> Result<usize, HistoryError> {
        let mut ask = self
            .connection
            .prepare_cached("SELECT min(time_ns) FROM point WHERE tier = ?1 AND object = ?2")
            .map_err(|it| self.failed(it))?;
        for (tier, grade) in TIERS.iter().enumerate().skip(tier) {
            let first: Option<i64> = ask
                .query_row(params![tier as i64, key], |row| row.get(0))
                .map_err(|it| self.failed(it))?;
            if first.is_some_and(|first_ns| first_ns <= since_ns.saturating_add(grade.step_ns)) {
                return Ok(tier);
            }
        }
        Ok(TIERS.len() - 1)
    }

    fn objects(
        &self,
        query: &HistoryQuery,
    ) -> Result<Vec<(i64, i64, HistoryObject)>, HistoryError> {
        let mut ask = self
            .connection
            .prepare_cached(
                "SELECT key, run, id, name, kind, code, first_ns FROM object WHERE first_ns <= ?2 AND last_ns >= ?1
                 ORDER BY first_ns, id",
            )
            .map_err(|it| self.failed(it))?;
        let read = |row: &rusqlite::Row<'_>| {
            let id: i64 = row.get(2)?;
            let (run, name, kind, code) = (row.get(1)?, row.get(3)?, row.get(4)?, row.get(5)?);
            Ok((row.get(0)?, row.get(6)?, HistoryObject { run, id: id as u64, name, kind, code }))
        };
        let times = [query.from.as_ns(), query.until.as_ns()];
        let found = ask.query_map(times, read).map_err(|it| self.failed(it))?;
        let found: Result<Vec<(i64, i64, HistoryObject)>, _> = found.collect();
        let is_wanted = |identity: &HistoryObject| {
            query.objects.is_empty()
                || query.objects.iter().any(|it| {
                    *it == identity.name
                        || *it == identity.id.to_string()
                        || (identity.code > 0 && *it == identity.code.to_string())
                })
        };
        let found = found.map_err(|it| self.failed(it))?;
        Ok(found.into_iter().filter(|(_, _, identity)| is_wanted(identity)).collect())
    }

    fn points(
        &self,
        tier: usize,
        key: i64,
        query: &HistoryQuery,
    ) -> Result<Vec<HistoryPoint>, HistoryError> {
        let mut ask = self
            .connection
            .prepare_cached(
                "SELECT time_ns, x, y, z, yaw FROM point
                 WHERE tier = ?1 AND object = ?2 AND time_ns BETWEEN ?3 AND ?4 ORDER BY time_ns",
            )
            .map_err(|it| self.failed(it))?;
        let read = |row: &rusqlite::Row<'_>| {
            Ok(HistoryPoint {
                time: Timestamp::from_ns(row.get(0)?),
                position_m: [row.get(1)?, row.get(2)?, row.get(3)?],
                yaw_rad: row.get(4)?,
            })
        };
        let wanted = params![tier as i64, key, query.from.as_ns(), query.until.as_ns()];
        let points = ask.query_map(wanted, read).map_err(|it| self.failed(it))?;
        let is_inside = |point: &HistoryPoint| {
            query.region_m.is_none_or(|[min, max]| {
                (0..3).all(|axis| (min[axis]..=max[axis]).contains(&point.position_m[axis]))
            })
        };
        let points = points.filter(|point| point.as_ref().map_or(true, is_inside));
        points.collect::<Result<_, _>>().map_err(|it| self.failed(it))
    }

    fn kept(&self) -> Result<Option<(Timestamp, Timestamp)>, HistoryError> {
        let ask = "SELECT min(first_ns), max(last_ns) FROM object";
        let read = |row: &rusqlite::Row<'_>| Ok(row.get::<_, Option<i64>>(0)?.zip(row.get(1)?));
        let kept = self.connection.query_row(ask, [], read).optional();
        let kept = kept.map_err(|it| self.failed(it))?.flatten();
        Ok(kept.map(|(first, last)| (Timestamp::from_ns(first), Timestamp::from_ns(last))))
    }
}

/// Leaves every so many-th point, so that no more than `most` are left.
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

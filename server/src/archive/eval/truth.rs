//! Reads another system's trajectories: a CSV table, or a trajectory in TUM's format.
//!
//! A table's first line names its columns, in any order: the time as `time_ns` or `time_s` (or `timestamp`, in either
//! unit: above 1e14 it is nanoseconds), `x`, `y`, `z` in metres (or `x_m` …), optionally `qx`, `qy`, `qz`, `qw`, and
//! optionally the object as `object`, `name`, `id` or `code`. TUM's format has no header: time in seconds, x y z,
//! qx qy qz qw, separated by spaces. Lines that begin with # are skipped.

use std::collections::BTreeMap;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use roundel_core::time::Timestamp;

use super::{EvalError, Sample, Trajectory};

/// Larger values of `timestamp` are nanoseconds.
const NANOSECONDS_ABOVE: f64 = 1e14;

struct Columns {
    time: usize,
    /// `None`: by magnitude.
    in_seconds: Option<bool>,
    position: [usize; 3],
    orientation: Option<[usize; 4]>,
    name: Option<usize>,
}

/// Parses a file's text; its name is for errors.
pub fn read(file: &str, text: &str) -> Result<Vec<Trajectory>, EvalError> {
    let wrong =
        |line: usize, message: String| EvalError::Truth { file: file.to_owned(), line, message };
    let is_content = |line: &str| !line.trim().is_empty() && !line.trim().starts_with('#');
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| is_content(line)).peekable();
    let Some((first, head)) = lines.peek().copied() else {
        return Err(wrong(1, "expected a table of times and positions, found nothing".to_owned()));
    };
    let has_head = head.chars().any(|it| it.is_ascii_alphabetic() && !matches!(it, 'e' | 'E'));
    let by = if head.contains(',') { ',' } else { ' ' };
    let columns = if has_head {
        lines.next();
        columns(&split(head, by)).map_err(|message| wrong(first, message))?
    } else {
        Columns {
            time: 0,
            in_seconds: None,
            position: [1, 2, 3],
            orientation: Some([4, 5, 6, 7]),
            name: None,
        }
    };
    let mut all: BTreeMap<String, Trajectory> = BTreeMap::new();
    for (number, line) in lines {
        let (name, sample) =
            sample(&split(line, by), &columns).map_err(|message| wrong(number, message))?;
        let trajectory = all.entry(name.clone()).or_default();
        trajectory.name = name;
        if trajectory.samples.last().is_some_and(|last| last.time >= sample.time) {
            let message = "expected increasing times, found one that is not after the one before";
            return Err(wrong(number, message.to_owned()));
        }
        trajectory.samples.push(sample);
    }
    Ok(all.into_values().collect())
}

fn split(line: &str, by: char) -> Vec<&str> {
    match by {
        ',' => line.split(',').map(str::trim).collect(),
        _ => line.split_whitespace().collect(),
    }
}

fn columns(head: &[&str]) -> Result<Columns, String> {
    let place = |names: &[&str]| {
        head.iter().position(|it| names.iter().any(|name| it.eq_ignore_ascii_case(name)))
    };
    let wanted = |names: &[&str]| {
        place(names).ok_or_else(|| {
            format!("expected a column {}, found {}", names.join(" or "), head.join(", "))
        })
    };
    let time = wanted(&["time_ns", "time_s", "timestamp", "time", "t"])?;
    let in_seconds = match head[time].to_ascii_lowercase().as_str() {
        "time_ns" => Some(false),
        "time_s" => Some(true),
        _ => None,
    };
    let position = [wanted(&["x", "x_m"])?, wanted(&["y", "y_m"])?, wanted(&["z", "z_m"])?];
    let turn = [place(&["qx"]), place(&["qy"]), place(&["qz"]), place(&["qw"])];
    let orientation = match turn {
        [Some(x), Some(y), Some(z), Some(w)] => Some([x, y, z, w]),
        [None, None, None, None] => None,
        _ => return Err("expected all of qx, qy, qz and qw, or none of them".to_owned()),
    };
    let name = place(&["object", "name", "id", "object_id", "code", "robot"]);
    Ok(Columns { time, in_seconds, position, orientation, name })
}

fn sample(cells: &[&str], columns: &Columns) -> Result<(String, Sample), String> {
    let cell = |place: usize| {
        cells.get(place).copied().ok_or_else(|| {
            format!("expected at least {} columns, found {}", place + 1, cells.len())
        })
    };
    let number = |place: usize| {
        let text = cell(place)?;
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| format!("expected a number in column {}, found {text:?}", place + 1))
    };
    let stamp = number(columns.time)?;
    let in_seconds = columns.in_seconds.unwrap_or(stamp.abs() < NANOSECONDS_ABOVE);
    let text = cell(columns.time)?;
    // Doubles of that size do not hold nanoseconds exactly.
    let ns = match in_seconds {
        true => seconds_as_ns(text)?,
        false => text.parse().unwrap_or(stamp as i64),
    };
    let [x, y, z] = columns.position;
    let position_m = Vector3::new(number(x)?, number(y)?, number(z)?);
    let orientation = match columns.orientation {
        None => None,
        Some([x, y, z, w]) => {
            let turn = Quaternion::new(number(w)?, number(x)?, number(y)?, number(z)?);
            if (turn.norm() - 1.0).abs() > 1e-3 {
                return Err(format!("expected a quaternion of length 1, found {}", turn.norm()));
            }
            Some(UnitQuaternion::from_quaternion(turn))
        }
    };
    let name = columns.name.map_or(Ok(""), cell)?.to_owned();
    Ok((name, Sample { time: Timestamp::from_ns(ns), position_m, orientation }))
}

/// Parses decimal seconds exactly.
fn seconds_as_ns(text: &str) -> Result<i64, String> {
    let wrong = || format!("expected seconds, found {text:?}");
    let plain = text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    if !plain {
        let seconds: f64 = text.parse().map_err(|_| wrong())?;
        return Ok((seconds * 1e9).round() as i64);
    }
    let (whole, part) = text.split_once('.').unwrap_or((text, ""));
    let seconds: i64 = if whole.is_empty() { 0 } else { whole.parse().map_err(|_| wrong())? };
    let digits: String = part.chars().chain("000000000".chars()).take(9).collect();
    let ns: i64 = digits.parse().map_err(|_| wrong())?;
    seconds.checked_mul(1_000_000_000).map(|it| it + ns).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_and_tum_files_are_read_to_the_nanosecond() {
        let table = "time_ns,object,x,y,z\n1700000000123456789,a,1,2,3\n1700000000123456789,b,0,0,1\n\
                     1700000000223456789,a,1.5,2,3\n";
        let read_table = read("t.csv", table).unwrap();
        assert_eq!(read_table.len(), 2);
        assert_eq!((read_table[0].name.as_str(), read_table[0].samples.len()), ("a", 2));
        assert_eq!(read_table[0].samples[0].time.as_ns(), 1_700_000_000_123_456_789);
        let tum = "# time x y z qx qy qz qw\n1700000000.123456789 1 2 3 0 0 0 1\n1700000000.2 1 2 3 0 0 1 0\n";
        let tum = read("t.tum", tum).unwrap();
        assert_eq!(tum[0].samples[0].time, read_table[0].samples[0].time);
        assert!(tum[0].samples.iter().all(|sample| sample.orientation.is_some()));
        let middle = read_table[0].at(Timestamp::from_ns(1_700_000_000_173_456_789)).unwrap();
        assert!((middle.position_m.x - 1.25).abs() < 1e-12);
        assert_eq!(read_table[0].at(Timestamp::from_ns(1_700_000_000_000_000_000)), None);
    }

    #[test]
    fn errors_name_the_line() {
        let error = |text: &str| read("t.csv", text).unwrap_err().to_string();
        assert!(
            error("").contains("t.csv:1: expected a table of times and positions, found nothing")
        );
        assert!(
            error("time_s,x,y\n")
                .contains("t.csv:1: expected a column z or z_m, found time_s, x, y")
        );
        assert!(
            error("time_s,x,y,z\n0,1,2,3\n1,1,two,3\n")
                .contains("t.csv:3: expected a number in column 3")
        );
        assert!(
            error("time_s,x,y,z\n1,1,2,3\n1,1,2,3\n")
                .contains("t.csv:3: expected increasing times")
        );
        assert!(error("time_s,x,y,z,qx\n").contains("expected all of qx, qy, qz and qw"));
        assert!(error("0 1 2 3 0 0 0 2\n").contains("expected a quaternion of length 1, found 2"));
    }
}

//! Exports of a history: CSV, and Parquet with the feature `parquet`.

use std::{fmt::Write as _, ops::Deref};

use super::{
    HistoryError,
    store::{HistoryObject, HistoryPoint, HistoryResult},
};

/// Rows of a piece of a CSV table.
const PIECE_ROWS: usize = 500;
const CSV_HEADER: &str = "time_ns,object_id,name,roundel,code,x_m,y_m,z_m,yaw_rad,source_id\n";

/// A header and a row for each point, in pieces of some rows. Angles are in radians, lengths in metres; unknown values are
/// empty.
pub fn csv(result: impl Deref<Target = HistoryResult>) -> impl Iterator<Item = String> {
    let (mut object, mut row) = (0, 0);
    let rows = std::iter::from_fn(move || {
        let (identity, points) = result.objects.get(object)?;
        let next = points.len().min(row + PIECE_ROWS);
        let text = csv_rows(identity, &points[row..next]);
        (object, row) = if next < points.len() { (object, next) } else { (object + 1, 0) };
        Some(text)
    });
    std::iter::once(CSV_HEADER.to_owned()).chain(rows)
}

fn csv_rows(identity: &HistoryObject, points: &[HistoryPoint]) -> String {
    let quoted = |text: &str| {
        if text.contains([',', '"', '\n']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_owned()
        }
    };
    let [name, kind, run] = [&identity.name, &identity.kind, &identity.run].map(|it| quoted(it));
    let code = if identity.code > 0 { identity.code.to_string() } else { String::new() };
    let mut text = String::new();
    for point in points {
        let [x, y, z] = point.position_m;
        let yaw = point.yaw_rad.map_or(String::new(), |yaw| yaw.to_string());
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{},{},{name},{kind},{code},{x},{y},{z},{yaw},{run}",
            point.time.as_ns(),
            identity.id
        );
    }
    text
}

/// The same columns as Parquet: `time_ns` as a timestamp in UTC, `code` and `yaw_rad` null where unknown.
#[cfg(feature = "parquet")]
pub fn parquet(result: &HistoryResult) -> Result<Vec<u8>, HistoryError> {
    columns::write(result)
        .map_err(|error| HistoryError::Format(format!("cannot write Parquet: {error}")))
}

/// Fails, since the feature is disabled.
#[cfg(not(feature = "parquet"))]
pub fn parquet(_: &HistoryResult) -> Result<Vec<u8>, HistoryError> {
    Err(HistoryError::Format(
        "this server was built without Parquet (`cargo build --release -p roundel-server --features parquet` \
         includes it); history.csv has the same columns"
            .to_owned(),
    ))
}

#[cfg(feature = "parquet")]
mod columns {
    use std::{io::Write, sync::Arc};

    use parquet::{
        basic::{Compression, ZstdLevel},
        data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int32Type, Int64Type},
        errors::Result,
        file::{
            properties::WriterProperties,
            writer::{SerializedFileWriter, SerializedRowGroupWriter},
        },
        schema::parser::parse_message_type,
    };

    use crate::archive::history::store::{HistoryObject, HistoryPoint, HistoryResult};

    const SCHEMA: &str = "message history {
        required int64 time_ns (TIMESTAMP(NANOS, true));
        required int64 object_id;
        required binary name (STRING);
        required binary roundel (STRING);
        optional int32 code;
        required double x_m;
        required double y_m;
        required double z_m;
        optional double yaw_rad;
        required binary source_id (STRING);
    }";

    type Row<'a> = (&'a HistoryObject, &'a HistoryPoint);

    pub(super) fn write(result: &HistoryResult) -> Result<Vec<u8>> {
        let rows: Vec<Row> = result
            .objects
            .iter()
            .flat_map(|(identity, points)| points.iter().map(move |point| (identity, point)))
            .collect();
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .build();
        let schema = Arc::new(parse_message_type(SCHEMA)?);
        let mut file = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
        let mut group = file.next_row_group()?;
        let text = |text: &str| Some(ByteArray::from(text));
        let all = rows.as_slice();
        column::<Int64Type, _>(&mut group, all, |(_, point)| Some(point.time.as_ns()))?;
        column::<Int64Type, _>(&mut group, all, |(identity, _)| i64::try_from(identity.id).ok())?;
        column::<ByteArrayType, _>(&mut group, all, |(identity, _)| text(&identity.name))?;
        column::<ByteArrayType, _>(&mut group, all, |(identity, _)| text(&identity.kind))?;
        column::<Int32Type, _>(&mut group, all, |(identity, _)| {
            i32::try_from(identity.code).ok().filter(|&code| code > 0)
        })?;
        for axis in 0..3 {
            column::<DoubleType, _>(&mut group, all, |(_, point)| Some(point.position_m[axis]))?;
        }
        column::<DoubleType, _>(&mut group, all, |(_, point)| point.yaw_rad)?;
        column::<ByteArrayType, _>(&mut group, all, |(identity, _)| text(&identity.run))?;
        group.close()?;
        file.into_inner()
    }

    /// Writes the next column; `None` is null.
    fn column<T: DataType, W: Write + Send>(
        group: &mut SerializedRowGroupWriter<'_, W>,
        rows: &[Row],
        value: impl Fn(Row) -> Option<T::T>,
    ) -> Result<()> {
        let Some(mut column) = group.next_column()? else { return Ok(()) };
        let values: Vec<Option<T::T>> = rows.iter().map(|&row| value(row)).collect();
        let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
        let present: Vec<T::T> = values.into_iter().flatten().collect();
        column.typed::<T>().write_batch(&present, Some(&levels), None)?;
        column.close()
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::time::Timestamp;

    use super::*;

    fn result() -> HistoryResult {
        let identity = |id, name: &str, code| HistoryObject {
            run: "r1".into(),
            id,
            name: name.into(),
            kind: "robot".into(),
            code,
        };
        let point = |ns, x_m, yaw_rad| HistoryPoint {
            time: Timestamp::from_ns(ns),
            position_m: [x_m, -0.5, 0.25],
            yaw_rad,
        };
        HistoryResult {
            objects: vec![
                (
                    identity(3, "cart, \"old\"", 12),
                    vec![point(1, 1.5, Some(0.5)), point(2, 2.5, None)],
                ),
                (identity(4, "", 0), vec![point(1, -1.0, None)]),
            ],
            step_s: 0.1,
            kept: None,
        }
    }

    #[test]
    fn csv_quotes_special_characters() {
        let text: String = csv(&result()).collect();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[1], r#"1,3,"cart, ""old""",robot,12,1.5,-0.5,0.25,0.5,r1"#);
        assert_eq!(rows[2], r#"2,3,"cart, ""old""",robot,12,2.5,-0.5,0.25,,r1"#);
        assert_eq!(rows[3], "1,4,,robot,,-1,-0.5,0.25,,r1");
        assert_eq!(rows.len(), 4);
    }

    #[test]
    fn csv_pieces_have_every_row_once() {
        let mut long = result();
        let first = long.objects[0].1[0];
        long.objects[0].1 = vec![first; 2 * PIECE_ROWS + 1];
        let pieces: Vec<String> = csv(&long).collect();
        let rows = |piece: &String| piece.lines().count();
        assert_eq!(pieces.iter().map(rows).collect::<Vec<_>>(), [1, PIECE_ROWS, PIECE_ROWS, 1, 1]);
    }

    #[cfg(not(feature = "parquet"))]
    #[test]
    fn without_the_feature_the_error_says_how_to_enable_it() {
        let error = parquet(&result()).unwrap_err().to_string();
        assert!(error.contains("--features parquet"), "{error}");
    }
}

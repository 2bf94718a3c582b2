use std::{collections::BTreeMap, fs};

use prost::Message;
use roundel_proto::v1;

use super::*;
use crate::archive::record::file_writer::{FileWriter, MessageStamp};

/// Ten seconds of ten snapshots each, flushed every second.
fn recorded(folder: &Path) -> PathBuf {
    let path = folder.join("run.mcap");
    let about = BTreeMap::from([("installation".to_owned(), "lab".to_owned())]);
    let mut writer = FileWriter::create(&path, &about).unwrap();
    for sequence in 0..100u64 {
        let log_time = Timestamp::from_ns(1_000_000_000 + sequence as i64 * 100_000_000);
        let message = v1::Snapshot { sequence, ..v1::Snapshot::default() };
        writer.write(Topic::Snapshots, MessageStamp::at(log_time, sequence), &message).unwrap();
        if sequence % 10 == 9 {
            writer.flush().unwrap();
        }
    }
    let bytes = writer.finish().unwrap();
    assert_eq!(bytes, fs::metadata(&path).unwrap().len());
    path
}

fn sequences(reader: &mut FileReader) -> Vec<u64> {
    let mut found = Vec::new();
    while let Some(messages) = reader.next_chunk().unwrap() {
        for raw in messages {
            assert_eq!(raw.channel, Channel::Topic(Topic::Snapshots));
            let snapshot = v1::Snapshot::decode(raw.data.as_slice()).unwrap();
            assert_eq!(u64::from(raw.sequence), snapshot.sequence);
            found.push(snapshot.sequence);
        }
    }
    found
}

#[test]
fn a_complete_file_is_read_from_any_position() {
    let folder = tempfile::tempdir().unwrap();
    let mut reader = FileReader::open(&recorded(folder.path())).unwrap();
    assert_eq!(reader.metadata()["installation"], "lab");
    assert_eq!(reader.damage(), &Damage::default());
    let (begin, end) = reader.span().unwrap();
    assert_eq!((begin.as_ns(), end.as_ns()), (1_000_000_000, 10_900_000_000));
    assert!(sequences(&mut reader).into_iter().eq(0..100));
    let chunk = reader.chunk_at(begin.plus_seconds(5.05));
    reader.seek(chunk);
    assert!(sequences(&mut reader).into_iter().eq(50..100));
}

#[test]
fn a_truncated_file_is_read_to_its_last_complete_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let whole = fs::read(recorded(folder.path())).unwrap();
    let cut = folder.path().join("cut.mcap");
    let mut most = 0;
    for length in (MAGIC.len()..whole.len() - MAGIC.len()).step_by(97) {
        fs::write(&cut, &whole[..length]).unwrap();
        match FileReader::open(&cut) {
            Ok(mut reader) => {
                let found = sequences(&mut reader);
                assert_eq!(found.len() % 10, 0, "chunks are complete or absent");
                assert!(found.len() >= most && found.iter().copied().eq(0..found.len() as u64));
                most = found.len();
                if reader.damage().is_cut_off {
                    let reported = reader.damage().sentences.join("; ");
                    assert!(reported.contains("the file has no end"), "{reported}");
                }
            }
            Err(error) => {
                assert_eq!(most, 0, "{error}");
                assert!(error.to_string().contains("without a complete chunk"), "{error}");
            }
        }
    }
    assert_eq!(most, 100);
}

#[test]
fn a_broken_chunk_is_skipped_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let mut bytes = fs::read(&path).unwrap();
    let place = FileReader::open(&path).unwrap().chunks()[4].clone();
    // Within the compressed messages, after the chunk's header.
    let broken = place.offset as usize + 9 + 60;
    bytes[broken] ^= 0x55;
    fs::write(&path, bytes).unwrap();
    let mut reader = FileReader::open(&path).unwrap();
    let found = sequences(&mut reader);
    assert_eq!(found.len(), 90, "{found:?}");
    let reported = reader.damage().sentences.join("; ");
    assert!(
        reported.contains(&format!("the chunk at byte {} is corrupt", place.offset)),
        "{reported}"
    );
    assert!(reader.damage().bytes > 0 && !reader.damage().is_cut_off);
}

#[test]
fn errors_say_what_a_foreign_file_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let error = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        FileReader::open(&path).err().map(|error| error.to_string()).unwrap_or_default()
    };
    assert!(error(b"").contains("found an empty file"));
    assert!(error(b"\x89PNG\r\n\x1a\n....").contains("found a PNG image"));
    assert!(error(b"time,x,y\n").contains("a file that begins with \"time,x,y\""));
    assert!(error(&MAGIC[..5]).contains("only 5 bytes of one"));
    let missing = FileReader::open(&folder.path().join("b.mcap")).err().unwrap().to_string();
    assert!(missing.contains("cannot read") && missing.contains("b.mcap"), "{missing}");

    let mut other = mcap::Writer::new(io::Cursor::new(Vec::new())).unwrap();
    other.add_channel(0, "/imu", "json", &BTreeMap::new()).unwrap();
    other.finish().unwrap();
    let error = error(other.into_inner().get_ref());
    assert!(error.contains("an MCAP file of another program, with the topics /imu"), "{error}");
}

#[test]
fn a_later_format_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("later.mcap");
    let mut writer = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    let metadata =
        BTreeMap::from([("format", "7"), ("version", "3.1")].map(|(k, v)| (k.into(), v.into())));
    writer.write_metadata(&mcap::records::Metadata { name: METADATA.into(), metadata }).unwrap();
    writer.finish().unwrap();
    let error = FileReader::open(&path).err().unwrap().to_string();
    assert!(error.contains("recorded by Roundel 3.1 in format 7"), "{error}");
}

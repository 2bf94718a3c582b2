//! Recordings with damage: every command reads what it can, reports the rest, and never panics or exhausts the memory.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use roundel_server::archive::{
    eval::estimate,
    record::{
        file_reader::{FileReader, ReadError},
        file_writer::{FileWriter, MessageStamp},
        schema::Topic,
    },
    replay::{
        ReplayFrom,
        copy::copy,
        reader::Reader,
        session::{ReplayOptions, ReplaySession},
    },
};

use super::failures::{Lab, recorded};

const MUTATIONS: u64 = 300;
/// Virtual memory of a process that reads a damaged file of some kilobytes. The allocator alone reserves 1 GB.
const MEMORY_KB: u64 = 2_000_000;

/// A small deterministic generator, so that a failing case can be repeated by its number.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % bound
    }
}

/// Flips bits, overwrites numbers, moves or removes parts, or cuts the end off.
fn damage(whole: &[u8], seed: u64) -> Vec<u8> {
    let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mut bytes = whole.to_vec();
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len().max(1));
        match random.below(6) {
            0 => bytes.truncate(at),
            1 if at + 8 <= bytes.len() => {
                let number = [u64::MAX, 1 << 40, 1 << 31, 0][random.below(4)];
                bytes[at..at + 8].copy_from_slice(&number.to_le_bytes());
            }
            2 => {
                let end = (at + random.below(200)).min(bytes.len());
                bytes.drain(at..end);
            }
            3 => {
                let end = (at + random.below(200)).min(bytes.len());
                let part = bytes[at..end].to_vec();
                let to = random.below(bytes.len().max(1));
                bytes.splice(to..to, part);
            }
            _ if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            _ => {}
        }
    }
    bytes
}

/// Reads a file in every way; returns the number of readable messages.
fn read_all(path: &Path) -> Result<usize, ReadError> {
    let mut reader = FileReader::open(path)?;
    let mut messages = 0;
    while let Some(some) = reader.next_chunk().unwrap() {
        messages += some.len();
    }
    let _ = (reader.span(), reader.collect(Topic::Health).unwrap());
    if let Ok(mut reader) = Reader::open(path, false) {
        let _ = estimate::read(&mut reader);
    }
    for from in [ReplayFrom::Snapshots, ReplayFrom::Observations] {
        let options = ReplayOptions { file: path.to_owned(), from, config: None };
        let to = path.with_extension("copy");
        let _ = fs::remove_file(&to);
        if let Ok(session) = ReplaySession::open(&options) {
            let _ = copy(session, &to, |_| {});
        }
    }
    Ok(messages)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn mutated_recordings_are_read_as_far_as_possible() {
    let lab = Lab::new("frames_every = 30\nmin_free_mb = 0\nstart = true\n");
    let good = recorded(&lab).await;
    let whole = fs::read(&good).unwrap();
    let all = read_all(&good).unwrap();
    assert!(all > 50, "{all}");
    let path = lab.folder.path().join("mutated.mcap");
    let mut partly = 0;
    for seed in 0..MUTATIONS {
        fs::write(&path, damage(&whole, seed)).unwrap();
        println!("seed {seed}");
        match read_all(&path) {
            Ok(found) => partly += usize::from(found > 0 && found < all),
            Err(error) => assert!(error.to_string().contains("mutated.mcap"), "{seed}: {error}"),
        }
    }
    assert!(partly > 50, "{partly}");
}

fn info(file: &Path) -> (Option<i32>, String) {
    let command = format!("ulimit -v {MEMORY_KB}; exec \"$0\" \"$@\"");
    let output = Command::new("sh")
        .args(["-c", &command, env!("CARGO_BIN_EXE_roundel"), "info"])
        .arg(file)
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&text).into_owned())
}

#[test]
fn a_recording_names_the_damaged_chunk_and_what_is_left() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/hostile");
    let Ok(entries) = fs::read_dir(&folder) else {
        println!("skipped: a_recording_names_the_damaged_chunk_and_what_is_left needs ../shared");
        return;
    };
    let files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    let files = files.iter().filter(|it| it.extension().is_some_and(|it| it == "mcap"));
    let mut count = 0;
    for file in files {
        count += 1;
        let (code, text) = info(file);
        assert_eq!(code, Some(1), "{}: {text}", file.display());
        let names_place = text.contains("the chunk at byte") || text.contains("error: ");
        assert!(names_place, "{}: {text}", file.display());
        let (from, config) = (ReplayFrom::Snapshots, None);
        let _ = ReplaySession::open(&ReplayOptions { file: file.clone(), from, config });
    }
    assert!(count >= 10, "{count} files in {}", folder.display());
}

#[test]
fn a_chunk_that_claims_gigabytes_is_reported_within_the_memory_limit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = FileWriter::create(&path, &Default::default()).unwrap();
    for number in 0..10u64 {
        let message = roundel_proto::v1::Snapshot::default();
        writer
            .write(
                Topic::Snapshots,
                MessageStamp { sequence: number, ..Default::default() },
                &message,
            )
            .unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    let reader = FileReader::open(&path).unwrap();
    let place = reader.chunks()[5].offset as usize;
    let mut bytes = fs::read(&path).unwrap();
    // After opcode, length and two times: the uncompressed size.
    bytes[place + 25..place + 33].copy_from_slice(&(1u64 << 36).to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let (code, text) = info(&path);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains(&format!("the chunk at byte {place} is corrupt")), "{text}");
    assert!(text.contains("claim to expand to 68.7 GB") && text.contains("/snapshots"), "{text}");
}

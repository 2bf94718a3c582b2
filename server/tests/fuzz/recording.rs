//! Recordings.

use std::{fs, path::Path};

use roundel_server::{
    app::cli::info,
    archive::{
        eval::estimate,
        record::file_reader::FileReader,
        replay::{
            ReplayFrom,
            copy::copy,
            reader::Reader,
            session::{ReplayOptions, ReplaySession},
        },
    },
};

use super::lab::with_file;

/// Every command reads what it can, and what `replay --output` writes is not damaged.
pub fn run(data: &[u8]) {
    with_file("recording.mcap", data, read);
}

fn read(path: &Path) {
    let Ok(mut reader) = FileReader::open(path) else { return };
    info::table(&info::read(&mut reader).unwrap());
    let lost = reader.damage().bytes;
    assert!(lost <= reader.length(), "{lost} bytes of {} are lost", reader.length());
    if let Ok(mut reader) = Reader::open(path, false) {
        let _ = estimate::read(&mut reader);
    }
    for from in [ReplayFrom::Snapshots, ReplayFrom::Observations, ReplayFrom::Frames] {
        let options = ReplayOptions { file: path.to_owned(), from, config: None };
        let to = path.with_extension("copy");
        let Ok(session) = ReplaySession::open(&options) else { continue };
        if copy(session, &to, |_| {}).is_ok()
            && let Ok(mut copied) = FileReader::open(&to)
        {
            while copied.next_chunk().unwrap().is_some() {}
            assert!(copied.damage().sentences.is_empty(), "{:?}", copied.damage());
        }
        let _ = fs::remove_file(&to);
    }
}

//! Opens and reads regular files only.
//!
//! A path in a configuration or a request may name a device, a pipe or a socket. Opening a pipe blocks, reading
//! `/dev/zero` never ends, and opening a watchdog device starts it. The type is therefore checked twice: of the path,
//! so that other files are not even opened, and of the opened file, so that a path that is replaced in between has no
//! effect. `O_NONBLOCK` keeps that second case from blocking.

use std::{
    fs::{self, File, FileType, OpenOptions},
    io::{self, Read},
    os::unix::fs::{FileTypeExt, OpenOptionsExt},
    path::Path,
};

use rustix::fs::OFlags;

/// Opens a regular file for reading.
pub fn open(path: &Path) -> io::Result<File> {
    check(fs::metadata(path)?.file_type())?;
    // The standard library adds O_CLOEXEC.
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path)?;
    check(file.metadata()?.file_type())?;
    Ok(file)
}

/// Reads a regular file of at most `max_bytes`.
pub fn read(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let size = file.metadata()?.len();
    let mut bytes = Vec::new();
    // A file may grow while it is read, and those of /proc have the size 0.
    if size <= max_bytes {
        file.take(max_bytes + 1).read_to_end(&mut bytes)?;
    }
    if size.max(bytes.len() as u64) > max_bytes {
        let message = format!("it is larger than {}", size_in_words(max_bytes));
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// Reads a regular UTF-8 file of at most `max_bytes`.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    String::from_utf8(read(path, max_bytes)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let message = format!("expected UTF-8 text, found other bytes after byte {at}");
        io::Error::new(io::ErrorKind::InvalidData, message)
    })
}

fn check(found: FileType) -> io::Result<()> {
    if found.is_file() {
        return Ok(());
    }
    let found = if found.is_dir() {
        "a folder"
    } else if found.is_char_device() {
        "a character device"
    } else if found.is_block_device() {
        "a block device"
    } else if found.is_fifo() {
        "a pipe"
    } else if found.is_socket() {
        "a socket"
    } else {
        "a file of another type"
    };
    let message = format!("it is not a regular file ({found})");
    Err(io::Error::new(io::ErrorKind::InvalidInput, message))
}

fn size_in_words(bytes: u64) -> String {
    match bytes >> 20 {
        0 => format!("{bytes} bytes"),
        megabytes => format!("{megabytes} MB"),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixListener;

    use super::*;

    #[test]
    fn only_regular_files_are_opened() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("a.txt"), "text").unwrap();
        std::os::unix::fs::symlink("a.txt", at("link")).unwrap();
        assert_eq!(read_text(&at("link"), 4).unwrap(), "text");
        let _socket = UnixListener::bind(at("socket")).unwrap();
        rustix::fs::mknodat(
            rustix::fs::CWD,
            at("pipe"),
            rustix::fs::FileType::Fifo,
            rustix::fs::Mode::RUSR,
            0,
        )
        .unwrap();
        for (path, expected) in [
            (at("socket"), "it is not a regular file (a socket)"),
            (at("pipe"), "it is not a regular file (a pipe)"),
            (at(""), "it is not a regular file (a folder)"),
            ("/dev/zero".into(), "it is not a regular file (a character device)"),
            ("/dev/ptmx".into(), "it is not a regular file (a character device)"),
            (at("none"), "No such file"),
        ] {
            let error = read(&path, 10).unwrap_err().to_string();
            assert!(error.contains(expected), "{}: {error}", path.display());
        }
    }

    #[test]
    fn reading_stops_at_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large");
        fs::write(&path, [b'a'; 100]).unwrap();
        assert_eq!(read(&path, 100).unwrap().len(), 100);
        assert_eq!(read(&path, 99).unwrap_err().to_string(), "it is larger than 99 bytes");
        // Sparse: it takes no space.
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(read(&path, 2 << 20).unwrap_err().to_string(), "it is larger than 2 MB");
        // Reports the size 0, and is longer.
        if let Ok(text) = fs::read("/proc/self/status") {
            assert_eq!(
                read(Path::new("/proc/self/status"), 10).unwrap_err().kind(),
                io::ErrorKind::FileTooLarge
            );
            assert!(text.len() > 10);
        }
        fs::write(&path, [b'a', 0xFF]).unwrap();
        let error = read_text(&path, 9).unwrap_err().to_string();
        assert_eq!(error, "expected UTF-8 text, found other bytes after byte 1");
    }
}

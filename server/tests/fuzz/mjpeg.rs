//! Streams of JPEGs from network cameras.

use roundel_core::time::Timestamp;
use roundel_server::capture::source::http::jpeg_splitter::{JpegSplitter, StampedJpeg};

/// The pictures and the number of broken ones do not depend on the chunks, and the pictures are parts of the stream.
pub fn run(data: &[u8]) {
    let Some((length, stream)) = data.split_first() else { return };
    let whole = split(stream, stream.len());
    assert_eq!(split(stream, 1 + 3 * usize::from(*length)), whole);
    let (pictures, broken) = whole;
    let bytes: usize = pictures.iter().map(|picture| picture.jpeg.len()).sum();
    assert!(bytes <= stream.len() && broken <= stream.len() as u64);
    for StampedJpeg { jpeg, .. } in pictures {
        assert!(jpeg.starts_with(&[0xFF, 0xD8, 0xFF]) && jpeg.ends_with(&[0xFF, 0xD9]));
    }
}

fn split(stream: &[u8], length: usize) -> (Vec<StampedJpeg>, u64) {
    let (mut splitter, mut pictures) = (JpegSplitter::default(), Vec::new());
    for chunk in stream.chunks(length.max(1)) {
        splitter.push(chunk, Timestamp::default());
        while let Some(picture) = splitter.pop() {
            pictures.push(picture);
        }
    }
    (pictures, splitter.take_broken())
}

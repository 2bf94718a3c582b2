//! Parses records and chunks of a file that may be damaged or hostile.
//!
//! A length is checked against the bytes that follow it before memory is reserved for it, and a chunk is decompressed
//! only as far as its compressed bytes really go, so that a few wrong bytes cannot exhaust the memory.

use std::io::Read;

use anyhow::{Context as _, bail, ensure};
use mcap::records::{Record, op};

use super::megabytes;

/// Limit of a decompressed chunk. Chunks are closed at 1 MB; only a large picture exceeds that.
const MAX_CHUNK_BYTES: u64 = 256 << 20;
const OPCODE_AND_LENGTH: usize = 9;

/// Parses a record of a kind that recordings use; `None` for any other.
pub(super) fn parse(opcode: u8, body: &[u8]) -> anyhow::Result<Option<Record<'_>>> {
    let lengths = match opcode {
        op::SCHEMA => Lengths { fixed: 2, strings: 2, has_map: false },
        op::CHANNEL => Lengths { fixed: 4, strings: 2, has_map: true },
        op::METADATA => Lengths { fixed: 0, strings: 1, has_map: true },
        // Times, uncompressed size and checksum come first.
        op::CHUNK => Lengths { fixed: 28, strings: 1, has_map: false },
        op::MESSAGE => Lengths { fixed: 0, strings: 0, has_map: false },
        _ => return Ok(None),
    };
    lengths.check(body).context("a length exceeds its record")?;
    Ok(Some(mcap::read::parse_record(opcode, body)?))
}

/// The records within a chunk, as bytes.
pub(super) fn decompress(body: &[u8]) -> anyhow::Result<Vec<u8>> {
    let Some(Record::Chunk { header, data }) = parse(op::CHUNK, body)? else {
        bail!("not a chunk");
    };
    let size = header.uncompressed_size;
    ensure!(
        size <= MAX_CHUNK_BYTES,
        "{} claim to expand to {}, expected at most {}",
        megabytes(data.len() as u64),
        megabytes(size),
        megabytes(MAX_CHUNK_BYTES)
    );
    let mut records = Vec::new();
    match header.compression.as_str() {
        "" => records.extend_from_slice(&data),
        "zstd" => {
            let decoder = zstd::stream::read::Decoder::with_buffer(&*data)?;
            decoder.take(size + 1).read_to_end(&mut records)?;
        }
        other => bail!("expected the compression `zstd` or none, found {other:?}"),
    }
    let found = records.len() as u64;
    ensure!(found == size, "expected {size} bytes of records, found {found}");
    let checksum = header.uncompressed_crc;
    ensure!(checksum == 0 || checksum == crc32fast::hash(&records), "its checksum is wrong");
    Ok(records)
}

/// Splits off the first of these records: opcode, body, and the rest.
pub(super) fn split_record(records: &[u8]) -> anyhow::Result<(u8, &[u8], &[u8])> {
    let (head, rest) =
        records.split_at_checked(OPCODE_AND_LENGTH).context("a record is cut off")?;
    let length = u64::from_le_bytes(head[1..].try_into()?);
    let body = usize::try_from(length).ok().and_then(|length| rest.split_at_checked(length));
    let (body, rest) = body.with_context(|| format!("a record of {length} bytes is cut off"))?;
    Ok((head[0], body, rest))
}

/// Where a record has strings, whose lengths precede them.
struct Lengths {
    /// Bytes before the first string.
    fixed: usize,
    strings: usize,
    /// A list of strings, preceded by its length in bytes, follows.
    has_map: bool,
}

impl Lengths {
    fn check(&self, body: &[u8]) -> Option<()> {
        let mut rest = body.get(self.fixed..)?;
        for _ in 0..self.strings {
            rest = split_string(rest)?.1;
        }
        if self.has_map {
            let mut map = split_string(rest)?.0;
            while !map.is_empty() {
                map = split_string(map)?.1;
            }
        }
        Some(())
    }
}

/// Splits off the bytes whose number the first four bytes give.
fn split_string(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_beyond_its_record_is_rejected_before_memory_is_reserved() {
        let huge = u32::MAX.to_le_bytes();
        for (opcode, fixed) in
            [(op::SCHEMA, 2), (op::CHANNEL, 4), (op::METADATA, 0), (op::CHUNK, 28)]
        {
            let body = [&vec![0; fixed], &huge[..], b"name"].concat();
            let error = parse(opcode, &body).unwrap_err().to_string();
            assert!(error.contains("a length exceeds its record"), "{error}");
        }
        assert!(parse(op::ATTACHMENT, &[]).unwrap().is_none());
        let record = [&[op::MESSAGE][..], &u64::MAX.to_le_bytes(), b"body"].concat();
        assert!(split_record(&record).is_err() && split_record(&record[..4]).is_err());
    }

    #[test]
    fn a_chunk_that_claims_too_much_is_rejected() {
        let chunk = |size: u64, compression: &str, data: &[u8]| {
            let mut body = [0; 16].to_vec();
            body.extend(size.to_le_bytes());
            body.extend([0; 4]);
            body.extend((compression.len() as u32).to_le_bytes());
            body.extend(compression.as_bytes());
            body.extend((data.len() as u64).to_le_bytes());
            body.extend(data);
            decompress(&body).map_err(|error| error.to_string())
        };
        let zeros = zstd::bulk::compress(&[0; 5000], 1).unwrap();
        assert_eq!(chunk(5000, "zstd", &zeros), Ok(vec![0; 5000]));
        for (size, expected) in [
            (4999, "expected 4999 bytes of records, found 5000"),
            (5001, "found 5000"),
            (u64::MAX, "claim to expand to"),
        ] {
            let error = chunk(size, "zstd", &zeros).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert!(chunk(4, "lz4", b"abcd").unwrap_err().contains("found \"lz4\""));
        assert!(chunk(4, "zstd", b"abcd").is_err());
    }
}

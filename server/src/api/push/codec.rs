//! Codec of `Push.Send`: counts the detections of a message before it decodes them.
//!
//! An empty detection takes two bytes in a message and hundreds in memory, so the size of a message does not bound the
//! memory of the decoded one.

use std::sync::Arc;

use bytes::Buf as _;
use prost::{
    DecodeError,
    encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field},
};
use roundel_proto::v1;
use tonic::{
    Status,
    codec::{BufferSettings, Codec, DecodeBuf, Decoder},
};
use tonic_prost::{ProstDecoder, ProstEncoder};

use crate::{api::error::ApiError, capture::source::push::PushEndpoints};

/// Fields from PushRequest to the detections: `observations.observations.detections`.
const OBSERVATIONS: [u32; 3] = [3, 3, 6];
/// `picture.observations.detections`.
const PICTURE: [u32; 3] = [6, 4, 6];

pub(super) struct PushCodec(pub(super) Arc<PushEndpoints>);

impl Codec for PushCodec {
    type Encode = v1::PushResponse;
    type Decode = v1::PushRequest;
    type Encoder = ProstEncoder<v1::PushResponse>;
    type Decoder = PushDecoder;

    fn encoder(&mut self) -> Self::Encoder {
        ProstEncoder::new(BufferSettings::default())
    }

    fn decoder(&mut self) -> PushDecoder {
        PushDecoder {
            endpoints: self.0.clone(),
            decoder: ProstDecoder::new(BufferSettings::default()),
        }
    }
}

pub(super) struct PushDecoder {
    endpoints: Arc<PushEndpoints>,
    decoder: ProstDecoder<v1::PushRequest>,
}

impl Decoder for PushDecoder {
    type Item = v1::PushRequest;
    type Error = Status;

    fn decode(&mut self, message: &mut DecodeBuf<'_>) -> Result<Option<v1::PushRequest>, Status> {
        // The buffer of a message is contiguous. tonic reports a malformed one below.
        let count = |path| count(message.chunk(), path).unwrap_or(0);
        check_count(count(&OBSERVATIONS), self.endpoints.max_detections(), "observations")?;
        check_count(count(&PICTURE), self.endpoints.max_detections(), "picture.observations")?;
        self.decoder.decode(message)
    }
}

fn check_count(found: usize, most: usize, field: &str) -> Result<(), ApiError> {
    if found <= most {
        return Ok(());
    }
    let expected =
        format!("at most {most} in a frame ([limits] max_roundels_per_camera of the server)");
    Err(ApiError::invalid(format!("{field}.detections"), expected, found))
}

/// Number of occurrences of the field at the end of `path`, all of whose fields hold messages.
fn count(mut message: &[u8], path: &[u32]) -> Result<usize, DecodeError> {
    let [field, inner @ ..] = path else { return Ok(1) };
    let mut sum = 0;
    while message.has_remaining() {
        let (tag, wire_type) = decode_key(&mut message)?;
        if tag != *field || wire_type != WireType::LengthDelimited {
            skip_field(wire_type, tag, &mut message, DecodeContext::default())?;
            continue;
        }
        let length = usize::try_from(decode_varint(&mut message)?).unwrap_or(usize::MAX);
        // Decoding reports a message that ends early.
        let Some((content, rest)) = message.split_at_checked(length) else { break };
        sum += self::count(content, inner)?;
        message = rest;
    }
    Ok(sum)
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;

    fn frame(detections: usize) -> Option<v1::FrameObservations> {
        let detections = vec![v1::Detection::default(); detections];
        Some(v1::FrameObservations { camera: "north".into(), detections, ..Default::default() })
    }

    #[test]
    fn detections_are_counted_without_decoding() {
        use v1::push_request::Message;
        let observations =
            v1::PushedObservations { sequence: 7, observations: frame(9), ..Default::default() };
        let picture = v1::PushedPicture { observations: frame(5), ..Default::default() };
        let counts = |message| {
            let bytes = v1::PushRequest { message: Some(message) }.encode_to_vec();
            [&OBSERVATIONS, &PICTURE].map(|path| count(&bytes, path).unwrap())
        };
        assert_eq!(counts(Message::Observations(observations.clone())), [9, 0]);
        assert_eq!(counts(Message::Picture(picture)), [0, 5]);
        // A repeated field extends the first one.
        let message = Some(Message::Observations(observations));
        let bytes = v1::PushRequest { message }.encode_to_vec();
        assert_eq!(count(&[bytes.clone(), bytes.clone()].concat(), &OBSERVATIONS), Ok(18));
        // Truncated messages are left to the decoder.
        for length in 0..bytes.len() {
            assert!(count(&bytes[..length], &OBSERVATIONS).unwrap_or(0) <= 9);
        }
    }

    #[test]
    fn the_error_names_the_key_that_limits() {
        let error = check_count(40_000, 400, "observations").unwrap_err().to_string();
        assert_eq!(
            error,
            "observations.detections: expected at most 400 in a frame ([limits] max_roundels_per_camera of the server), \
             found 40000"
        );
        assert_eq!(check_count(400, 400, "observations"), Ok(()));
    }
}

//! SubscribeSnapshots: a tonic service with a codec of its own, so that subscribers share encoded snapshots.
//!
//! The generated service would encode every message for every subscriber. Here the stream yields [`EncodedSnapshot`]s,
//! and the codec copies them into the connection's buffer. hyper polls the stream when the client has flow-control window,
//! so a slow client gets the newest snapshot and the number that it missed.

use std::{
    convert::Infallible,
    future::{Ready, ready},
    sync::{Arc, atomic::Ordering},
};

use axum::{body::Body, extract::Request, http::Response};
use bytes::BufMut as _;
use futures::{StreamExt as _, stream};
use roundel_proto::v1;
use tonic::{
    Status,
    codec::{BufferSettings, Codec, EncodeBuf, Encoder},
    server::{Grpc, ServerStreamingService},
};
use tonic_prost::ProstDecoder;

use super::{Messages, until_shutdown};
use crate::api::{
    ApiState, MAX_REQUEST_BYTES,
    encoding_budget::EncodingShare,
    error::ApiError,
    listener::encoding_share,
    selection::{MESSAGE_FIELDS, Selection},
    snapshot_encoder::Encoding,
    snapshot_subscription::{EncodedSnapshot, SnapshotSubscription},
};

/// The method's path, which its route takes from the generated service.
pub(super) const PATH: &str = "/roundel.v1.Roundel/SubscribeSnapshots";
/// Average over all connections; a single one may have more.
const SUBSCRIPTIONS_PER_CLIENT: usize = 4;

pub(super) async fn subscribe(
    api: Arc<ApiState>,
    request: Request,
) -> Result<Response<tonic::body::Body>, Infallible> {
    let mut grpc =
        Grpc::new(SnapshotCodec).apply_max_message_size_config(Some(MAX_REQUEST_BYTES), None);
    Ok(grpc.server_streaming(Subscribe(api), request.map(Body::new)).await)
}

struct Subscribe(Arc<ApiState>);

impl ServerStreamingService<v1::SubscribeSnapshotsRequest> for Subscribe {
    type Response = EncodedSnapshot;
    type ResponseStream = Messages<EncodedSnapshot>;
    type Future = Ready<Result<tonic::Response<Self::ResponseStream>, Status>>;

    fn call(&mut self, request: tonic::Request<v1::SubscribeSnapshotsRequest>) -> Self::Future {
        let share = encoding_share(request.extensions());
        ready(self.stream(request.into_inner(), share).map_err(Status::from))
    }
}

impl Subscribe {
    fn stream(
        &self,
        request: v1::SubscribeSnapshotsRequest,
        share: Arc<EncodingShare>,
    ) -> Result<tonic::Response<Messages<EncodedSnapshot>>, ApiError> {
        let api = &self.0;
        let selection = Selection::new(request, &api.hub.installation().kinds, &MESSAGE_FIELDS)?;
        check_subscription_limit(api)?;
        let subscription = SnapshotSubscription::new(api.clone(), selection, share);
        let snapshots = stream::unfold(subscription, |mut subscription| async move {
            let snapshot = subscription.next(Encoding::Protobuf).await?;
            Some((snapshot, subscription))
        });
        Ok(tonic::Response::new(until_shutdown(snapshots.map(Ok), api.cancel.clone())))
    }
}

/// Bounds the number of different snapshots that have to be encoded.
fn check_subscription_limit(api: &ApiState) -> Result<(), ApiError> {
    let limit = SUBSCRIPTIONS_PER_CLIENT * api.limits.max_clients;
    if api.counters.snapshot_subscribers.load(Ordering::Relaxed) < limit as u64 {
        return Ok(());
    }
    Err(ApiError::ResourceExhausted(format!(
        "the limit of subscriptions to snapshots is reached: {limit}, which is {SUBSCRIPTIONS_PER_CLIENT} for each of \
         [limits] max_clients"
    )))
}

#[derive(Default)]
struct SnapshotCodec;

impl Codec for SnapshotCodec {
    type Encode = EncodedSnapshot;
    type Decode = v1::SubscribeSnapshotsRequest;
    type Encoder = SnapshotEncoder;
    type Decoder = ProstDecoder<v1::SubscribeSnapshotsRequest>;

    fn encoder(&mut self) -> SnapshotEncoder {
        SnapshotEncoder
    }

    fn decoder(&mut self) -> Self::Decoder {
        ProstDecoder::new(BufferSettings::default())
    }
}

struct SnapshotEncoder;

impl Encoder for SnapshotEncoder {
    type Item = EncodedSnapshot;
    type Error = Status;

    fn encode(
        &mut self,
        snapshot: EncodedSnapshot,
        buffer: &mut EncodeBuf<'_>,
    ) -> Result<(), Status> {
        let own = snapshot.own.protobuf();
        buffer.reserve(own.len() + snapshot.shared.len());
        buffer.put_slice(&own);
        buffer.put_slice(&snapshot.shared);
        Ok(())
    }
}

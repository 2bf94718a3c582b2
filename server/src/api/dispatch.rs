//! Hands each request to gRPC, gRPC-Web or HTTP, by its content type.
//!
//! The routers are not merged: merged, tonic would answer unknown REST paths.

use std::{convert::Infallible, sync::Arc, time::Duration};

use axum::{
    Router,
    body::Body,
    http::{Request, Response, Version, header},
    response::IntoResponse,
};
use hyper::body::Incoming;
use tonic::Status;
use tower::{Layer, ServiceExt, service_fn};
use tower_http::{cors::CorsLayer, timeout::TimeoutBody};

use super::{
    access::{
        AccessControl,
        expiry::{EXPIRED, Expiry},
    },
    deadline,
    error::ApiError,
};

#[derive(Clone)]
pub(super) struct Dispatch {
    /// Requests with a content type of `application/grpc…`.
    pub grpc_router: Router,
    pub http_router: Router,
    pub access: Arc<AccessControl>,
    /// Access for pages of other origins, if any.
    pub cors: Option<CorsLayer>,
    /// Longest pause within a request's body.
    pub body_timeout: Duration,
}

impl Dispatch {
    pub(super) async fn answer(
        mut self,
        request: Request<Incoming>,
    ) -> Result<Response<Body>, Infallible> {
        if let Err(error) = self.access.check_names(&request) {
            return Ok(refusal(&request, error));
        }
        match self.cors.take() {
            None => self.route(request).await,
            Some(cors) => {
                let route = service_fn(move |request| self.clone().route(request));
                cors.layer(route).oneshot(request).await
            }
        }
    }

    async fn route(self, mut request: Request<Incoming>) -> Result<Response<Body>, Infallible> {
        if let Err(error) = self.access.check_identity(&mut request) {
            return Ok(refusal(&request, error));
        }
        // A gRPC request stream may pause for any time: HTTP/2 pings its client.
        let may_pause = request.version() >= Version::HTTP_2 && is_grpc(&request);
        let request = request.map(|body| match may_pause {
            true => Body::new(body),
            false => Body::new(TimeoutBody::new(self.body_timeout, body)),
        });
        if is_grpc_web(&request) {
            self.answer_grpc_web(request).await
        } else if is_grpc(&request) {
            self.answer_grpc(request).await
        } else {
            self.http_router.oneshot(request).await
        }
    }

    async fn answer_grpc(self, request: Request<Body>) -> Result<Response<Body>, Infallible> {
        let (headers, expiry) = (request.headers().clone(), Expiry::of(request.extensions()));
        let response = deadline::answer(&headers, self.grpc_router.oneshot(request)).await?;
        let Some(at) = expiry.instant() else { return Ok(response) };
        let end = Status::unauthenticated(EXPIRED);
        Ok(response.map(|body| deadline::limited(body, at, end)))
    }

    async fn answer_grpc_web(self, request: Request<Body>) -> Result<Response<Body>, Infallible> {
        let grpc = service_fn(move |request: Request<tonic::body::Body>| {
            let this = self.clone();
            async move {
                let response = this.answer_grpc(request.map(Body::new)).await?;
                Ok::<_, Infallible>(response.map(tonic::body::Body::new))
            }
        });
        let service = tonic_web::GrpcWebLayer::new().layer(grpc);
        Ok(service.oneshot(request).await?.map(Body::new))
    }
}

/// An error in the protocol of the request.
fn refusal<B>(request: &Request<B>, error: ApiError) -> Response<Body> {
    if !is_grpc(request) {
        return error.into_response();
    }
    let mut response = Status::from(error).into_http();
    // gRPC-Web has no trailers, so that errors without a body are in the headers as well.
    if let Some(content_type) = request.headers().get(header::CONTENT_TYPE) {
        response.headers_mut().insert(header::CONTENT_TYPE, content_type.clone());
    }
    response
}

fn is_grpc_web<B>(request: &Request<B>) -> bool {
    has_content_type(request, b"application/grpc-web")
}

pub(super) fn is_grpc<B>(request: &Request<B>) -> bool {
    has_content_type(request, b"application/grpc")
}

fn has_content_type<B>(request: &Request<B>, prefix: &[u8]) -> bool {
    let content_type = request.headers().get(header::CONTENT_TYPE);
    content_type.is_some_and(|value| value.as_bytes().starts_with(prefix))
}

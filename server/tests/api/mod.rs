//! The gRPC, REST and WebSocket APIs over loopback sockets. The test feeds the hub directly: no cameras, no fusion.

mod access;
mod allowed_origins;
mod camera_pose;
mod client_readme;
mod connections;
mod deadline;
mod fuzz;
mod fuzz_websocket;
mod grpc;
mod grpc_web;
mod http;
mod lens;
mod many_subscribers;
mod observations;
mod picture;
mod plan_map;
mod print_files;
mod print_sizes;
mod rig;
mod rust_client;
mod select_objects;
mod service_info;
mod simulation;
mod stalled_clients;
mod websocket;

//! Nodes and programs that send frames or detections to `push:` cameras of a server, over real sockets.

mod cuttable_proxy;
mod lost_link;
mod picture_requests;
mod rejected_input;
mod rig;
mod sent_pictures;
mod trust;

//! Errors of starting a server or a node.

use std::{io, net::SocketAddr};

use roundel_core::marker::{DetectorError, MaskError};
use thiserror::Error;

use crate::{
    api::tls::TlsError,
    capture::source::TimesError,
    fusion::{
        calibration::file::CalibrationFileError, camera_manager::CameraManagerError,
        setup::ObjectError,
    },
};

#[derive(Debug, Error)]
pub enum ServeError {
    #[error("cannot listen on {address}: {source}; {}", remedy(.source))]
    Listen { address: SocketAddr, source: io::Error },
    #[error(
        "refusing to listen on {address}: other computers could read and change everything. Either\n  \
         - add `tls = {{ certificate = \"roundel.pem\", key = \"roundel.key\", self_signed = true }}` under [server]\n    \
         and an entry of [[access]] by `roundel token add NAME --role setup --config FILE`;\n  \
         - or, if you trust everyone on this network, add `insecure = true` under [server] (the option --insecure)"
    )]
    Exposed { address: SocketAddr },
    #[error(transparent)]
    Tls(#[from] TlsError),
    #[error(transparent)]
    Times(#[from] TimesError),
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    #[error("kinds of roundel: {0}")]
    Detector(#[from] DetectorError),
    #[error(transparent)]
    Mask(#[from] MaskError),
    #[error(transparent)]
    CameraManager(#[from] CameraManagerError),
    #[error(transparent)]
    Object(#[from] ObjectError),
    #[error(
        "camera \"{camera}\" has `source = \"push:\"`: only a server accepts pushed frames; give the node the camera's own source"
    )]
    NodeIsFed { camera: String },
    #[error(transparent)]
    Client(roundel_client::Error),
    #[error("cannot start the thread `{name}`: {source}")]
    Thread { name: String, source: io::Error },
}

fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::AddrInUse => {
            "another program, perhaps another roundel, uses this port: stop it, or choose another `listen` (port 0 selects a \
             free one)"
        }
        io::ErrorKind::PermissionDenied => "ports below 1024 need privileges: choose a higher one",
        io::ErrorKind::AddrNotAvailable => "this computer has no such address: correct `listen`",
        _ => "correct `listen`",
    }
}

//! Serves a recording: hub, player and APIs, without cameras.

use std::{net::SocketAddr, sync::Arc, thread::JoinHandle};

use tokio_util::sync::CancellationToken;

use super::serve::{ServeError, listen, spawn};
use crate::{
    api::{self, AllowedOrigins, ApiState, access::AccessControl},
    archive::replay::{Replay, ReplayStatus, player::Player, session::ReplaySession},
    model::{access::AccessConfig, hub::Hub},
};

/// A server that plays a recording. Dropping it ends its thread.
pub struct ReplayServer {
    address: SocketAddr,
    hub: Arc<Hub>,
    replay: Replay,
    cancel: CancellationToken,
    player: Option<JoinHandle<()>>,
    api: Option<tokio::task::JoinHandle<()>>,
}

impl ReplayServer {
    /// Binds the port and begins to play, in the current tokio runtime.
    pub async fn start(
        session: ReplaySession,
        address: SocketAddr,
        begin: ReplayStatus,
    ) -> Result<Self, ServeError> {
        let (listener, address) = listen(address).await?;
        let (hub, clock, late_window_ms) =
            (session.hub.clone(), session.clock, session.late_window_ms);
        let replay = Replay::new(begin);
        let player = Player::new(session, replay.clone());
        let player = spawn("replay".to_owned(), move || player.run())?;
        let cancel = CancellationToken::new();
        let access =
            AccessControl::new(&AccessConfig::default(), AllowedOrigins::default(), address, true);
        let state = ApiState {
            access: Arc::new(access),
            late_window_ms,
            replay: Some(replay.clone()),
            cancel: cancel.clone(),
            ..ApiState::new(hub.clone(), clock)
        };
        let api = Some(tokio::spawn(api::serve(listener, state)));
        Ok(Self { address, hub, replay, cancel, player: Some(player), api })
    }

    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    pub fn replay(&self) -> &Replay {
        &self.replay
    }

    pub async fn shutdown(mut self) {
        self.replay.stop();
        if let Some(player) = self.player.take() {
            let _ = tokio::task::spawn_blocking(move || player.join()).await;
        }
        self.cancel.cancel();
        if let Some(api) = self.api.take() {
            let _ = api.await;
        }
    }
}

impl Drop for ReplayServer {
    fn drop(&mut self) {
        self.replay.stop();
        self.cancel.cancel();
    }
}

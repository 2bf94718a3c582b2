//! Serves a recording: hub, player and APIs, without cameras.

use std::{net::SocketAddr, sync::Arc, thread::JoinHandle};

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use super::serve::ServeError;
use crate::{
    api::{self, ApiState},
    archive::replay::{Replay, ReplayStatus, player::Player, session::ReplaySession},
    model::hub::Hub,
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
    /// Binds the port and begins to play. To be called within a tokio runtime.
    pub async fn start(
        session: ReplaySession,
        listen: SocketAddr,
        begin: ReplayStatus,
    ) -> Result<Self, ServeError> {
        let listening = |source| ServeError::Listen { address: listen, source };
        let listener = TcpListener::bind(listen).await.map_err(listening)?;
        let address = listener.local_addr().map_err(listening)?;
        let ReplaySession { reader, engine, updates, hub, clock, late_window_ms } = session;
        let replay = Replay::new(begin);
        let player = Player::new((reader, engine), updates, replay.clone());
        let builder = std::thread::Builder::new().name("replay".to_owned());
        let thread = builder.spawn(move || player.run());
        let thread =
            thread.map_err(|source| ServeError::Thread { name: "replay".to_owned(), source })?;
        let cancel = CancellationToken::new();
        let state = ApiState {
            late_window_ms,
            replay: Some(replay.clone()),
            cancel: cancel.clone(),
            ..ApiState::new(hub.clone(), clock)
        };
        let api = Some(tokio::spawn(api::serve(listener, state)));
        Ok(Self { address, hub, replay, cancel, player: Some(thread), api })
    }

    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// The newest of everything.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    /// The recording that is being played.
    pub fn replay(&self) -> &Replay {
        &self.replay
    }

    pub async fn shutdown(mut self) {
        self.replay.stop();
        if let Some(player) = self.player.take() {
            // It obeys at once.
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

//! Recordings that a server makes, and one that it plays, from afar.

use crate::{Client, Error, v1};

impl Client {
    /// Has the server record what happens into files on its machine.
    ///
    /// # Errors
    /// [`Error::Refused`] for a wrong name or length, while it records already, or where it cannot; and those of the
    /// connection.
    pub async fn start_recording(
        &self,
        request: v1::StartRecordingRequest,
    ) -> Result<v1::Recording, Error> {
        let answer = self.service().start_recording(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Ends the recording; its files are whole when this returns.
    ///
    /// # Errors
    /// [`Error::Refused`] if nothing is recorded, and those of the connection.
    pub async fn stop_recording(&self) -> Result<v1::Recording, Error> {
        let answer = self.long_service().stop_recording(v1::StopRecordingRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// The recording that is being made, or the last one.
    ///
    /// # Errors
    /// Of the connection.
    pub async fn recording(&self) -> Result<v1::Recording, Error> {
        let answer = self.service().get_recording(v1::GetRecordingRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// The files of recordings in the server's folder, the oldest first.
    ///
    /// # Errors
    /// Of the connection.
    pub async fn recordings(&self) -> Result<v1::ListRecordingsResponse, Error> {
        let answer = self.service().list_recordings(v1::ListRecordingsRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Where objects were, as the server's history keeps it.
    ///
    /// # Errors
    /// [`Error::Refused`] for a wrong field or by a server that keeps none, and those of the connection.
    pub async fn history(
        &self,
        request: v1::QueryHistoryRequest,
    ) -> Result<v1::QueryHistoryResponse, Error> {
        let answer = self.long_service().query_history(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// The recording that the server plays (`roundel replay`), and how far it is.
    ///
    /// # Errors
    /// [`Error::Refused`] if it plays none, and those of the connection.
    pub async fn replay(&self) -> Result<v1::Replay, Error> {
        let answer = self.service().get_replay(v1::GetReplayRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Pauses the recording that the server plays, goes on, seeks, changes its speed; absent fields stay as they are.
    ///
    /// # Errors
    /// [`Error::Refused`] if it plays none or a number is out of its range, and those of the connection.
    pub async fn control_replay(
        &self,
        request: v1::ControlReplayRequest,
    ) -> Result<v1::Replay, Error> {
        let answer = self.service().control_replay(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }
}

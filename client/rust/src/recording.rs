//! Calls for recordings, history and replay.

use crate::{Client, Error, v1};

impl Client {
    /// Starts a recording into files on the server.
    ///
    /// # Errors
    /// [`Error::Refused`] for an invalid name or duration, during another recording, or if the server cannot record; and
    /// connection errors.
    pub async fn start_recording(
        &self,
        request: v1::StartRecordingRequest,
    ) -> Result<v1::Recording, Error> {
        self.response(self.service().start_recording(request).await)
    }

    /// Ends the recording. Its files are complete on return.
    ///
    /// # Errors
    /// [`Error::Refused`] without a recording, and connection errors.
    pub async fn stop_recording(&self) -> Result<v1::Recording, Error> {
        self.response(self.long_service().stop_recording(v1::StopRecordingRequest {}).await)
    }

    /// The current recording, or the last one.
    ///
    /// # Errors
    /// Connection errors.
    pub async fn recording(&self) -> Result<v1::Recording, Error> {
        self.response(self.service().get_recording(v1::GetRecordingRequest {}).await)
    }

    /// The recordings in the server's folder, oldest first.
    ///
    /// # Errors
    /// Connection errors.
    pub async fn recordings(&self) -> Result<v1::ListRecordingsResponse, Error> {
        self.response(self.service().list_recordings(v1::ListRecordingsRequest {}).await)
    }

    /// Past positions of objects, from the server's history.
    ///
    /// # Errors
    /// [`Error::Refused`] for an invalid field or without a history, and connection errors.
    pub async fn history(
        &self,
        request: v1::QueryHistoryRequest,
    ) -> Result<v1::QueryHistoryResponse, Error> {
        self.response(self.long_service().query_history(request).await)
    }

    /// The recording that `roundel replay` plays, and its position.
    ///
    /// # Errors
    /// [`Error::Refused`] without a replay, and connection errors.
    pub async fn replay(&self) -> Result<v1::Replay, Error> {
        self.response(self.service().get_replay(v1::GetReplayRequest {}).await)
    }

    /// Pauses, resumes or seeks the replay, or changes its speed. Absent fields leave a value unchanged.
    ///
    /// # Errors
    /// [`Error::Refused`] without a replay or for a number out of range, and connection errors.
    pub async fn control_replay(
        &self,
        request: v1::ControlReplayRequest,
    ) -> Result<v1::Replay, Error> {
        self.response(self.service().control_replay(request).await)
    }
}

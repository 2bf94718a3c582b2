//! Calibration of the arena, from afar.

use crate::{Client, Error, Messages, v1};

impl Client {
    /// Begins to calibrate the arena: the server records for a while, during which robots should drive about,
    /// then finds where its cameras stand. [`Client::watch_calibration`] follows it.
    ///
    /// # Errors
    /// [`Error::Refused`] for a wrong length, while another one runs, or without reference roundels; and those
    /// of the connection.
    pub async fn start_calibration(
        &self,
        request: v1::StartCalibrationRequest,
    ) -> Result<v1::Calibration, Error> {
        let answer = self.service().start_calibration(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// The newest calibration: how far it is, and what came out.
    ///
    /// # Errors
    /// Of the connection.
    pub async fn calibration(&self) -> Result<v1::Calibration, Error> {
        let answer = self.service().get_calibration(v1::GetCalibrationRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// The newest calibration, and each change of it. The stream ends with an error when the connection is
    /// lost.
    ///
    /// # Errors
    /// Of the connection.
    pub async fn watch_calibration(&self) -> Result<Messages<v1::Calibration>, Error> {
        let answer = self.streams().watch_calibration(v1::WatchCalibrationRequest {}).await;
        Ok(self.messages(answer.map_err(|status| self.error(&status))?.into_inner()))
    }

    /// Ends the calibration that is running, without a result.
    ///
    /// # Errors
    /// [`Error::Refused`] if none is, and those of the connection.
    pub async fn cancel_calibration(&self) -> Result<v1::Calibration, Error> {
        let answer = self.service().cancel_calibration(v1::CancelCalibrationRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Has the cameras take over what the newest calibration found.
    ///
    /// # Errors
    /// [`Error::Refused`] if it found nothing, and those of the connection.
    pub async fn apply_calibration(&self) -> Result<v1::Calibration, Error> {
        let answer = self.service().apply_calibration(v1::ApplyCalibrationRequest {}).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }
}

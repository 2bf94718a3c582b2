//! Calls that calibrate the arena.

use crate::{Client, Error, Messages, v1};

impl Client {
    /// Starts a calibration of the arena. The server records for a while, during which robots should drive around,
    /// and then estimates the camera poses. [`Client::watch_calibration`] reports the progress.
    ///
    /// # Errors
    /// [`Error::Refused`] for an invalid duration, while another calibration runs, or without reference roundels; and
    /// connection errors.
    pub async fn start_calibration(
        &self,
        request: v1::StartCalibrationRequest,
    ) -> Result<v1::Calibration, Error> {
        self.response(self.service().start_calibration(request).await)
    }

    /// The newest calibration with its progress and result.
    ///
    /// # Errors
    /// Connection errors.
    pub async fn calibration(&self) -> Result<v1::Calibration, Error> {
        self.response(self.service().get_calibration(v1::GetCalibrationRequest {}).await)
    }

    /// The newest calibration and each change of it. The stream ends with an error when the connection is lost.
    ///
    /// # Errors
    /// Connection errors.
    pub async fn watch_calibration(&self) -> Result<Messages<v1::Calibration>, Error> {
        let answer = self.streams().watch_calibration(v1::WatchCalibrationRequest {}).await;
        Ok(self.messages(answer.map_err(|status| self.error(&status))?.into_inner()))
    }

    /// Ends the running calibration without a result.
    ///
    /// # Errors
    /// [`Error::Refused`] if none is running, and connection errors.
    pub async fn cancel_calibration(&self) -> Result<v1::Calibration, Error> {
        self.response(self.service().cancel_calibration(v1::CancelCalibrationRequest {}).await)
    }

    /// Applies the result of the newest calibration to the cameras.
    ///
    /// # Errors
    /// [`Error::Refused`] without a result, and connection errors.
    pub async fn apply_calibration(&self) -> Result<v1::Calibration, Error> {
        self.response(self.service().apply_calibration(v1::ApplyCalibrationRequest {}).await)
    }
}

//! Calls that add, change and remove cameras.

use crate::{Client, Error, v1};

impl Client {
    /// A camera's entry in the server's configuration, without user and password of its source.
    ///
    /// # Errors
    /// [`Error::Refused`] if the camera does not exist or the server does not let clients set up its cameras, and
    /// connection errors.
    pub async fn camera_setup(&self, name: &str) -> Result<v1::CameraSetup, Error> {
        let request = v1::GetCameraSetupRequest { name: name.to_owned() };
        self.response(self.service().get_camera_setup(request).await)
    }

    /// Adds a camera to the running server and to its configuration file; the response names the file.
    ///
    /// # Errors
    /// [`Error::Refused`] with the invalid field or the reason, and connection errors.
    pub async fn add_camera(&self, camera: v1::CameraSetup) -> Result<v1::CameraChange, Error> {
        let request = v1::AddCameraRequest { camera: Some(camera) };
        self.response(self.long_service().add_camera(request).await)
    }

    /// Sets these fields of a camera to their values in `camera`; removes those that are absent or empty there.
    ///
    /// # Errors
    /// As for [`Client::add_camera`].
    pub async fn change_camera(
        &self,
        name: &str,
        camera: v1::CameraSetup,
        fields: &[&str],
    ) -> Result<v1::CameraChange, Error> {
        let fields = fields.iter().map(|&field| field.to_owned()).collect();
        let request =
            v1::ChangeCameraRequest { name: name.to_owned(), camera: Some(camera), fields };
        self.response(self.long_service().change_camera(request).await)
    }

    /// Removes a camera from the running server.
    ///
    /// # Errors
    /// As for [`Client::add_camera`].
    pub async fn remove_camera(&self, name: &str) -> Result<v1::CameraChange, Error> {
        let request = v1::RemoveCameraRequest { name: name.to_owned() };
        self.response(self.long_service().remove_camera(request).await)
    }
}

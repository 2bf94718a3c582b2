//! Cameras that are added, changed and removed, from afar.

use crate::{Client, Error, v1};

impl Client {
    /// A camera as the server's configuration says it, but for user and password of its source.
    ///
    /// # Errors
    /// [`Error::Refused`] for a camera that does not exist, or by a server that lets no client set up its cameras; and
    /// those of the connection.
    pub async fn camera_setup(&self, name: &str) -> Result<v1::CameraSetup, Error> {
        let request = v1::GetCameraSetupRequest { name: name.to_owned() };
        let answer = self.service().get_camera_setup(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Adds a camera while the server runs, and has it write that into its configuration; the answer says where.
    ///
    /// # Errors
    /// [`Error::Refused`] names the field that is wrong, or says why nothing can be changed; and those of the connection.
    pub async fn add_camera(&self, camera: v1::CameraSetup) -> Result<v1::CameraChange, Error> {
        let request = v1::AddCameraRequest { camera: Some(camera) };
        let answer = self.long_service().add_camera(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Changes a camera in these fields, by name, to what `camera` says of them; one that is absent or empty there is
    /// taken out. All others stay.
    ///
    /// # Errors
    /// As of [`Client::add_camera`].
    pub async fn change_camera(
        &self,
        name: &str,
        camera: v1::CameraSetup,
        fields: &[&str],
    ) -> Result<v1::CameraChange, Error> {
        let fields = fields.iter().map(|&field| field.to_owned()).collect();
        let request =
            v1::ChangeCameraRequest { name: name.to_owned(), camera: Some(camera), fields };
        let answer = self.long_service().change_camera(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Removes a camera while the server runs.
    ///
    /// # Errors
    /// As of [`Client::add_camera`].
    pub async fn remove_camera(&self, name: &str) -> Result<v1::CameraChange, Error> {
        let request = v1::RemoveCameraRequest { name: name.to_owned() };
        let answer = self.long_service().remove_camera(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }
}

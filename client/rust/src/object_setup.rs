//! Calls that name, add, change and remove configured objects.

use crate::{Client, Error, v1};

impl Client {
    /// An object's entry in the server's configuration.
    ///
    /// # Errors
    /// [`Error::Refused`] if the object does not exist or the server does not let clients change its configuration, and
    /// connection errors.
    pub async fn object_setup(&self, name: &str) -> Result<v1::ObjectSetup, Error> {
        let request = v1::GetObjectSetupRequest { name: name.to_owned() };
        self.response(self.service().get_object_setup(request).await)
    }

    /// Adds an object to the running server and to its configuration file; the response names the file.
    ///
    /// # Errors
    /// [`Error::Refused`] with the invalid field or the reason, and connection errors.
    pub async fn add_object(&self, object: v1::ObjectSetup) -> Result<v1::ObjectChange, Error> {
        let request = v1::AddObjectRequest { object: Some(object) };
        self.response(self.service().add_object(request).await)
    }

    /// Sets these fields of an object to their values in `object`; removes those that are absent or empty there. The
    /// object keeps its id and its track when its name or its tracked point changes.
    ///
    /// # Errors
    /// As for [`Client::add_object`].
    pub async fn change_object(
        &self,
        name: &str,
        object: v1::ObjectSetup,
        fields: &[&str],
    ) -> Result<v1::ObjectChange, Error> {
        let fields = fields.iter().map(|&field| field.to_owned()).collect();
        let request =
            v1::ChangeObjectRequest { name: name.to_owned(), object: Some(object), fields };
        self.response(self.service().change_object(request).await)
    }

    /// Removes an object from the running server. An object with a code stays tracked, without a name.
    ///
    /// # Errors
    /// As for [`Client::add_object`].
    pub async fn remove_object(&self, name: &str) -> Result<v1::ObjectChange, Error> {
        let request = v1::RemoveObjectRequest { name: name.to_owned() };
        self.response(self.service().remove_object(request).await)
    }

    /// Names a tracked object. Renames a configured object; adds another one to the configuration, by its code, or by its
    /// kind of roundel if it is the only one of that kind.
    ///
    /// # Errors
    /// As for [`Client::add_object`]; also if nothing distinguishes the object from others.
    pub async fn name_object(&self, object_id: u64, name: &str) -> Result<v1::ObjectChange, Error> {
        let request = v1::NameObjectRequest { object_id, name: name.to_owned() };
        self.response(self.service().name_object(request).await)
    }
}

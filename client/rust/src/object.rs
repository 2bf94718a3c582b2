//! Objects of the configuration that are named, added, changed and removed, from afar.

use crate::{Client, Error, v1};

impl Client {
    /// An object as the server's configuration says it.
    ///
    /// # Errors
    /// [`Error::Refused`] for an object that does not exist, or by a server that lets no client change what is
    /// configured; and those of the connection.
    pub async fn object_setup(&self, name: &str) -> Result<v1::ObjectSetup, Error> {
        let request = v1::GetObjectSetupRequest { name: name.to_owned() };
        let answer = self.service().get_object_setup(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Adds an object while the server runs, and has it write that into its configuration; the answer says where.
    ///
    /// # Errors
    /// [`Error::Refused`] names the field that is wrong, or says why nothing can be changed; and those of the connection.
    pub async fn add_object(&self, object: v1::ObjectSetup) -> Result<v1::ObjectChange, Error> {
        let request = v1::AddObjectRequest { object: Some(object) };
        let answer = self.service().add_object(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Changes an object in these fields, by name, to what `object` says of them; one that is absent or empty there is
    /// taken out. All others stay. Under another name or followed by another point, it keeps its id and its track.
    ///
    /// # Errors
    /// As of [`Client::add_object`].
    pub async fn change_object(
        &self,
        name: &str,
        object: v1::ObjectSetup,
        fields: &[&str],
    ) -> Result<v1::ObjectChange, Error> {
        let fields = fields.iter().map(|&field| field.to_owned()).collect();
        let request =
            v1::ChangeObjectRequest { name: name.to_owned(), object: Some(object), fields };
        let answer = self.service().change_object(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Removes an object while the server runs; one that was known by its code is followed on without a name.
    ///
    /// # Errors
    /// As of [`Client::add_object`].
    pub async fn remove_object(&self, name: &str) -> Result<v1::ObjectChange, Error> {
        let request = v1::RemoveObjectRequest { name: name.to_owned() };
        let answer = self.service().remove_object(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }

    /// Gives a name to an object that is seen: another one to a configured object; any other one is configured from now
    /// on, by its code, or by its kind of roundel if it is the only one of it.
    ///
    /// # Errors
    /// As of [`Client::add_object`]; also if nothing on the object tells it from others.
    pub async fn name_object(&self, object_id: u64, name: &str) -> Result<v1::ObjectChange, Error> {
        let request = v1::NameObjectRequest { object_id, name: name.to_owned() };
        let answer = self.service().name_object(request).await;
        answer.map(tonic::Response::into_inner).map_err(|status| self.error(&status))
    }
}

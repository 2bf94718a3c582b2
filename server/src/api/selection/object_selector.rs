//! Selects objects by id, name or code.
//!
//! Ids change when the server restarts; names and codes stay with their objects. Names and codes are looked up in each
//! snapshot, so an object that gets its name or code later is included from then on.

use roundel_core::{
    id::ObjectId,
    marker::{Code, CodeLayout},
    world::ObjectState,
};
use roundel_proto::v1;

use super::FieldNames;
use crate::{api::error::ApiError, model::hub::Installation};

/// Maximum length of each list.
pub const MAX_SELECTORS: usize = 10_000;

/// Includes the objects of any list, or all objects if every list is empty. Lists are sorted, without duplicates.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct ObjectSelector {
    ids: Vec<ObjectId>,
    names: Vec<String>,
    /// Number and bits; bits 0 match any layout.
    codes: Vec<(u16, u8)>,
}

impl ObjectSelector {
    pub(super) fn checked(
        request: &v1::SubscribeSnapshotsRequest,
        fields: &FieldNames,
    ) -> Result<Self, ApiError> {
        let id = |&id: &u64| match id {
            0 => Err(ApiError::invalid(fields.ids, "ids of objects, which count from 1", 0)),
            id => Ok(ObjectId(id)),
        };
        let name = |name: &String| match name.as_str() {
            "" => Err(ApiError::invalid("names", "names of objects", "an empty one")),
            name => Ok(name.to_owned()),
        };
        Ok(Self {
            ids: sorted(&request.object_ids, fields.ids, "ids", id)?,
            names: sorted(&request.names, "names", "names", name)?,
            codes: sorted(&request.codes, "codes", "codes", checked_code)?,
        })
    }

    pub(super) fn selects_all(&self) -> bool {
        self.ids.is_empty() && self.names.is_empty() && self.codes.is_empty()
    }

    pub(super) fn includes(&self, installation: &Installation, state: &ObjectState) -> bool {
        let has_name = || {
            let name = installation.object_name(state.kind, state.body);
            self.names.binary_search_by(|known| known.as_str().cmp(name)).is_ok()
        };
        let has_code = |Code { bits, number }| {
            [bits, 0].iter().any(|&bits| self.codes.binary_search(&(number, bits)).is_ok())
        };
        self.selects_all()
            || self.ids.binary_search(&state.id).is_ok()
            || (!self.names.is_empty() && has_name())
            || (!self.codes.is_empty() && state.code.is_some_and(has_code))
    }
}

/// Checks and sorts items; `what` they are, in the plural, is for errors.
fn sorted<T, U: Ord>(
    items: &[T],
    field: &str,
    what: &str,
    check: impl Fn(&T) -> Result<U, ApiError>,
) -> Result<Vec<U>, ApiError> {
    if items.len() > MAX_SELECTORS {
        let expected = format!("at most {MAX_SELECTORS} {what} (leave them out for all objects)");
        return Err(ApiError::invalid(field, expected, items.len()));
    }
    let mut items = items.iter().map(check).collect::<Result<Vec<U>, ApiError>>()?;
    items.sort_unstable();
    items.dedup();
    Ok(items)
}

fn checked_code(code: &v1::Code) -> Result<(u16, u8), ApiError> {
    let (least, most) = CodeLayout::BITS;
    let number = u16::try_from(code.number).ok().filter(|&number| number > 0).ok_or_else(|| {
        ApiError::invalid("codes", format!("numbers of codes, from 1 to {}", u16::MAX), code.number)
    })?;
    let bits =
        u8::try_from(code.bits).ok().filter(|bits| *bits == 0 || (least..=most).contains(bits));
    let bits = bits.ok_or_else(|| {
        let expected = format!("codes of {least} to {most} bits, or 0 for any");
        ApiError::invalid("codes", expected, format!("{} bits", code.bits))
    })?;
    Ok((number, bits))
}

#[cfg(test)]
mod tests {
    use super::{super::QUERY_FIELDS, *};

    fn selector(request: v1::SubscribeSnapshotsRequest) -> Result<ObjectSelector, String> {
        ObjectSelector::checked(&request, &QUERY_FIELDS).map_err(|error| error.to_string())
    }

    #[test]
    fn lists_have_a_maximum_length() {
        let request = |count: u64| v1::SubscribeSnapshotsRequest {
            object_ids: (1..=count).collect(),
            ..Default::default()
        };
        assert_eq!(selector(request(10_000)).unwrap().ids.len(), 10_000);
        let error = selector(request(10_001)).unwrap_err();
        assert_eq!(
            error,
            "ids: expected at most 10000 ids (leave them out for all objects), found 10001"
        );
        let names = vec!["a".to_owned(); 10_001];
        let error =
            selector(v1::SubscribeSnapshotsRequest { names, ..Default::default() }).unwrap_err();
        assert!(error.starts_with("names: expected at most 10000 names"), "{error}");
    }

    #[test]
    fn invalid_codes_and_names_are_rejected_by_field() {
        let error = |bits, number| {
            let codes = vec![v1::Code { bits, number }];
            selector(v1::SubscribeSnapshotsRequest { codes, ..Default::default() }).unwrap_err()
        };
        assert_eq!(error(8, 0), "codes: expected numbers of codes, from 1 to 65535, found 0");
        assert_eq!(
            error(8, 65_536),
            "codes: expected numbers of codes, from 1 to 65535, found 65536"
        );
        for bits in [1, 17, 256 + 8] {
            let expected = "codes: expected codes of 2 to 16 bits, or 0 for any";
            assert_eq!(error(bits, 1), format!("{expected}, found {bits} bits"));
        }
        let names = vec!["a".to_owned(), String::new()];
        let error =
            selector(v1::SubscribeSnapshotsRequest { names, ..Default::default() }).unwrap_err();
        assert_eq!(error, "names: expected names of objects, found an empty one");
    }
}

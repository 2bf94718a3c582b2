//! Query parameters of REST and the WebSocket.

use std::{num::ParseIntError, str::FromStr};

use axum::{extract::Query, http::Uri};
use roundel_proto::v1;

use super::error::ApiError;

/// The parameters of one query. Handlers take the ones they know; [`Self::finish`] rejects the rest.
#[derive(Debug)]
pub struct QueryParameters {
    left: Vec<(String, String)>,
    known: Vec<&'static str>,
}

impl QueryParameters {
    /// Parses a query. A parameter with an empty value counts as absent.
    pub fn of(uri: &Uri) -> Result<Self, ApiError> {
        let Query(left) = Query::<Vec<(String, String)>>::try_from_uri(uri).map_err(|error| {
            ApiError::invalid("query", format!("name=value&… ({error})"), uri.query().unwrap_or(""))
        })?;
        Ok(Self { left, known: Vec::new() })
    }

    pub fn take(&mut self, name: &'static str) -> Result<Option<String>, ApiError> {
        self.known.push(name);
        let mut values = self.left.extract_if(.., |(key, _)| key == name).map(|(_, text)| text);
        let value = values.next();
        if let Some(other) = values.next() {
            return Err(ApiError::invalid(name, "one value", format!("another, {other:?}")));
        }
        Ok(value.filter(|text| !text.is_empty()))
    }

    /// Takes and parses a parameter; `expected` describes its values.
    pub fn take_parsed<T: FromStr>(
        &mut self,
        name: &'static str,
        expected: &str,
    ) -> Result<Option<T>, ApiError> {
        self.take(name)?.map(|text| parsed(&text, name, expected)).transpose()
    }

    /// Takes a list separated by commas; empty if absent.
    pub fn take_list<T: FromStr>(
        &mut self,
        name: &'static str,
        expected: &str,
    ) -> Result<Vec<T>, ApiError> {
        let text = self.take(name)?.unwrap_or_default();
        let items = text.split(',').map(str::trim).filter(|item| !item.is_empty());
        items.map(|item| parsed(item, name, expected)).collect()
    }

    fn take_corner(&mut self, name: &'static str) -> Result<Option<v1::Vector3>, ApiError> {
        let expected = "three numbers of metres, such as -1,0,2.5";
        match self.take_list(name, expected)?.as_slice() {
            [] => Ok(None),
            &[x, y, z] => Ok(Some(v1::Vector3 { x, y, z })),
            others => Err(ApiError::invalid(name, expected, format!("{} numbers", others.len()))),
        }
    }

    /// Takes a box: `min` and `max`.
    pub fn take_region(&mut self) -> Result<Option<v1::Box>, ApiError> {
        let (min, max) = (self.take_corner("min")?, self.take_corner("max")?);
        Ok((min.is_some() || max.is_some()).then_some(v1::Box { min, max }))
    }

    /// Takes the parameters of a snapshot: `ids`, `names`, `codes`, `roundels`, `min`, `max`, `horizon_ms`,
    /// `omit_covariance`.
    pub fn take_selection(&mut self) -> Result<v1::SubscribeSnapshotsRequest, ApiError> {
        let object_ids = self.take_list("ids", "ids with commas between, such as 1,2")?;
        let names = self.take_list("names", "names of objects")?;
        let codes = "numbers with commas between, such as 12, or 8:12 for one of 8 bits";
        let codes = self.take_list::<QueriedCode>("codes", codes)?;
        let region = self.take_region()?;
        Ok(v1::SubscribeSnapshotsRequest {
            object_ids,
            names,
            codes: codes.into_iter().map(|code| code.0).collect(),
            region,
            max_rate_hz: None,
            horizon_ms: self.take_parsed("horizon_ms", "a number of milliseconds")?,
            roundels: self.take_list("roundels", "names of kinds")?,
            omit_covariance: self.take_parsed("omit_covariance", "true or false")?.unwrap_or(false),
        })
    }

    /// Rejects an unknown parameter, with the most similar known one.
    pub fn finish(self) -> Result<(), ApiError> {
        let Some((name, _)) = self.left.first() else { return Ok(()) };
        let similarity = |known: &str| strsim::jaro_winkler(known, name);
        let nearest = self.known.iter().max_by(|a, b| similarity(a).total_cmp(&similarity(b)));
        let expected = nearest.map_or("no parameters here".to_owned(), |nearest| {
            format!("one of {} (perhaps {nearest}?)", self.known.join(", "))
        });
        Err(ApiError::invalid("query", expected, format!("{name:?}")))
    }
}

/// `NUMBER` or `BITS:NUMBER`.
struct QueriedCode(v1::Code);

impl FromStr for QueriedCode {
    type Err = ParseIntError;

    fn from_str(text: &str) -> Result<Self, ParseIntError> {
        let (bits, number) = text.split_once(':').unwrap_or(("0", text));
        Ok(Self(v1::Code { bits: bits.parse()?, number: number.parse()? }))
    }
}

fn parsed<T: FromStr>(text: &str, name: &str, expected: &str) -> Result<T, ApiError> {
    text.parse().map_err(|_| ApiError::invalid(name, expected, format!("{text:?}")))
}

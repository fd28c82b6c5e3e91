//! Query strings: every parameter is known and given once, or the request is refused by its name.

use super::HttpError;
use crate::service::BoxQuery;
use axum::extract::Query;
use axum::http::Uri;
use std::str::FromStr;

/// Longest value that an error quotes, characters.
const MAX_QUOTED: usize = 80;

/// The parameters of a request, taken out one by one.
#[derive(Debug)]
pub struct Params(Vec<(String, String)>);

impl Params {
    /// The parameters, if each is among `known` and given once.
    ///
    /// # Errors
    /// [`crate::service::ErrorKind::InvalidRequest`] at the parameter.
    pub fn new(uri: &Uri, known: &[&str]) -> Result<Self, HttpError> {
        let Query(pairs) = Query::<Vec<(String, String)>>::try_from_uri(uri)
            .map_err(|error| HttpError::invalid("query", format!("the query string is not valid: {error}")))?;
        for (at, (name, _)) in pairs.iter().enumerate() {
            if !known.contains(&name.as_str()) {
                let name = quoted(name);
                let choices = if known.is_empty() {
                    "it takes none".to_owned()
                } else {
                    format!("it takes {}", known.join(", "))
                };
                let detail = format!("unknown query parameter {name:?}: {choices}");
                return Err(HttpError::invalid(name, detail));
            }
            if pairs[..at].iter().any(|(other, _)| other == name) {
                return Err(HttpError::invalid(name.clone(), format!("query parameter {name:?} is given twice")));
            }
        }
        Ok(Self(pairs))
    }

    /// Refuses any parameter.
    ///
    /// # Errors
    /// As [`Params::new`].
    pub fn none(uri: &Uri) -> Result<(), HttpError> {
        Self::new(uri, &[]).map(drop)
    }

    /// A parameter's text.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// A parameter as a number.
    ///
    /// # Errors
    /// [`crate::service::ErrorKind::InvalidRequest`] at the parameter.
    pub fn number<T: FromStr>(&self, name: &str, what: &str) -> Result<Option<T>, HttpError> {
        self.text(name).map(|text| parse(name, text, what)).transpose()
    }

    /// The half-open box and depth of a region or grid query.
    ///
    /// # Errors
    /// [`crate::service::ErrorKind::InvalidRequest`] at the parameter.
    pub fn box_query(&self) -> Result<BoxQuery, HttpError> {
        let metres = "a number of metres";
        Ok(BoxQuery {
            min_x: self.number("min_x", metres)?,
            min_y: self.number("min_y", metres)?,
            max_x: self.number("max_x", metres)?,
            max_y: self.number("max_y", metres)?,
            depth: self.number("depth", "a whole number")?,
        })
    }
}

/// A number from text.
///
/// # Errors
/// [`crate::service::ErrorKind::InvalidRequest`] at `name`.
pub fn parse<T: FromStr>(name: &str, text: &str, what: &str) -> Result<T, HttpError> {
    text.parse().map_err(|_| HttpError::invalid(name, format!("{name} must be {what}, got {:?}", quoted(text))))
}

fn quoted(text: &str) -> String {
    text.chars().take(MAX_QUOTED).collect()
}

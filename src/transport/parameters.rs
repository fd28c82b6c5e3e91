//! Parameters beside a path or key: every one is known and given once, or the request is refused by its name.

use crate::service::{BoxQuery, ErrorKind, ServiceError};
use std::str::FromStr;

/// Longest value that an error quotes, characters.
const MAX_QUOTED: usize = 80;

/// The parameters of a request, by name.
#[derive(Debug)]
pub struct Parameters(Vec<(String, String)>);

impl Parameters {
    /// The parameters, if each is among `known` and given once.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidRequest`] at the parameter.
    pub fn new(pairs: Vec<(String, String)>, known: &[&str]) -> Result<Self, ServiceError> {
        for (at, (name, _)) in pairs.iter().enumerate() {
            if !known.contains(&name.as_str()) {
                let name = quoted(name);
                let choices = if known.is_empty() {
                    "it takes none".to_owned()
                } else {
                    format!("it takes {}", known.join(", "))
                };
                let detail = format!("unknown query parameter {name:?}: {choices}");
                return Err(invalid(name, detail));
            }
            if pairs[..at].iter().any(|(other, _)| other == name) {
                return Err(invalid(name.clone(), format!("query parameter {name:?} is given twice")));
            }
        }
        Ok(Self(pairs))
    }

    /// A parameter's text.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// A parameter as a number.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidRequest`] at the parameter.
    pub fn number<T: FromStr>(&self, name: &str, what: &str) -> Result<Option<T>, ServiceError> {
        self.text(name).map(|text| parse(name, text, what)).transpose()
    }

    /// A parameter that is `true` or `false`; false where it is left out.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidRequest`] at the parameter.
    pub fn flag(&self, name: &str) -> Result<bool, ServiceError> {
        self.number(name, "true or false").map(Option::unwrap_or_default)
    }

    /// The name of the snapshot that is asked, not checked yet; empty where it is left out.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidRequest`] at a parameter without a value: who writes one does not mean the map as it is now.
    pub fn snapshot(&self) -> Result<&str, ServiceError> {
        match self.text("snapshot") {
            Some("") => Err(invalid("snapshot", "snapshot must be the name of a snapshot".to_owned())),
            text => Ok(text.unwrap_or_default()),
        }
    }

    /// The half-open box and depth of a region or grid query.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidRequest`] at the parameter.
    pub fn box_query(&self) -> Result<BoxQuery, ServiceError> {
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
/// [`ErrorKind::InvalidRequest`] at `name`.
pub fn parse<T: FromStr>(name: &str, text: &str, what: &str) -> Result<T, ServiceError> {
    text.parse().map_err(|_| invalid(name, format!("{name} must be {what}, got {:?}", quoted(text))))
}

fn invalid(field: impl Into<String>, detail: String) -> ServiceError {
    ServiceError::new(ErrorKind::InvalidRequest, detail).at(field)
}

fn quoted(text: &str) -> String {
    text.chars().take(MAX_QUOTED).collect()
}

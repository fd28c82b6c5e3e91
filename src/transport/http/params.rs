//! Query strings.

use super::HttpError;
use super::openapi::Operation;
use crate::transport::parameters::Parameters;
use axum::extract::Query;
use axum::http::Uri;

/// The parameters of a query string, if the operation knows each and each is given once.
///
/// # Errors
/// [`crate::service::ErrorKind::InvalidRequest`] at the parameter.
pub fn params(uri: &Uri, operation: &Operation) -> Result<Parameters, HttpError> {
    among(uri, &operation.query())
}

fn among(uri: &Uri, known: &[&str]) -> Result<Parameters, HttpError> {
    let Query(pairs) = Query::<Vec<(String, String)>>::try_from_uri(uri)
        .map_err(|error| HttpError::invalid("query", format!("the query string is not valid: {error}")))?;
    Ok(Parameters::new(pairs, known)?)
}

/// Refuses any parameter.
///
/// # Errors
/// As [`params`].
pub fn no_params(uri: &Uri) -> Result<(), HttpError> {
    among(uri, &[]).map(drop)
}

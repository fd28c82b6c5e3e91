//! What there is to know of an operation of REST.

use super::parameter::{ENDING, Parameter, Place};
use crate::service::ErrorKind;
use axum::routing::MethodFilter;

/// A method of HTTP.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verb {
    Get,
    Put,
    Post,
    Delete,
}

impl Verb {
    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Get => "GET",
            Self::Put => "PUT",
            Self::Post => "POST",
            Self::Delete => "DELETE",
        }
    }

    /// What the router takes for it.
    pub fn filter(self) -> MethodFilter {
        match self {
            Self::Get => MethodFilter::GET,
            Self::Put => MethodFilter::PUT,
            Self::Post => MethodFilter::POST,
            Self::Delete => MethodFilter::DELETE,
        }
    }
}

/// What a request brings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Body {
    /// Nothing.
    None,
    /// A message as JSON or protobuf.
    Message(&'static str),
    /// A message as JSON or protobuf, or nothing: the path says it all.
    Maybe(&'static str),
    /// A configuration, a whole creation, or nothing.
    Config,
    /// Scans: one, many, or one a line.
    Scans,
    /// A map file.
    File,
}

/// What an answer is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// Nothing.
    None,
    /// A message as JSON or protobuf.
    Message(&'static str),
    /// A message as JSON alone, of a schema of the description's own.
    Json(&'static str),
    /// What an insertion answers: one message, or one a scan.
    Acknowledgements,
    /// A dense raster.
    Raster,
    /// A tile.
    Tile,
    /// Changes as they come.
    Events,
    /// A map as a file.
    File,
    /// Metrics as Prometheus reads them.
    Metrics,
    /// A page for people.
    Page,
    /// JSON for programs, a page for people.
    Index,
}

/// One operation.
#[derive(Debug)]
pub struct Operation {
    /// Its name; those of gRPC where it has one there.
    pub id: &'static str,
    /// The method.
    pub method: Verb,
    /// The path, as the router has it.
    pub path: &'static str,
    /// The group that it is shown in.
    pub tag: &'static str,
    /// What it does, in a few words.
    pub summary: &'static str,
    /// What there is to know of it.
    pub text: &'static str,
    /// Its parameters, without the map's name.
    pub parameters: &'static [Parameter],
    /// What a request brings.
    pub body: Body,
    /// Status and content of what it answers.
    pub answers: &'static [(u16, Content)],
    /// Errors beside those that every operation may have.
    pub refused: &'static [ErrorKind],
}

impl Operation {
    /// The path as the description writes it.
    pub fn shown_path(&self) -> String {
        let ending = self.parameters.contains(&ENDING);
        if ending { format!("{}.{{ending}}", self.path) } else { self.path.to_owned() }
    }

    /// Is it the interface's own, with a version in its path?
    pub fn versioned(&self) -> bool {
        self.path.starts_with("/v1/")
    }

    /// The names of its parameters in the query string.
    pub fn query(&self) -> Vec<&'static str> {
        let query = self.parameters.iter().filter(|parameter| parameter.place == Place::Query);
        query.map(|parameter| parameter.name).collect()
    }
}

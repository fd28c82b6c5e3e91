//! The viewer: the files of one page, embedded in the binary.

use super::params::no_params;
use super::{HttpError, accept, respond, system};
use axum::body::Bytes;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

/// A file of the bundle, by its path in it.
pub(super) struct Asset {
    name: &'static str,
    /// A strong entity tag.
    tag: &'static str,
    bytes: &'static [u8],
}

/// All files of the bundle; none where it was built without.
static ASSETS: &[Asset] = include!(concat!(env!("OUT_DIR"), "/viewer.rs"));

const PAGE: &str = "index.html";

/// The page that shows the description of the interface.
const DOCS: &str = "docs.html";

/// Names in this folder hold a hash of the contents.
const HASHED: &str = "assets/";

const HTML: &str = "text/html; charset=utf-8";

/// The page takes everything from this server and is part of no other page.
const POLICY: &str =
    "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'";

/// The page of the description draws its signs from its sheet, as `data:` images.
const DOCS_POLICY: &str = "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; \
    object-src 'none'";

/// What stands at `/` where the viewer is not in the binary.
const WITHOUT: &str = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>ubbmap</title><h1>ubbmap</h1>\
    <p>The pages are not in this build of the server. The interface works without them: it is described at \
    <a href=\"/openapi.json\">/openapi.json</a>, maps are at <a href=\"/v1/maps\">/v1/maps</a>, metrics at <a href=\"/metrics\">/metrics</a>.</p></html>\n";

/// What `/` is: programs get the list of routes, browsers the page.
#[derive(Debug, Clone, Copy)]
enum Index {
    Routes,
    Page,
}

const INDEX: [(&str, Index); 2] = [(accept::JSON, Index::Routes), ("text/html", Index::Page)];

/// `GET /`
pub async fn index(request: Request) -> Result<Response, HttpError> {
    match accept::choose(request.headers(), &INDEX)? {
        Index::Routes => {
            no_params(request.uri())?;
            Ok(system::index())
        }
        Index::Page => Ok(page(find(PAGE), request.headers())),
    }
}

/// The page that shows the description of the interface.
pub fn docs(headers: &HeaderMap) -> Response {
    let mut response = page(find(DOCS), headers);
    response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(DOCS_POLICY));
    response
}

/// A page, or where it is not in the binary one that says so.
pub(super) fn page(page: Option<&'static Asset>, headers: &HeaderMap) -> Response {
    match page {
        Some(page) => file(page, headers),
        None => (guards(), respond::bytes_of(HTML, Bytes::from_static(WITHOUT.as_bytes()))).into_response(),
    }
}

/// `GET /viewer/{*path}`
pub async fn asset(uri: Uri, headers: HeaderMap) -> Result<Response, HttpError> {
    let name = uri.path().strip_prefix("/viewer/").unwrap_or_default();
    match find(name) {
        Some(asset) => Ok(file(asset, &headers)),
        None => Err(system::route_not_found(uri).await),
    }
}

fn find(name: &str) -> Option<&'static Asset> {
    ASSETS.iter().find(|asset| asset.name == name)
}

fn file(asset: &Asset, headers: &HeaderMap) -> Response {
    let caching = if asset.name.starts_with(HASHED) { "public, max-age=31536000, immutable" } else { "no-cache" };
    let tag = HeaderValue::from_static(asset.tag);
    let unchanged = respond::matches(headers, &tag);
    let caching = [(header::ETAG, tag), (header::CACHE_CONTROL, HeaderValue::from_static(caching))];
    if unchanged {
        return (StatusCode::NOT_MODIFIED, caching).into_response();
    }
    let body = respond::bytes_of(media(asset.name), Bytes::from_static(asset.bytes));
    (guards(), caching, body).into_response()
}

fn guards() -> [(HeaderName, HeaderValue); 3] {
    [
        (header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY)),
        (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
        (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    ]
}

fn media(name: &str) -> &'static str {
    match name.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "html" => HTML,
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "md" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

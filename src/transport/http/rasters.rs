//! Dense rasters: grids of a box and tiles of a node.

use super::body::apart;
use super::params::params;
use super::path::{MapPath, TilePath};
use super::{HttpError, accept, pictures, respond};
use crate::service::{ErrorKind, Raster, ServiceError};
use crate::transport::access::{OnBehalf, Operation};
use crate::transport::operations;
use crate::transport::parameters::parse;
use crate::wire::{self, Encoding};
use axum::body::Bytes;
use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::hash::{DefaultHasher, Hash, Hasher};

const NPY: &str = "application/x-npy";
const PNG: &str = "image/png";

/// What a raster is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Form {
    Json,
    Protobuf,
    Npy,
    Png,
}

/// Media types of grids, the default first.
const FORMS: [(&str, Form); 5] = [
    (accept::JSON, Form::Json),
    (accept::PROTOBUF, Form::Protobuf),
    ("application/protobuf", Form::Protobuf),
    (NPY, Form::Npy),
    (PNG, Form::Png),
];

/// `GET /v1/maps/{map}/grid`, also of a snapshot
pub async fn grid(caller: OnBehalf, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    let params = params(request.uri(), &["min_x", "min_y", "max_x", "max_y", "depth", "format", "snapshot"])?;
    let form = match params.text("format") {
        None => accept::choose(request.headers(), &FORMS)?,
        Some("json") => Form::Json,
        Some("protobuf" | "pb") => Form::Protobuf,
        Some("npy") => Form::Npy,
        Some("png") => Form::Png,
        Some(_) => return Err(HttpError::invalid("format", "format must be json, npy, png or protobuf")),
    };
    let (query, snapshot) = (params.box_query()?, params.snapshot()?);
    let raster = operations::view(&caller, Operation::GetGrid, &map, snapshot).await?.grid(&query).await?;
    let place = place(&raster);
    let size = raster.classes.len();
    let response = match form {
        Form::Json => respond::message(Encoding::Json, wire::grid_response(raster), size).await?,
        Form::Protobuf => respond::message(Encoding::Protobuf, wire::grid_response(raster), size).await?,
        Form::Npy | Form::Png => picture(form, raster).await?,
    };
    Ok((place, response).into_response())
}

/// `GET /v1/maps/{map}/tiles/{z}/{x}/{y}.png`, `.npy`, `.pb`, with an ETag of the tile's contents; also of a
/// snapshot.
pub async fn tile(caller: OnBehalf, path: TilePath, request: Request) -> Result<Response, HttpError> {
    let params = params(request.uri(), &["snapshot"])?;
    let whole = "a whole number";
    let z = parse("z", &path.z, whole)?;
    let x = parse("x", &path.x, whole)?;
    let (y, ending) = path.y.split_once('.').unwrap_or((path.y.as_str(), ""));
    let y = parse("y", y, whole)?;
    let form = match ending {
        "png" => Form::Png,
        "npy" => Form::Npy,
        "pb" => Form::Protobuf,
        _ => {
            let detail = "a tile's path must end in .png, .npy or .pb";
            return Err(HttpError(ServiceError::new(ErrorKind::NotAcceptable, detail).at("y")));
        }
    };
    let raster =
        operations::view(&caller, Operation::GetTile, &path.map, params.snapshot()?).await?.tile(z, x, y).await?;
    let tag = entity_tag(&raster, form);
    let caching = [(header::ETAG, tag.clone()), (header::CACHE_CONTROL, HeaderValue::from_static("no-cache"))];
    let place = place(&raster);
    if respond::matches(request.headers(), &tag) {
        return Ok((StatusCode::NOT_MODIFIED, caching, place).into_response());
    }
    let size = raster.classes.len();
    let response = match form {
        Form::Png | Form::Npy => picture(form, raster).await?,
        Form::Json | Form::Protobuf => {
            respond::message(Encoding::Protobuf, wire::tile_response(raster, (z, x, y)), size).await?
        }
    };
    Ok((caching, place, response).into_response())
}

async fn picture(form: Form, raster: Raster) -> Result<Response, HttpError> {
    if form == Form::Png && raster.classes.is_empty() {
        let detail = "the box holds no cells, and an image has at least one";
        return Err(HttpError::new(ErrorKind::InvalidRegion, detail));
    }
    let media = if form == Form::Png { PNG } else { NPY };
    let write = if form == Form::Png { pictures::png } else { pictures::npy };
    let bytes = apart(raster.classes.len(), move || write(&raster)).await?;
    Ok(respond::bytes_of(media, Bytes::from(bytes)))
}

/// Where a raster lies, for forms that do not say it themselves.
fn place(raster: &Raster) -> [(HeaderName, HeaderValue); 5] {
    let text = |value: f64| HeaderValue::try_from(value.to_string()).unwrap_or(HeaderValue::from_static(""));
    [
        (HeaderName::from_static("ubbmap-revision"), HeaderValue::from(raster.revision)),
        (HeaderName::from_static("ubbmap-depth"), HeaderValue::from(u16::from(raster.depth))),
        (HeaderName::from_static("ubbmap-min-x"), text(raster.min.0)),
        (HeaderName::from_static("ubbmap-min-y"), text(raster.min.1)),
        (HeaderName::from_static("ubbmap-cell-size"), text(raster.cell_size)),
    ]
}

/// A strong tag: equal tags mean equal bytes. It hangs on the contents alone, so a commit elsewhere in the map leaves
/// it; the protobuf form holds the revision and changes with it.
fn entity_tag(raster: &Raster, form: Form) -> HeaderValue {
    let mut hasher = DefaultHasher::new();
    form.hash(&mut hasher);
    env!("CARGO_PKG_VERSION").hash(&mut hasher);
    (raster.depth, raster.x, raster.y, raster.width, raster.height, raster.class_count).hash(&mut hasher);
    raster.classes.hash(&mut hasher);
    if form == Form::Protobuf {
        raster.revision.hash(&mut hasher);
        [raster.min.0, raster.min.1, raster.cell_size].map(f64::to_bits).hash(&mut hasher);
    }
    let tag = format!("\"{:016x}\"", hasher.finish());
    HeaderValue::try_from(tag).unwrap_or(HeaderValue::from_static("\"\""))
}

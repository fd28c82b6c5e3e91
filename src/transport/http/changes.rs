//! What changed: at once (`/changes`), and as it is committed (`/events`).

use super::params::params;
use super::path::MapPath;
use super::problem::Problem;
use super::{App, HttpError, accept, lines, respond};
use crate::transport::access::OnBehalf;
use crate::transport::operations;
use crate::transport::watching::{self, Change};
use crate::wire::v1;
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// How often a quiet stream of events shows that it lives.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Where a client that lost the connection stopped reading (HTML, server-sent events).
const LAST_EVENT_ID: &str = "last-event-id";

const KNOWN: [&str; 7] = ["since", "min_x", "min_y", "max_x", "max_y", "depth", "contents"];

/// Those of a stream of changes.
const WATCHED: [&str; 8] = ["since", "min_x", "min_y", "max_x", "max_y", "depth", "contents", "robots"];

const REVISION: &str = "a revision, a whole number";

/// How a stream of changes is written.
#[derive(Debug, Clone, Copy)]
enum Form {
    Events,
    Lines,
}

const FORMS: [(&str, Form); 2] = [("text/event-stream", Form::Events), (lines::NDJSON, Form::Lines)];

/// `GET /v1/maps/{map}/changes?since=`
pub async fn since(caller: OnBehalf, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    let params = params(request.uri(), &KNOWN)?;
    let form = accept::message(request.headers())?;
    let since = params.number("since", REVISION)?;
    let since = since.ok_or_else(|| HttpError::invalid("since", "since is missing: changes after which revision?"))?;
    let area = params.box_query()?;
    let request = v1::GetChangesRequest {
        map: map.to_string(),
        since,
        min_x: area.min_x,
        min_y: area.min_y,
        max_x: area.max_x,
        max_y: area.max_y,
        depth: area.depth,
        contents: params.flag("contents")?,
    };
    let response = operations::get_changes(&caller, request).await?;
    let size = response.blocks.iter().map(|block| size_of_val(block) + block.classes.len()).sum();
    respond::message(form, response, size).await
}

/// `GET /v1/maps/{map}/events`: server-sent events whose id is the revision, or a line of JSON each.
pub async fn events(
    State(app): State<App>,
    caller: OnBehalf,
    path: MapPath,
    request: Request,
) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    let params = params(request.uri(), &WATCHED)?;
    let form = accept::choose(request.headers(), &FORMS)?;
    let since = match last_event(request.headers())? {
        // It is where the client stopped; the query string is where it once began.
        Some(last) => Some(last),
        None => params.number("since", REVISION)?,
    };
    let area = params.box_query()?;
    let request = v1::WatchMapRequest {
        map: map.to_string(),
        since,
        min_x: area.min_x,
        min_y: area.min_y,
        max_x: area.max_x,
        max_y: area.max_y,
        depth: area.depth,
        contents: params.flag("contents")?,
        robots: params.flag("robots")?,
    };
    let changes = watching::begin(&caller, &app.door, &request).await?;
    Ok(match form {
        Form::Events => event_stream(changes),
        Form::Lines => lines::response(changes),
    })
}

fn last_event(headers: &HeaderMap) -> Result<Option<u64>, HttpError> {
    let Some(value) = headers.get(LAST_EVENT_ID) else { return Ok(None) };
    let revision = value.to_str().ok().and_then(|text| text.trim().parse().ok());
    revision.map(Some).ok_or_else(|| HttpError::invalid(LAST_EVENT_ID, "Last-Event-ID must be a revision"))
}

fn event_stream(changes: mpsc::Receiver<Change>) -> Response {
    let events = ReceiverStream::new(changes).map(|change| Ok::<_, Infallible>(event(change)));
    Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response()
}

/// A change, or as the last event why there are no more.
fn event(change: Change) -> Event {
    match change {
        Ok(message) => {
            let event = Event::default().event("changes").id(message.revision.to_string());
            event.data(lines::json(&message))
        }
        Err(error) => Event::default().event("end").data(lines::json(&Problem::from(&error))),
    }
}

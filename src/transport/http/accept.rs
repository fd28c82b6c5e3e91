//! Which form an answer takes, by `Accept` (RFC 9110, 12.5.1).

use super::HttpError;
use crate::service::ErrorKind;
use crate::wire::Encoding;
use axum::http::{HeaderMap, header};

/// Media type of proto3 JSON.
pub const JSON: &str = "application/json";

/// Media type of protobuf, as answers name it.
pub const PROTOBUF: &str = "application/x-protobuf";

/// Forms of answers that are messages.
const MESSAGES: [(&str, Encoding); 3] =
    [(JSON, Encoding::Json), (PROTOBUF, Encoding::Protobuf), ("application/protobuf", Encoding::Protobuf)];

/// JSON or protobuf.
///
/// # Errors
/// [`ErrorKind::NotAcceptable`]
pub fn message(headers: &HeaderMap) -> Result<Encoding, HttpError> {
    choose(headers, &MESSAGES)
}

/// The offer that the client likes best; of equals the first. Without the header, the first.
///
/// # Errors
/// [`ErrorKind::NotAcceptable`] naming the offers.
pub fn choose<T: Copy>(headers: &HeaderMap, offers: &[(&str, T)]) -> Result<T, HttpError> {
    let ranges: Vec<Range> = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .filter_map(Range::parse)
        .collect();
    if !headers.contains_key(header::ACCEPT)
        && let Some((_, first)) = offers.first()
    {
        return Ok(*first);
    }
    let mut best: Option<(f32, T)> = None;
    for (media, offer) in offers {
        let quality = quality(&ranges, media);
        if quality > best.map_or(0.0, |(quality, _)| quality) {
            best = Some((quality, *offer));
        }
    }
    best.map(|(_, offer)| offer).ok_or_else(|| {
        let known: Vec<_> = offers.iter().map(|(media, _)| *media).collect();
        let mut error = HttpError::new(ErrorKind::NotAcceptable, format!("the answer comes as {}", known.join(", ")));
        error.0.field = Some("accept".to_owned());
        error
    })
}

/// A media range with its weight.
struct Range {
    media: String,
    quality: f32,
}

impl Range {
    fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split(';').map(str::trim);
        let media = parts.next().filter(|media| media.contains('/'))?.to_ascii_lowercase();
        let quality = parts
            .filter_map(|part| part.split_once('='))
            .find(|(name, _)| name.trim().eq_ignore_ascii_case("q"))
            .and_then(|(_, value)| value.trim().parse::<f32>().ok())
            .filter(|quality| quality.is_finite())
            .unwrap_or(1.0);
        Some(Self { media, quality })
    }
}

/// The weight of the most specific range that a media type is in; 0 when it is in none.
fn quality(ranges: &[Range], media: &str) -> f32 {
    let family = media.split('/').next().unwrap_or_default();
    let find = |wanted: &str| ranges.iter().find(|range| range.media == wanted).map(|range| range.quality);
    find(media).or_else(|| find(&format!("{family}/*"))).or_else(|| find("*/*")).unwrap_or(0.0)
}

//! Panics, the table of problems, and the choice of an answer's form.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::problem::Problem;
use super::{HttpError, accept, observe, viewer};
use crate::service::{ErrorKind, ServiceError};
use crate::transport::status::status;
use crate::wire::Encoding;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, Request, header};
use axum::response::IntoResponse;
use axum::{Router, routing::get};
use http_body_util::BodyExt;
use tower::ServiceExt;
use tower_http::catch_panic::CatchPanicLayer;

#[tokio::test]
async fn every_kind_of_error_is_a_problem() {
    for kind in ErrorKind::ALL.iter().copied() {
        let row = status(kind);
        let response = HttpError(ServiceError::new(kind, "what is wrong").at("field")).into_response();
        assert_eq!(response.status().as_u16(), row.http);
        assert!((400..=599).contains(&row.http), "{kind:?}");
        assert_eq!(response.headers()[header::CONTENT_TYPE], "application/problem+json");
        assert_eq!(response.headers().contains_key(header::RETRY_AFTER), row.retry_after.is_some());
        let body = response.into_body().collect().await.unwrap().to_bytes();
        let problem: Problem = serde_json::from_slice(&body).unwrap();
        assert_eq!((problem.status, problem.code.as_str()), (row.http, kind.code()));
        assert!(problem.r#type.starts_with("urn:ubbmap:problem:"), "{}", problem.r#type);
        assert_eq!((problem.detail.as_str(), problem.field.as_deref()), ("what is wrong", Some("field")));
    }
}

#[tokio::test]
async fn a_panic_is_an_internal_problem_that_keeps_its_words_to_itself() {
    async fn fails() -> &'static str {
        panic!("the secret words")
    }
    let router: Router = Router::new().route("/", get(fails)).layer(CatchPanicLayer::custom(observe::panicked));
    let response = router.oneshot(Request::new(Body::empty())).await.unwrap();
    assert_eq!(response.status().as_u16(), 500);
    let body = response.into_body().collect().await.unwrap().to_bytes();
    let problem: Problem = serde_json::from_slice(&body).unwrap();
    assert_eq!(problem.code, "INTERNAL");
    assert!(!problem.detail.contains("secret"));
}

#[test]
fn the_form_is_the_one_the_client_likes_best() {
    let choose = |accepts: &[&str]| {
        let mut headers = HeaderMap::new();
        for accept in accepts {
            headers.append(header::ACCEPT, HeaderValue::from_str(accept).unwrap());
        }
        accept::message(&headers).ok()
    };
    assert_eq!(choose(&[]), Some(Encoding::Json));
    assert_eq!(choose(&["*/*"]), Some(Encoding::Json));
    assert_eq!(choose(&["application/x-protobuf"]), Some(Encoding::Protobuf));
    assert_eq!(choose(&["Application/Protobuf"]), Some(Encoding::Protobuf));
    assert_eq!(choose(&["text/html, application/*;q=0.5"]), Some(Encoding::Json));
    assert_eq!(choose(&["application/json;q=0.1, application/x-protobuf"]), Some(Encoding::Protobuf));
    assert_eq!(choose(&["application/json;q=0.1", "application/x-protobuf;q=0.2"]), Some(Encoding::Protobuf));
    assert_eq!(choose(&["*/*, application/json;q=0"]), Some(Encoding::Protobuf));
    assert_eq!(choose(&["text/html"]), None);
    assert_eq!(choose(&["nonsense"]), None);
    assert_eq!(choose(&["application/json;q=0"]), None);
}

#[tokio::test]
async fn a_server_without_the_viewer_says_so_and_where_the_interface_is() {
    let response = viewer::page(None, &HeaderMap::new());
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()[header::CONTENT_TYPE], "text/html; charset=utf-8");
    assert!(response.headers().contains_key(header::CONTENT_SECURITY_POLICY));
    let body = response.into_body().collect().await.unwrap().to_bytes();
    let html = std::str::from_utf8(&body).unwrap();
    assert!(html.contains("not in this build") && html.contains("href=\"/v1/maps\""), "{html}");
}

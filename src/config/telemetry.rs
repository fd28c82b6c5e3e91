//! The settings of traces.

use super::ConfigError;
use axum::http::Uri;
use serde::{Deserialize, Serialize};

/// Traces of requests by OpenTelemetry; needs a program that was built with the feature `otel`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Telemetry {
    /// The collector's endpoint for OTLP over gRPC; empty for none.
    pub otlp_endpoint: String,
    /// What the traces call this server.
    pub service_name: String,
    /// The share of requests that are traced, where the client has not decided it.
    pub sampling: f64,
}

impl Default for Telemetry {
    fn default() -> Self {
        Self { otlp_endpoint: String::new(), service_name: "ubbmap".to_owned(), sampling: 1.0 }
    }
}

impl Telemetry {
    /// Checks the values.
    ///
    /// # Errors
    /// [`ConfigError::Value`] at the setting.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let bad = |key: &str, problem: String| Err(ConfigError::Value { key: format!("telemetry.{key}"), problem });
        if !(0.0..=1.0).contains(&self.sampling) {
            return bad("sampling", format!("must be between 0 and 1, got {}", self.sampling));
        }
        if self.service_name.is_empty() || self.service_name.len() > 255 {
            return bad("service_name", "must be a name of 1 to 255 characters".to_owned());
        }
        if self.otlp_endpoint.is_empty() {
            return Ok(());
        }
        if !cfg!(feature = "otel") {
            let problem = "this program was built without traces: build it with `--features otel`".to_owned();
            return bad("otlp_endpoint", problem);
        }
        let uri = self.otlp_endpoint.parse::<Uri>().ok();
        let good = uri.is_some_and(|uri| uri.scheme_str() == Some("http") && uri.host().is_some());
        if !good {
            let problem = format!("must be a URL such as \"http://127.0.0.1:4317\", got {:?}", self.otlp_endpoint);
            return bad("otlp_endpoint", problem);
        }
        Ok(())
    }
}

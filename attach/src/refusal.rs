//! Why a request is refused: a code for programs, a text for people.

use std::fmt;

use axum::{
    Json,
    http::StatusCode,
    response::{IntoResponse, Response},
};
use serde_json::{Value, json};

#[derive(Debug, PartialEq)]
pub(crate) struct Refusal {
    pub status: StatusCode,
    pub code: &'static str,
    pub text: String,
    /// Why the drive refused an object.
    pub abort: Option<u32>,
}

impl Refusal {
    pub fn new(status: StatusCode, code: &'static str, text: impl Into<String>) -> Self {
        Self {
            status,
            code,
            text: text.into(),
            abort: None,
        }
    }

    /// Of what was understood and cannot be done.
    pub fn of(code: &'static str, text: impl Into<String>) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, code, text)
    }

    /// Of what the program does not grant.
    pub fn not_granted(what: impl fmt::Display) -> Self {
        let text = format!("the program does not grant that clients {what}");
        Self::new(StatusCode::FORBIDDEN, "not_granted", text)
    }

    pub fn json(&self) -> Value {
        json!({"error": {"code": self.code, "text": self.text, "abort": self.abort}})
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        (self.status, Json(self.json())).into_response()
    }
}

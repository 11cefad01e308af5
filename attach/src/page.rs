//! The panel: a page that is in the program, and loads nothing from elsewhere.

use axum::{
    Router,
    http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS},
    response::IntoResponse,
    routing::get,
};

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// A file of the page, by its name.
macro_rules! part {
    ($name:literal, $kind:expr) => {
        (
            concat!("/", $name),
            $kind,
            include_str!(concat!("page/", $name)),
        )
    };
}

const PARTS: [(&str, &str, &str); 22] = [
    ("/", HTML, include_str!("page/index.html")),
    part!("panel.css", CSS),
    part!("theme.js", SCRIPT),
    part!("panel.js", SCRIPT),
    part!("connection.js", SCRIPT),
    part!("control.js", SCRIPT),
    part!("dom.js", SCRIPT),
    part!("words.js", SCRIPT),
    part!("goals.js", SCRIPT),
    part!("cards.js", SCRIPT),
    part!("scope.js", SCRIPT),
    part!("cursors.js", SCRIPT),
    part!("signals.js", SCRIPT),
    part!("devices.js", SCRIPT),
    part!("values.js", SCRIPT),
    part!("objects.js", SCRIPT),
    part!("compare.js", SCRIPT),
    part!("log.js", SCRIPT),
    part!("blackbox.js", SCRIPT),
    part!("cycles.js", SCRIPT),
    part!("uPlot.min.css", CSS),
    part!("uPlot.iife.min.js", SCRIPT),
];

/// Nothing from elsewhere, and shown in no other page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; \
                      img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Whether this is a part of the page, which shows nothing of a machine by itself.
pub(crate) fn is_part(path: &str) -> bool {
    PARTS.iter().any(|(part, _, _)| *part == path)
}

pub(crate) fn router<S: Clone + Send + Sync + 'static>() -> Router<S> {
    PARTS
        .iter()
        .fold(Router::new(), |router, (path, kind, text)| {
            router.route(
                path,
                get(async || {
                    let headers = [
                        (CONTENT_TYPE, *kind),
                        (CONTENT_SECURITY_POLICY, POLICY),
                        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
                        (CACHE_CONTROL, "no-cache"),
                    ];
                    (headers, *text).into_response()
                }),
            )
        })
}

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

const PARTS: [(&str, &str, &str); 6] = [
    ("/", HTML, include_str!("page/index.html")),
    ("/panel.css", CSS, include_str!("page/panel.css")),
    ("/panel.js", SCRIPT, include_str!("page/panel.js")),
    ("/scope.js", SCRIPT, include_str!("page/scope.js")),
    ("/uPlot.min.css", CSS, include_str!("page/uPlot.min.css")),
    (
        "/uPlot.iife.min.js",
        SCRIPT,
        include_str!("page/uPlot.iife.min.js"),
    ),
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

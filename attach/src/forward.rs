//! Passes requests on to the Unix socket of the program that has the network.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

use axum::{
    Extension, Router,
    body::Body,
    extract::{Request, State},
    http::{
        HeaderName, HeaderValue, StatusCode,
        header::{HOST, ORIGIN, UPGRADE},
    },
    response::{IntoResponse, Response},
};
use hyper::{client::conn::http1, upgrade};
use hyper_util::rt::TokioIo;
use tokio::{io::copy_bidirectional, net::UnixStream};

use crate::{log::Log, refusal::Refusal, server::Place};

/// By which start of a server an answer was given, or is to be: a request for another start is refused. A page that has asked one program
/// for axes and units is not to move those of the next one, to which its numbers may be other distances.
pub(crate) const START: HeaderName = HeaderName::from_static("servocrab-start");

/// The program that has the network.
struct Shower {
    socket: PathBuf,
    /// Of the first answer.
    start: OnceLock<HeaderValue>,
    log: Log,
}

pub(crate) fn router(socket: &Path, log: Log) -> Router {
    Router::new().fallback(pass_on).with_state(Arc::new(Shower {
        socket: socket.to_owned(),
        start: OnceLock::new(),
        log,
    }))
}

async fn pass_on(
    State(shower): State<Arc<Shower>>,
    Extension(place): Extension<Place>,
    request: Request,
) -> Response {
    match answer(&shower, place, request).await {
        Ok(response) => response,
        Err(error) => {
            let socket = shower.socket.display();
            shower.log.warn(format_args!("{socket}: {error}"));
            let text = format!("the program that has the network does not answer: {error}");
            Refusal::new(StatusCode::BAD_GATEWAY, "no_program", text).into_response()
        }
    }
}

async fn answer(
    shower: &Shower,
    place: Place,
    mut request: Request,
) -> Result<Response, Box<dyn std::error::Error + Send + Sync>> {
    let stream = UnixStream::connect(&shower.socket).await?;
    let (mut program, connection) = http1::handshake(TokioIo::new(stream)).await?;
    // Its end is that of the answer.
    tokio::spawn(connection.with_upgrades());
    // The gate has looked at them.
    request.headers_mut().remove(ORIGIN);
    request
        .headers_mut()
        .insert(HOST, HeaderValue::from_static("localhost"));
    if let Some(start) = shower.start.get() {
        request.headers_mut().insert(START, start.clone());
    }
    let client = request
        .headers()
        .contains_key(UPGRADE)
        .then(|| upgrade::on(&mut request));
    let mut response = program.send_request(request).await?;
    if let Some(start) = response.headers().get(START) {
        shower.start.get_or_init(|| start.clone());
    }
    if response.status() == StatusCode::SWITCHING_PROTOCOLS
        && let Some(client) = client
    {
        let program = upgrade::on(&mut response);
        tokio::spawn(async move {
            if let Ok((client, program)) = tokio::try_join!(client, program) {
                let (mut client, mut program) = (TokioIo::new(client), TokioIo::new(program));
                // Whichever end is gone ends the other.
                let _ = copy_bidirectional(&mut client, &mut program).await;
            }
            drop(place);
        });
    }
    Ok(response.map(Body::new))
}

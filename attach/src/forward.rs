//! Passes requests on to the Unix socket of the program that has the network.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use axum::{
    Extension, Router,
    body::Body,
    extract::{Request, State},
    http::{
        HeaderValue, StatusCode,
        header::{HOST, ORIGIN, UPGRADE},
    },
    response::{IntoResponse, Response},
};
use hyper::{client::conn::http1, upgrade};
use hyper_util::rt::TokioIo;
use tokio::{io::copy_bidirectional, net::UnixStream};

use crate::{log::Log, refusal::Refusal, server::Place};

pub(crate) fn router(socket: &Path, log: Log) -> Router {
    Router::new()
        .fallback(pass_on)
        .with_state(Arc::new((socket.to_owned(), log)))
}

async fn pass_on(
    State(state): State<Arc<(PathBuf, Log)>>,
    Extension(place): Extension<Place>,
    request: Request,
) -> Response {
    let (socket, log) = &*state;
    match answer(socket, place, request).await {
        Ok(response) => response,
        Err(error) => {
            log.warn(format_args!("{}: {error}", socket.display()));
            let text = format!("the program that has the network does not answer: {error}");
            Refusal::new(StatusCode::BAD_GATEWAY, "no_program", text).into_response()
        }
    }
}

async fn answer(
    socket: &Path,
    place: Place,
    mut request: Request,
) -> Result<Response, Box<dyn std::error::Error + Send + Sync>> {
    let stream = UnixStream::connect(socket).await?;
    let (mut program, connection) = http1::handshake(TokioIo::new(stream)).await?;
    // Its end is that of the answer.
    tokio::spawn(connection.with_upgrades());
    // The gate has looked at them.
    request.headers_mut().remove(ORIGIN);
    request
        .headers_mut()
        .insert(HOST, HeaderValue::from_static("localhost"));
    let client = request
        .headers()
        .contains_key(UPGRADE)
        .then(|| upgrade::on(&mut request));
    let mut response = program.send_request(request).await?;
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

//! The requests and their answers.

use std::{sync::Arc, time::Duration};

use axum::{
    Extension, Json, Router,
    extract::{Path, State},
    http::{StatusCode, header::CONTENT_TYPE},
    response::{IntoResponse, Response},
    routing::{get, post},
};
use serde_json::{Value, json};
use servocrab::{
    axis::StopRequest,
    bus::{Durations, NetworkView},
    coe::{ObjectAddress, SdoError},
};
use tokio::{sync::Semaphore, time::timeout};

use crate::{metrics, server::Client};

/// How long a request for an object waits for those before it.
const TURN: Duration = Duration::from_secs(2);

#[derive(Clone)]
struct Shown {
    view: NetworkView,
    /// One upload at a time, so that the program's own transfers wait for at most one of them.
    upload: Arc<Semaphore>,
}

pub(crate) fn router(view: NetworkView) -> Router {
    let shown = Shown {
        view,
        upload: Arc::new(Semaphore::new(1)),
    };
    Router::new()
        .route("/v1/line", get(line))
        .route("/v1/axes", get(axes))
        .route("/v1/statistics", get(statistics))
        .route("/metrics", get(metrics))
        .route("/v1/od/{drive}/{index}/{subindex}", get(object))
        .route("/v1/axes/{name}/stop", post(stop))
        .route("/v1/quick_stop", post(quick_stop))
        .fallback(async || refused(StatusCode::NOT_FOUND, "no_such_request", NO_REQUEST))
        .method_not_allowed_fallback(async || {
            refused(
                StatusCode::METHOD_NOT_ALLOWED,
                "wrong_method",
                "read by GET and stop by POST",
            )
        })
        .with_state(shown)
}

const NO_REQUEST: &str = "there is no such request: /v1/line, /v1/axes, /v1/statistics, /metrics, /v1/od/DRIVE/INDEX/SUBINDEX; by \
                          POST /v1/axes/NAME/stop and /v1/quick_stop";

fn refused(status: StatusCode, code: &str, text: impl Into<String>) -> Response {
    let error = json!({"error": {"code": code, "text": text.into()}});
    (status, Json(error)).into_response()
}

async fn line(State(shown): State<Shown>) -> Json<Value> {
    let drives = shown.view.drives().map(|sdo| {
        let drive = sdo.drive();
        json!({
            "position": drive.position,
            "name": drive.name,
            "vendor": drive.identity.vendor,
            "product": drive.identity.product,
            "revision": drive.identity.revision,
            "serial": drive.identity.serial,
        })
    });
    Json(json!({"drives": drives.collect::<Vec<_>>()}))
}

async fn axes(State(shown): State<Shown>) -> Json<Value> {
    let axes = shown.view.axes().into_iter().map(|axis| {
        let snapshot = axis.snapshot;
        json!({
            "name": axis.identity.axis,
            "drive": axis.identity.drive.position,
            "unit": axis.unit,
            "position": axis.position,
            "velocity": axis.velocity,
            "state": snapshot.state.to_string(),
            "statusword": {"value": snapshot.statusword.bits(), "text": snapshot.statusword.to_string()},
            "controlword": snapshot.controlword.bits(),
            "mode": snapshot.mode.to_string(),
            "answered": snapshot.answered,
            "lost": snapshot.lost,
            "age": snapshot.age,
            "cycle": snapshot.cycle,
            "halted": snapshot.halted,
            "has_set_point": snapshot.has_set_point,
            "referenced": snapshot.referenced,
        })
    });
    Json(axes.collect())
}

async fn statistics(State(shown): State<Shown>) -> Json<Value> {
    let (counted, timing) = (shown.view.statistics(), shown.view.timing());
    let drives = shown.view.drive_statistics().into_iter().map(|drive| {
        json!({
            "position": drive.drive.position,
            "stale_cycles": drive.stale_cycles,
            "undelivered_cycles": drive.undelivered_cycles,
            "emergencies": drive.emergencies.iter()
                .map(|(code, number)| json!({"code": code, "number": number})).collect::<Vec<_>>(),
        })
    });
    Json(json!({
        "cycles": counted.cycles,
        "late_cycles": counted.late_cycles,
        "overruns": counted.overruns,
        "lost_frames": counted.lost,
        "late_frames": counted.late,
        "damaged_frames": counted.damaged,
        "foreign_frames": counted.foreign,
        "frames_not_sent": counted.not_sent,
        "wrong_working_counters": counted.wrong_working_counters,
        "acyclic_frames_in_a_cycle": counted.acyclic_in_cycle,
        "lateness_us": durations(&timing.lateness),
        "round_trip_us": durations(&timing.round_trip),
        "drives": drives.collect::<Vec<_>>(),
    }))
}

async fn metrics(State(shown): State<Shown>) -> Response {
    // One at a time, as the uploads: the ports are asked over the line.
    let ports = timeout(TURN, async {
        let _turn = shown.upload.acquire().await.ok()?;
        shown.view.port_errors().await.ok()
    });
    let ports = ports.await.ok().flatten();
    match metrics::text(&shown.view, ports.as_deref()) {
        Ok(text) => ([(CONTENT_TYPE, metrics::TYPE)], text).into_response(),
        Err(error) => {
            let status = StatusCode::INTERNAL_SERVER_ERROR;
            refused(status, "not_written", error.to_string())
        }
    }
}

fn durations(times: &Durations) -> Value {
    let us = |time: Option<Duration>| time.map(|time| time.as_secs_f64() * 1e6);
    json!({
        "least": us(times.least()),
        "50 %": us(times.quantile(0.5)),
        "99 %": us(times.quantile(0.99)),
        "99.9 %": us(times.quantile(0.999)),
        "most": us(times.most()),
    })
}

async fn object(
    State(shown): State<Shown>,
    Path((drive, index, subindex)): Path<(String, String, String)>,
) -> Response {
    let Ok(address) = format!("{index}:{subindex}").parse::<ObjectAddress>() else {
        let text = format!("`{index}/{subindex}` is no object: ask for one as 6041h/0 or 0x6041/0");
        return refused(StatusCode::BAD_REQUEST, "no_object", text);
    };
    let mut drives = shown.view.drives();
    let place = drive.parse::<u16>().ok();
    let Some(sdo) = drives.find(|sdo| Some(sdo.drive().position) == place) else {
        let text = format!("no drive was declared at position `{drive}`: /v1/line lists them");
        return refused(StatusCode::NOT_FOUND, "no_drive", text);
    };
    let Ok(Ok(_turn)) = timeout(TURN, shown.upload.acquire()).await else {
        let text = "another object is being read: ask again later";
        return refused(StatusCode::SERVICE_UNAVAILABLE, "busy", text);
    };
    match sdo.read_bytes(address.index, address.subindex).await {
        Ok(bytes) => Json(json!({
            "index": address.index,
            "subindex": address.subindex,
            "bytes": bytes,
        }))
        .into_response(),
        Err(error) => {
            let (status, code) = match error.error {
                SdoError::Aborted { .. } => (StatusCode::UNPROCESSABLE_ENTITY, "aborted"),
                SdoError::Closed { .. } => (StatusCode::SERVICE_UNAVAILABLE, "closed"),
                _ => (StatusCode::BAD_GATEWAY, "not_read"),
            };
            refused(status, code, error.to_string())
        }
    }
}

async fn stop(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Response {
    if let Err(error) = shown.view.stop_axis(&name, StopRequest::STOP) {
        return refused(StatusCode::NOT_FOUND, "no_axis", error.to_string());
    }
    let Client { user, process } = client;
    tracing::warn!(target: "servocrab::attach", "axis {name} is stopped by user {user}, process {process:?}");
    accepted()
}

async fn quick_stop(State(shown): State<Shown>, Extension(client): Extension<Client>) -> Response {
    shown.view.stop_all(StopRequest::QUICK_STOP);
    let Client { user, process } = client;
    tracing::warn!(target: "servocrab::attach", "all axes are stopped by user {user}, process {process:?}");
    accepted()
}

/// The stop is in the next frame; whether the axes stand, `/v1/axes` says.
fn accepted() -> Response {
    (StatusCode::ACCEPTED, Json(json!({"asked": true}))).into_response()
}

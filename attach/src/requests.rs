//! The requests and their answers.

use std::{collections::HashMap, time::Duration};

use axum::{
    Extension, Json, Router,
    extract::{
        DefaultBodyLimit, Path, Query, RawQuery, Request, State, WebSocketUpgrade, ws::WebSocket,
    },
    http::{HeaderValue, StatusCode, header::CONTENT_TYPE},
    middleware::{Next, from_fn_with_state, map_response},
    response::{IntoResponse, Response},
    routing::{get, post},
};
use serde_json::{Map, Value, json};
use servocrab::{
    StopRequest,
    bus::{Durations, NetworkEvent, NetworkView, NoSignal, Signal},
    ds402::Controlword,
};

use crate::{
    commands, control,
    forward::START,
    line, metrics, objects,
    refusal::Refusal,
    server::{Client, Place},
    shown::Shown,
    streams::SIGNALS,
};

/// Bytes of the body of a request.
const BODY: usize = 64 * 1024;
/// Bytes of a message of a client.
const MESSAGE: usize = 4096;

/// `start` names this start of the server.
pub(crate) fn router(shown: Shown, start: HeaderValue) -> Router {
    Router::new()
        .route("/v1/line", get(line::line))
        .route("/v1/devices", get(line::devices))
        .route("/v1/axes", get(line::axes))
        .route("/v1/signals", get(line::signals))
        .route("/v1/statistics", get(statistics))
        .route("/metrics", get(metrics))
        .route("/v1/ios", get(line::ios))
        .route("/v1/grants", get(grants))
        .route("/v1/events", get(events))
        .route("/v1/emergencies", get(emergencies))
        .route("/v1/commands", get(commands))
        .route("/v1/events/{number}/black_box", get(black_box))
        .route("/v1/od/{drive}", get(objects::dictionary))
        .route("/v1/od/{drive}/information", get(objects::information))
        .route(
            "/v1/od/{drive}/{index}/{subindex}",
            get(objects::read).post(objects::write),
        )
        .route("/v1/stream", get(stream))
        .route("/v1/control", get(control))
        .route("/v1/axes/{name}/limits", get(objects::limits))
        .route("/v1/enable", post(commands::enable_all))
        .route("/v1/axes/{name}/enable", post(commands::enable))
        .route("/v1/axes/{name}/recover", post(commands::recover))
        .route("/v1/axes/{name}/disable", post(commands::disable))
        .route("/v1/axes/{name}/reset_fault", post(commands::reset_fault))
        .route("/v1/axes/{name}/move", post(commands::move_axis))
        .route("/v1/axes/{name}/home", post(commands::home))
        .route_layer(from_fn_with_state(start, of_this_start))
        // Whoever asks for a stop gets it.
        .route("/v1/axes/{name}/stop", post(stop))
        .route("/v1/quick_stop", post(quick_stop))
        .fallback(async || Refusal::new(StatusCode::NOT_FOUND, "no_such_request", NO_REQUEST))
        .method_not_allowed_fallback(async || {
            Refusal::new(
                StatusCode::METHOD_NOT_ALLOWED,
                "wrong_method",
                "read by GET, stop and change by POST",
            )
        })
        .layer(DefaultBodyLimit::max(BODY))
        .layer(map_response(in_json))
        .with_state(shown)
}

const NO_REQUEST: &str = "there is no such request: /v1/line, /v1/devices, /v1/axes, /v1/ios, /v1/signals, /v1/statistics, /v1/grants, \
                          /v1/events, /v1/emergencies, /v1/commands, /v1/events/NUMBER/black_box, /v1/od/DRIVE, /v1/od/DRIVE/INDEX/SUBINDEX, /v1/od/DRIVE/information, /v1/stream, /v1/control, /metrics; by POST \
                          /v1/axes/NAME/stop, enable, disable, reset_fault, recover, move and home, /v1/enable, /v1/od/DRIVE/INDEX/SUBINDEX, /v1/quick_stop";

/// A refusal that was made before a request was understood, as all others are.
async fn in_json(response: Response) -> Response {
    let status = response.status();
    let kind = response.headers().get(CONTENT_TYPE);
    let is_json = kind.is_some_and(|kind| kind == "application/json");
    if is_json || !(status.is_client_error() || status.is_server_error()) {
        return response;
    }
    let reason = status.canonical_reason().unwrap_or("it is refused");
    Refusal::new(status, "not_understood", reason).into_response()
}

/// Refuses what is asked of another start, and says which one this is.
async fn of_this_start(State(start): State<HeaderValue>, request: Request, next: Next) -> Response {
    let asked = request.headers().get(START);
    if asked.is_some_and(|asked| *asked != start) {
        return Refusal::new(
            StatusCode::CONFLICT,
            "another_start",
            "the program that was shown here has ended, and another one has the network, perhaps with other axes and units: start the \
             panel again",
        )
        .into_response();
    }
    let mut response = next.run(request).await;
    response.headers_mut().insert(START, start);
    response
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
    let axes = shown.view.axis_statistics().into_iter().map(|axis| {
        json!({
            "name": axis.axis.axis,
            "motions": axis.motions.iter()
                .map(|(end, number)| (end.to_string(), (*number).into())).collect::<Map<_, _>>(),
            "faults": axis.faults.iter()
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
        "axes": axes.collect::<Vec<_>>(),
    }))
}

async fn metrics(State(shown): State<Shown>) -> Response {
    // One at a time, as the uploads: the ports are asked over the line.
    let ports = match shown.turn().await {
        Ok(_turn) => shown.view.port_errors().await.ok(),
        Err(_) => None,
    };
    match metrics::text(&shown.view, ports.as_deref()) {
        Ok(text) => ([(CONTENT_TYPE, metrics::TYPE)], text).into_response(),
        Err(error) => {
            let status = StatusCode::INTERNAL_SERVER_ERROR;
            Refusal::new(status, "not_written", error.to_string()).into_response()
        }
    }
}

/// Two bars of a histogram for each doubling of the time.
const BARS_OF_AN_OCTAVE: f64 = 2.0;

fn durations(times: &Durations) -> Value {
    let us = |time: Option<Duration>| time.map(|time| time.as_secs_f64() * 1e6);
    let mut bars: Vec<(i32, u64)> = Vec::new();
    for (bucket, count) in times.buckets() {
        let end = bucket.end().as_secs_f64() * 1e6;
        // Below a nanosecond there is no time.
        let bar = (BARS_OF_AN_OCTAVE * end.max(1e-3).log2()).ceil() as i32;
        match bars.last_mut() {
            Some((last, counted)) if *last == bar => *counted += count,
            _ => bars.push((bar, count)),
        }
    }
    let bars = bars.into_iter().map(|(bar, count)| {
        let up_to = (f64::from(bar) / BARS_OF_AN_OCTAVE).exp2();
        json!({"up_to": up_to, "count": count})
    });
    json!({
        "histogram": bars.collect::<Vec<_>>(),
        "least": us(times.least()),
        "50 %": us(times.quantile(0.5)),
        "99 %": us(times.quantile(0.99)),
        "99.9 %": us(times.quantile(0.999)),
        "most": us(times.most()),
    })
}

async fn commands(State(shown): State<Shown>) -> Json<Value> {
    Json(shown.journal.json())
}

async fn grants(State(shown): State<Shown>) -> Json<Value> {
    Json(shown.granted.json())
}

async fn events(State(shown): State<Shown>) -> Json<Value> {
    let events = shown
        .view
        .recent_events()
        .into_iter()
        .map(|(number, event)| {
            let axis = match &event {
                NetworkEvent::AxisIncident(black_box) => Some(&black_box.axis.axis),
                _ => None,
            };
            json!({
                "number": number,
                "drive": event.drive().position,
                "axis": axis,
                "text": event.to_string(),
                "has_black_box": axis.is_some(),
            })
        });
    Json(events.collect())
}

async fn emergencies(State(shown): State<Shown>) -> Json<Value> {
    let recent = shown.view.recent_emergencies().into_iter();
    let emergencies = recent.map(|(number, emergency)| {
        json!({
            "number": number,
            "drive": emergency.drive.position,
            "seconds": emergency.at.as_secs_f64(),
            "code": emergency.emergency.code,
            "register": emergency.emergency.register,
            "data": emergency.emergency.data,
            "text": emergency.text,
        })
    });
    Json(emergencies.collect())
}

/// The cycles around a fault or a loss.
async fn black_box(
    State(shown): State<Shown>,
    Path(number): Path<String>,
) -> Result<Json<Value>, Refusal> {
    let events = shown.view.recent_events();
    let mut events = events.iter();
    let event = events.find(|(known, _)| known.to_string() == number);
    let Some((_, NetworkEvent::AxisIncident(black_box))) = event else {
        let text = format!("no event `{number}` with a black box is kept: /v1/events lists them");
        return Err(Refusal::new(StatusCode::NOT_FOUND, "no_black_box", text));
    };
    let axes = shown.view.axes();
    let mut axes = axes.iter();
    let axis = axes.find(|axis| axis.identity == black_box.axis);
    let (unit, scale) = axis.map_or(("counts", servocrab::units::Scale::COUNTS), |axis| {
        (axis.unit, axis.scale)
    });
    let cycles = black_box.cycles.iter().map(|cycle| {
        json!({
            "number": cycle.number,
            "time": cycle.time.as_secs_f64(),
            "answered": format!("{:?}", cycle.answered),
            "controlword": cycle.controlword.bits(),
            // Of a relative move it is a distance.
            "target": (!cycle.controlword.contains(Controlword::RELATIVE)).then(|| scale.position_of(cycle.target)),
            "statusword": cycle.inputs.map(|inputs| inputs.statusword.bits()),
            "state": cycle.inputs.map(|inputs| inputs.statusword.state().to_string()),
            "position": cycle.inputs.map(|inputs| scale.position_of(inputs.position)),
        })
    });
    Ok(Json(json!({
        "axis": black_box.axis.axis,
        "text": black_box.to_string(),
        "unit": unit,
        "cycles": cycles.collect::<Vec<_>>(),
    })))
}

/// The names of the signals. A comma in a name is escaped, and one between two names is not. A client that escapes the latter too gets what
/// it means as long as no name has a comma.
fn names(view: &NetworkView, raw: &str, query: &HashMap<String, String>) -> Vec<String> {
    let escaped = raw
        .split('&')
        .find_map(|part| part.strip_prefix("signals="));
    let names = escaped.unwrap_or_default().split(',');
    let whole = query.get("signals").map_or("", String::as_str);
    let names: Vec<_> = names.filter_map(unescaped).collect();
    match names.as_slice() {
        [_, _, ..] => names,
        _ if whole.parse().is_ok_and(|one| view.recorder([one]).is_ok()) => vec![whole.to_owned()],
        _ => whole.split(',').map(str::to_owned).collect(),
    }
}

/// What this part of a query stands for.
fn unescaped(part: &str) -> Option<String> {
    let uri = format!("/?part={part}").parse().ok()?;
    let Query(fields) = Query::<HashMap<String, String>>::try_from_uri(&uri).ok()?;
    fields.into_values().next()
}

/// The signals of a query, as `signals=x.position,x.velocity&every=10`.
async fn stream(
    State(shown): State<Shown>,
    Extension(place): Extension<Place>,
    Query(query): Query<HashMap<String, String>>,
    RawQuery(raw): RawQuery,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Result<Response, Refusal> {
    let bad = |text: String| Refusal::new(StatusCode::BAD_REQUEST, "no_stream", text);
    let upgrade = upgrade.map_err(|error| bad(format!("a WebSocket is expected: {error}")))?;
    let signals = names(&shown.view, raw.as_deref().unwrap_or_default(), &query);
    let signals = signals.iter().map(|name| name.parse::<Signal>());
    let signals: Vec<_> = signals
        .collect::<Result<_, NoSignal>>()
        .map_err(|error| bad(error.to_string()))?;
    let every = query
        .get("every")
        .map_or(Ok(1), |every| every.parse::<u32>());
    let every = every.ok().filter(|every| (1..=10_000).contains(every));
    let every = every.ok_or_else(|| bad("`every` is a number of cycles from 1 to 10000".into()))?;
    if signals.len() > SIGNALS {
        return Err(bad(format!("at most {SIGNALS} signals in a stream")));
    }
    let stream = shown.streams.open(&shown.view, &signals, every);
    let stream = stream.map_err(|error| bad(error.to_string()))?;
    Ok(upgraded(upgrade, place, async move |socket| {
        stream.send(socket).await;
    }))
}

async fn control(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Extension(place): Extension<Place>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Result<Response, Refusal> {
    let upgrade = upgrade.map_err(|error| {
        let text = format!("a WebSocket is expected: {error}");
        Refusal::new(StatusCode::BAD_REQUEST, "no_websocket", text)
    })?;
    Ok(upgraded(upgrade, place, async move |socket| {
        control::serve(shown, client, socket).await;
    }))
}

/// The client keeps its place until the WebSocket ends.
fn upgraded<F>(
    upgrade: WebSocketUpgrade,
    place: Place,
    serve: impl FnOnce(WebSocket) -> F + Send + 'static,
) -> Response
where
    F: Future<Output = ()> + Send + 'static,
{
    upgrade
        .protocols(["servocrab"])
        .max_message_size(MESSAGE)
        .max_frame_size(MESSAGE)
        .on_upgrade(|socket| {
            let served = serve(socket);
            async move {
                served.await;
                drop(place);
            }
        })
}

async fn stop(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Result<Response, Refusal> {
    stop_axis(&shown, &client, &name)?;
    Ok(accepted())
}

async fn quick_stop(State(shown): State<Shown>, Extension(client): Extension<Client>) -> Response {
    stop_all(&shown, &client);
    accepted()
}

/// Stops an axis by request of a client.
pub(crate) fn stop_axis(shown: &Shown, client: &Client, name: &str) -> Result<(), Refusal> {
    let stopped = shown.view.stop_axis(name, StopRequest::STOP);
    stopped.map_err(|error| Refusal::new(StatusCode::NOT_FOUND, "no_axis", error.to_string()))?;
    shown.journal.stop(client, &format!("stop {name}"));
    shown
        .log
        .warn(format_args!("axis {name} is stopped by {client}"));
    Ok(())
}

/// Stops all axes by quick stop, by request of a client.
pub(crate) fn stop_all(shown: &Shown, client: &Client) {
    shown.view.stop_all(StopRequest::QUICK_STOP);
    shown.journal.stop(client, "quick stop of all axes");
    shown
        .log
        .warn(format_args!("all axes are stopped by {client}"));
}

/// The stop is in the next frame; whether the axes stand, `/v1/axes` says.
fn accepted() -> Response {
    (StatusCode::ACCEPTED, Json(json!({"asked": true}))).into_response()
}

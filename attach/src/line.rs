//! What is shown of the line: its devices, the axes, and the signals that can be streamed.

use axum::{
    Json,
    extract::{Query, State},
    http::StatusCode,
};
use serde::Deserialize;
use serde_json::{Value, json};
use servocrab::{
    bus::{AxisView, DevicePorts, NetworkEvent, NetworkView, SeenDevice, Signal},
    coe::{DriveEmergency, obj},
    pdo_map::Direction,
};

use crate::{refusal::Refusal, shown::Shown};

pub(crate) async fn line(State(shown): State<Shown>) -> Json<Value> {
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

/// All devices of the line with their states and what their ports have counted, read over the line now.
pub(crate) async fn devices(State(shown): State<Shown>) -> Result<Json<Value>, Refusal> {
    let _turn = shown.turn().await?;
    let not_read = |error: servocrab::NetworkError| {
        Refusal::new(StatusCode::BAD_GATEWAY, "line", error.to_string())
    };
    let states = shown.view.device_states().await.map_err(not_read)?;
    let ports = shown.view.port_errors().await.map_err(not_read)?;
    let devices = states.iter().map(|seen| {
        let position = seen.device.position;
        let ports = ports.iter().find(|ports| ports.position == position);
        device(&shown.view, seen, ports)
    });
    Ok(Json(devices.collect()))
}

fn device(view: &NetworkView, seen: &SeenDevice, ports: Option<&DevicePorts>) -> Value {
    let position = seen.device.position;
    let is_drive = view
        .axes()
        .iter()
        .any(|axis| axis.identity.drive.position == position);
    let io = view
        .ios()
        .iter()
        .find(|io| io.device().position == position);
    let kind = match (is_drive, io) {
        (true, _) => "drive",
        (false, Some(_)) => "io",
        (false, None) => "other",
    };
    let ports = ports.map(|device| {
        let ports = device.ports.iter().map(|port| {
            json!({
                "invalid_frames": port.invalid_frames,
                "physical": port.physical,
                "forwarded": port.forwarded,
                "lost_links": port.lost_links,
            })
        });
        ports.collect::<Vec<_>>()
    });
    json!({
        "position": position,
        "name": seen.device.name,
        "kind": kind,
        "io": io.map(servocrab::bus::Io::name),
        "state": seen.status.map(|status| status.state.to_string()),
        "error": seen.status.and_then(|status| status.error),
        "text": seen.status.map(|status| status.to_string()),
        "ports": ports,
    })
}

pub(crate) async fn ios(State(shown): State<Shown>) -> Json<Value> {
    let ios = shown.view.ios().iter().map(|io| {
        let points = io.points().iter().map(|point| {
            json!({
                "name": point.name,
                "index": point.object.index,
                "subindex": point.object.subindex,
                "bits": point.place.bits,
                "is_input": point.direction == Direction::Inputs,
                "signal": Signal::point(io.name(), &point.object.to_string()).to_string(),
            })
        });
        json!({
            "name": io.name(),
            "position": io.device().position,
            "points": points.collect::<Vec<_>>(),
        })
    });
    Json(ios.collect())
}

pub(crate) async fn axes(State(shown): State<Shown>) -> Json<Value> {
    let (events, emergencies) = (shown.view.recent_events(), shown.view.recent_emergencies());
    let axes = shown.view.axes().into_iter().map(|axis| {
        let trouble = trouble(&axis, &events, &emergencies);
        let snapshot = axis.snapshot;
        json!({
            "name": axis.identity.axis,
            "drive": axis.identity.drive.position,
            "unit": axis.unit,
            "count": (axis.scale.position_of(1) - axis.scale.position_of(0)).abs(),
            "position": axis.position,
            "velocity": axis.velocity,
            "following_error": axis.following_error,
            "torque": axis.torque,
            "state": snapshot.state.to_string(),
            "statusword": {
                "value": snapshot.statusword.bits(),
                "text": snapshot.statusword.to_string(),
                "bits": snapshot.statusword.iter_names().map(|(name, _)| name).collect::<Vec<_>>(),
            },
            "controlword": snapshot.controlword.bits(),
            "controlword_bits": snapshot.controlword.iter_names().map(|(name, _)| name).collect::<Vec<_>>(),
            "mode": snapshot.mode.to_string(),
            "mode_number": snapshot.mode.raw(),
            "answered": snapshot.answered,
            "lost": snapshot.lost,
            "age": snapshot.age,
            "cycle": snapshot.cycle,
            "halted": snapshot.halted,
            "has_set_point": snapshot.has_set_point,
            "referenced": snapshot.referenced,
            "slipped": snapshot.slipped,
            "trouble": trouble.map(|(kind, text)| json!({"kind": kind, "text": text})),
        })
    });
    Json(axes.collect())
}

/// Whether an axis is `lost` or has a `fault`, and what is known of why.
fn trouble(
    axis: &AxisView,
    events: &[(u64, NetworkEvent)],
    emergencies: &[(u64, DriveEmergency)],
) -> Option<(&'static str, String)> {
    let position = axis.identity.drive.position;
    let of_drive = |event: &&NetworkEvent| {
        event.drive().position == position
            && matches!(
                event,
                NetworkEvent::Lost(_)
                    | NetworkEvent::Back(_)
                    | NetworkEvent::LeftOp { .. }
                    | NetworkEvent::InOp(_)
            )
    };
    let mut events = events.iter().rev().map(|(_, event)| event);
    let away = events
        .find(of_drive)
        .filter(|event| matches!(event, NetworkEvent::Lost(_) | NetworkEvent::LeftOp { .. }));
    if let Some(event) = away {
        return Some(("lost", event.to_string()));
    }
    if axis.snapshot.lost {
        return Some(("lost", "the drive does not answer".to_owned()));
    }
    if !axis.snapshot.state.is_fault() {
        return None;
    }
    let mut emergencies = emergencies.iter().rev().map(|(_, emergency)| emergency);
    // One of 0 says that another is over.
    let latest = emergencies
        .find(|emergency| emergency.drive.position == position && emergency.emergency.code != 0);
    let text = match latest {
        Some(latest) => format!(
            "the drive says {:04X}h: {}",
            latest.emergency.code, latest.text
        ),
        None => "the drive has sent no emergency: its error code is 603Fh".to_owned(),
    };
    let lag = match axis.snapshot.shows_following_error() {
        true => "following error (statusword bit 13); ",
        false => "",
    };
    Some(("fault", format!("{lag}{text}")))
}

#[derive(Deserialize)]
pub(crate) struct Wanted {
    name: Option<String>,
}

/// The signals of the declared devices, or the one that is asked for: refused with the reason where there is no such.
pub(crate) async fn signals(
    State(shown): State<Shown>,
    Query(wanted): Query<Wanted>,
) -> Result<Json<Value>, Refusal> {
    if let Some(name) = wanted.name {
        let refused = |text: String| Refusal::new(StatusCode::BAD_REQUEST, "no_signal", text);
        let signal: Signal = name
            .parse()
            .map_err(|error: servocrab::bus::NoSignal| refused(error.to_string()))?;
        let unit = unit_of(&shown.view, &signal).map_err(refused)?;
        return Ok(Json(json!([{"signal": signal.to_string(), "unit": unit}])));
    }
    let axes = shown.view.axes();
    let of_axes = axes.iter().flat_map(|axis| {
        let name = &*axis.identity.axis;
        let position = axis.identity.drive.position;
        let objects = obj::all();
        let objects = objects
            .into_iter()
            .map(|object| (Signal::axis(name, object), !object.writable));
        let state = (Signal::state(name), true);
        objects
            .chain([state])
            .map(move |(signal, is_input)| (signal, Some(position), is_input))
    });
    let of_ios = shown.view.ios().iter().flat_map(|io| {
        let position = io.device().position;
        io.points().iter().map(move |point| {
            let signal = Signal::point(io.name(), &point.object.to_string());
            (signal, Some(position), point.direction == Direction::Inputs)
        })
    });
    let all = of_axes
        .chain(of_ios)
        .chain([(Signal::Lateness, None, true)]);
    let known = all.filter_map(|(signal, device, is_input)| {
        let unit = unit_of(&shown.view, &signal).ok()?;
        Some(json!({
            "signal": signal.to_string(),
            "unit": unit,
            "device": device,
            "is_input": is_input,
        }))
    });
    Ok(Json(known.collect()))
}

fn unit_of(view: &NetworkView, signal: &Signal) -> Result<String, String> {
    let recorder = view.recorder([signal.clone()]);
    let recorder = recorder.map_err(|error| error.to_string())?;
    let unit = recorder.signals().iter().map(|shown| shown.unit.clone());
    Ok(unit.collect())
}

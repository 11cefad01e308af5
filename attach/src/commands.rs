//! What clients may do with axes where the program grants it.

use std::{fmt, time::Duration};

use axum::{
    Extension, Json,
    body::Bytes,
    extract::{Path, State},
    http::StatusCode,
    response::{IntoResponse, Response},
};
use serde::Deserialize;
use serde_json::{Value, json};
use servocrab::{
    AxisError, BufferMode, HomingMethod, HomingParameters, NetworkError, Outcome, SetPoint,
    units::Scale,
};
use tokio::time::timeout;

use crate::{
    grants::{Granted, GrantedAxis},
    refusal::Refusal,
    server::Client,
    shown::Shown,
};

/// How long the end of a motion is waited for before its request is answered all the same.
const ANSWERS: Duration = Duration::from_secs(50);

impl Granted {
    /// An axis that may be jogged.
    pub fn jog(&self, name: &str) -> Result<&GrantedAxis, Refusal> {
        let granted = self.axes.get(name);
        let granted = granted.filter(|axis| axis.max_velocity.is_some());
        granted.ok_or_else(|| Refusal::not_granted(format_args!("jog `{name}`")))
    }

    fn moves(&self, name: &str) -> Result<&GrantedAxis, Refusal> {
        let granted = self.axes.get(name).filter(|axis| axis.moves);
        granted.ok_or_else(|| Refusal::not_granted(format_args!("move `{name}`")))
    }

    fn any(&self, name: &str) -> Result<&GrantedAxis, Refusal> {
        let granted = self.axes.get(name);
        granted.ok_or_else(|| Refusal::not_granted(format_args!("enable `{name}`")))
    }

    pub fn json(&self) -> Value {
        let mut axes: Vec<_> = self.axes.iter().collect();
        axes.sort_by_key(|(name, _)| *name);
        let axes = axes.into_iter().map(|(name, axis)| {
            json!({"axis": name, "max_velocity": axis.max_velocity, "moves": axis.moves})
        });
        json!({"parameters": self.parameters, "axes": axes.collect::<Vec<_>>()})
    }
}

pub(crate) fn body<'a, T: Deserialize<'a>>(bytes: &'a Bytes) -> Result<T, Refusal> {
    serde_json::from_slice(bytes)
        .map_err(|error| Refusal::of("bad_body", format!("the body is not understood: {error}")))
}

/// Why a command was not done, for who asked.
trait Failed: fmt::Display + Send + 'static {
    fn refusal(&self, shown: &Shown, client: &Client) -> Refusal;
}

impl Failed for AxisError {
    fn refusal(&self, shown: &Shown, client: &Client) -> Refusal {
        shown.refusal_of(self, client)
    }
}

impl Failed for NetworkError {
    fn refusal(&self, _: &Shown, _: &Client) -> Refusal {
        Refusal::of("network", self.to_string())
    }
}

/// Answered when it is done, or after 50 s. It is done to its end also where the client goes away.
async fn finish<E: Failed>(
    shown: Shown,
    client: Client,
    what: String,
    work: impl Future<Output = Result<String, E>> + Send + 'static,
) -> Response {
    shown.log.warn(format_args!("{what}: by {client}"));
    let begun = shown.journal.begin(&client, &what);
    let done = tokio::spawn(async move {
        match work.await {
            Ok(outcome) => {
                shown.log.info(format_args!("{what}: {outcome}"));
                begun.done(&outcome);
                Ok(outcome)
            }
            Err(error) => {
                shown.log.warn(format_args!("{what}: {error}"));
                begun.failed(&error.to_string());
                Err(error.refusal(&shown, &client))
            }
        }
    });
    match timeout(ANSWERS, done).await {
        Ok(Ok(Ok(outcome))) => Json(json!({"done": true, "text": outcome})).into_response(),
        Ok(Ok(Err(refusal))) => refusal.into_response(),
        Ok(Err(_)) => {
            let status = StatusCode::INTERNAL_SERVER_ERROR;
            Refusal::new(status, "ended", "the work was given up").into_response()
        }
        Err(_) => (StatusCode::ACCEPTED, Json(json!({"done": false}))).into_response(),
    }
}

pub(crate) async fn enable(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Result<Response, Refusal> {
    let axis = shown.granted.any(&name)?.axis.clone();
    let work = async move { axis.enable().await.map(|()| "enabled".to_owned()) };
    Ok(finish(shown, client, format!("enable {name}"), work).await)
}

/// Enables all axes that the client may enable, at once. The first error is answered; the others are enabled all the same.
pub(crate) async fn enable_all(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
) -> Result<Response, Refusal> {
    let axes = shown.granted.axes.values();
    let axes: Vec<_> = axes.map(|granted| granted.axis.clone()).collect();
    if axes.is_empty() {
        return Err(Refusal::not_granted("enable any axis"));
    }
    let work = async move {
        let count = axes.len();
        let enables: Vec<_> = axes
            .into_iter()
            .map(|axis| tokio::spawn(async move { axis.enable().await }))
            .collect();
        let mut first = Ok(format!("{count} axes are enabled"));
        for enabled in enables {
            // One that was given up has panicked, and is shown as it is.
            if let Ok(Err(error)) = enabled.await {
                first = first.and(Err(error));
            }
        }
        first
    };
    Ok(finish(shown, client, "enable all axes".into(), work).await)
}

/// Brings the drive of this axis back into OP. All its axes begin again by that, so each of them is to be granted.
pub(crate) async fn recover(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Result<Response, Refusal> {
    let position = shown.granted.any(&name)?.axis.identity().drive.position;
    for axis in shown.view.axes() {
        if axis.identity.drive.position == position
            && !shown.granted.axes.contains_key(&*axis.identity.axis)
        {
            let other = &axis.identity.axis;
            return Err(Refusal::not_granted(format_args!(
                "recover the drive of `{name}`: `{other}` is of the same drive"
            )));
        }
    }
    let view = shown.view.clone();
    let work = async move { view.recover(position).await.map(|how| how.to_string()) };
    let what = format!("recover the drive of {name}");
    Ok(finish(shown, client, what, work).await)
}

pub(crate) async fn disable(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Result<Response, Refusal> {
    let axis = shown.granted.any(&name)?.axis.clone();
    let work = async move { axis.disable().await.map(|_| "disabled".to_owned()) };
    Ok(finish(shown, client, format!("disable {name}"), work).await)
}

pub(crate) async fn reset_fault(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
) -> Result<Response, Refusal> {
    let axis = shown.granted.any(&name)?.axis.clone();
    let work = async move { axis.reset_fault().await.map(|_| "reset".to_owned()) };
    Ok(finish(shown, client, format!("reset the fault of {name}"), work).await)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MoveBody {
    to: Option<f64>,
    by: Option<f64>,
    velocity: f64,
    /// The drive's own where it is not given.
    acceleration: Option<f64>,
    deceleration: Option<f64>,
}

pub(crate) async fn move_axis(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
    bytes: Bytes,
) -> Result<Response, Refusal> {
    let granted = shown.granted.moves(&name)?.clone();
    let MoveBody {
        to,
        by,
        velocity,
        acceleration,
        deceleration,
    } = body(&bytes)?;
    let scale = granted.scale;
    let ramp = |ramp: Option<f64>| {
        let ramp = ramp.map(|ramp| scale.acceleration(ramp)).transpose();
        ramp.map_err(|error| Refusal::of("acceleration", error.to_string()))
    };
    let (acceleration, deceleration) = (ramp(acceleration)?, ramp(deceleration)?);
    let counts = scale.velocity(velocity);
    let counts = counts.map_err(|error| Refusal::of("velocity", error.to_string()))?;
    let (is_relative, asked) = match (to, by) {
        (Some(to), None) => (false, to),
        (None, Some(by)) => (true, by),
        _ => {
            return Err(Refusal::of(
                "bad_body",
                "`to` or `by` is expected, and not both",
            ));
        }
    };
    let value = scale.position(asked);
    let value = value.map_err(|error| Refusal::of("position", error.to_string()))?;
    let unit = shown.unit_of(&name);
    let way = if is_relative { "by" } else { "to" };
    let what = format!("move {name} {way} {asked} {unit} with {velocity} {unit}/s");
    let of_work = shown.clone();
    let work = async move {
        let lease = granted.axis.profile_position().await?;
        let _led = of_work.led(&name);
        // Some drives can replace no move. One of the program, whose lease is gone, is replaced.
        let buffer_mode = match granted.axis.status().has_set_point {
            true => BufferMode::Aborting,
            false => BufferMode::Buffered,
        };
        let mut set_point = SetPoint::new().velocity(counts).buffer_mode(buffer_mode);
        set_point.parameters.acceleration = acceleration;
        set_point.parameters.deceleration = deceleration;
        let begun = match is_relative {
            true => lease.move_rel(value, set_point).await,
            false => lease.move_abs(value, set_point).await,
        };
        let outcome = match begun {
            Ok(motion) => motion.done().await.map(|outcome| {
                let how = match outcome {
                    Outcome::Passed { .. } => "passed",
                    Outcome::Contact { .. } => "contact at",
                    _ => "reached",
                };
                format!(
                    "{how} {} {unit}",
                    shown_position(&scale, outcome.position())
                )
            }),
            Err(error) => Err(error),
        };
        let released = lease.release().await;
        outcome.and_then(|outcome| released.map(|()| outcome))
    };
    Ok(finish(shown, client, what, work).await)
}

/// A position in the unit of the axis, without the digits of the conversion.
fn shown_position(scale: &Scale, counts: i32) -> f64 {
    (scale.position_of(counts) * 1e6).round() / 1e6
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HomeBody {
    method: i8,
    /// Seconds.
    within: f64,
}

pub(crate) async fn home(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path(name): Path<String>,
    bytes: Bytes,
) -> Result<Response, Refusal> {
    let granted = shown.granted.moves(&name)?.clone();
    let unit = shown.unit_of(&name);
    let HomeBody { method, within } = body(&bytes)?;
    let within = Duration::try_from_secs_f64(within);
    let within = within.map_err(|error| Refusal::of("bad_body", format!("`within`: {error}")))?;
    let what = format!("home {name} by method {method}");
    let of_work = shown.clone();
    let work = async move {
        let lease = granted.axis.homing().await?;
        let _led = of_work.led(&name);
        let parameters = HomingParameters::new(HomingMethod(method));
        let homed = lease.home(parameters).within(within).await;
        let released = lease.release().await;
        homed.and_then(|homed| {
            let position = shown_position(&granted.scale, homed.position);
            released.map(|()| format!("homed at {position} {unit}"))
        })
    };
    Ok(finish(shown, client, what, work).await)
}

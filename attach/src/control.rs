//! Hold to jog, over a WebSocket.
//!
//! The server sends its tick every 40 ms: `{"tick": 17}`. A client that holds a jog answers with the latest tick that it has:
//! `{"hold": {"axis": "x", "velocity": 5.0, "tick": 17}}`. A hold that echoes an old tick was delayed on its way and feeds nothing. Each
//! jog has a dead-man time, which the axis core judges on the bus thread: whatever becomes of the page, of this connection or of this
//! server, the target velocity is 0 in the next frame after it.
//!
//! A stop by `{"stop": {"axis": "x"}}` or `{"quick_stop": {}}` needs no tick, and is answered by `{"asked": true}`.

use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use axum::{
    body::Bytes,
    extract::ws::{Message, Utf8Bytes, WebSocket},
};
use serde::Deserialize;
use serde_json::{Value, json};
use servocrab::{Failure, profile_velocity::JogSetPoint};
use tokio::{
    sync::{mpsc, watch},
    time::{MissedTickBehavior, interval},
};

use crate::{
    grants::GrantedAxis,
    journal::Begun,
    refusal::Refusal,
    requests::{stop_all, stop_axis},
    server::Client,
    shown::Shown,
    streams::sent,
};

/// From one tick to the next.
const TICK: Duration = Duration::from_millis(40);
/// A hold that echoes an older tick feeds nothing.
const FRESH: Duration = Duration::from_millis(200);
/// How long a jog goes on without a hold.
const DEAD_MAN: Duration = Duration::from_millis(200);
/// Messages of one client in a second, and those of each axis that may be jogged. A page that holds a jog sends 25.
const MESSAGES: usize = 200;
const MESSAGES_OF_AXIS: usize = 50;

#[derive(Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum Said {
    /// A jog is held.
    Hold {
        axis: String,
        /// In the axis' unit per second.
        velocity: f64,
        tick: u64,
    },
    /// It is let go.
    Release { axis: String },
    /// The axis is stopped. A browser lets requests wait for those before them, and no WebSocket.
    Stop { axis: String },
    /// All axes are stopped by quick stop.
    QuickStop {},
}

/// The latest hold of a jog, for its task.
#[derive(Clone, Copy)]
struct Held {
    /// In counts.
    velocity: i32,
    at: Instant,
}

/// The jogs of one client, each with the task that holds it.
struct Jogs {
    shown: Shown,
    client: Client,
    held: HashMap<String, watch::Sender<Held>>,
    /// What the tasks have to say, to the client.
    answers: mpsc::Sender<Value>,
    ticks: Ticks,
}

/// When the latest ticks were sent.
struct Ticks {
    began: Instant,
    latest: u64,
}

impl Ticks {
    fn next(&mut self) -> u64 {
        self.latest = u64::try_from(self.began.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.latest
    }

    /// Whether who echoes this tick has had it a short time ago.
    fn is_fresh(&self, tick: u64) -> bool {
        let sent = Duration::from_millis(tick);
        tick <= self.latest && self.began.elapsed().saturating_sub(sent) <= FRESH
    }
}

pub(crate) async fn serve(shown: Shown, client: Client, mut socket: WebSocket) {
    let (answers, mut answered) = mpsc::channel(64);
    let mut jogs = Jogs {
        shown,
        client,
        held: HashMap::new(),
        answers,
        ticks: Ticks {
            began: Instant::now(),
            latest: 0,
        },
    };
    let mut turns = interval(TICK);
    turns.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let most = MESSAGES + MESSAGES_OF_AXIS * jogs.shown.granted.axes.len();
    let (mut second, mut messages) = (Instant::now(), 0);
    // Where this ends, all its jogs end: their senders are dropped.
    loop {
        tokio::select! {
            _ = turns.tick() => {
                let tick = json!({"tick": jogs.ticks.next()});
                if !sent(&mut socket, text(&tick)).await {
                    return;
                }
            }
            Some(answer) = answered.recv() => {
                if !sent(&mut socket, text(&answer)).await {
                    return;
                }
            }
            message = socket.recv() => {
                if second.elapsed() > Duration::from_secs(1) {
                    (second, messages) = (Instant::now(), 0);
                }
                messages += 1;
                if messages > most {
                    let error = Refusal::of("too_many", "too many messages in a second");
                    let _ = sent(&mut socket, text(&error.json())).await;
                    return;
                }
                let answer = match message {
                    Some(Ok(Message::Text(said))) => jogs.hear(&said).unwrap_or_else(|refusal| Some(refusal.json())),
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => None,
                    Some(Ok(Message::Binary(_))) => Some(Refusal::of("bad_message", "JSON in text messages is expected").json()),
                    _ => return,
                };
                if let Some(answer) = answer
                    && !sent(&mut socket, text(&answer)).await
                {
                    return;
                }
            }
        }
    }
}

fn text(json: &Value) -> Message {
    let bytes = Bytes::from(json.to_string());
    Message::Text(Utf8Bytes::try_from(bytes).unwrap_or_default())
}

impl Jogs {
    /// What is answered, where something is.
    fn hear(&mut self, said: &str) -> Result<Option<Value>, Refusal> {
        let said = serde_json::from_str(said)
            .map_err(|error| Refusal::of("bad_message", format!("not understood: {error}")))?;
        match said {
            Said::Release { axis } => {
                // The task hears it by that.
                self.held.remove(&axis);
            }
            Said::Hold {
                axis,
                velocity,
                tick,
            } => self.hold(axis, velocity, tick)?,
            Said::Stop { axis } => {
                stop_axis(&self.shown, &self.client, &axis)?;
                return Ok(Some(json!({"asked": true})));
            }
            Said::QuickStop {} => {
                stop_all(&self.shown, &self.client);
                return Ok(Some(json!({"asked": true})));
            }
        }
        Ok(None)
    }

    fn hold(&mut self, axis: String, velocity: f64, tick: u64) -> Result<(), Refusal> {
        if !self.ticks.is_fresh(tick) {
            return Err(Refusal::of(
                "late",
                format!("the hold of `{axis}` was on its way for too long: it moves nothing"),
            ));
        }
        let granted = self.shown.granted.jog(&axis)?;
        let fastest = granted.max_velocity.unwrap_or(0.0);
        if !(-fastest..=fastest).contains(&velocity) {
            self.held.remove(&axis);
            return Err(Refusal::of(
                "too_fast",
                format!(
                    "`{axis}` is granted to be jogged with up to {fastest} per second, not with {velocity}"
                ),
            ));
        }
        let counts = granted.scale.target_velocity(velocity);
        let counts = counts.map_err(|error| Refusal::of("velocity", error.to_string()))?;
        let held = Held {
            velocity: counts,
            at: Instant::now(),
        };
        if let Some(sender) = self.held.get(&axis) {
            // A jog that something has ended does not begin again under a hand that still holds it.
            let text = || format!("the jog of `{axis}` has ended: let go of it first");
            return sender.send(held).map_err(|_| Refusal::of("ended", text()));
        }
        let (sender, latest) = watch::channel(held);
        self.shown
            .log
            .warn(format_args!("axis {axis} is jogged by {}", self.client));
        let unit = self.shown.unit_of(&axis);
        let what = format!("jog {axis} with {velocity} {unit}/s");
        let begun = self.shown.journal.begin(&self.client, &what);
        tokio::spawn(jog(
            axis.clone(),
            granted.clone(),
            latest,
            self.answers.clone(),
            self.shown.clone(),
            self.client.clone(),
            begun,
        ));
        self.held.insert(axis, sender);
        Ok(())
    }
}

/// One jog, from its first hold to its end.
async fn jog(
    name: String,
    granted: GrantedAxis,
    latest: watch::Receiver<Held>,
    answers: mpsc::Sender<Value>,
    shown: Shown,
    client: Client,
    begun: Begun,
) {
    let ended = match held(&shown, &name, &granted, latest, &answers).await {
        Ok(()) => {
            begun.done("released");
            json!({"jog": {"axis": name, "state": "released"}})
        }
        Err(error) => {
            let refusal = shown.refusal_of(&error, &client);
            begun.failed(&refusal.text);
            json!({"jog": {"axis": name, "state": "ended", "code": refusal.code, "text": refusal.text}})
        }
    };
    // Nobody reads it where the client is gone.
    let _ = answers.send(ended).await;
}

async fn held(
    shown: &Shown,
    name: &str,
    granted: &GrantedAxis,
    mut latest: watch::Receiver<Held>,
    answers: &mpsc::Sender<Value>,
) -> Result<(), servocrab::AxisError> {
    let lease = granted.axis.profile_velocity().await?;
    let _led = shown.led(name);
    // Whoever held it may have let go, or be gone, while the drive changed its mode.
    let first = *latest.borrow_and_update();
    if latest.has_changed().is_err() || first.at.elapsed() > FRESH {
        return lease.release().await;
    }
    let set_point = JogSetPoint::new(first.velocity).dead_man(DEAD_MAN);
    let jog = tokio::select! {
        jog = lease.jog(set_point) => jog?,
        // Dropped on its way, the jog is let go.
        () = let_go(latest.clone()) => return lease.release().await,
    };
    let _ = answers
        .send(json!({"jog": {"axis": name, "state": "moving"}}))
        .await;
    let mut looks = interval(TICK);
    // Until it is let go, which an error of the channel says.
    let ended = loop {
        let held = tokio::select! {
            changed = latest.changed() => match changed {
                Ok(()) => {
                    let velocity = latest.borrow_and_update().velocity;
                    jog.set(velocity)
                }
                Err(_) => break None,
            },
            // What has ended it is said, and the mode given back, also where no hold comes any more.
            _ = looks.tick() => match jog.ended() {
                Some(_) => jog.hold(),
                None => Ok(()),
            },
        };
        if let Err(error) = held {
            break Some(error);
        }
    };
    if let Some(error) = ended {
        drop(jog);
        // The client gets the reason of the end.
        let _ = lease.release().await;
        return Err(error);
    }
    let released = jog.release().await;
    let given_back = lease.release().await;
    match released {
        // It was let go by its time already, and stands.
        Err(error) if error.failure() == Some(Failure::NotHeld) => given_back,
        other => other.and(given_back),
    }
}

async fn let_go(mut latest: watch::Receiver<Held>) {
    while latest.changed().await.is_ok() {}
}

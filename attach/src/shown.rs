//! What all requests share, and what they find in it.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use axum::http::StatusCode;
use serde_json::Value;
use servocrab::{
    AxisError,
    axis::AxisErrorKind,
    bus::NetworkView,
    coe::{DriveError, NoInformation, ObjectAddress, SdoError, SdoHandle},
};
use tokio::{
    sync::{Semaphore, SemaphorePermit},
    time::timeout,
};

use crate::{
    grants::{AskedFor, Asks, Granted},
    journal::Journal,
    log::Log,
    refusal::Refusal,
    server::Client,
    streams::Streams,
};

/// The code of a drive without SDO information.
pub(crate) const NOT_SUPPORTED: &str = "not_supported";
/// How long a transfer waits for those before it.
const TURN: Duration = Duration::from_secs(2);

/// What all requests share.
#[derive(Clone)]
pub(crate) struct Shown {
    pub view: NetworkView,
    /// One transfer at a time, so that the program's own wait for at most one of them.
    pub transfers: Arc<Semaphore>,
    pub granted: Arc<Granted>,
    pub asks: Asks,
    pub streams: Arc<Streams>,
    /// The objects of each drive, once they were listed.
    pub dictionaries: Arc<Mutex<HashMap<u16, Value>>>,
    /// How many of the clients' tasks have the mode of each axis.
    pub led: Arc<Mutex<HashMap<String, usize>>>,
    /// What clients have commanded.
    pub journal: Journal,
    pub log: Log,
}

/// A client's task has the mode of this axis, until this is dropped.
pub(crate) struct Led {
    axis: String,
    all: Arc<Mutex<HashMap<String, usize>>>,
}

impl Drop for Led {
    fn drop(&mut self) {
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(tasks) = all.get_mut(&self.axis) {
            *tasks = tasks.saturating_sub(1);
        }
    }
}

impl Shown {
    /// For who has just got the lease of an axis, to be dropped before it.
    pub fn led(&self, axis: &str) -> Led {
        let mut all = self.led.lock().unwrap_or_else(PoisonError::into_inner);
        let tasks = all.entry(axis.to_owned()).or_default();
        *tasks = tasks.saturating_add(1);
        Led {
            axis: axis.to_owned(),
            all: Arc::clone(&self.led),
        }
    }

    fn is_led(&self, axis: &str) -> bool {
        let all = self.led.lock().unwrap_or_else(PoisonError::into_inner);
        all.get(axis).is_some_and(|tasks| *tasks > 0)
    }

    /// The unit in which an axis was declared; nothing for one that is not.
    pub fn unit_of(&self, name: &str) -> &'static str {
        let axes = self.view.axes();
        let axis = axes.iter().find(|axis| *axis.identity.axis == *name);
        axis.map_or("", |axis| axis.unit)
    }

    /// The turn of one transfer.
    pub async fn turn(&self) -> Result<SemaphorePermit<'_>, Refusal> {
        match timeout(TURN, self.transfers.acquire()).await {
            Ok(Ok(turn)) => Ok(turn),
            _ => {
                let text = "other transfers are under way: ask again later";
                Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "busy", text))
            }
        }
    }

    /// Why an axis did not do it. Where the program holds the axis' mode it is asked for it; where a client
    /// does, nobody is.
    pub fn refusal_of(&self, error: &AxisError, client: &Client) -> Refusal {
        if !matches!(error.kind, AxisErrorKind::ModeInUse) {
            return Refusal::of("axis", error.to_string());
        }
        if self.is_led(&error.identity.axis) {
            let text = format!(
                "{error}; a client has it, or its jog is still coming to a stand: ask again later"
            );
            return Refusal::new(StatusCode::CONFLICT, "in_use", text);
        }
        let asked = AskedFor {
            axis: error.identity.axis.to_string(),
            client: client.to_string(),
        };
        // A program that does not listen has as many questions as it can have.
        let _ = self.asks.try_send(asked);
        let text = format!("{error}; the program is asked for it");
        Refusal::new(StatusCode::CONFLICT, "in_use", text)
    }

    /// The objects of the drive at this position.
    pub fn drive(&self, position: &str) -> Result<&SdoHandle, Refusal> {
        let place = position.parse::<u16>().ok();
        let mut drives = self.view.drives();
        let sdo = drives.find(|sdo| Some(sdo.drive().position) == place);
        sdo.ok_or_else(|| {
            let text =
                format!("no drive was declared at position `{position}`: /v1/line lists them");
            Refusal::new(StatusCode::NOT_FOUND, "no_drive", text)
        })
    }

    /// The objects of a drive, and which one is asked for.
    pub fn object(
        &self,
        drive: &str,
        index: &str,
        subindex: &str,
    ) -> Result<(&SdoHandle, ObjectAddress), Refusal> {
        let object = format!("{index}:{subindex}").parse();
        let object = object.map_err(|_| {
            let text =
                format!("`{index}/{subindex}` is no object: ask for one as 6041h/0 or 0x6041/0");
            Refusal::new(StatusCode::BAD_REQUEST, "no_object", text)
        })?;
        Ok((self.drive(drive)?, object))
    }
}

/// Why a transfer was not done.
pub(crate) fn sdo_refusal(error: &DriveError) -> Refusal {
    let (status, code) = match error.error {
        SdoError::Aborted { .. } => (StatusCode::UNPROCESSABLE_ENTITY, "aborted"),
        SdoError::NotSupported { .. } => (StatusCode::UNPROCESSABLE_ENTITY, NOT_SUPPORTED),
        SdoError::Closed { .. } => (StatusCode::SERVICE_UNAVAILABLE, "closed"),
        SdoError::Absent { .. } => (StatusCode::SERVICE_UNAVAILABLE, "absent"),
        _ => (StatusCode::BAD_GATEWAY, "not_transferred"),
    };
    let abort = match error.error {
        SdoError::Aborted { code, .. }
        | SdoError::NotSupported {
            reason: NoInformation::Service(code),
            ..
        } => Some(code.0),
        _ => None,
    };
    Refusal {
        abort,
        ..Refusal::new(status, code, error.error.to_string())
    }
}

//! The objects of drives, by SDO.

use std::{sync::PoisonError, time::Duration};

use axum::{
    Extension, Json,
    body::Bytes,
    extract::{Path, Query, State},
    http::StatusCode,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use servocrab::{
    bus::Signal,
    coe::{
        AbortCode, AxisOffset, DriveError, DriveId, Object, ObjectAddress, SdoError, SdoHandle,
        TypeCode,
        information::{ListKind, Question},
        obj,
    },
};

use crate::{
    commands::body,
    grants::is_owned,
    refusal::Refusal,
    server::Client,
    shown::{Shown, sdo_refusal},
};

/// Bytes of an object that is written.
const OBJECT: usize = 4096;
/// Of these, what the log of commands shows.
const SHOWN: usize = 16;
/// The longest time for a reply of a drive that a client may ask for.
const LONGEST: Duration = Duration::from_secs(60);

/// How an object is read or written: `complete=true&timeout_ms=5000`.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct How {
    /// By complete access.
    pub complete: bool,
    /// The time for each reply.
    pub timeout_ms: Option<u64>,
}

impl How {
    fn of(self, sdo: &SdoHandle) -> SdoHandle {
        let timeout = self.timeout_ms.map(Duration::from_millis);
        match timeout {
            Some(timeout) => sdo.clone().with_timeout(timeout.min(LONGEST)),
            None => sdo.clone(),
        }
    }
}

pub(crate) async fn read(
    State(shown): State<Shown>,
    Path((drive, index, subindex)): Path<(String, String, String)>,
    Query(how): Query<How>,
) -> Result<Json<Value>, Refusal> {
    let (sdo, address) = shown.object(&drive, &index, &subindex)?;
    let (sdo, _turn) = (how.of(sdo), shown.turn().await?);
    let read = match how.complete {
        true => sdo.read_complete(address.index, address.subindex).await,
        false => sdo.read_bytes(address.index, address.subindex).await,
    };
    let bytes = read.map_err(|error| sdo_refusal(&error))?;
    Ok(Json(json!({
        "index": address.index,
        "subindex": address.subindex,
        "bytes": bytes,
    })))
}

/// The limits of an axis as its drive holds them now, in the unit of the axis; nothing for what the drive does not have.
pub(crate) async fn limits(
    State(shown): State<Shown>,
    Path(name): Path<String>,
) -> Result<Json<Value>, Refusal> {
    let axes = shown.view.axes();
    let axis = axes.iter().find(|axis| *axis.identity.axis == *name);
    let axis = axis.ok_or_else(|| {
        let text = format!("no axis is named `{name}`: /v1/axes lists them");
        Refusal::new(StatusCode::NOT_FOUND, "no_axis", text)
    })?;
    let sdo = shown.drive(&axis.identity.drive.position.to_string())?;
    let _turn = shown.turn().await?;
    let position = async |object: Object<i32>| {
        let read = if_there(sdo.read(object.offset(axis.offset)).await)?;
        Ok::<_, Refusal>(read.map(|counts| axis.scale.position_of(counts)))
    };
    let max_velocity = if_there(
        sdo.read(obj::MAX_PROFILE_VELOCITY.offset(axis.offset))
            .await,
    )?;
    // 0, and the most that the object can hold, limit nothing.
    let max_velocity = max_velocity.filter(|velocity| !matches!(*velocity, 0 | u32::MAX));
    Ok(Json(json!({
        "unit": axis.unit,
        "min_position": position(obj::SOFTWARE_LIMIT_MIN).await?,
        "max_position": position(obj::SOFTWARE_LIMIT_MAX).await?,
        "max_velocity": max_velocity.map(|velocity| axis.scale.velocity_of(velocity)),
    })))
}

/// Nothing where the drive does not have the object.
fn if_there<T>(read: Result<T, DriveError>) -> Result<Option<T>, Refusal> {
    match read {
        Ok(value) => Ok(Some(value)),
        Err(error) => match error.error.abort_code() {
            Some(AbortCode::NO_OBJECT | AbortCode::NO_SUBINDEX) => Ok(None),
            _ => Err(sdo_refusal(&error)),
        },
    }
}

/// A question of SDO information, as the query of a request.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Asked {
    kind: AskedKind,
    #[serde(default)]
    list: u8,
    #[serde(default)]
    index: u16,
    #[serde(default)]
    subindex: u8,
    #[serde(default)]
    wanted: u8,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum AskedKind {
    Counts,
    List,
    Object,
    Entry,
}

impl From<Question> for Asked {
    fn from(question: Question) -> Self {
        let asked = |kind| Self {
            kind,
            list: 0,
            index: 0,
            subindex: 0,
            wanted: 0,
        };
        match question {
            Question::Counts => asked(AskedKind::Counts),
            Question::List(list) => Self {
                list: list as u8,
                ..asked(AskedKind::List)
            },
            Question::Object { index } => Self {
                index,
                ..asked(AskedKind::Object)
            },
            Question::Entry {
                index,
                subindex,
                wanted,
            } => Self {
                index,
                subindex,
                wanted,
                ..asked(AskedKind::Entry)
            },
        }
    }
}

impl Asked {
    /// None for a list that there is not.
    fn question(self) -> Option<Question> {
        let (index, subindex, wanted) = (self.index, self.subindex, self.wanted);
        Some(match self.kind {
            AskedKind::Counts => Question::Counts,
            AskedKind::List => Question::List(match self.list {
                1 => ListKind::All,
                2 => ListKind::Outputs,
                3 => ListKind::Inputs,
                4 => ListKind::Backup,
                5 => ListKind::Settings,
                _ => return None,
            }),
            AskedKind::Object => Question::Object { index },
            AskedKind::Entry => Question::Entry {
                index,
                subindex,
                wanted,
            },
        })
    }
}

/// One question of SDO information; the bytes of its answer.
pub(crate) async fn information(
    State(shown): State<Shown>,
    Path(drive): Path<String>,
    Query(asked): Query<Asked>,
) -> Result<Json<Value>, Refusal> {
    let sdo = shown.drive(&drive)?;
    let question = asked.question().ok_or_else(|| {
        Refusal::of(
            "bad_question",
            "the lists of objects have the numbers 1 to 5",
        )
    })?;
    let _turn = shown.turn().await?;
    let answer = sdo.information(question).await;
    let bytes = answer.map_err(|error| sdo_refusal(&error))?;
    Ok(Json(json!({ "bytes": bytes })))
}

/// The objects of a drive as it lists them, or those that the library knows. Listed once: that can take seconds.
pub(crate) async fn dictionary(
    State(shown): State<Shown>,
    Path(drive): Path<String>,
) -> Result<Json<Value>, Refusal> {
    let sdo = shown.drive(&drive)?;
    let position = sdo.drive().position;
    let known = || {
        let all = shown
            .dictionaries
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        all.get(&position).cloned()
    };
    if let Some(known) = known() {
        return Ok(Json(known));
    }
    let _turn = shown.turn().await?;
    if let Some(known) = known() {
        return Ok(Json(known));
    }
    let is_owned =
        |object: ObjectAddress| is_owned(object) || is_mapped(&shown, sdo.drive(), object);
    let listed = listed(sdo, is_owned).await;
    let listed = listed.map_err(|error| sdo_refusal(&error))?;
    let mut all = shown
        .dictionaries
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    all.insert(position, listed.clone());
    Ok(Json(listed))
}

/// With those that clients never write.
async fn listed(
    sdo: &SdoHandle,
    is_owned: impl Fn(ObjectAddress) -> bool,
) -> Result<Value, DriveError> {
    let dictionary = match sdo.dictionary().await {
        Ok(dictionary) => dictionary,
        Err(error) if matches!(error.error, SdoError::NotSupported { .. }) => {
            let known = obj::all()
                .into_iter()
                .map(|object| object.offset(AxisOffset::default()));
            return Ok(known
                .map(|object| {
                    let address = object.address();
                    json!({
                        "index": address.index,
                        "subindex": address.subindex,
                        "name": object.name,
                        "type": TypeCode::from(object.data_type).to_string(),
                        "bits": object.bits(),
                        "access": if object.writable { "rw" } else { "ro" },
                        "owned": is_owned(address),
                    })
                })
                .collect());
        }
        Err(error) => return Err(error),
    };
    let entries = dictionary.objects.iter().flat_map(|object| {
        object.entries.iter().map(|entry| {
            json!({
                "index": entry.address.index,
                "subindex": entry.address.subindex,
                "name": object.description.name_with(entry),
                "type": entry.data_type.to_string(),
                "bits": entry.bits,
                "access": entry.access.to_string(),
                "owned": is_owned(entry.address),
            })
        })
    });
    Ok(entries.collect())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    bytes: Vec<u8>,
}

/// Whether this object of the drive is in the process data.
fn is_mapped(shown: &Shown, drive: &DriveId, object: ObjectAddress) -> bool {
    let mapped = Signal::Device {
        position: drive.position,
        object,
    };
    shown.view.recorder([mapped]).is_ok()
}

pub(crate) async fn write(
    State(shown): State<Shown>,
    Extension(client): Extension<Client>,
    Path((drive, index, subindex)): Path<(String, String, String)>,
    Query(how): Query<How>,
    bytes: Bytes,
) -> Result<Json<Value>, Refusal> {
    if !shown.granted.parameters {
        return Err(Refusal::not_granted("write objects"));
    }
    let (sdo, object) = shown.object(&drive, &index, &subindex)?;
    let sdo = how.of(sdo);
    let Written { bytes } = body(&bytes)?;
    let is_mapped = match how.complete {
        true => (0..=u8::MAX).any(|subindex| {
            let part = ObjectAddress::new(object.index, subindex);
            is_mapped(&shown, sdo.drive(), part)
        }),
        false => is_mapped(&shown, sdo.drive(), object),
    };
    if is_owned(object) || is_mapped {
        let text = format!(
            "{object} is in the process data, or the library itself writes it or relies on it"
        );
        return Err(Refusal::new(StatusCode::FORBIDDEN, "owned", text));
    }
    if bytes.is_empty() || bytes.len() > OBJECT {
        let text = format!(
            "an object of 1 to {OBJECT} bytes is expected, and not {}",
            bytes.len()
        );
        return Err(Refusal::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            "bad_body",
            text,
        ));
    }
    let _turn = shown.turn().await?;
    let drive = sdo.drive();
    shown.log.warn(format_args!(
        "{object} of {drive} is written by {client}: {bytes:02X?}"
    ));
    let shown_bytes = bytes.get(..SHOWN).unwrap_or(&bytes);
    let more = if bytes.len() > SHOWN { " …" } else { "" };
    let what = format!(
        "write {object} of drive {} to {shown_bytes:02X?}{more}",
        drive.position
    );
    let begun = shown.journal.begin(&client, &what);
    let written = match how.complete {
        true => {
            sdo.write_complete(object.index, object.subindex, bytes)
                .await
        }
        false => sdo.write_bytes(object.index, object.subindex, bytes).await,
    };
    match written {
        Ok(()) => {
            begun.done("written");
            Ok(Json(json!({"written": true})))
        }
        Err(error) => {
            let refusal = sdo_refusal(&error);
            begun.failed(&refusal.text);
            Err(refusal)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::query;

    #[test]
    fn every_question_comes_back_out_of_its_query() {
        let entry = Question::Entry {
            index: 0x6081,
            subindex: 3,
            wanted: Question::EVERYTHING,
        };
        let lists = [
            ListKind::All,
            ListKind::Outputs,
            ListKind::Inputs,
            ListKind::Backup,
            ListKind::Settings,
        ];
        let questions = lists.map(Question::List).into_iter().chain([
            Question::Counts,
            Question::Object { index: 0x1018 },
            entry,
        ]);
        for question in questions {
            let uri = format!("/?{}", query(&Asked::from(question))).parse();
            let Query(asked) = Query::<Asked>::try_from_uri(&uri.unwrap()).unwrap();
            assert_eq!(asked.question(), Some(question));
        }
    }
}

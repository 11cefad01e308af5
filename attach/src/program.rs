//! A program that shows its network, as other programs see it: its answers, and the objects of its drives.

use std::{
    io,
    os::unix::net::UnixStream as StdStream,
    path::{Path, PathBuf},
    sync::Arc,
    thread,
    time::Duration,
};

use axum::body::{Body, to_bytes};
use hyper::{
    Method, Request,
    client::conn::http1,
    header::{CONTENT_TYPE, HOST},
};
use hyper_util::rt::TokioIo;
use serde::Deserialize;
use serde_json::{Value, json};
use servocrab::{
    coe::{
        AbortCode, DriveId, NoInformation, ObjectAddress, RemoteRequest, RemoteTransfer,
        RemoteTransfers, SdoError, SdoHandle, Transfer,
    },
    sii::Identity,
};
use tokio::{
    net::UnixStream,
    runtime,
    sync::{mpsc, oneshot},
    time::timeout,
};

use crate::{
    objects::{Asked, How},
    shown::NOT_SUPPORTED,
};

/// Bytes of an answer: more than a dictionary of ten thousand entries has.
const ANSWER: usize = 16 << 20;
/// How long a program may take for an answer. The list of a drive's objects takes seconds, and a motion up to 50.
const PATIENCE: Duration = Duration::from_secs(120);

/// Why a program does not do what a client asks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// Nobody shows a network on this socket.
    #[error("nobody shows a network here: {0}")]
    Nobody(io::Error),
    /// The program refuses it.
    #[error("{text}")]
    Refused {
        /// Why, for programs, such as `not_granted`.
        code: String,
        /// Why, for people.
        text: String,
        /// Why the drive refused an object.
        abort: Option<u32>,
    },
    /// What came was not expected.
    #[error("the program does not answer as expected: {0}")]
    Protocol(String),
}

impl ClientError {
    /// What the body of a refusal says.
    pub(crate) fn refused(body: &[u8]) -> Self {
        #[derive(Deserialize)]
        struct Refused {
            error: Reason,
        }
        #[derive(Deserialize)]
        struct Reason {
            code: String,
            text: String,
            #[serde(default)]
            abort: Option<u32>,
        }
        match serde_json::from_slice(body) {
            Ok(Refused {
                error: Reason { code, text, abort },
            }) => Self::Refused { code, text, abort },
            Err(error) => Self::Protocol(error.to_string()),
        }
    }

    pub(crate) fn protocol(error: &(impl ToString + ?Sized)) -> Self {
        Self::Protocol(error.to_string())
    }
}

type Answer = Result<Vec<u8>, ClientError>;

/// What the thread of a [`Program`] does.
enum Work {
    Ask(Question, oneshot::Sender<Answer>),
    /// The objects of the drive at this position.
    Serve(u16, RemoteTransfers),
}

struct Question {
    method: Method,
    path: String,
    body: Option<Value>,
}

impl Question {
    fn get(path: impl Into<String>) -> Self {
        Self {
            method: Method::GET,
            path: path.into(),
            body: None,
        }
    }
}

/// A program that shows its network on a Unix socket. Its line is not opened, and nothing on it is reset.
///
/// ```no_run
/// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
/// use servocrab::coe::obj;
/// use servocrab_attach::{Program, socket_of};
/// let program = Program::open(&socket_of("eth0"))?;
/// for sdo in program.drives().await? {
///     println!("{}: {:04X}h", sdo.drive(), sdo.read(obj::STATUSWORD).await?);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Program {
    work: mpsc::UnboundedSender<Work>,
}

impl Program {
    /// The program at this socket ([`socket_of`](crate::socket_of)). What it is asked goes over a thread of its own, which ends when this
    /// and all handles of drives are dropped.
    ///
    /// # Errors
    /// [`ClientError::Nobody`] where nobody is there; [`ClientError::Protocol`] where the thread cannot be had.
    pub fn open(socket: &Path) -> Result<Self, ClientError> {
        StdStream::connect(socket).map_err(ClientError::Nobody)?;
        let runtime = runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| ClientError::protocol(&error))?;
        let (work, asked) = mpsc::unbounded_channel();
        let socket = Arc::new(socket.to_owned());
        thread::Builder::new()
            .name("servocrab-client".to_owned())
            .spawn(move || runtime.block_on(serve(socket, asked)))
            .map_err(|error| ClientError::protocol(&error))?;
        Ok(Self { work })
    }

    /// The body of its answer to this, such as `/v1/axes`; docs/attach.md lists what there is.
    ///
    /// # Errors
    /// [`ClientError`] where the program refuses it, or is gone.
    pub async fn get(&self, path: &str) -> Result<Vec<u8>, ClientError> {
        let (answer, answered) = oneshot::channel();
        let gone = || ClientError::Protocol("the thread has ended".to_owned());
        let work = Work::Ask(Question::get(path), answer);
        self.work.send(work).map_err(|_| gone())?;
        answered.await.map_err(|_| gone())?
    }

    /// The objects of its drives, in the order of their declaration. The program reads and writes them between its own transfers, and
    /// refuses what it does not grant.
    ///
    /// # Errors
    /// [`ClientError`] where the program does not say which there are.
    pub async fn drives(&self) -> Result<Vec<SdoHandle>, ClientError> {
        #[derive(Deserialize)]
        struct Line {
            drives: Vec<Drive>,
        }
        #[derive(Deserialize)]
        struct Drive {
            position: u16,
            name: String,
            vendor: u32,
            product: u32,
            revision: u32,
            serial: u32,
        }
        let line = self.get("/v1/line").await?;
        let Line { drives } =
            serde_json::from_slice(&line).map_err(|error| ClientError::protocol(&error))?;
        let handles = drives.into_iter().map(|drive| {
            let position = drive.position;
            let (sdo, transfers) = SdoHandle::remote(DriveId {
                position,
                name: drive.name,
                identity: Identity {
                    vendor: drive.vendor,
                    product: drive.product,
                    revision: drive.revision,
                    serial: drive.serial,
                },
            });
            // Without the thread its transfers end as closed.
            let _ = self.work.send(Work::Serve(position, transfers));
            sdo
        });
        Ok(handles.collect())
    }
}

/// Until nobody asks any more.
async fn serve(socket: Arc<PathBuf>, mut asked: mpsc::UnboundedReceiver<Work>) {
    let mut tasks = tokio::task::JoinSet::new();
    while let Some(work) = asked.recv().await {
        let socket = Arc::clone(&socket);
        match work {
            Work::Ask(question, answer) => {
                tasks.spawn(async move {
                    // Whoever asked may be gone.
                    let _ = answer.send(ask(&socket, question).await);
                });
            }
            Work::Serve(position, transfers) => {
                tasks.spawn(async move {
                    while let Some(transfer) = transfers.next().await {
                        let done = pass_on(&socket, position, &transfer).await;
                        transfer.answer(done);
                    }
                });
            }
        }
        while tasks.try_join_next().is_some() {}
    }
    while tasks.join_next().await.is_some() {}
}

async fn ask(socket: &Path, question: Question) -> Answer {
    let answered = timeout(PATIENCE, asked(socket, question)).await;
    answered.unwrap_or_else(|_| {
        let seconds = PATIENCE.as_secs();
        Err(ClientError::Protocol(format!("nothing in {seconds} s")))
    })
}

async fn asked(socket: &Path, question: Question) -> Answer {
    let stream = UnixStream::connect(socket).await;
    let stream = stream.map_err(ClientError::Nobody)?;
    let handshake = http1::handshake(TokioIo::new(stream)).await;
    let (mut program, connection) = handshake.map_err(|error| ClientError::protocol(&error))?;
    // Its end is that of the answer.
    let connection = tokio::spawn(connection);
    let body = question.body.map(|body| body.to_string());
    let request = Request::builder()
        .method(question.method)
        .uri(question.path)
        .header(HOST, "localhost")
        .header(CONTENT_TYPE, "application/json")
        .body(Body::from(body.unwrap_or_default()))
        .map_err(|error| ClientError::protocol(&error))?;
    let answered = program.send_request(request).await;
    let answered = answered.map_err(|error| ClientError::protocol(&error))?;
    let status = answered.status();
    let body = to_bytes(Body::new(answered.into_body()), ANSWER).await;
    connection.abort();
    let body = body.map_err(|error| ClientError::protocol(&error))?;
    match status.is_success() {
        true => Ok(body.into()),
        false => Err(ClientError::refused(&body)),
    }
}

#[derive(Deserialize)]
struct Read {
    bytes: Vec<u8>,
}

/// Has the program do one transfer.
async fn pass_on(
    socket: &Path,
    position: u16,
    transfer: &RemoteTransfer,
) -> Result<Vec<u8>, SdoError> {
    let how = |complete_access: bool| {
        let timeout = transfer.timeout.map(|timeout| timeout.as_millis());
        How {
            complete: complete_access,
            timeout_ms: timeout.and_then(|timeout| timeout.try_into().ok()),
        }
    };
    let path = |object: ObjectAddress, complete_access: bool| {
        path_of(position, object, &how(complete_access))
    };
    let question = match &transfer.request {
        RemoteRequest::Read {
            object,
            complete_access,
        } => Question::get(path(*object, *complete_access)),
        RemoteRequest::Write {
            object,
            data,
            complete_access,
        } => Question {
            method: Method::POST,
            path: path(*object, *complete_access),
            body: Some(json!({ "bytes": data })),
        },
        RemoteRequest::Ask(question) => {
            let asked = query(&Asked::from(*question));
            Question::get(format!("/v1/od/{position}/information?{asked}"))
        }
    };
    let is_write = question.method == Method::POST;
    let answer = ask(socket, question).await;
    let answer = answer.map_err(|error| sdo_error(transfer.transfer(), error))?;
    if is_write {
        return Ok(Vec::new());
    }
    match serde_json::from_slice(&answer) {
        Ok(Read { bytes }) => Ok(bytes),
        Err(error) => Err(sdo_error(
            transfer.transfer(),
            ClientError::protocol(&error),
        )),
    }
}

/// Where the program has this object: both numbers are hexadecimal.
fn path_of(position: u16, object: ObjectAddress, how: &How) -> String {
    let (index, subindex) = (object.index, format!("{:02X}", object.subindex));
    let how = query(how);
    format!("/v1/od/{position}/{index:04X}h/{subindex}?{how}")
}

/// The fields of a flat structure as a query; those without a value are left out.
pub(crate) fn query(of: &impl serde::Serialize) -> String {
    let Ok(Value::Object(fields)) = serde_json::to_value(of) else {
        return String::new();
    };
    let pairs = fields.iter().filter_map(|(name, value)| match value {
        Value::Null => None,
        Value::String(text) => Some(format!("{name}={text}")),
        other => Some(format!("{name}={other}")),
    });
    pairs.collect::<Vec<_>>().join("&")
}

/// What the program said, as the drive's own answer where it is that.
fn sdo_error(transfer: Transfer, error: ClientError) -> SdoError {
    match error {
        ClientError::Refused { code, abort, .. } if code == NOT_SUPPORTED => {
            let reason = abort.map_or(NoInformation::Sii, |abort| {
                NoInformation::Service(AbortCode(abort))
            });
            SdoError::NotSupported { transfer, reason }
        }
        ClientError::Refused {
            abort: Some(abort), ..
        } => SdoError::Aborted {
            transfer,
            code: AbortCode(abort),
        },
        ClientError::Refused { text, .. } => {
            let prefix = format!("{transfer}: ");
            SdoError::Remote {
                transfer,
                reason: text.strip_prefix(&prefix).unwrap_or(&text).to_owned(),
            }
        }
        other => SdoError::Remote {
            transfer,
            reason: other.to_string(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_query_has_the_fields_that_are_set() {
        let how = How {
            complete: true,
            timeout_ms: None,
        };
        assert_eq!(query(&how), "complete=true");
        let path = path_of(3, ObjectAddress::new(0x1600, 16), &how);
        assert_eq!(path, "/v1/od/3/1600h/10?complete=true");
    }
}

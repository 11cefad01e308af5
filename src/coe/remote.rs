//! The objects of drives whose line another program has: who passes the transfers on to that program takes them here.

use alloc::sync::Arc;
use alloc::vec::Vec;
use core::time::Duration;

use smol::channel::{Receiver, Sender, bounded};

use super::error::{DriveId, SdoError, Transfer};
use super::handle::{SdoHandle, Server};
use super::information::Question;
use super::object::ObjectAddress;

/// Calls that may wait.
const WAITING: usize = 16;

/// What a transfer of an [`SdoHandle::remote`] asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RemoteRequest {
    /// The bytes of an object.
    Read {
        /// The object.
        object: ObjectAddress,
        /// All subindices from this one on at once.
        complete_access: bool,
    },
    /// To write an object.
    Write {
        /// The object.
        object: ObjectAddress,
        /// Its bytes.
        data: Vec<u8>,
        /// All subindices from this one on at once.
        complete_access: bool,
    },
    /// What the dictionary says: the bytes of the answer to this question, as [`Inquiry`](super::information::Inquiry) gives them.
    Ask(Question),
}

/// A transfer that somebody waits for.
#[derive(Debug)]
pub struct RemoteTransfer {
    transfer: Transfer,
    /// What is asked.
    pub request: RemoteRequest,
    /// The time for each reply, where the program has set one ([`SdoHandle::with_timeout`]).
    pub timeout: Option<Duration>,
    answer: Sender<Result<Vec<u8>, SdoError>>,
}

impl RemoteTransfer {
    pub(super) async fn call(
        calls: &Sender<Self>,
        transfer: Transfer,
        request: RemoteRequest,
        timeout: Option<Duration>,
    ) -> Result<Vec<u8>, SdoError> {
        let (answer, answered) = bounded(1);
        let call = Self {
            transfer,
            request,
            timeout,
            answer,
        };
        let closed = SdoError::Closed { transfer };
        if calls.send(call).await.is_err() {
            return Err(closed);
        }
        answered.recv().await.unwrap_or(Err(closed))
    }

    /// What its errors name.
    #[must_use]
    pub const fn transfer(&self) -> Transfer {
        self.transfer
    }

    /// Ends it. Where it is dropped instead, the transfer fails as [`SdoError::Closed`].
    pub fn answer(self, result: Result<Vec<u8>, SdoError>) {
        // Nobody waits for it any more.
        let _ = self.answer.try_send(result);
    }
}

/// The transfers of an [`SdoHandle::remote`] and its clones, in their order.
#[derive(Debug)]
pub struct RemoteTransfers(Receiver<RemoteTransfer>);

impl RemoteTransfers {
    /// The next one; `None` once the last handle is dropped.
    pub async fn next(&self) -> Option<RemoteTransfer> {
        self.0.recv().await.ok()
    }
}

impl SdoHandle {
    /// The objects of a drive whose line another program has, and the transfers that are to be passed on to it. Whoever passes them on
    /// decides what becomes of a transfer whose future is dropped.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// use servocrab::{coe::{DriveId, SdoHandle, obj}, sii::Identity};
    ///
    /// let drive = DriveId { position: 0, name: "lift".into(), identity: Identity::default() };
    /// let (sdo, transfers) = SdoHandle::remote(drive);
    /// let program = async {
    ///     while let Some(transfer) = transfers.next().await {
    ///         transfer.answer(Ok(vec![0x37, 0x16])); // as the other program has read it
    ///     }
    ///     unreachable!("the handle lives on")
    /// };
    /// let read = smol::block_on(smol::future::or(sdo.read(obj::STATUSWORD), program))?;
    /// assert_eq!(read, 0x1637);
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn remote(drive: DriveId) -> (Self, RemoteTransfers) {
        let (calls, transfers) = bounded(WAITING);
        let handle = Self {
            server: Server::Remote(calls),
            drive: Arc::new(drive),
            timeout: None,
        };
        (handle, RemoteTransfers(transfers))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::{AbortCode, obj};
    use crate::sii::Identity;

    #[test]
    fn what_is_asked_gets_to_the_other_program_and_what_it_answers_back() {
        let drive = DriveId {
            position: 2,
            name: "lift".into(),
            identity: Identity::default(),
        };
        let (sdo, transfers) = SdoHandle::remote(drive);
        let object = ObjectAddress::new(0x6081, 0);
        let patient = sdo.clone().with_timeout(Duration::from_secs(9));
        let program = async {
            let write = transfers.next().await.unwrap();
            let expected = RemoteRequest::Write {
                object,
                data: vec![1, 2, 0, 0],
                complete_access: false,
            };
            assert_eq!((&write.request, write.timeout), (&expected, None));
            write.answer(Ok(Vec::new()));
            let read = transfers.next().await.unwrap();
            let expected = RemoteRequest::Read {
                object: ObjectAddress::new(0x1600, 1),
                complete_access: true,
            };
            assert_eq!(read.request, expected);
            assert_eq!(read.timeout, Some(Duration::from_secs(9)));
            let (transfer, code) = (read.transfer(), AbortCode::NO_OBJECT);
            read.answer(Err(SdoError::Aborted { transfer, code }));
            let asked = transfers.next().await.unwrap();
            let question = Question::Object { index: 0x6081 };
            assert_eq!(asked.request, RemoteRequest::Ask(question));
            asked.answer(Ok(b"\x81\x60\x07\x00\x00\x07speed".into()));
            // Dropped: it will never be answered.
            drop(transfers.next().await);
        };
        let uses = async {
            sdo.write(obj::PROFILE_VELOCITY, 0x201).await.unwrap();
            let refused = patient.read_complete(0x1600, 1).await.unwrap_err();
            assert_eq!(refused.error.abort_code(), Some(AbortCode::NO_OBJECT));
            let described = sdo.describe_object(0x6081).await.unwrap();
            assert_eq!(described.name, "speed");
            let lost = sdo.read_bytes(0x6081, 0).await.unwrap_err();
            assert!(matches!(lost.error, SdoError::Closed { .. }), "{lost}");
        };
        smol::block_on(smol::future::zip(program, uses));
        drop((transfers, patient));
        let ended = smol::block_on(sdo.read(obj::PROFILE_VELOCITY)).unwrap_err();
        assert!(matches!(ended.error, SdoError::Closed { .. }), "{ended}");
    }
}

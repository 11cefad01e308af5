//! What a program holds of a mailbox client: the handle for SDO transfers.

use alloc::sync::Arc;
use alloc::vec::Vec;
use core::time::Duration;

use smol::channel::{Sender, bounded};

use super::error::{DriveError, DriveId, SdoError, Transfer};
use super::information::Question;
use super::object::{Object, ObjectAddress};
use super::value::{Readable, Value, Writable};

mod information;

/// Reads and writes objects of one drive; clones share its mailbox, in which transfers run one after another.
///
/// A caller that drops its future leaves the mailbox in order: a transfer that has not begun is withdrawn, one
/// that has is completed by the client.
#[derive(Debug, Clone)]
pub struct SdoHandle {
    pub(super) requests: Sender<Request>,
    pub(super) drive: Arc<DriveId>,
    pub(super) timeout: Option<Duration>,
}

/// A transfer on its way to the client.
#[derive(Debug)]
pub(super) struct Request {
    pub(super) transfer: Transfer,
    pub(super) body: Body,
    pub(super) timeout: Option<Duration>,
    pub(super) reply: Sender<Result<Vec<u8>, SdoError>>,
}

/// What a transfer is to do.
#[derive(Debug)]
pub(super) enum Body {
    Upload {
        complete_access: bool,
        /// The object's width in bytes where the program knows it.
        width: Option<usize>,
    },
    Download {
        complete_access: bool,
        data: Vec<u8>,
    },
    Ask(Question),
}

impl SdoHandle {
    /// The drive.
    #[must_use]
    pub fn drive(&self) -> &DriveId {
        &self.drive
    }

    /// The same handle with another time for each reply, for objects over which a device takes long (storing
    /// parameters).
    #[must_use]
    pub const fn with_timeout(mut self, timeout: Duration) -> Self {
        self.timeout = Some(timeout);
        self
    }

    /// Reads an object.
    ///
    /// # Errors
    /// [`SdoError`] with the drive: it refused (`Aborted`, `Mailbox`), did not answer (`Timeout`, `Link`), broke
    /// the protocol (`UnexpectedReply`, `Toggle`, `Cut`), has the object with another width (`WrongSize`), or the
    /// bus is gone (`Closed`).
    pub async fn read<T: Value, A: Readable>(&self, object: Object<T, A>) -> Result<T, DriveError> {
        let transfer = Transfer::read(object.address());
        let width = match usize::from(T::DATA_TYPE.bits()) {
            0 => None,
            bits => Some(bits / 8),
        };
        let data = self.run(transfer, upload(false, width)).await?;
        T::decode(&data).ok_or_else(|| {
            self.error(SdoError::WrongSize {
                transfer,
                expected: width.unwrap_or_default(),
                got: data.len(),
            })
        })
    }

    /// Writes an object; confirmed by the drive when the future resolves.
    ///
    /// A write is never made twice, whether the drive looks at the mailbox counter or not: one without a reply is not
    /// repeated, and one whose frame is lost is sent again only when the drive has answered another request without
    /// answering this one, so that it never arrived. Segments are told apart by their toggle bit.
    ///
    /// # Errors
    /// As [`SdoHandle::read`]. After `Timeout` and `Link` the write may have taken effect.
    pub async fn write<T: Value, A: Writable>(
        &self,
        object: Object<T, A>,
        value: T,
    ) -> Result<(), DriveError> {
        let transfer = Transfer::write(object.address());
        self.run(transfer, download(false, value.encode())).await?;
        Ok(())
    }

    /// Reads the bytes of `index:subindex`, as many as the drive sends.
    ///
    /// # Errors
    /// As [`SdoHandle::read`], but for `WrongSize` of a type.
    pub async fn read_bytes(&self, index: u16, subindex: u8) -> Result<Vec<u8>, DriveError> {
        let transfer = Transfer::read(ObjectAddress::new(index, subindex));
        self.run(transfer, upload(false, None)).await
    }

    /// Writes `data` to `index:subindex`.
    ///
    /// # Errors
    /// As [`SdoHandle::write`].
    pub async fn write_bytes(
        &self,
        index: u16,
        subindex: u8,
        data: Vec<u8>,
    ) -> Result<(), DriveError> {
        let transfer = Transfer::write(ObjectAddress::new(index, subindex));
        self.run(transfer, download(false, data)).await?;
        Ok(())
    }

    /// Reads `index` from `subindex` on (0 or 1) with all subindices that follow, by complete access. From
    /// subindex 0 on the first two bytes are the count and a zero; elements lie one behind the other.
    ///
    /// # Errors
    /// As [`SdoHandle::read_bytes`]; many drives refuse with abort code 06010004h.
    pub async fn read_complete(&self, index: u16, subindex: u8) -> Result<Vec<u8>, DriveError> {
        let transfer = Transfer::read(ObjectAddress::new(index, subindex));
        self.run(transfer, upload(true, None)).await
    }

    /// Writes `index` from `subindex` on (0 or 1) with all subindices that follow, by complete access. From
    /// subindex 0 on `data` begins with the count and a zero; elements lie one behind the other.
    ///
    /// # Errors
    /// As [`SdoHandle::write`]; many drives refuse with abort code 06010004h.
    pub async fn write_complete(
        &self,
        index: u16,
        subindex: u8,
        data: Vec<u8>,
    ) -> Result<(), DriveError> {
        let transfer = Transfer::write(ObjectAddress::new(index, subindex));
        self.run(transfer, download(true, data)).await?;
        Ok(())
    }

    pub(super) async fn run(&self, transfer: Transfer, body: Body) -> Result<Vec<u8>, DriveError> {
        let (reply, answer) = bounded(1);
        let request = Request {
            transfer,
            body,
            timeout: self.timeout,
            reply,
        };
        let closed = || self.error(SdoError::Closed { transfer });
        self.requests.send(request).await.map_err(|_| closed())?;
        let result = answer.recv().await.map_err(|_| closed())?;
        result.map_err(|error| self.error(error))
    }

    pub(super) fn error(&self, error: SdoError) -> DriveError {
        DriveError {
            drive: DriveId::clone(&self.drive),
            error,
        }
    }
}

const fn upload(complete_access: bool, width: Option<usize>) -> Body {
    Body::Upload {
        complete_access,
        width,
    }
}

const fn download(complete_access: bool, data: Vec<u8>) -> Body {
    Body::Download {
        complete_access,
        data,
    }
}

//! What a program holds of a mailbox client: the handle for SDO transfers.

use alloc::sync::Arc;
use alloc::vec::Vec;
use core::time::Duration;

use super::calls::{Callers, Request};
use super::client::Dialogue;
use super::error::{DriveError, DriveId, SdoError, Transfer};
use super::object::{Object, ObjectAddress};
use super::sdo::{Download, Upload};
use super::value::{Readable, Value, Writable};

mod information;

/// Reads and writes objects of one drive; clones share its mailbox, in which transfers run one after another.
///
/// A caller that drops its future leaves the mailbox in order. A transfer that has not begun is withdrawn; the client completes one
/// that has.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::coe::{SdoError, obj};
/// let sdo = net.sdo(0).ok_or("no drive was declared there")?;
/// sdo.write(obj::QUICK_STOP_DECELERATION, 150_000).await?;
/// assert_eq!(sdo.read(obj::QUICK_STOP_DECELERATION).await?, 150_000); // typed
/// let bytes = sdo.read_bytes(0x6085, 0).await?; // an object without a name here
/// assert_eq!(bytes, 150_000_u32.to_le_bytes());
/// let refused = sdo.read_bytes(0x5FFF, 0).await.unwrap_err();
/// assert!(matches!(refused.error, SdoError::Aborted { .. }), "{refused}"); // no such object
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct SdoHandle {
    pub(super) calls: Arc<Callers>,
    pub(super) drive: Arc<DriveId>,
    pub(super) timeout: Option<Duration>,
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
        let mut upload = Upload::new(transfer.object);
        if let Some(width) = width {
            upload = upload.width(width);
        }
        let data = self.upload(upload).await?;
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
    /// A write is never made twice, whether the drive looks at the mailbox counter or not. One without a reply is not repeated. One
    /// whose frame is lost is sent again only when it is known never to have arrived: the drive has answered another request
    /// without answering this one. The toggle bit distinguishes segments.
    ///
    /// # Errors
    /// As [`SdoHandle::read`]. After `Timeout` and `Link` the write may have taken effect.
    pub async fn write<T: Value, A: Writable>(
        &self,
        object: Object<T, A>,
        value: T,
    ) -> Result<(), DriveError> {
        let download = self.new_download(object.address(), value.encode());
        self.download(download).await
    }

    /// Reads the bytes of `index:subindex`, as many as the drive sends.
    ///
    /// # Errors
    /// As [`SdoHandle::read`], but for `WrongSize` of a type.
    pub async fn read_bytes(&self, index: u16, subindex: u8) -> Result<Vec<u8>, DriveError> {
        let object = ObjectAddress::new(index, subindex);
        self.upload_bytes(Upload::new(object)).await
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
        let object = ObjectAddress::new(index, subindex);
        self.download(self.new_download(object, data)).await
    }

    /// Reads `index` from `subindex` on (0 or 1) with all subindices that follow, by complete access. From
    /// subindex 0 on the first two bytes are the count and a zero; elements lie one behind the other.
    ///
    /// # Errors
    /// As [`SdoHandle::read_bytes`]; many drives refuse with abort code 06010004h.
    pub async fn read_complete(&self, index: u16, subindex: u8) -> Result<Vec<u8>, DriveError> {
        let object = ObjectAddress::new(index, subindex);
        self.upload_bytes(Upload::new(object).complete_access())
            .await
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
        let object = ObjectAddress::new(index, subindex);
        let download = self.new_download(object, data).complete_access();
        self.download(download).await
    }

    fn new_download(&self, object: ObjectAddress, data: Vec<u8>) -> Download {
        Download::new(object, data, self.calls.settings().write_length)
    }

    async fn download(&self, download: Download) -> Result<(), DriveError> {
        let transfer = Transfer::write(download.object());
        self.run(transfer, Dialogue::Download(download)).await?;
        Ok(())
    }

    async fn upload(&self, upload: Upload) -> Result<Vec<u8>, DriveError> {
        let transfer = Transfer::read(upload.object());
        let upload = upload.with_buffer(self.room());
        self.run(transfer, Dialogue::Upload(upload)).await
    }

    /// As [`SdoHandle::upload`], and no more room than the bytes take.
    async fn upload_bytes(&self, upload: Upload) -> Result<Vec<u8>, DriveError> {
        let mut data = self.upload(upload).await?;
        data.shrink_to_fit();
        Ok(data)
    }

    /// Room for any answer: the client finds none on its thread.
    fn room(&self) -> Vec<u8> {
        Vec::with_capacity(self.calls.room())
    }

    async fn run(&self, transfer: Transfer, dialogue: Dialogue) -> Result<Vec<u8>, DriveError> {
        let usual = self.calls.settings().reply_timeout;
        let timeout = self.timeout.unwrap_or(usual);
        let request = Request {
            transfer,
            dialogue,
            timeout,
        };
        let answer = self.calls.call(request).await;
        let answer = answer.ok_or_else(|| self.error(SdoError::Closed { transfer }))?;
        match answer.result {
            Ok(()) => Ok(answer.dialogue.into_data()),
            Err(failure) => {
                let step = answer.dialogue.waits_for();
                let error = failure.describe(transfer, timeout, step);
                Err(self.error(answer.dialogue.judge(error)))
            }
        }
    }

    pub(super) fn error(&self, error: SdoError) -> DriveError {
        DriveError {
            drive: DriveId::clone(&self.drive),
            error,
        }
    }
}

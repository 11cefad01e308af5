//! Replies that come after their transfer was given up: not to be taken for those of another.

use core::time::Duration;

use super::{Clock, MailboxClient, dialogue::Dialogue, dialogue::Failure};
use crate::coe::error::Transfer;
use crate::coe::obj;
use crate::coe::object::ObjectAddress;
use crate::coe::sdo::{SdoFault, Upload};
use crate::coe::transport::MailboxTransport;

/// Transfers that are remembered as owed their replies; with more of them any object may be meant.
pub(super) const MOST_OWED: usize = 32;

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Notes that the reply to this transfer may still come.
    pub(super) fn remember_owed(&mut self, transfer: Transfer) {
        if self.owed.len() < MOST_OWED && !self.owed.contains(&transfer) {
            self.owed.push(transfer);
        }
    }

    /// Whether a reply may still come that would pass for one to `transfer`.
    pub(super) fn owes_like(&self, transfer: Transfer) -> bool {
        self.owed.len() >= MOST_OWED || self.owed.iter().any(|owed| owed.is_like(transfer))
    }

    /// An answer to this transfer has come. A device answers in order: nothing earlier is owed any more.
    pub(super) fn answered(&mut self, transfer: Transfer) {
        self.owed.clear();
        if core::mem::take(&mut self.sent_again) {
            self.owed.push(transfer);
        }
    }

    /// An object whose reading is no answer to `transfer` or to what is owed.
    pub(super) fn another_object(&self, transfer: Transfer) -> ObjectAddress {
        let others = [obj::DEVICE_TYPE, obj::VENDOR_ID, obj::PRODUCT_CODE].map(|o| o.address());
        let is_free = |other: &ObjectAddress| {
            let read = Transfer::read(*other);
            !read.is_like(transfer) && !self.owed.iter().any(|owed| owed.is_like(read))
        };
        others.into_iter().find(is_free).unwrap_or(others[0])
    }

    /// Waits out the late reply of an earlier transfer of the same object, which its address does not distinguish from this one's.
    /// A device answers in order: once it has answered about another object, nothing late comes.
    pub(super) async fn resynchronise(
        &mut self,
        transfer: Transfer,
        timeout: Duration,
    ) -> Result<(), Failure> {
        let other = self.another_object(transfer);
        if self.read_another(other, timeout).await {
            Ok(())
        } else {
            Err(Failure::EarlierReply)
        }
    }

    /// Reads an object whose value does not matter; whether the device answered.
    pub(super) async fn read_another(&mut self, other: ObjectAddress, timeout: Duration) -> bool {
        let upload = Upload::new(other).with_buffer(core::mem::take(&mut self.other));
        let mut dialogue = Dialogue::Upload(upload);
        let read = self
            .converse(&mut dialogue, Transfer::read(other), timeout)
            .await;
        self.other = dialogue.into_data();
        matches!(read, Ok(()) | Err(Failure::Fault(SdoFault::Aborted(_))))
    }
}

//! A write whose frame is lost: the device may have taken it, or never seen it, and its sync manager does not tell which.
//!
//! It is not sent again before that is known: a command object must not be carried out twice. A device answers in order, so
//! another object is read: if the write's own answer does not come before that one's, the write never arrived.

use core::time::Duration;

use super::{Clock, MailboxClient, dialogue::Dialogue, dialogue::Failure, notes::MailEvent};
use crate::coe::error::{SdoError, SdoStep, Transfer};
use crate::coe::mailbox::Mail;
use crate::coe::sdo::{Step, Upload};
use crate::coe::transport::MailboxTransport;

/// How long the answer is looked for before another object is read.
pub(super) const LOOKED_FOR: Duration = Duration::from_millis(20);

/// How a transfer ends without success.
pub(super) enum Ending {
    Failed(SdoError),
    /// The frame with its mail is lost.
    Doubtful,
}

/// What has become of a doubtful write.
pub(super) enum Settled {
    Written,
    /// It can be sent again.
    NeverArrived(Dialogue),
}

/// A doubtful write while another object is read.
#[derive(Default)]
pub(super) struct Doubt {
    write: Option<Dialogue>,
    answer: Option<Result<Step, Failure>>,
}

impl Doubt {
    /// Takes a reply that is not the other object's. False if it is not the write's either.
    pub(super) fn feed(&mut self, reply: Mail<'_>) -> bool {
        match self.write.as_mut().map(|write| write.feed(reply, false)) {
            None | Some(Ok(Step::Foreign)) => false,
            Some(answer) => {
                self.answer = Some(answer);
                true
            }
        }
    }
}

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Finds out whether the device has taken the write.
    pub(super) async fn settle(
        &mut self,
        write: Dialogue,
        transfer: Transfer,
        timeout: Duration,
    ) -> Result<Settled, SdoError> {
        self.note(MailEvent::Doubtful(transfer));
        let other = self.another_object(transfer);
        self.remember_owed(transfer);
        self.doubt.write = Some(write);
        let mut dialogue = Dialogue::Upload(Upload::new(other));
        let read = self
            .converse(&mut dialogue, Transfer::read(other), timeout)
            .await;
        let write = self.doubt.write.take();
        match (self.doubt.answer.take(), read, write) {
            (Some(Ok(_)), ..) => Ok(Settled::Written),
            (Some(Err(failure)), ..) => Err(failure.describe(transfer, timeout, SdoStep::Reply)),
            (None, Ok(()) | Err(Ending::Failed(SdoError::Aborted { .. })), Some(write)) => {
                Ok(Settled::NeverArrived(write))
            }
            _ => {
                self.remember_owed(transfer);
                Err(SdoError::Timeout {
                    transfer,
                    step: SdoStep::Reply,
                    after: timeout,
                })
            }
        }
    }
}

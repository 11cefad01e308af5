//! A write whose frame is lost: the device may have taken it, or never seen it, and its sync manager does not show which.
//!
//! It is not sent again before that is known: a command object must not be carried out twice. A device answers in order, so the
//! client reads another object. If the write's own answer does not come before that one's, the write never arrived.

use alloc::vec::Vec;
use core::time::Duration;

use super::{Clock, MailboxClient, dialogue::Dialogue, dialogue::Failure, notes::MailEvent};
use crate::coe::error::Transfer;
use crate::coe::mailbox::Mail;
use crate::coe::sdo::{Download, Step};
use crate::coe::transport::MailboxTransport;

/// How long the answer is looked for before another object is read.
pub(super) const LOOKED_FOR: Duration = Duration::from_millis(20);

/// What has become of an unconfirmed write.
pub(super) enum Settled {
    Written,
    /// It can be sent again.
    NeverArrived,
}

/// An unconfirmed write while another object is read.
#[derive(Default)]
pub(super) struct Doubt {
    /// In its place, and without its data, which were in the one message: it takes the same replies.
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
        transfer: Transfer,
        timeout: Duration,
    ) -> Result<Settled, Failure> {
        self.note(MailEvent::Doubtful(transfer));
        let other = self.another_object(transfer);
        self.remember_owed(transfer);
        let write = Download::new(transfer.object, Vec::new(), self.settings.write_length);
        self.doubt.write = Some(Dialogue::Download(write));
        let answered = self.read_another(other, timeout).await;
        self.doubt.write = None;
        match self.doubt.answer.take() {
            Some(Ok(_)) => Ok(Settled::Written),
            Some(Err(failure)) => Err(failure),
            None if answered => Ok(Settled::NeverArrived),
            None => {
                self.remember_owed(transfer);
                Err(Failure::NoReply)
            }
        }
    }
}

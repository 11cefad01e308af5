//! Accesses to the mailbox with their deadlines, and the request for a message whose reading was lost.

use core::{future::Future, time::Duration};

use smol::future::or;

use super::{Clock, MailboxClient, dialogue::Failure};
use crate::coe::transport::{LinkFault, MailboxStatus, MailboxTransport};

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Asks the device for its last message once more and waits until it has followed.
    pub(super) async fn repeat(&mut self, before: MailboxStatus) -> Result<(), Failure> {
        let toggle = !before.repeat_requested;
        let deadline = self.clock.now() + self.settings.frame_timeout;
        self.repeated = true;
        while let Err(fault) = self.access(self.transport.request_repeat(toggle)).await {
            self.tolerate(fault)?;
            self.pause().await;
        }
        // A device that never follows has no repeat; what it sends next is read as usual.
        while self.clock.now() < deadline {
            match self.access(self.transport.status()).await {
                Ok(status) if status.repeat_done == toggle => break,
                Ok(_) => {}
                Err(fault) => self.tolerate(fault)?,
            }
            self.pause().await;
        }
        Ok(())
    }

    /// Asks the device for its last message once more, whatever its mailbox shows.
    pub(super) async fn ask_again(&mut self) -> Result<(), Failure> {
        loop {
            match self.access(self.transport.status()).await {
                Ok(status) => return self.repeat(status).await,
                Err(fault) => self.tolerate(fault)?,
            }
        }
    }

    async fn pause(&self) {
        let next = self.clock.now() + self.settings.poll_interval;
        self.clock.sleep_until(next).await;
    }

    /// One access with its deadline.
    pub(super) async fn access<R>(
        &self,
        access: impl Future<Output = Result<R, LinkFault>>,
    ) -> Result<R, LinkFault> {
        self.access_within(self.settings.frame_timeout, access)
            .await
    }

    pub(super) async fn access_within<R>(
        &self,
        limit: Duration,
        access: impl Future<Output = Result<R, LinkFault>>,
    ) -> Result<R, LinkFault> {
        let deadline = self.clock.now() + limit;
        or(access, async {
            self.clock.sleep_until(deadline).await;
            Err(LinkFault::Lost)
        })
        .await
    }

    /// Counts a failed access; too many in a row end the transfer.
    pub(super) fn tolerate(&mut self, fault: LinkFault) -> Result<(), Failure> {
        if fault == LinkFault::Busy {
            return Ok(());
        }
        self.failures += 1;
        if self.failures >= self.settings.attempts {
            return Err(Failure::Link(fault));
        }
        Ok(())
    }
}

//! Reading of messages: one at a time, to whom it concerns, and what waits while nothing was asked for.

use alloc::sync::Arc;

use super::{
    Clock, Found, MAILS_AT_ONCE, MailboxClient,
    dialogue::{Dialogue, Failure},
    notes::MailEvent,
};
use crate::coe::{
    emergencies::Received,
    emergency::Emergency,
    mailbox::{HEADER_LENGTH, Mail},
    sdo::Step,
    transport::{LinkFault, MailboxTransport},
};

impl<T: MailboxTransport, C: Clock> MailboxClient<T, C> {
    /// Reads away what waits while nothing was asked for.
    pub(super) async fn collect(&mut self, mut mail_waits: bool) {
        self.forget_the_session_before();
        for _ in 0..MAILS_AT_ONCE {
            let found = if core::mem::take(&mut mail_waits) {
                self.read_waiting().await
            } else {
                self.look(None).await
            };
            match found {
                Ok(Found::Other) => {}
                Ok(_) => break,
                Err(fault) => {
                    self.note(MailEvent::Unreadable(fault));
                    break;
                }
            }
        }
        self.signal.forget();
    }

    /// Reads one message, if there is one, and hands it to whom it concerns.
    pub(super) async fn look(&mut self, dialogue: Option<&mut Dialogue>) -> Result<Found, Failure> {
        let status = match self.access(self.transport.status()).await {
            Ok(status) => status,
            Err(fault) => {
                self.tolerate(fault)?;
                return Ok(Found::Nothing);
            }
        };
        if !status.mail_waiting {
            self.failures = 0;
            return Ok(Found::Nothing);
        }
        match self.read().await {
            Ok(true) => self.take(dialogue),
            // Empty although a message waited: a frame that was sent again has read it before.
            Ok(false) | Err(LinkFault::Lost) => {
                self.tolerate(LinkFault::Lost)?;
                self.repeat(status).await?;
                Ok(Found::Nothing)
            }
            Err(fault) => {
                self.tolerate(fault)?;
                Ok(Found::Nothing)
            }
        }
    }

    /// Reads the message that is known to wait while nothing was asked for.
    async fn read_waiting(&mut self) -> Result<Found, Failure> {
        match self.read().await {
            Ok(true) => self.take(None),
            // Empty although a message waited: a frame that came twice has read it before.
            Ok(false) | Err(LinkFault::Lost) => {
                self.tolerate(LinkFault::Lost)?;
                self.ask_again().await?;
                Ok(Found::Nothing)
            }
            Err(fault) => {
                self.tolerate(fault)?;
                Ok(Found::Nothing)
            }
        }
    }

    /// Reads one message, where there may be one, and hands it to whom it concerns.
    pub(super) async fn read_unasked(&mut self, dialogue: &mut Dialogue) -> Result<Found, Failure> {
        match self.read().await {
            Ok(true) => self.take(Some(dialogue)),
            Ok(false) => Ok(Found::Nothing),
            // Whether a message was read by the frame that is lost, nobody knows.
            Err(LinkFault::Lost) => {
                self.tolerate(LinkFault::Lost)?;
                self.ask_again().await?;
                Ok(Found::Nothing)
            }
            Err(fault) => {
                self.tolerate(fault)?;
                Ok(Found::Nothing)
            }
        }
    }

    /// Reads the mailbox; false if it is empty.
    async fn read(&mut self) -> Result<bool, LinkFault> {
        let mut mail = core::mem::take(&mut self.reply);
        mail.fill(0);
        let reading = self.transport.read_mail(&mut mail);
        let read = self
            .access_within(self.settings.mail_timeout, reading)
            .await;
        self.reply = mail;
        if read == Ok(true) {
            self.failures = 0;
        }
        read
    }

    /// Takes the message that was read.
    fn take(&mut self, dialogue: Option<&mut Dialogue>) -> Result<Found, Failure> {
        let mail = core::mem::take(&mut self.reply);
        let found = self.pass_on(&mail, dialogue);
        self.reply = mail;
        found
    }

    fn pass_on(&mut self, mail: &[u8], dialogue: Option<&mut Dialogue>) -> Result<Found, Failure> {
        let (header, content) = match Mail::parse(mail) {
            Ok(parsed) => parsed,
            Err(cut) if dialogue.is_some() => return Err(Failure::Fault(cut.into())),
            Err(cut) => {
                self.note(MailEvent::Cut(cut));
                return Ok(Found::Other);
            }
        };
        let whole = mail
            .get(..HEADER_LENGTH + usize::from(header.length))
            .unwrap_or(mail);
        let twice = self.repeated && header.counter != 0 && whole == self.last;
        self.repeated = false;
        if twice {
            return Ok(Found::Other);
        }
        self.last.clear();
        self.last.extend_from_slice(whole);
        match (content, dialogue) {
            (Mail::Emergency(emergency), _) => {
                self.report(emergency);
                Ok(Found::Other)
            }
            (content @ (Mail::SdoReply(_) | Mail::SdoInformation(_)), Some(dialogue)) => {
                match dialogue.feed(content, self.owed.is_empty())? {
                    Step::Foreign => {
                        if !self.doubt.feed(content) {
                            self.note(MailEvent::Foreign(content.into()));
                        }
                        Ok(Found::Other)
                    }
                    step => Ok(Found::Answer(step)),
                }
            }
            (Mail::Error(error), Some(_)) if self.owed.is_empty() => Err(Failure::Refused(error)),
            // An error reply does not say which request it is for. If it was this one's, no other answer will come.
            (Mail::Error(error), Some(_)) => {
                self.refusal = Some(error);
                Ok(Found::Other)
            }
            (content, _) => {
                self.note(MailEvent::Unawaited(content.into()));
                Ok(Found::Other)
            }
        }
    }

    fn report(&self, emergency: Emergency) {
        self.note(MailEvent::Emergency(emergency, Arc::clone(&self.texts)));
        let received = Received {
            drive: Arc::clone(&self.drive),
            at: self.clock.now(),
            emergency,
            texts: Arc::clone(&self.texts),
        };
        if let Some(queue) = &self.of_network {
            queue.push(received.clone());
        }
        self.emergencies.push(received);
    }
}

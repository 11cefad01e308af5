//! What a mailbox client notes for the log. It runs on the thread that owns the bus, where a subscriber that blocks would stop the
//! cycles. So its owner may take the records and write them elsewhere.

use alloc::sync::Arc;
use core::{fmt, time::Duration};

use tracing::Level;

use super::Failure;
use crate::coe::emergency::Emergency;
use crate::coe::error::{DriveId, ErrorTexts, Transfer};
use crate::coe::mailbox::{CutMail, Mail, MailboxError, Protocol};

/// Where notes go, each with its time.
pub(crate) type Notes = Arc<dyn Fn(Duration, MailNote) + Send + Sync>;

/// One event to be logged.
#[derive(Debug, Clone)]
pub(crate) struct MailNote {
    pub(super) drive: Arc<DriveId>,
    pub(super) event: MailEvent,
}

#[derive(Debug, Clone)]
pub(super) enum MailEvent {
    Request(Transfer, Excerpt),
    /// The mailbox could not be read while nothing was asked for.
    Unreadable(Failure),
    Cut(CutMail),
    Unawaited(Content),
    /// A reply that no request under way has.
    Foreign(Content),
    /// The frame of a request is lost.
    Doubtful(Transfer),
    Emergency(Emergency, Arc<ErrorTexts>),
}

/// What a message contains, of its data as much as an [`Excerpt`] holds.
#[derive(Debug, Clone, Copy)]
#[expect(dead_code, reason = "they are read by their Debug")]
pub(super) enum Content {
    SdoReply(Excerpt),
    Emergency(Emergency),
    Error(MailboxError),
    SdoInformation(Excerpt),
    Other(Protocol, u8),
}

/// The beginning of some bytes, as much as a note has room for.
#[derive(Clone, Copy)]
pub(super) struct Excerpt {
    bytes: [u8; EXCERPT],
    length: usize,
}

/// A message with four bytes of an object takes 16, one with a mapping's longest object 44.
const EXCERPT: usize = 48;

impl Excerpt {
    pub fn of(all: &[u8]) -> Self {
        let mut bytes = [0; EXCERPT];
        for (to, from) in bytes.iter_mut().zip(all) {
            *to = *from;
        }
        Self {
            bytes,
            length: all.len(),
        }
    }
}

/// As of the bytes; what is left out is counted.
impl fmt::Debug for Excerpt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.bytes.get(..self.length) {
            Some(all) => all.fmt(f),
            None => write!(f, "{:?} and {} more", self.bytes, self.length - EXCERPT),
        }
    }
}

impl From<Mail<'_>> for Content {
    fn from(mail: Mail<'_>) -> Self {
        match mail {
            Mail::SdoReply(reply) => Self::SdoReply(Excerpt::of(reply)),
            Mail::Emergency(emergency) => Self::Emergency(emergency),
            Mail::Error(error) => Self::Error(error),
            Mail::SdoInformation(reply) => Self::SdoInformation(Excerpt::of(reply)),
            Mail::Other(protocol, service) => Self::Other(protocol, service),
        }
    }
}

#[cfg(test)]
impl MailNote {
    /// For the tests of those that take records.
    pub fn of_each_kind(drive: &Arc<DriveId>) -> impl Iterator<Item = Self> {
        let object = crate::coe::obj::CONTROLWORD.address();
        let transfer = Transfer::read(object);
        let cut = CutMail { needed: 6, got: 2 };
        let emergency = Emergency {
            code: 0x7320,
            register: 0x21,
            data: [0; 5],
        };
        let events = [
            MailEvent::Request(transfer, Excerpt::of(&[1; 16])),
            MailEvent::Unreadable(Failure::NoReply),
            MailEvent::Cut(cut),
            MailEvent::Unawaited(Content::Emergency(emergency)),
            MailEvent::Foreign(Content::SdoReply(Excerpt::of(&[2; 8]))),
            MailEvent::Doubtful(transfer),
            MailEvent::Emergency(emergency, Arc::default()),
        ];
        let drive = Arc::clone(drive);
        events.into_iter().map(move |event| Self {
            drive: Arc::clone(&drive),
            event,
        })
    }
}

impl MailNote {
    /// The level of the event that [`write`](Self::write) makes of it.
    pub fn level(&self) -> Level {
        match self.event {
            MailEvent::Request(..) => Level::TRACE,
            MailEvent::Unreadable(_)
            | MailEvent::Unawaited(_)
            | MailEvent::Foreign(_)
            | MailEvent::Doubtful(_) => Level::DEBUG,
            MailEvent::Cut(_) | MailEvent::Emergency(..) => Level::WARN,
        }
    }

    /// Makes an event of it.
    pub fn write(&self, at: Duration) {
        let drive = &self.drive;
        match &self.event {
            MailEvent::Request(transfer, mail) => {
                tracing::trace!(target: crate::log_target::DRIVE, %drive, %transfer, ?mail, ?at, "request");
            }
            MailEvent::Unreadable(fault) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, ?fault, ?at, "mailbox could not be read");
            }
            MailEvent::Cut(cut) => {
                tracing::warn!(target: crate::log_target::DRIVE, %drive, %cut, ?at, "message dropped");
            }
            MailEvent::Unawaited(content) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, ?content, ?at, "message that no call waits for dropped");
            }
            MailEvent::Foreign(reply) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, ?reply, ?at, "reply of another request dropped");
            }
            MailEvent::Doubtful(transfer) => {
                tracing::debug!(
                    target: crate::log_target::DRIVE,
                    %drive,
                    %transfer,
                    ?at,
                    "its frame is lost: whether it has arrived is being found out"
                );
            }
            MailEvent::Emergency(emergency, texts) => tracing::warn!(
                target: crate::log_target::DRIVE,
                %drive,
                code = %format_args!("{:04X}h", emergency.code),
                register = %format_args!("{:02X}h", emergency.register),
                data = %format_args!("{:02X?}", emergency.data),
                text = %texts.text(emergency),
                ?at,
                "emergency"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_excerpt_is_shown_as_the_bytes_and_says_how_many_are_left_out() {
        assert_eq!(format!("{:?}", Excerpt::of(&[1, 2])), "[1, 2]");
        assert_eq!(format!("{:?}", Excerpt::of(&[])), "[]");
        assert_eq!(
            format!("{:?}", Excerpt::of(&[7; EXCERPT])),
            format!("{:?}", [7; EXCERPT])
        );
        assert_eq!(
            format!("{:?}", Excerpt::of(&[7; 60])),
            format!("{:?} and 12 more", [7; 48])
        );
        let content = Content::from(Mail::SdoReply(&[3, 4]));
        let whole = Mail::SdoReply(&[3, 4]);
        assert_eq!(format!("{content:?}"), format!("{whole:?}"));
    }
}

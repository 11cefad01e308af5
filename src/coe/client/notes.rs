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
pub(super) enum Content {
    SdoReply(Excerpt),
    Emergency(Emergency),
    Error(MailboxError),
    SdoInformation(Excerpt),
    Other(Protocol, u8),
}

/// The beginning of some bytes, as much as a note has room for.
#[derive(Debug, Clone, Copy)]
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

/// The bytes in hexadecimal; what is left out is counted.
impl fmt::Display for Excerpt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.bytes.get(..self.length) {
            Some(all) => write!(f, "{all:02X?}"),
            None => write!(f, "{:02X?} and {} more", self.bytes, self.length - EXCERPT),
        }
    }
}

impl fmt::Display for Content {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SdoReply(reply) => write!(f, "SDO reply {reply}"),
            Self::Emergency(emergency) => emergency.fmt(f),
            Self::Error(error) => write!(f, "mailbox error: {error}"),
            Self::SdoInformation(reply) => write!(f, "SDO information {reply}"),
            Self::Other(protocol, service) => write!(f, "{protocol:?}, service {service}"),
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
                tracing::trace!(target: crate::log_target::DRIVE, %drive, %transfer, %mail, ?at, "request");
            }
            MailEvent::Unreadable(fault) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, ?fault, ?at, "mailbox could not be read");
            }
            MailEvent::Cut(cut) => {
                tracing::warn!(target: crate::log_target::DRIVE, %drive, %cut, ?at, "message dropped");
            }
            MailEvent::Unawaited(content) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, %content, ?at, "message that no call waits for dropped");
            }
            MailEvent::Foreign(reply) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, %reply, ?at, "reply of another request dropped");
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
    fn an_excerpt_is_shown_in_hexadecimal_and_says_how_many_bytes_are_left_out() {
        assert_eq!(Excerpt::of(&[1, 0xA2]).to_string(), "[01, A2]");
        assert_eq!(Excerpt::of(&[]).to_string(), "[]");
        let whole = format!("[{}07]", "07, ".repeat(EXCERPT - 1));
        assert_eq!(Excerpt::of(&[7; EXCERPT]).to_string(), whole);
        let cut = format!("{whole} and 12 more");
        assert_eq!(Excerpt::of(&[7; 60]).to_string(), cut);
    }

    #[test]
    fn the_words_of_a_message_are_shown_in_hexadecimal() {
        let emergency = Emergency {
            code: 0x7320,
            register: 0x21,
            data: [0x10, 0, 0, 0, 0xFF],
        };
        let shown = |mail| Content::from(mail).to_string();
        assert_eq!(shown(Mail::Emergency(emergency)), emergency.to_string());
        assert!(emergency.to_string().contains("7320h"), "{emergency}");
        assert_eq!(shown(Mail::SdoReply(&[0x4F, 0x41])), "SDO reply [4F, 41]");
        assert_eq!(shown(Mail::SdoInformation(&[0x82])), "SDO information [82]");
        assert_eq!(shown(Mail::Other(Protocol::Foe, 3)), "Foe, service 3");
    }
}

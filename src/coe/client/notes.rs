//! What a mailbox client notes for the log. It runs on the thread that owns the bus, where a subscriber that blocks would stop the
//! cycles. So its owner may take the records and write them elsewhere.

use alloc::sync::Arc;
use core::{fmt, time::Duration};

use tracing::Level;

use super::Failure;
use crate::coe::emergency::Emergency;
use crate::coe::error::{DriveId, ErrorTexts, Transfer};
use crate::coe::mailbox::{CutMessage, MailboxError, MailboxMessage, Protocol};

/// Where notes go, each with its time.
pub(crate) type MailboxLog = Arc<dyn Fn(Duration, MailboxRecord) + Send + Sync>;

/// One event to be logged.
#[derive(Debug, Clone)]
pub(crate) struct MailboxRecord {
    pub(super) drive: Arc<DriveId>,
    pub(super) event: MailboxEvent,
}

#[derive(Debug, Clone)]
pub(super) enum MailboxEvent {
    Request(Transfer, Excerpt),
    /// The mailbox could not be read while nothing was asked for.
    Unreadable(Failure),
    Cut(CutMessage),
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

impl From<MailboxMessage<'_>> for Content {
    fn from(message: MailboxMessage<'_>) -> Self {
        match message {
            MailboxMessage::SdoReply(reply) => Self::SdoReply(Excerpt::of(reply)),
            MailboxMessage::Emergency(emergency) => Self::Emergency(emergency),
            MailboxMessage::Error(error) => Self::Error(error),
            MailboxMessage::SdoInformation(reply) => Self::SdoInformation(Excerpt::of(reply)),
            MailboxMessage::Other(protocol, service) => Self::Other(protocol, service),
        }
    }
}

#[cfg(test)]
impl MailboxRecord {
    /// For the tests of those that take records.
    pub fn of_each_kind(drive: &Arc<DriveId>) -> impl Iterator<Item = Self> {
        let object = crate::coe::obj::CONTROLWORD.address();
        let transfer = Transfer::read(object);
        let cut = CutMessage { needed: 6, got: 2 };
        let emergency = Emergency {
            code: 0x7320,
            register: 0x21,
            data: [0; 5],
        };
        let events = [
            MailboxEvent::Request(transfer, Excerpt::of(&[1; 16])),
            MailboxEvent::Unreadable(Failure::NoReply),
            MailboxEvent::Cut(cut),
            MailboxEvent::Unawaited(Content::Emergency(emergency)),
            MailboxEvent::Foreign(Content::SdoReply(Excerpt::of(&[2; 8]))),
            MailboxEvent::Doubtful(transfer),
            MailboxEvent::Emergency(emergency, Arc::default()),
        ];
        let drive = Arc::clone(drive);
        events.into_iter().map(move |event| Self {
            drive: Arc::clone(&drive),
            event,
        })
    }
}

impl MailboxRecord {
    /// The level of the event that [`write`](Self::write) makes of it.
    pub fn level(&self) -> Level {
        match self.event {
            MailboxEvent::Request(..) => Level::TRACE,
            MailboxEvent::Unreadable(_)
            | MailboxEvent::Unawaited(_)
            | MailboxEvent::Foreign(_)
            | MailboxEvent::Doubtful(_) => Level::DEBUG,
            MailboxEvent::Cut(_) | MailboxEvent::Emergency(..) => Level::WARN,
        }
    }

    /// Makes an event of it.
    pub fn write(&self, at: Duration) {
        let drive = &self.drive;
        match &self.event {
            MailboxEvent::Request(transfer, message) => {
                tracing::trace!(target: crate::log_target::DRIVE, %drive, %transfer, %message, ?at, "request");
            }
            MailboxEvent::Unreadable(fault) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, ?fault, ?at, "mailbox could not be read");
            }
            MailboxEvent::Cut(cut) => {
                tracing::warn!(target: crate::log_target::DRIVE, %drive, %cut, ?at, "message dropped");
            }
            MailboxEvent::Unawaited(content) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, %content, ?at, "message that no call waits for dropped");
            }
            MailboxEvent::Foreign(reply) => {
                tracing::debug!(target: crate::log_target::DRIVE, %drive, %reply, ?at, "reply of another request dropped");
            }
            MailboxEvent::Doubtful(transfer) => {
                tracing::debug!(
                    target: crate::log_target::DRIVE,
                    %drive,
                    %transfer,
                    ?at,
                    "its frame is lost: whether it has arrived is being found out"
                );
            }
            MailboxEvent::Emergency(emergency, texts) => tracing::warn!(
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
        let shown = |message| Content::from(message).to_string();
        assert_eq!(
            shown(MailboxMessage::Emergency(emergency)),
            emergency.to_string()
        );
        assert!(emergency.to_string().contains("7320h"), "{emergency}");
        assert_eq!(
            shown(MailboxMessage::SdoReply(&[0x4F, 0x41])),
            "SDO reply [4F, 41]"
        );
        assert_eq!(
            shown(MailboxMessage::SdoInformation(&[0x82])),
            "SDO information [82]"
        );
        assert_eq!(
            shown(MailboxMessage::Other(Protocol::Foe, 3)),
            "Foe, service 3"
        );
    }
}

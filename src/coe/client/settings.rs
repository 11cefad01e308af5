//! Settings of a mailbox client: lengths, deadlines, bounds.

use core::time::Duration;

use crate::sii::{Mailbox, Sii};

/// Lengths, deadlines and bounds of a mailbox client.
///
/// ```
/// use core::time::Duration;
/// use servocrab::{coe::MailboxSettings, sii::{Mailbox, Protocols}};
///
/// // As a device's SII gives it.
/// let mailbox = Mailbox {
///     receive_offset: 0x1800,
///     receive_length: 1024,
///     send_offset: 0x1C00,
///     send_length: 1024,
///     protocols: Protocols(4), // CoE
/// };
/// let patient = MailboxSettings { reply_timeout: Duration::from_secs(5), ..MailboxSettings::new(&mailbox) };
/// assert_eq!(patient.read_length, 1024);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MailboxSettings {
    /// Bytes of the mailbox that the master writes.
    pub write_length: usize,
    /// Bytes of the mailbox that the master reads.
    pub read_length: usize,
    /// After this a frame counts as lost and its future is dropped.
    pub frame_timeout: Duration,
    /// After this the reading of a message counts as lost, and the message is asked for again by the repeat request. Shorter
    /// than the time for a frame, because the link must not send this one again: that would read the next message.
    pub mail_timeout: Duration,
    /// After this a request without reply has failed; counted anew for each segment.
    pub reply_timeout: Duration,
    /// The longest time between two looks at a mailbox while a reply is due; the first ones follow each other sooner.
    pub poll_interval: Duration,
    /// The time between two looks at the mailbox while nothing is due, for emergencies. Not in the cycles of a `Network`, whose
    /// frames show what waits.
    pub idle_interval: Duration,
    /// Whether the device may be asked by SDO information: what its SII's CoE details say. If not, such questions fail as
    /// not supported, unasked.
    pub sdo_information: bool,
    /// How many accesses in a row may fail before a transfer is given up.
    pub attempts: u32,
    /// Requests that may wait.
    pub request_capacity: usize,
    /// Emergencies that are kept for a program that has not taken them.
    pub emergency_capacity: usize,
}

impl MailboxSettings {
    /// The settings for the mailbox of a device with this SII, as [`MailboxSettings::new`].
    #[must_use]
    pub fn of(sii: &Sii, mailbox: &Mailbox) -> Self {
        let general = sii.general.as_ref();
        Self {
            sdo_information: general.is_none_or(|general| general.coe.sdo_information()),
            ..Self::new(mailbox)
        }
    }

    /// The settings for a device's mailbox, with 1 s for a reply.
    #[must_use]
    pub fn new(mailbox: &Mailbox) -> Self {
        Self {
            write_length: usize::from(mailbox.receive_length),
            read_length: usize::from(mailbox.send_length),
            frame_timeout: Duration::from_millis(150),
            mail_timeout: Duration::from_millis(40),
            reply_timeout: Duration::from_secs(1),
            poll_interval: Duration::from_micros(250),
            idle_interval: Duration::from_millis(10),
            sdo_information: true,
            attempts: 5,
            request_capacity: 16,
            emergency_capacity: 64,
        }
    }
}

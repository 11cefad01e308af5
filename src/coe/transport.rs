//! How messages reach a device: the few accesses that the mailbox client needs, and those over ethercrab.

use core::future::Future;

use ethercrab::error::{Error, PduError};
use ethercrab::{Command, EtherCrabWireWrite, MainDevice};

use crate::sii::Mailbox;

/// First register of sync manager 0; sync manager 1 follows.
const SYNC_MANAGER_0: u16 = 0x0800;
/// The activation register of sync manager 1.
const SYNC_MANAGER_1_ACTIVATE: u16 = 0x080E;

/// The accesses to one device's mailbox. All futures are polled and dropped on one thread.
///
/// None has a deadline of its own: the client drops a future that takes too long.
pub trait MailboxTransport {
    /// Writes `message`, padded to the mailbox's whole length; `false` if the mailbox did not take it (it is full).
    fn write_message(&self, message: &[u8]) -> impl Future<Output = Result<bool, LinkFault>>;

    /// Reads the whole mailbox of the device into `message`; `false` if it was empty.
    fn read_message(&self, message: &mut [u8]) -> impl Future<Output = Result<bool, LinkFault>>;

    /// Reads the state of both mailboxes.
    fn status(&self) -> impl Future<Output = Result<MailboxStatus, LinkFault>>;

    /// Sets the repeat request of the device's mailbox to `toggle`; a change asks for the last message again.
    fn request_repeat(&self, toggle: bool) -> impl Future<Output = Result<(), LinkFault>>;
}

/// The state of a device's mailboxes (registers 0805h, 080Dh, 080Eh, 080Fh).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MailboxStatus {
    /// The device has not yet taken the last request.
    pub request_pending: bool,
    /// A message of the device waits to be read.
    pub message_waiting: bool,
    /// The repeat request as the master set it last.
    pub repeat_requested: bool,
    /// The repeat request that the device has followed.
    pub repeat_done: bool,
}

impl MailboxStatus {
    /// The state that the 16 registers of sync managers 0 and 1 show, 0800h to 080Fh; `None` if there are fewer.
    #[must_use]
    pub fn from_registers(registers: &[u8]) -> Option<Self> {
        Some(Self {
            request_pending: registers.get(0x5)? & 0x08 != 0,
            message_waiting: registers.get(0xD)? & 0x08 != 0,
            repeat_requested: registers.get(0xE)? & 0x02 != 0,
            repeat_done: registers.get(0xF)? & 0x02 != 0,
        })
    }
}

/// Why an access to a mailbox failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LinkFault {
    /// No frame came back: the access may or may not have taken effect.
    #[error("no frame came back")]
    Lost,
    /// No frame could be sent now; it can be later.
    #[error("no free frame")]
    Busy,
    /// The frame came back, the device did not act on it.
    #[error("the device does not answer")]
    NotAnswered,
    /// ethercrab refused.
    #[error("ethercrab: {0}")]
    Refused(LinkRefusal),
}

/// Why ethercrab refused an access, as a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct LinkRefusal(Error);

impl LinkRefusal {
    pub(crate) const fn new(error: Error) -> Self {
        Self(error)
    }
}

/// A device's mailbox, reached by ethercrab's commands.
///
/// ethercrab's timeouts must be longer than the client's, and its futures be polled and dropped on the thread
/// that sends its frames.
///
/// ```no_run
/// use servocrab::coe::{Clock, DriveId, EthercrabMailbox, MailboxClient, MailboxSettings, obj};
/// # async fn example(
/// #     main: &'static ethercrab::MainDevice<'static>,
/// #     mailbox: servocrab::sii::Mailbox,
/// #     clock: impl Clock,
/// #     drive: DriveId,
/// # ) -> Result<(), Box<dyn std::error::Error>> {
/// // The device with the station address 1001h, in PREOP; its mailbox is in its SII.
/// let transport = EthercrabMailbox::new(main, 0x1001, mailbox);
/// let settings = MailboxSettings::new(&mailbox);
/// let (client, sdo, _emergencies) = MailboxClient::new(transport, clock, settings, drive);
/// // `client.run()` is the actor that serves the handles, on the thread that sends the frames.
/// smol::future::or(async { client.run().await; }, async {
///     println!("{:?}", sdo.read(obj::STATUSWORD).await);
/// })
/// .await;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Copy)]
pub struct EthercrabMailbox<'m> {
    main: &'m MainDevice<'m>,
    station: u16,
    mailbox: Mailbox,
}

impl<'m> EthercrabMailbox<'m> {
    /// The mailbox of the device with the configured address `station`.
    #[must_use]
    pub const fn new(main: &'m MainDevice<'m>, station: u16, mailbox: Mailbox) -> Self {
        Self {
            main,
            station,
            mailbox,
        }
    }

    // The bytes are copied out in the poll in which they come. What ethercrab hands out points into a frame slot that is already
    // free again.
    async fn read(&self, register: u16, into: &mut [u8]) -> Result<(), LinkFault> {
        let length = u16::try_from(into.len()).unwrap_or(u16::MAX);
        let received = Command::fprd(self.station, register)
            .receive_slice(self.main, length)
            .await
            .map_err(fault)?;
        for (to, from) in into.iter_mut().zip(received.iter()) {
            *to = *from;
        }
        Ok(())
    }

    async fn write(&self, register: u16, data: impl EtherCrabWireWrite) -> Result<(), LinkFault> {
        let answer = Command::fpwr(self.station, register)
            .send_receive_slice(self.main, data)
            .await;
        answer.map(drop).map_err(fault)
    }
}

impl MailboxTransport for EthercrabMailbox<'_> {
    async fn write_message(&self, message: &[u8]) -> Result<bool, LinkFault> {
        let whole = Padded {
            message,
            length: usize::from(self.mailbox.receive_length),
        };
        taken(self.write(self.mailbox.receive_offset, whole).await)
    }

    async fn read_message(&self, message: &mut [u8]) -> Result<bool, LinkFault> {
        taken(self.read(self.mailbox.send_offset, message).await)
    }

    async fn status(&self) -> Result<MailboxStatus, LinkFault> {
        let mut registers = [0; 16];
        self.read(SYNC_MANAGER_0, &mut registers).await?;
        MailboxStatus::from_registers(&registers).ok_or(LinkFault::NotAnswered)
    }

    async fn request_repeat(&self, toggle: bool) -> Result<(), LinkFault> {
        let activate = 0x01 | u8::from(toggle) << 1;
        self.write(SYNC_MANAGER_1_ACTIVATE, [activate]).await
    }
}

/// A message as long as its mailbox: only a write of the last byte hands the mailbox over to the device.
struct Padded<'a> {
    message: &'a [u8],
    length: usize,
}

impl EtherCrabWireWrite for Padded<'_> {
    fn pack_to_slice_unchecked<'buf>(&self, buf: &'buf mut [u8]) -> &'buf [u8] {
        let whole = buf.get_mut(..self.length).unwrap_or_default();
        let (message, rest) = whole.split_at_mut(self.message.len().min(whole.len()));
        for (to, from) in message.iter_mut().zip(self.message) {
            *to = *from;
        }
        rest.fill(0);
        whole
    }

    fn packed_len(&self) -> usize {
        self.length
    }
}

fn taken(answer: Result<(), LinkFault>) -> Result<bool, LinkFault> {
    match answer {
        Ok(()) => Ok(true),
        Err(LinkFault::NotAnswered) => Ok(false),
        Err(fault) => Err(fault),
    }
}

fn fault(error: Error) -> LinkFault {
    match error {
        Error::WorkingCounter { .. } => LinkFault::NotAnswered,
        // The bus loop ends a request that it has given up as undecodable.
        Error::Timeout(_) | Error::Pdu(PduError::Decode) => LinkFault::Lost,
        Error::Pdu(PduError::SwapState) => LinkFault::Busy,
        error => LinkFault::Refused(LinkRefusal::new(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mailbox_state_is_read_from_the_sync_managers_registers() {
        // A real AKD's mailboxes (control 26h and 22h), a message waiting, a repeat asked for and done.
        let registers = [
            0x00, 0x18, 0x00, 0x04, 0x26, 0x00, 0x01, 0x00, 0x00, 0x1C, 0x00, 0x04, 0x22, 0x08,
            0x03, 0x02,
        ];
        assert_eq!(
            MailboxStatus::from_registers(&registers),
            Some(MailboxStatus {
                request_pending: false,
                message_waiting: true,
                repeat_requested: true,
                repeat_done: true
            })
        );
        for length in 0..16 {
            assert_eq!(MailboxStatus::from_registers(&registers[..length]), None);
        }
    }
}

//! The EtherCAT mailbox: header, counter, error replies, and what a message that was read contains
//! (ETG.1000.4, mailbox; ETG.1000.6, CoE header). The parser allocates nothing: what it gives points into the message.

use alloc::vec::Vec;
use core::fmt;

use super::emergency::Emergency;

/// Bytes of the mailbox header.
pub const HEADER_LENGTH: usize = 6;
/// Bytes of the CoE header.
pub const COE_HEADER_LENGTH: usize = 2;
/// The shortest message that can carry an SDO: mailbox header, CoE header, eight bytes of SDO.
pub const SHORTEST_MAILBOX: usize = HEADER_LENGTH + COE_HEADER_LENGTH + 8;

/// The header in front of every message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// Bytes behind the header.
    pub length: u16,
    /// The station address of the message's source; 0 in messages of the master.
    pub address: u16,
    /// Channel (bits 0–5) and priority (bits 6–7), both 0 in practice.
    pub channel: u8,
    /// The protocol of the bytes behind the header.
    pub protocol: Protocol,
    /// 1 to 7; 0 from a device that does not count.
    pub counter: u8,
}

impl Header {
    /// The header of a CoE message of the master.
    #[must_use]
    pub const fn coe(length: u16, counter: Counter) -> Self {
        Self {
            length,
            address: 0,
            channel: 0,
            protocol: Protocol::Coe,
            counter: counter.0,
        }
    }

    /// The header and the bytes that its length covers; what lies behind them in the mailbox is left out.
    ///
    /// # Errors
    /// [`CutMessage`] if `message` is shorter than the header or than the header says.
    pub fn parse(message: &[u8]) -> Result<(Self, &[u8]), CutMessage> {
        let &[l0, l1, a0, a1, channel, kind, ref rest @ ..] = message else {
            return Err(CutMessage {
                needed: HEADER_LENGTH,
                got: message.len(),
            });
        };
        let length = u16::from_le_bytes([l0, l1]);
        let payload = rest.get(..usize::from(length)).ok_or(CutMessage {
            needed: HEADER_LENGTH + usize::from(length),
            got: message.len(),
        })?;
        let header = Self {
            length,
            address: u16::from_le_bytes([a0, a1]),
            channel,
            protocol: Protocol::from_bits(kind & 0x0F),
            counter: kind >> 4 & 0x07,
        };
        Ok((header, payload))
    }

    /// The header's bytes.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; HEADER_LENGTH] {
        let [l0, l1] = self.length.to_le_bytes();
        let [a0, a1] = self.address.to_le_bytes();
        let kind = self.protocol.bits() | (self.counter & 0x07) << 4;
        [l0, l1, a0, a1, self.channel, kind]
    }
}

/// The protocol of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// The device refuses a message.
    Error,
    /// ADS over EtherCAT.
    Aoe,
    /// Ethernet over EtherCAT.
    Eoe,
    /// CANopen over EtherCAT.
    Coe,
    /// File access over EtherCAT.
    Foe,
    /// Servo profile over EtherCAT.
    Soe,
    /// The vendor's own.
    Voe,
    /// A value that the standard reserves.
    Unknown(u8),
}

impl Protocol {
    const fn from_bits(bits: u8) -> Self {
        match bits {
            0 => Self::Error,
            1 => Self::Aoe,
            2 => Self::Eoe,
            3 => Self::Coe,
            4 => Self::Foe,
            5 => Self::Soe,
            0xF => Self::Voe,
            other => Self::Unknown(other),
        }
    }

    const fn bits(self) -> u8 {
        match self {
            Self::Error => 0,
            Self::Aoe => 1,
            Self::Eoe => 2,
            Self::Coe => 3,
            Self::Foe => 4,
            Self::Soe => 5,
            Self::Voe => 0xF,
            Self::Unknown(bits) => bits & 0x0F,
        }
    }
}

/// The counter of a session's messages: 1 to 7 and round again, never 0.
///
/// A device drops a message whose counter is that of the message before: that makes it safe to send a message again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counter(u8);

impl Counter {
    /// The first counter of a session.
    pub const FIRST: Self = Self(1);

    /// The counter of the next message.
    #[must_use]
    pub const fn next(self) -> Self {
        if self.0 >= 7 {
            Self(1)
        } else {
            Self(self.0 + 1)
        }
    }

    /// The number, 1 to 7.
    #[must_use]
    pub const fn get(self) -> u8 {
        self.0
    }
}

/// What a message that was read from a device contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MailboxMessage<'a> {
    /// The SDO server's answer: the bytes behind the CoE header.
    SdoReply(&'a [u8]),
    /// An emergency, which answers nothing.
    Emergency(Emergency),
    /// The device refused a message for its form.
    Error(MailboxError),
    /// SDO information: the bytes behind the CoE header.
    SdoInformation(&'a [u8]),
    /// Something that this library does not use: the protocol and, for CoE, the service.
    Other(Protocol, u8),
}

impl<'a> MailboxMessage<'a> {
    /// Reads what the bytes from a mailbox contain.
    ///
    /// # Errors
    /// [`CutMessage`] if the message ends before its headers do, or an emergency or error reply is too short.
    pub fn parse(message: &'a [u8]) -> Result<(Header, Self), CutMessage> {
        let (header, payload) = Header::parse(message)?;
        let content = match header.protocol {
            Protocol::Error => Self::Error(MailboxError::parse(payload)?),
            Protocol::Coe => {
                let &[h0, h1, ref rest @ ..] = payload else {
                    return Err(CutMessage {
                        needed: COE_HEADER_LENGTH,
                        got: payload.len(),
                    });
                };
                match u16::from_le_bytes([h0, h1]) >> 12 {
                    1 => Self::Emergency(Emergency::parse(rest)?),
                    3 => Self::SdoReply(rest),
                    // An abort travels as an SDO request in both directions (ETG.1000.6, abort SDO transfer);
                    // some devices send it as a response.
                    2 if rest.first().is_some_and(|command| command >> 5 == 4) => {
                        Self::SdoReply(rest)
                    }
                    8 => Self::SdoInformation(rest),
                    service => Self::Other(Protocol::Coe, service as u8),
                }
            }
            other => Self::Other(other, 0),
        };
        Ok((header, content))
    }
}

/// Makes of `message` a whole message of the master, with the SDO request that `append` appends.
pub fn sdo_message(message: &mut Vec<u8>, counter: Counter, append: impl FnOnce(&mut Vec<u8>)) {
    coe_message(message, counter, 2, append);
}

/// Makes of `message` a whole message of the master, with the SDO information request that `append` appends.
pub fn information_message(
    message: &mut Vec<u8>,
    counter: Counter,
    append: impl FnOnce(&mut Vec<u8>),
) {
    coe_message(message, counter, 8, append);
}

fn coe_message(
    message: &mut Vec<u8>,
    counter: Counter,
    service: u16,
    append: impl FnOnce(&mut Vec<u8>),
) {
    message.clear();
    message.extend_from_slice(&[0; HEADER_LENGTH]);
    message.extend_from_slice(&(service << 12).to_le_bytes());
    append(message);
    let length = u16::try_from(message.len().saturating_sub(HEADER_LENGTH)).unwrap_or(u16::MAX);
    for (to, from) in message
        .iter_mut()
        .zip(Header::coe(length, counter).to_bytes())
    {
        *to = from;
    }
}

/// Why a device refused a message for its form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct MailboxError(pub u16);

impl MailboxError {
    fn parse(payload: &[u8]) -> Result<Self, CutMessage> {
        match *payload {
            [_, _, c0, c1, ..] => Ok(Self(u16::from_le_bytes([c0, c1]))),
            _ => Err(CutMessage {
                needed: 4,
                got: payload.len(),
            }),
        }
    }

    /// Whether the device does not know what the message asks for, whatever its content.
    #[must_use]
    pub const fn is_about_the_service(self) -> bool {
        matches!(self.0, 2 | 4 | 5)
    }

    /// The meaning as text.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self.0 {
            1 => "syntax of the mailbox header is wrong",
            2 => "mailbox protocol is not supported",
            3 => "channel is invalid",
            4 => "service is not supported",
            5 => "protocol header is invalid",
            6 => "message is too short",
            7 => "device has no memory left",
            8 => "length is inconsistent",
            _ => "unknown reason",
        }
    }
}

impl fmt::Display for MailboxError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:04X}h)", self.text(), self.0)
    }
}

/// A message that ends before it should.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("message cut: expected at least {needed} bytes, got {got}")]
pub struct CutMessage {
    /// Bytes that there should be at least.
    pub needed: usize,
    /// Bytes that there are.
    pub got: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    // Public ethercrab repository, dumps/soem-sdinfo-akd.pcapng: SOEM reads 1C00h:3 of a real AKD.
    const REQUEST: [u8; 16] = [
        0x0A, 0, 0, 0, 0, 0x23, 0x00, 0x20, 0x40, 0x00, 0x1C, 0x03, 0, 0, 0, 0,
    ];
    const REPLY: [u8; 16] = [
        0x0A, 0, 0, 0, 0, 0x23, 0x00, 0x30, 0x4F, 0x00, 0x1C, 0x03, 0x03, 0, 0, 0,
    ];
    // A simulated drive, recorded with SOEM: 5555h does not exist. The abort is an SDO request.
    const ABORT: [u8; 16] = [
        0x0A, 0, 0, 0, 0, 0x73, 0x00, 0x20, 0x80, 0x55, 0x55, 0, 0, 0, 0x02, 0x06,
    ];
    const EMERGENCY: [u8; 16] = [
        0x0A, 0, 0, 0, 0, 0x13, 0x00, 0x10, 0x11, 0x86, 0x21, 1, 2, 3, 4, 5,
    ];
    const ERROR: [u8; 10] = [4, 0, 0, 0, 0, 0x10, 1, 0, 5, 0];

    #[test]
    fn a_request_is_written_as_soem_writes_it_to_a_real_akd() {
        let counter = Counter::FIRST.next();
        let mut message = alloc::vec![0xEE; 40];
        sdo_message(&mut message, counter, |message| {
            message.extend_from_slice(&REQUEST[8..]);
        });
        assert_eq!(message, REQUEST);
    }

    #[test]
    fn a_reply_of_a_real_akd_is_an_sdo_reply_with_the_requests_counter() {
        let (header, message) = MailboxMessage::parse(&REPLY).unwrap();
        assert_eq!(header.counter, 2);
        assert_eq!(message, MailboxMessage::SdoReply(&REPLY[8..]));
    }

    #[test]
    fn an_abort_is_an_answer_as_request_and_as_response() {
        assert_eq!(
            MailboxMessage::parse(&ABORT).unwrap().1,
            MailboxMessage::SdoReply(&ABORT[8..])
        );
        let mut response = ABORT;
        response[7] = 0x30;
        assert_eq!(
            MailboxMessage::parse(&response).unwrap().1,
            MailboxMessage::SdoReply(&ABORT[8..])
        );
    }

    #[test]
    fn a_request_that_comes_from_a_device_answers_nothing() {
        assert_eq!(
            MailboxMessage::parse(&REQUEST).unwrap().1,
            MailboxMessage::Other(Protocol::Coe, 2)
        );
    }

    #[test]
    fn bytes_behind_the_message_are_no_part_of_it() {
        let mut mailbox = [0xEE; 64];
        mailbox[..16].copy_from_slice(&REPLY);
        assert_eq!(
            MailboxMessage::parse(&mailbox).unwrap().1,
            MailboxMessage::SdoReply(&REPLY[8..])
        );
    }

    #[test]
    fn emergencies_and_mailbox_errors_are_told_apart_from_replies() {
        let expected = Emergency {
            code: 0x8611,
            register: 0x21,
            data: [1, 2, 3, 4, 5],
        };
        assert_eq!(
            MailboxMessage::parse(&EMERGENCY).unwrap().1,
            MailboxMessage::Emergency(expected)
        );
        let (_, error) = MailboxMessage::parse(&ERROR).unwrap();
        assert_eq!(error, MailboxMessage::Error(MailboxError(5)));
    }

    #[test]
    fn every_truncation_is_an_error() {
        for whole in [&REPLY[..], &EMERGENCY, &ERROR] {
            for length in 0..whole.len() {
                assert!(
                    MailboxMessage::parse(&whole[..length]).is_err(),
                    "{length} bytes"
                );
            }
        }
    }

    #[test]
    fn a_message_that_claims_less_than_its_content_needs_is_cut() {
        let mut short = EMERGENCY;
        for length in 0..10 {
            short[0] = length;
            assert!(
                MailboxMessage::parse(&short).is_err(),
                "{length} bytes claimed"
            );
        }
    }

    #[test]
    fn the_counter_runs_from_one_to_seven_and_never_shows_zero() {
        let mut counter = Counter::FIRST;
        let mut seen = Vec::new();
        for _ in 0..9 {
            seen.push(counter.get());
            counter = counter.next();
        }
        assert_eq!(seen, [1, 2, 3, 4, 5, 6, 7, 1, 2]);
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_make_the_parser_panic(bytes: Vec<u8>) {
            let _ = MailboxMessage::parse(&bytes).map(|(header, _)| header.to_bytes());
        }

        #[test]
        fn a_header_survives_its_bytes(length in 0u16..40, address: u16, channel: u8, kind in 0u8..0x80) {
            let mut message = [0u8; 46];
            message[..2].copy_from_slice(&length.to_le_bytes());
            message[2..4].copy_from_slice(&address.to_le_bytes());
            message[4] = channel;
            message[5] = kind;
            let (header, payload) = Header::parse(&message).unwrap();
            proptest::prop_assert_eq!(&header.to_bytes()[..], &message[..6]);
            proptest::prop_assert_eq!(payload.len(), usize::from(length));
        }
    }
}

//! Whole messages: mailbox header, CoE header, emergencies, error replies.

use servocrab::coe::Emergency;
use servocrab::coe::mailbox::{HEADER_LENGTH, MailboxMessage};

use super::memory::within;

/// Reads one message. The parser keeps nothing: what it gives points into the message.
pub fn run(data: &[u8]) {
    let parsed = within(0, || MailboxMessage::parse(data));
    match parsed {
        Ok((header, content)) => {
            assert!(data.len() >= HEADER_LENGTH + usize::from(header.length));
            // Bit 15, which is reserved, is not kept.
            let mut head = [0; HEADER_LENGTH];
            head.copy_from_slice(&data[..HEADER_LENGTH]);
            head[5] &= 0x7F;
            assert_eq!(header.to_bytes(), head);
            within(256, || match content {
                MailboxMessage::Emergency(emergency) => emergency.to_string(),
                MailboxMessage::Error(error) => error.to_string(),
                _ => String::new(),
            });
        }
        Err(cut) => assert!(cut.needed > cut.got && cut.got <= data.len()),
    }
    let emergency = within(0, || Emergency::parse(data));
    assert_eq!(emergency.is_ok(), data.len() >= 8);
}

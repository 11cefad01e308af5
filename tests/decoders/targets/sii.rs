//! The image of a device's EEPROM.

use servocrab::coe::MailboxSettings;
use servocrab::sii::Sii;

use super::memory::within;

/// Reads one image. It holds at most 32 KiB and 16 times the image: a string or a PDO may be there without a byte of content.
pub fn run(data: &[u8]) {
    let Ok(sii) = within(32 * 1024 + 16 * data.len(), || Sii::parse(data)) else {
        return;
    };
    let _ = sii.name();
    assert!(sii.strings.len() <= 255);
    for number in 0..=u8::MAX {
        assert_eq!(
            sii.string(number).is_some(),
            (1..=sii.strings.len()).contains(&usize::from(number))
        );
    }
    if let Some(mailbox) = &sii.mailbox {
        let _ = MailboxSettings::of(&sii, mailbox);
    }
}

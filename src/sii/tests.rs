//! Bytes named AKD are from the public ethercrab repository, dumps/eeprom/akd.hex (a real Kollmorgen AKD).

use super::*;
use alloc::vec;

/// The first 80h bytes of the AKD's image: words up to the first category.
fn akd_header() -> Vec<u8> {
    let mut image = vec![0; 0x80];
    image[0x10..0x20].copy_from_slice(&[
        0x6A, 0, 0, 0, 0x44, 0x4B, 0x41, 0, 2, 0, 0, 0, 0x93, 0, 0x83, 0x99,
    ]);
    let mailbox = [0x00, 0x18, 0x00, 0x04, 0x00, 0x1C, 0x00, 0x04];
    image[0x28..0x30].copy_from_slice(&mailbox);
    image[0x30..0x38].copy_from_slice(&mailbox);
    image[0x38] = 0x0E;
    image
}

/// Categories of the AKD: its vendor's 0801h, 30, 40, 41, the first PDOs of 50 and 51, 60. The strings are shorter.
fn akd_image() -> Vec<u8> {
    let mut image = akd_header();
    image.extend([0x01, 0x08, 0x06, 0x00]);
    image.extend(*b"01-20-00-003");
    image.extend([0x0A, 0x00, 0x09, 0x00, 0x04, 0x03]);
    image.extend(*b"AKD\x05Drive\x01s\x03DRV\0");
    image.extend([
        0x1E, 0, 0x10, 0, 2, 5, 1, 4, 1, 0x0D, 1, 3, 0, 1, 0, 5, 0, 0, 3, 0, 0x11, 0, 0, 0, 0, 0,
        0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    ]);
    image.extend([0x28, 0, 2, 0, 1, 2, 3, 0xFF]);
    image.extend([0x29, 0, 0x10, 0]);
    image.extend([0x00, 0x18, 0x00, 0x04, 0x26, 0, 1, 1]);
    image.extend([0x00, 0x1C, 0x00, 0x04, 0x22, 0, 1, 2]);
    image.extend([0x00, 0x11, 0, 0, 0x24, 0, 1, 3]);
    image.extend([0x40, 0x11, 0, 0, 0x20, 0, 1, 4]);
    image.extend([0x32, 0, 0x08, 0]);
    image.extend([0x00, 0x1A, 1, 0xFF, 0, 8, 0, 0]);
    image.extend([0x41, 0x60, 0, 9, 6, 0x10, 0, 0]);
    image.extend([0x33, 0, 0x0C, 0]);
    image.extend([0x01, 0x17, 2, 2, 0, 0x17, 0x10, 0]);
    image.extend([0xC1, 0x60, 1, 0x19, 4, 0x20, 0, 0]);
    image.extend([0x40, 0x60, 0, 0x18, 6, 0x10, 0, 0]);
    image.extend([0x3C, 0, 0x0C, 0]);
    image.extend([0; 14]);
    image.extend([0, 3, 1, 0, 6, 0, 0, 0, 0, 0]);
    image.extend([0xFF, 0xFF]);
    image
}

#[test]
fn the_image_of_a_real_akd_is_understood() {
    let sii = Sii::parse(&akd_image()).unwrap();
    assert_eq!(
        sii.identity,
        Identity {
            vendor: 0x6A,
            product: 0x0041_4B44,
            revision: 2,
            serial: 0x9983_0093
        }
    );
    let mailbox = sii.mailbox.unwrap();
    assert_eq!(
        (mailbox.receive_offset, mailbox.receive_length),
        (0x1800, 1024)
    );
    assert_eq!((mailbox.send_offset, mailbox.send_length), (0x1C00, 1024));
    assert!(mailbox.protocols.coe());
    assert_eq!(sii.name(), Some("DRV"));
    let coe = sii.general.unwrap().coe;
    assert!(coe.sdo() && coe.pdo_assignment() && coe.pdo_configuration());
    assert!(!coe.sdo_information() && !coe.complete_access());
    assert_eq!(
        sii.fmmu_usage,
        [
            FmmuUsage::Outputs,
            FmmuUsage::Inputs,
            FmmuUsage::MailboxStatus,
            FmmuUsage::Unused
        ]
    );
    assert_eq!(sii.clock_modes[0].assign_activate, 0x0300);
    assert_eq!(sii.clock_modes[0].name, 6);
}

#[test]
fn the_akds_output_sync_manager_has_no_watchdog_trigger() {
    let sii = Sii::parse(&akd_image()).unwrap();
    let usages: Vec<_> = sii.sync_managers.iter().map(|sm| sm.usage).collect();
    assert_eq!(
        usages,
        [
            SyncManagerUsage::MailboxOut,
            SyncManagerUsage::MailboxIn,
            SyncManagerUsage::Outputs,
            SyncManagerUsage::Inputs
        ]
    );
    let outputs = sii.sync_managers[2];
    assert_eq!((outputs.start, outputs.control), (0x1100, 0x24));
    assert!(!outputs.triggers_watchdog());
}

#[test]
fn the_akds_pdos_are_read_with_their_entries() {
    let sii = Sii::parse(&akd_image()).unwrap();
    assert_eq!(sii.tx_pdos[0].index, 0x1A00);
    assert_eq!(sii.tx_pdos[0].sync_manager, None);
    assert_eq!(sii.rx_pdos[0].sync_manager, Some(2));
    let entry = |index, subindex, name, bits| PdoEntry {
        index,
        subindex,
        name,
        bits,
    };
    assert_eq!(
        sii.rx_pdos[0].entries,
        [entry(0x60C1, 1, 0x19, 32), entry(0x6040, 0, 0x18, 16)]
    );
}

#[test]
fn a_device_without_mailbox_says_so() {
    let mut image = vec![0; 0x80];
    image.extend([0xFF, 0xFF]);
    assert_eq!(Sii::parse(&image).unwrap().mailbox, None);
}

#[test]
fn every_truncation_is_an_error() {
    let image = akd_image();
    for length in 0..image.len() {
        assert!(Sii::parse(&image[..length]).is_err(), "{length} bytes");
    }
}

proptest::proptest! {
    #[test]
    fn no_categories_make_the_parser_panic(tail: Vec<u8>, category in proptest::sample::select(vec![10u8, 30, 40, 41, 50, 51, 60, 70])) {
        let mut image = akd_header();
        image.extend([category, 0, (tail.len() / 2) as u8, 0]);
        image.extend(&tail);
        let whole = Sii::parse(&image);
        image.extend([0xFF, 0xFF]);
        let _ = (whole, Sii::parse(&image));
    }
}

#[test]
fn a_text_of_a_device_holds_no_character_that_a_terminal_obeys() {
    let text = text_of_device(b"Drive\x1b[2J\r\nOK\xFF");
    assert_eq!(text, "Drive[2JOK\u{FFFD}");
}

//! A real AKD's EEPROM through the library's parser, and beside the simulated AKD2G's.

use std::collections::BTreeSet;

use servocrab::sii::{
    ClockMode, FmmuUsage, Identity, Pdo, PdoEntry, Sii, SyncManager, SyncManagerUsage,
};
use servocrab_sim::personality;

use super::vectors::akd_eeprom;
use crate::datagrams::Wire;

const GENERAL: u16 = 30;
const FMMU: u16 = 40;
const SYNC_MANAGERS: u16 = 41;
const TX_PDOS: u16 = 50;
const RX_PDOS: u16 = 51;
const CLOCK: u16 = 60;

#[test]
fn a_real_akds_eeprom_says_who_it_is() {
    let akd = Sii::parse(&akd_eeprom()).unwrap();
    assert_eq!(
        akd.identity,
        Identity {
            vendor: 0x6A,
            product: 0x0041_4B44,
            revision: 2,
            serial: 0x9983_0093,
        }
    );
    assert_eq!(akd.name(), Some("AKD EtherCAT Drive (CoE)"));
    let general = akd.general.unwrap();
    assert_eq!(akd.string(general.group), Some("Drive"));
    assert_eq!(akd.string(general.order), Some("AKD"));
    assert_eq!(akd.strings.len(), 33);
    assert_eq!(akd.string(33), Some("AOUT.VALUE write"));
    assert_eq!(akd.string(34), None);
}

#[test]
fn a_real_akds_eeprom_says_what_its_mailbox_can_do() {
    let akd = Sii::parse(&akd_eeprom()).unwrap();
    let mailbox = akd.mailbox.unwrap();
    assert_eq!(
        (mailbox.receive_offset, mailbox.receive_length),
        (0x1800, 1024)
    );
    assert_eq!((mailbox.send_offset, mailbox.send_length), (0x1C00, 1024));
    assert_eq!(mailbox.protocols.0, 0x000E);
    let coe = akd.general.unwrap().coe;
    assert_eq!(coe.0, 0x0D);
    assert!(coe.sdo() && coe.pdo_assignment() && coe.pdo_configuration());
    assert!(!coe.sdo_information() && !coe.complete_access());
}

#[test]
fn a_real_akds_eeprom_says_where_process_data_lies() {
    let akd = Sii::parse(&akd_eeprom()).unwrap();
    assert_eq!(
        akd.fmmu_usage,
        [
            FmmuUsage::Outputs,
            FmmuUsage::Inputs,
            FmmuUsage::MailboxStatus,
            FmmuUsage::Unused
        ]
    );
    let sync_manager = |start, length, control, usage| SyncManager {
        start,
        length,
        control,
        enable: 1,
        usage,
    };
    assert_eq!(
        akd.sync_managers,
        [
            sync_manager(0x1800, 1024, 0x26, SyncManagerUsage::MailboxOut),
            sync_manager(0x1C00, 1024, 0x22, SyncManagerUsage::MailboxIn),
            sync_manager(0x1100, 0, 0x24, SyncManagerUsage::Outputs),
            sync_manager(0x1140, 0, 0x20, SyncManagerUsage::Inputs),
        ]
    );
    // Why the bring-up switches the watchdog on by itself.
    assert!(!akd.sync_managers[2].triggers_watchdog());
    let clock_mode = |assign_activate, name| ClockMode {
        sync0_cycle_ns: 0,
        sync0_shift_ns: 0,
        assign_activate,
        name,
    };
    assert_eq!(akd.clock_modes, [clock_mode(0x0300, 6), clock_mode(0, 7)]);
    assert_eq!(akd.string(6), Some("DcSync"));
    assert_eq!(akd.string(7), Some("DcOff"));
}

#[test]
fn a_real_akds_eeprom_lists_its_pdos_and_assigns_two_that_coe_does_not() {
    let akd = Sii::parse(&akd_eeprom()).unwrap();
    let indices = |pdos: &[Pdo]| pdos.iter().map(|pdo| pdo.index).collect::<Vec<_>>();
    assert_eq!(
        indices(&akd.tx_pdos),
        [
            0x1A00, 0x1A01, 0x1A02, 0x1A03, 0x1B01, 0x1B20, 0x1B21, 0x1B22, 0x1B23, 0x1B24, 0x1B25,
            0x1B26
        ]
    );
    assert_eq!(
        indices(&akd.rx_pdos),
        [
            0x1600, 0x1601, 0x1602, 0x1603, 0x1701, 0x1702, 0x1720, 0x1721, 0x1722, 0x1723, 0x1724,
            0x1725
        ]
    );
    // A preset for Profile Position of which the statusword, 16 bits, comes second.
    let preset = &akd.tx_pdos[9];
    let entry = |entry: &PdoEntry| (entry.index, entry.subindex, entry.bits);
    let entries: Vec<_> = preset.entries.iter().map(entry).collect();
    assert_eq!(entries, [(0x6064, 0, 32), (0x6041, 0, 16)]);
    let names = preset.entries.iter().map(|entry| akd.string(entry.name));
    assert_eq!(
        names.collect::<Vec<_>>(),
        [Some("Position actual value"), Some("Statusword")]
    );
    assert_eq!((preset.flags, preset.name), (0x0010, 8));
    assert_eq!(akd.string(preset.name), Some("Inputs"));
    assert_eq!(
        entry(&akd.rx_pdos[10].entries[0]),
        (0x607A, 0, 32),
        "target position"
    );
    // By CoE this drive assigns 1600h to 1603h and 1A00h to 1A03h (akd_sdo_mails.txt): the SII is no mapping (pitfall 37).
    let assigned = |pdos: &[Pdo]| {
        pdos.iter()
            .filter_map(|pdo| Some((pdo.index, pdo.sync_manager?)))
            .collect::<Vec<_>>()
    };
    assert_eq!(assigned(&akd.rx_pdos), [(0x1701, 2)]);
    assert_eq!(assigned(&akd.tx_pdos), [(0x1B01, 3)]);
}

#[test]
fn a_real_eeprom_cut_anywhere_before_its_end_mark_is_an_error() {
    let image = akd_eeprom();
    for length in 0..0x696 {
        assert!(Sii::parse(&image[..length]).is_err(), "{length} bytes");
    }
    assert!(Sii::parse(&image[..0x696]).is_ok());
}

/// The simulated drive's EEPROM, read through its registers, as far as the end mark.
fn simulated_eeprom() -> Vec<u8> {
    Wire::new(personality::akd2g()).sii_image()
}

/// Number and content of each category, by hand: the library's parser is under test too.
fn categories(image: &[u8]) -> Vec<(u16, Vec<u8>)> {
    let word = |at: usize| u16::from_le_bytes([image[at], image[at + 1]]);
    let mut at = 0x80;
    let mut found = Vec::new();
    while word(at) != 0xFFFF {
        let end = at + 4 + 2 * usize::from(word(at + 2));
        found.push((word(at), image[at + 4..end].to_vec()));
        at = end;
    }
    found
}

fn content(image: &[u8], category: u16) -> Vec<u8> {
    let found = categories(image);
    let (_, content) = found.iter().find(|(kind, _)| *kind == category).unwrap();
    content.clone()
}

#[test]
fn the_simulated_drive_has_a_real_ones_categories_in_its_order() {
    let kinds = |image: &[u8]| {
        let found = categories(image);
        found.iter().map(|(kind, _)| *kind).collect::<Vec<_>>()
    };
    let real = kinds(&akd_eeprom());
    assert_eq!(
        real,
        [
            0x0800,
            0x0801,
            10,
            GENERAL,
            FMMU,
            SYNC_MANAGERS,
            43,
            TX_PDOS,
            RX_PDOS,
            CLOCK
        ]
    );
    assert_eq!(kinds(&simulated_eeprom()), real);
}

#[test]
fn the_simulated_drives_header_has_a_real_ones_fields() {
    let (real, simulated) = (akd_eeprom(), simulated_eeprom());
    // What each range of the first 80h bytes is; the others are equal.
    let different = [
        (0x14..0x18, "product code: another drive"),
        (0x18..0x1C, "revision: another drive"),
        (0x1C..0x20, "serial number: another drive"),
        (0x28..0x30, "bootstrap mailbox: no BOOT"),
        (0x7C..0x7D, "size of the EEPROM: 32 kbit, not 16"),
    ];
    for (at, (r, s)) in real.iter().zip(&simulated).take(0x80).enumerate() {
        let listed = different.iter().any(|(range, _)| range.contains(&at));
        assert!(r == s || listed, "byte {at:02X}h: {r:02X}h and {s:02X}h");
    }
    for (range, what) in different {
        assert_ne!(real[range.clone()], simulated[range], "{what}");
    }
}

#[test]
fn the_simulated_drives_general_fmmu_sync_manager_and_clock_categories_have_a_real_ones_fields() {
    // Category, byte, what lies there in the real one and in the simulated one, and why that may differ.
    let different = [
        (GENERAL, 0x01, 5, 0, "number of the image's name: no image"),
        (GENERAL, 0x03, 4, 3, "number of the name's string"),
        (GENERAL, 0x04, 1, 0, "reserved"),
        (GENERAL, 0x09, 1, 2, "one axis, two axes"),
        (GENERAL, 0x0E, 3, 0, "the group's other string"),
        (SYNC_MANAGERS, 18, 0, 38, "the length of what is assigned"),
        (SYNC_MANAGERS, 24, 0x40, 0x00, "inputs at 1140h, 1200h"),
        (SYNC_MANAGERS, 25, 0x11, 0x12, "inputs at 1140h, 1200h"),
        (SYNC_MANAGERS, 26, 0, 22, "the length of what is assigned"),
        (CLOCK, 18, 6, 4, "number of the name's string"),
        (CLOCK, 42, 7, 5, "number of the name's string"),
    ];
    let (real, simulated) = (akd_eeprom(), simulated_eeprom());
    let mut found = BTreeSet::new();
    for category in [GENERAL, FMMU, SYNC_MANAGERS, CLOCK] {
        let (real, simulated) = (content(&real, category), content(&simulated, category));
        assert_eq!(real.len(), simulated.len(), "length of category {category}");
        for (at, (r, s)) in real.into_iter().zip(simulated).enumerate() {
            if r != s {
                found.insert((category, at, r, s));
            }
        }
    }
    let listed: BTreeSet<_> = different
        .into_iter()
        .map(|(category, at, real, simulated, _)| (category, at, real, simulated))
        .collect();
    assert_eq!(found, listed);
}

/// The PDOs of category 50 or 51: head of eight bytes, entries of eight bytes.
fn raw_pdos(content: &[u8]) -> Vec<(Vec<u8>, Vec<Vec<u8>>)> {
    let mut pdos = Vec::new();
    let mut rest = content;
    while !rest.is_empty() {
        let (head, behind) = rest.split_at(8);
        let (entries, next) = behind.split_at(8 * usize::from(head[2]));
        pdos.push((
            head.to_vec(),
            entries.chunks(8).map(<[u8]>::to_vec).collect(),
        ));
        rest = next;
    }
    pdos
}

#[test]
fn the_simulated_drives_pdo_entries_have_a_real_ones_types_and_lengths() {
    // Object, type, bits, flags. The names are left out: the simulated drive names no entries.
    let entries = |image: &[u8]| {
        let both = [content(image, TX_PDOS), content(image, RX_PDOS)];
        let pdos = both.iter().flat_map(|content| raw_pdos(content));
        pdos.flat_map(|(_, entries)| entries)
            .map(|entry| {
                let object = (u16::from_le_bytes([entry[0], entry[1]]), entry[2]);
                (object, (entry[4], entry[5], entry[6], entry[7]))
            })
            .collect::<BTreeSet<_>>()
    };
    let real = entries(&akd_eeprom());
    let mut shared = Vec::new();
    for (object, form) in entries(&simulated_eeprom()) {
        if real.iter().any(|(known, _)| *known == object) {
            assert!(real.contains(&(object, form)), "{object:X?} {form:?}");
            shared.push(object.0);
        }
    }
    // The others of the default mapping are in no PDO of the AKD's SII.
    assert_eq!(shared, [0x6040, 0x6041, 0x6064, 0x606C, 0x607A]);
}

#[test]
fn the_simulated_drives_pdo_heads_differ_from_a_real_ones_as_listed() {
    let heads = |image: &[u8], category| {
        let pdos = raw_pdos(&content(image, category));
        pdos.into_iter().map(|(head, _)| head).collect::<Vec<_>>()
    };
    let (real, simulated) = (akd_eeprom(), simulated_eeprom());
    // Index, entries, sync manager, clock, name, flags. The real one assigns a preset, and marks presets as fixed (bit 4).
    for (category, first, sync_manager) in [(TX_PDOS, 0x1A00u16, 3), (RX_PDOS, 0x1600, 2)] {
        let (real, simulated) = (heads(&real, category), heads(&simulated, category));
        assert_eq!(real[0][..2], first.to_le_bytes());
        assert_eq!(simulated[0][..2], first.to_le_bytes());
        for head in &real {
            assert!([0xFF, sync_manager].contains(&head[3]), "{head:?}");
            assert!(head[4] == 0 && head[5] != 0, "{head:?}");
            assert!(matches!(head[6..], [0 | 0x10, 0]), "{head:?}");
        }
        for head in &simulated {
            // Both axes' PDOs are assigned, in SII as in CoE; without a name; flexible.
            assert_eq!(head[3..], [sync_manager, 0, 0, 0, 0]);
        }
    }
}

#[test]
fn the_library_reads_the_same_from_both() {
    let real = Sii::parse(&akd_eeprom()).unwrap();
    let simulated = Sii::parse(&simulated_eeprom()).unwrap();
    assert_eq!(simulated.mailbox, real.mailbox);
    assert_eq!(simulated.fmmu_usage, real.fmmu_usage);
    assert_eq!(simulated.general.unwrap().coe, real.general.unwrap().coe);
    let form = |sii: &Sii| {
        let managers = sii.sync_managers.iter();
        managers
            .map(|sm| (sm.control, sm.enable, sm.usage))
            .collect::<Vec<_>>()
    };
    assert_eq!(form(&simulated), form(&real));
    let modes = |sii: &Sii| {
        let modes = sii.clock_modes.iter();
        modes
            .map(|mode| {
                (
                    sii.string(mode.name).map(str::to_owned),
                    mode.assign_activate,
                )
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(modes(&simulated), modes(&real));
}

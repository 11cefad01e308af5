//! What each drive says of its dictionary holds: every object and subindex is as the SDO information service describes it.

use servocrab_sim::personality::Servo;

use crate::information::{ask, list};
use crate::master::{Master, abort, request};

/// Bits of the access word (ETG.1000.6; SOEM lists a real Leadshine EL7 with the same).
const READ: u16 = 0x0007;
const WRITE: u16 = 0x0038;
const WRITE_PREOP: u16 = 0x0008;
const RX: u16 = 0x0040;
const TX: u16 = 0x0080;

const ALL: [fn() -> Servo; 5] = [
    Servo::akd2g,
    Servo::pp2010,
    Servo::ax2000,
    Servo::sigma7,
    Servo::generic,
];

/// Every drive with all services, in PREOP.
fn drives() -> impl Iterator<Item = Master> {
    ALL.into_iter().map(|drive| {
        let drive = drive().with_sdo_information().with_complete_access();
        let mut master = Master::of(drive.build());
        master.bring_to_preop();
        master
    })
}

/// One subindex as the drive describes it.
struct Entry {
    index: u16,
    subindex: u8,
    data_type: u16,
    bits: u16,
    access: u16,
}

/// All objects: index, object code and entries.
fn objects(master: &mut Master) -> Vec<(u16, u8, Vec<Entry>)> {
    list(master, 1)
        .1
        .into_iter()
        .map(|index| {
            let [low, high] = index.to_le_bytes();
            let object = ask(master, 3, &[low, high]);
            assert_eq!(object[2], 4, "{index:04X}h");
            assert!(object.len() > 12, "{index:04X}h has a name");
            let entries = (0..=object[10])
                .filter_map(|subindex| entry(master, index, subindex))
                .collect();
            let behind = ask(master, 5, &[low, high, object[10] + 1, 7]);
            assert_eq!(behind[2], 7, "{index:04X}h ends there");
            (index, object[11], entries)
        })
        .collect()
}

/// A subindex, unless it does not exist.
fn entry(master: &mut Master, index: u16, subindex: u8) -> Option<Entry> {
    let [low, high] = index.to_le_bytes();
    let told = ask(master, 5, &[low, high, subindex, 7]);
    if told[2] == 7 {
        assert_eq!(master.upload(index, subindex), Err(0x0609_0011));
        return None;
    }
    assert!(told.len() > 16, "{index:04X}h:{subindex} has a name");
    let word = |at| u16::from_le_bytes([told[at], told[at + 1]]);
    Some(Entry {
        index,
        subindex,
        data_type: word(10),
        bits: word(12),
        access: word(14),
    })
}

/// A download in one mail of any length that the mailbox takes.
fn write(master: &mut Master, index: u16, subindex: u8, value: &[u8]) -> Result<(), u32> {
    let mut data = (value.len() as u32).to_le_bytes().to_vec();
    data.extend(value);
    let reply = master.coe(&request(0x21, index, subindex, &data));
    if reply[2] == 0x80 {
        return Err(abort(&reply));
    }
    assert_eq!(reply[2], 0x60);
    Ok(())
}

#[test]
fn every_subindex_has_its_length_and_can_be_read_when_it_says_so() {
    for mut master in drives() {
        for (index, code, entries) in objects(&mut master) {
            assert!(!entries.is_empty(), "{index:04X}h");
            assert_eq!(code == 7, entries.len() == 1, "{index:04X}h");
            for entry in entries {
                let at = format!("{index:04X}h:{}", entry.subindex);
                match master.upload(index, entry.subindex) {
                    Ok(_) if entry.access & READ == 0 => panic!("{at} cannot be read"),
                    Ok(value) if entry.data_type == 9 => {
                        assert!(8 * value.len() <= entry.bits.into(), "{at}");
                    }
                    Ok(value) => assert_eq!(8 * value.len(), entry.bits.into(), "{at}"),
                    Err(code) if entry.access & READ == 0 => assert_eq!(code, 0x0601_0001, "{at}"),
                    // No error has happened yet.
                    Err(code) => assert_eq!((index, code), (0x1003, 0x0800_0024), "{at}"),
                }
            }
        }
    }
}

#[test]
fn every_subindex_can_be_written_when_it_says_so_and_else_not() {
    for mut master in drives() {
        for (index, _, entries) in objects(&mut master) {
            for Entry {
                subindex, access, ..
            } in entries
            {
                let at = format!("{index:04X}h:{subindex}");
                let Ok(value) = master.upload(index, subindex) else {
                    continue;
                };
                // 1010h and 1011h take their signatures alone.
                let value = match index {
                    0x1010 => b"save".to_vec(),
                    0x1011 => b"load".to_vec(),
                    _ => value,
                };
                let written = write(&mut master, index, subindex, &value);
                match access & WRITE {
                    0 => assert_eq!(written, Err(0x0601_0002), "{at}"),
                    // PDO lists: the one in use stays as it is, and elements are locked while they count.
                    WRITE_PREOP => assert!(
                        matches!(written, Ok(()) | Err(0x0601_0003 | 0x0800_0022)),
                        "{at}: {written:X?}"
                    ),
                    _ => assert_eq!(written, Ok(()), "{at}"),
                }
            }
        }
    }
}

#[test]
fn every_object_read_as_a_whole_is_the_sum_of_its_subindices() {
    for mut master in drives() {
        for (index, code, entries) in objects(&mut master) {
            let reply = master.coe(&request(0x50, index, 0, &[]));
            if code == 7 {
                assert_eq!(abort(&reply), 0x0601_0004, "{index:04X}h");
                continue;
            }
            let count = master.upload(index, 0).unwrap()[0];
            let mut expected = vec![count, 0];
            for entry in entries {
                if (1..=count).contains(&entry.subindex) {
                    let zeros = vec![0; usize::from(entry.bits / 8)];
                    expected.extend(master.upload(index, entry.subindex).unwrap_or(zeros));
                }
            }
            let read = match reply[2] {
                0x51 => reply[10..].to_vec(),
                command => reply[6..10 - usize::from(command >> 2 & 3)].to_vec(),
            };
            assert_eq!(read, expected, "{index:04X}h");
        }
    }
}

#[test]
fn every_subindex_can_be_mapped_where_it_says_so_and_else_not() {
    for mut master in drives() {
        let entries: Vec<Entry> = objects(&mut master)
            .into_iter()
            .flat_map(|(_, _, entries)| entries)
            .collect();
        for (assignment, area, bit) in [(0x1C12, 0x1600, RX), (0x1C13, 0x1A00, TX)] {
            master.download(assignment, 0, &[0]).unwrap();
            let pdo = entries.iter().map(|entry| entry.index);
            let pdo = pdo.filter(|index| index & 0xFE00 == area).min().unwrap();
            master.download(pdo, 0, &[0]).unwrap();
            for entry in &entries {
                let mapped = u32::from(entry.index) << 16
                    | u32::from(entry.subindex) << 8
                    | u32::from(entry.bits.min(255));
                let written = master.download(pdo, 1, &mapped.to_le_bytes());
                assert_eq!(
                    written.is_ok(),
                    entry.access & bit != 0,
                    "{:04X}h:{} in {pdo:04X}h: {written:X?}",
                    entry.index,
                    entry.subindex
                );
            }
        }
    }
}

#[test]
fn what_a_drive_keeps_is_in_the_list_of_what_a_replacement_needs() {
    // Sigma-7 documents: 607Dh is kept in the EEPROM; 607Ah is not.
    let mut master = Master::of(Servo::sigma7().with_sdo_information().build());
    master.bring_to_preop();
    let kept = list(&mut master, 4).1;
    assert!(
        kept.contains(&0x607D) && !kept.contains(&0x607A),
        "{kept:04X?}"
    );
    assert_eq!(list(&mut master, 0).1[3], kept.len() as u16);
    let access = entry(&mut master, 0x607D, 1).unwrap().access;
    assert_eq!(access & 0x0100, 0x0100);
}

#[test]
fn what_the_sii_offers_is_served_and_nothing_else() {
    for drive in ALL {
        for (information, complete) in [(false, false), (false, true), (true, false), (true, true)]
        {
            let mut drive = drive().without_sdo_information().without_complete_access();
            if information {
                drive = drive.with_sdo_information();
            }
            if complete {
                drive = drive.with_complete_access();
            }
            let mut master = Master::of(drive.build());
            master.bring_to_preop();
            let details = coe_details(&mut master);
            assert_eq!(details & 0x02 != 0, information);
            assert_eq!(details & 0x20 != 0, complete);
            let reply = master.coe(&[0x00, 0x80, 3, 0, 0, 0, 0x18, 0x10]);
            if information {
                assert_eq!(reply[..3], [0x00, 0x80, 4]);
            } else {
                assert_eq!(abort(&reply), 0x0504_0001, "an unknown command");
            }
            let reply = master.coe(&request(0x50, 0x1018, 0, &[]));
            if complete {
                assert_eq!(reply[2], 0x51);
            } else {
                assert_eq!(abort(&reply), 0x0601_0004);
            }
        }
    }
}

/// The CoE details, byte 5 of SII category 30, read through the ESC's registers.
fn coe_details(master: &mut Master) -> u8 {
    let mut word = 0x40;
    loop {
        let [kind, length] = sii_words(master, word);
        if kind == 30 {
            return sii_words(master, word + 4)[0].to_le_bytes()[1];
        }
        assert_ne!(kind, 0xFFFF, "there is a category 30");
        word += 2 + length;
    }
}

fn sii_words(master: &mut Master, address: u16) -> [u16; 2] {
    // It is the device's own in PREOP.
    master.write(0x1001, 0x0500, &[0]);
    let mut command = vec![0x00, 0x01];
    command.extend(u32::from(address).to_le_bytes());
    master.write(0x1001, 0x0502, &command);
    let [a, b, c, d]: [u8; 4] = master.read(0x1001, 0x0508);
    [u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])]
}

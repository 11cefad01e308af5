//! The SDO information service, byte by byte. Behind the CoE header (service 8): operation with the "more follows" bit 80h,
//! zero, fragments left u16, then the data, of which only the first fragment has the beginning (ETG.1000.6, tables of the
//! SDO information services). Operations: 1 and 2 list, 3 and 4 object, 5 and 6 entry, 7 error.

use servocrab_sim::{Segment, personality::Servo};

use crate::master::Master;

fn preop(mailbox: u16) -> Master {
    let drive = Servo::akd2g()
        .with_sdo_information()
        .mailbox_bytes(mailbox)
        .build();
    let mut master = Master::new(Segment::new().with(drive));
    master.mailbox = usize::from(mailbox);
    master.bring_to_preop();
    master
}

/// CoE header, operation, and its data.
pub(crate) fn ask(master: &mut Master, operation: u8, data: &[u8]) -> Vec<u8> {
    let mut payload = vec![0x00, 0x80, operation, 0, 0, 0];
    payload.extend(data);
    master.coe(&payload)
}

/// A list, put together from its fragments: its type, and its words.
pub(crate) fn list(master: &mut Master, kind: u8) -> (u16, Vec<u16>) {
    let mut payload = vec![0x00, 0x80, 1, 0, 0, 0, kind, 0];
    payload.resize(8, 0);
    master.post(3, &payload);
    let mut bytes = Vec::new();
    let mut expected_left = None;
    loop {
        let (_, mail) = master.fetch().expect("a fragment");
        assert_eq!(mail[..2], [0x00, 0x80]);
        let left = u16::from_le_bytes([mail[4], mail[5]]);
        assert_eq!(mail[2], if left > 0 { 0x82 } else { 0x02 });
        assert!(expected_left.is_none_or(|expected| expected == left));
        assert_eq!(mail.len() % 2, 0, "no word is cut");
        bytes.extend(&mail[6..]);
        if left == 0 {
            break;
        }
        expected_left = Some(left - 1);
    }
    assert_eq!(master.fetch(), None, "nothing behind the last fragment");
    let mut words = bytes
        .chunks(2)
        .map(|word| u16::from_le_bytes([word[0], word[1]]));
    (words.next().unwrap(), words.collect())
}

#[test]
fn the_device_type_is_described_as_soem_saw_it_elsewhere() {
    // SOEM's scan of a simulated drive made with KickCAT: 1000h is a variable (7) of type 0007h with this name, but for its
    // capital letter.
    let reply = ask(&mut preop(1024), 3, &[0x00, 0x10]);
    let mut expected = vec![
        0x00, 0x80, 0x04, 0, 0, 0, 0x00, 0x10, 0x07, 0x00, 0x00, 0x07,
    ];
    expected.extend(b"Device type");
    assert_eq!(reply, expected);
}

#[test]
fn records_and_arrays_tell_their_type_and_their_highest_subindex() {
    let mut master = preop(1024);
    // Index, type, highest subindex, object code.
    let expected: [(&[u8], &[u8]); 6] = [
        // A record of identity numbers, type 0023h, and a mapping, type 0021h: as SOEM lists a real Leadshine EL7.
        (&[0x18, 0x10, 0x23, 0, 4, 9], b"Identity"),
        (&[0x00, 0x16, 0x21, 0, 16, 9], b"RxPDO mapping 1"),
        (&[0x10, 0x1A, 0x21, 0, 16, 9], b"TxPDO mapping 17"),
        (&[0x12, 0x1C, 0x06, 0, 2, 8], b"RxPDO assignment"),
        (&[0x03, 0x10, 0x07, 0, 8, 8], b"Pre-defined error field"),
        (&[0x7D, 0x68, 0x04, 0, 2, 8], b"Software position limit"),
    ];
    for (head, name) in expected {
        let reply = ask(&mut master, 3, &head[..2]);
        assert_eq!(reply[6..12], *head);
        assert_eq!(reply[12..], *name);
    }
}

#[test]
fn an_entry_tells_its_type_its_length_its_access_and_its_name() {
    let mut master = preop(1024);
    // Index, subindex, what is told; then type, bits and access as SOEM lists them of a real Leadshine EL7: 6041h can be
    // read and mapped into a TxPDO (0087h), 607Ah read, written and mapped into an RxPDO (007Fh), 1018h:1 read (0007h),
    // 1C12h:1 read, and written in PREOP (000Fh).
    let expected: [(&[u8], &[u8], &[u8]); 5] = [
        (&[0x41, 0x60, 0, 7], &[6, 0, 16, 0, 0x87, 0], b"Statusword"),
        (
            &[0x7A, 0x60, 0, 7],
            &[4, 0, 32, 0, 0x7F, 0],
            b"Target position",
        ),
        (&[0x18, 0x10, 1, 7], &[7, 0, 32, 0, 0x07, 0], b"Vendor ID"),
        (&[0x12, 0x1C, 1, 7], &[6, 0, 16, 0, 0x0F, 0], b"PDO"),
        (
            &[0x7D, 0x60, 0, 7],
            &[5, 0, 8, 0, 0x07, 0],
            b"Number of entries",
        ),
    ];
    for (asked, facts, name) in expected {
        let reply = ask(&mut master, 5, asked);
        assert_eq!(reply[..6], [0x00, 0x80, 0x06, 0, 0, 0]);
        assert_eq!(reply[6..10], *asked);
        assert_eq!(reply[10..16], *facts);
        assert_eq!(reply[16..], *name);
    }
}

#[test]
fn unit_default_and_range_come_when_they_are_asked_for_and_known() {
    let mut master = preop(1024);
    // Everything about 6081h: unit (increments per second), default (one turn of 2^20 counts), minimum, maximum, name.
    let reply = ask(&mut master, 5, &[0x81, 0x60, 0, 0x7F]);
    assert_eq!(reply[9], 0x7F);
    assert_eq!(
        reply[16..32],
        [
            0x00, 0x03, 0xB5, 0x00, 0x00, 0x00, 0x10, 0x00, 0, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF
        ]
    );
    assert_eq!(reply[32..], *b"Profile velocity");
    // Only the range of 605Ah: 0 to 8, two bytes each.
    let reply = ask(&mut master, 5, &[0x5A, 0x60, 0, 0x60]);
    assert_eq!(reply[9], 0x60);
    assert_eq!(reply[16..20], [0, 0, 8, 0]);
    assert_eq!(reply[20..], *b"Quick stop option code");
    assert_eq!(master.download(0x605A, 0, &[8, 0]), Ok(()));
    assert_eq!(master.download(0x605A, 0, &[9, 0]), Err(0x0609_0030));
    // A value that can only be read has neither default nor range.
    let reply = ask(&mut master, 5, &[0x41, 0x60, 0, 0x7F]);
    assert_eq!(reply[9], 0x07);
    assert_eq!(reply[16..], *b"Statusword");
    // The default stays what it was at power-up.
    master.download(0x6081, 0, &[1, 0, 0, 0]).unwrap();
    let reply = ask(&mut master, 5, &[0x81, 0x60, 0, 0x10]);
    assert_eq!(reply[16..20], [0x00, 0x00, 0x10, 0x00]);
}

#[test]
fn the_lists_agree_with_their_counts_and_with_the_dictionary() {
    let mut master = preop(1024);
    let (kind, counts) = list(&mut master, 0);
    assert_eq!((kind, counts.len()), (0, 5));
    let (kind, all) = list(&mut master, 1);
    assert_eq!(kind, 1);
    assert!(
        all.is_sorted_by(|one, next| one < next),
        "ascending, each once"
    );
    for (kind, count) in (1..).zip(counts) {
        let (_, listed) = list(&mut master, kind);
        assert_eq!(listed.len(), usize::from(count), "list {kind}");
        assert!(listed.iter().all(|index| all.contains(index)));
    }
    for index in [
        0x1000, 0x1001, 0x1003, 0x1018, 0x1600, 0x1C13, 0x5000, 0x5F00, 0x6040, 0x6840,
    ] {
        assert!(all.contains(&index), "{index:04X}h");
    }
    let outputs = list(&mut master, 2).1;
    let inputs = list(&mut master, 3).1;
    assert!(outputs.contains(&0x6040) && !inputs.contains(&0x6040));
    assert!(inputs.contains(&0x6841) && !outputs.contains(&0x6841));
    // What is not in the list does not exist.
    for index in [0x1004, 0x1C14, 0x6000, 0x7040] {
        assert!(!all.contains(&index));
        assert_eq!(master.upload(index, 0), Err(0x0602_0000));
    }
}

#[test]
fn a_long_list_is_cut_into_fragments_that_count_down() {
    let whole = list(&mut preop(1024), 1);
    // 64 bytes: 52 of data in each fragment; with 65 no more, because a word is not cut.
    assert_eq!(list(&mut preop(65), 1), whole);
    let mut master = preop(64);
    assert_eq!(list(&mut master, 1), whole);
    let count = (2 + 2 * whole.1.len()).div_ceil(52);
    assert!(count > 2);
    master.post(3, &[0x00, 0x80, 1, 0, 0, 0, 1, 0]);
    let (counter, first) = master.fetch().unwrap();
    assert_eq!(first.len(), 58);
    assert_eq!(
        first[..10],
        [0x00, 0x80, 0x82, 0, count as u8 - 1, 0, 1, 0, 0x00, 0x10]
    );
    // Each fragment is a mail with a counter of its own.
    let (next, second) = master.fetch().unwrap();
    assert_eq!(next >> 4, (counter >> 4) % 7 + 1);
    assert_eq!(second[2..6], [0x82, 0, count as u8 - 2, 0]);
}

#[test]
fn what_does_not_exist_is_answered_with_an_error_of_the_service() {
    let mut master = preop(1024);
    let expected: [(u8, &[u8], u32); 5] = [
        (3, &[0x45, 0x23], 0x0602_0000),
        (5, &[0x45, 0x23, 0, 7], 0x0602_0000),
        (5, &[0x18, 0x10, 5, 7], 0x0609_0011),
        (1, &[6, 0], 0x0601_0000),
        (9, &[0, 0], 0x0504_0001),
    ];
    for (operation, data, code) in expected {
        let mut error = vec![0x00, 0x80, 0x07, 0, 0, 0];
        error.extend(code.to_le_bytes());
        assert_eq!(ask(&mut master, operation, data), error);
    }
}

#[test]
fn a_request_that_is_too_short_is_an_error_of_the_mailbox() {
    let mut master = preop(1024);
    for payload in [
        &[0x00u8, 0x80][..],
        &[0x00, 0x80, 1, 0, 0],
        &[0x00, 0x80, 1, 0, 0, 0, 1],
        &[0x00, 0x80, 5, 0, 0, 0, 0, 0x10, 0],
    ] {
        master.post(3, payload);
        let (kind, reply) = master.fetch().unwrap();
        assert_eq!((kind & 0x0F, reply), (0, vec![1, 0, 6, 0]));
    }
}

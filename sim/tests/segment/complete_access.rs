//! Complete access, byte by byte: 50h asks, 51h or 53h to 5Fh answers; 31h writes, 70h confirms. With subindex 0 the count
//! takes two bytes. The layouts are the standard's (ETG.1000.6, tables of the SDO services with their complete access bit);
//! the exchanges marked so are what SOEM exchanged with a slave that nobody here wrote.

use servocrab_sim::{Segment, personality::Servo};

use crate::master::{Master, abort, request};

fn preop() -> Master {
    let drive = Servo::akd2g().with_complete_access().build();
    let mut master = Master::new(Segment::new().with(drive));
    master.bring_to_preop();
    master
}

/// A complete upload that is answered in one mail.
fn read_all(master: &mut Master, index: u16, start: u8) -> Vec<u8> {
    let reply = master.coe(&request(0x50, index, start, &[]));
    assert_eq!(reply[2] & 0xF0, 0x50, "{reply:02X?}");
    if reply[2] & 0x02 != 0 {
        return reply[6..10 - usize::from(reply[2] >> 2 & 3)].to_vec();
    }
    let size = u32::from_le_bytes(reply[6..10].try_into().unwrap());
    assert_eq!(size as usize, reply.len() - 10);
    reply[10..].to_vec()
}

/// A complete download in one mail: what came back.
fn write_all(master: &mut Master, index: u16, start: u8, bytes: &[u8]) -> Result<(), u32> {
    let mut data = (bytes.len() as u32).to_le_bytes().to_vec();
    data.extend(bytes);
    let reply = master.coe(&request(0x31, index, start, &data));
    if reply[2] == 0x80 {
        return Err(abort(&reply));
    }
    let [low, high] = index.to_le_bytes();
    assert_eq!(reply, [0x00, 0x30, 0x70, low, high, start, 0, 0, 0, 0]);
    Ok(())
}

#[test]
fn the_sync_manager_types_come_as_soem_saw_them_elsewhere() {
    // SOEM's scan of a simulated drive made with KickCAT: request and reply of 1C00h.
    let mut master = preop();
    let reply = master.coe(&[0x00, 0x20, 0x50, 0x00, 0x1C, 0x00, 0, 0, 0, 0]);
    assert_eq!(
        reply,
        [
            0x00, 0x30, 0x51, 0x00, 0x1C, 0x00, 6, 0, 0, 0, 4, 0, 1, 2, 3, 4
        ]
    );
}

#[test]
fn an_assignment_is_as_long_as_its_count_says() {
    let mut master = preop();
    assert_eq!(
        read_all(&mut master, 0x1C12, 0),
        [2, 0, 0x00, 0x16, 0x10, 0x16]
    );
    assert_eq!(
        read_all(&mut master, 0x1C12, 1),
        [0x00, 0x16, 0x10, 0x16],
        "expedited"
    );
    master.download(0x1C12, 0, &[0]).unwrap();
    assert_eq!(read_all(&mut master, 0x1C12, 0), [0, 0]);
}

#[test]
fn the_identity_starts_at_subindex_1_when_asked_to() {
    let mut master = preop();
    let numbers = read_all(&mut master, 0x1018, 1);
    assert_eq!(
        numbers,
        [
            0x6A, 0, 0, 0, 0x32, 0x44, 0x4B, 0x41, 1, 0, 0, 0, 0, 0, 0, 0
        ]
    );
    let whole = read_all(&mut master, 0x1018, 0);
    assert_eq!(whole[..2], [4, 0]);
    assert_eq!(whole[2..], numbers);
}

#[test]
fn elements_of_several_lengths_stand_one_behind_the_other() {
    let mut master = preop();
    // 1C32h: type u16, cycle time u32 (1 ms), shift time u32, types supported u16.
    assert_eq!(
        read_all(&mut master, 0x1C32, 0),
        [4, 0, 0, 0, 0x40, 0x42, 0x0F, 0, 0, 0, 0, 0, 5, 0]
    );
}

#[test]
fn an_element_that_cannot_be_read_comes_as_zeros_and_one_that_cannot_be_written_is_left() {
    let mut master = preop();
    let bytes = [3, 0, 0x11, 0x22, 0xAA, 0xBB, 0xCC, 0xDD, 1, 2, 3, 4];
    assert_eq!(write_all(&mut master, 0x5F01, 0, &bytes), Ok(()));
    assert_eq!(
        read_all(&mut master, 0x5F01, 0),
        [3, 0, 0x11, 0x22, 0, 0, 0, 0, 1, 2, 3, 4]
    );
    assert_eq!(master.upload(0x5F01, 2), Err(0x0601_0001));
    // 1C32h:1 can be written, the other three cannot.
    let bytes = [2, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3];
    assert_eq!(write_all(&mut master, 0x1C32, 1, &bytes), Ok(()));
    assert_eq!(
        read_all(&mut master, 0x1C32, 1),
        [2, 0, 0x40, 0x42, 0x0F, 0, 0, 0, 0, 0, 5, 0]
    );
    // Of 1018h none can.
    assert_eq!(
        write_all(&mut master, 0x1018, 0, &[0; 18]),
        Err(0x0601_0002)
    );
}

#[test]
fn an_axis_object_is_written_as_a_whole() {
    let mut master = preop();
    let limits = [2, 0, 0xF0, 0xD8, 0xFF, 0xFF, 0x10, 0x27, 0, 0];
    assert_eq!(write_all(&mut master, 0x607D, 0, &limits), Ok(()));
    assert_eq!(read_all(&mut master, 0x607D, 0), limits);
    let axis = master.segment.axis(0, 0).unwrap();
    assert_eq!(axis.get(0x607D, 1), Some(-10_000));
    assert_eq!(axis.get(0x607D, 2), Some(10_000));
}

#[test]
fn a_refused_element_leaves_the_whole_object_as_it_was() {
    let mut master = preop();
    let before = read_all(&mut master, 0x6091, 0);
    // Zero revolutions of the shaft are out of range.
    let bytes = [2, 0, 7, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(write_all(&mut master, 0x6091, 0, &bytes), Err(0x0609_0030));
    assert_eq!(read_all(&mut master, 0x6091, 0), before);
}

#[test]
fn a_mapping_is_written_in_one_transfer_after_its_pdo_was_taken_out() {
    let mut master = preop();
    let mapping = [2, 0, 0x10, 0x00, 0x40, 0x60, 0x20, 0x00, 0x7A, 0x60];
    // Still assigned: not possible in this state.
    assert_eq!(
        write_all(&mut master, 0x1600, 0, &mapping),
        Err(0x0800_0022)
    );
    assert_eq!(master.upload(0x1600, 0), Ok(vec![6]), "nothing was changed");
    assert_eq!(write_all(&mut master, 0x1C12, 0, &[0, 0]), Ok(()));
    assert_eq!(write_all(&mut master, 0x1600, 0, &mapping), Ok(()));
    assert_eq!(
        write_all(&mut master, 0x1C12, 0, &[1, 0, 0x00, 0x16]),
        Ok(())
    );
    assert_eq!(read_all(&mut master, 0x1600, 0), mapping);
    assert_eq!(read_all(&mut master, 0x1C12, 0), [1, 0, 0x00, 0x16]);
}

#[test]
fn a_list_keeps_its_rules() {
    let mut master = preop();
    // From subindex 1 on, subindex 0 is not touched, and it is not zero.
    assert_eq!(
        write_all(&mut master, 0x1C12, 1, &[0x10, 0x16, 0x00, 0x16]),
        Err(0x0601_0003)
    );
    // An element too few, an element too many, a PDO that does not exist, more elements than the list has.
    let wrong: [(&[u8], u32); 4] = [
        (&[2, 0, 0x00, 0x16], 0x0607_0013),
        (&[1, 0, 0x00, 0x16, 0x10, 0x16], 0x0607_0012),
        (&[1, 0, 0x23, 0x16], 0x0609_0030),
        (&[3, 0, 0x00, 0x16, 0x10, 0x16], 0x0609_0011),
    ];
    for (bytes, code) in wrong {
        assert_eq!(write_all(&mut master, 0x1C12, 0, bytes), Err(code));
    }
    assert_eq!(
        read_all(&mut master, 0x1C12, 0),
        [2, 0, 0x00, 0x16, 0x10, 0x16]
    );
    // More than the object can take is refused before any data comes.
    let reply = master.coe(&request(0x31, 0x1C12, 0, &7u32.to_le_bytes()));
    assert_eq!(abort(&reply), 0x0607_0012);
}

#[test]
fn what_has_no_complete_access_is_refused() {
    let mut master = preop();
    // A single value; a start beyond 1; an object that does not exist.
    for (index, start, code) in [
        (0x6040, 0, 0x0601_0004),
        (0x1018, 2, 0x0601_0000),
        (0x2345, 0, 0x0602_0000),
    ] {
        let read = master.coe(&request(0x50, index, start, &[]));
        assert_eq!(abort(&read), code, "{index:04X}h:{start}");
        let written = write_all(&mut master, index, start, &[0; 8]);
        assert_eq!(written, Err(code), "{index:04X}h:{start}");
    }
}

#[test]
fn a_device_whose_coe_details_do_not_offer_it_refuses_all_of_it() {
    let mut master = Master::new(Segment::new().with(Servo::akd2g().build()));
    master.bring_to_preop();
    for command in [0x50, 0x31, 0x33] {
        let reply = master.coe(&request(command, 0x1C12, 0, &[2, 0, 0, 0, 0, 0]));
        assert_eq!(abort(&reply), 0x0601_0004, "{command:02X}h");
    }
}

#[test]
fn a_whole_object_travels_in_segments_when_the_mailbox_is_short() {
    // A mailbox of 24 bytes: 8 bytes in the initiate mail, 15 in a segment.
    let drive = Servo::akd2g()
        .with_complete_access()
        .mailbox_bytes(24)
        .build();
    let mut master = Master::new(Segment::new().with(drive));
    master.mailbox = 24;
    master.bring_to_preop();
    let reply = master.coe(&request(0x50, 0x1018, 0, &[]));
    assert_eq!(
        reply,
        [
            0x00, 0x30, 0x51, 0x18, 0x10, 0, 18, 0, 0, 0, 4, 0, 0x6A, 0, 0, 0, 0x32, 0x44
        ]
    );
    let reply = master.coe(&request(0x60, 0, 0, &[]));
    assert_eq!(
        reply,
        [0x00, 0x30, 0x01, 0x4B, 0x41, 1, 0, 0, 0, 0, 0, 0, 0]
    );
    // And back: ten bytes of 607Dh, eight of them with the first mail.
    let mut first = 10u32.to_le_bytes().to_vec();
    first.extend([2, 0, 1, 0, 0, 0, 9, 0]);
    assert_eq!(master.coe(&request(0x31, 0x607D, 0, &first))[2], 0x70);
    // n = 5 of the seven bytes are unused.
    let reply = master.coe(&[0x00, 0x20, 0x0B, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(reply[..3], [0x00, 0x30, 0x20]);
    assert_eq!(master.upload(0x607D, 1), Ok(vec![1, 0, 0, 0]));
    assert_eq!(master.upload(0x607D, 2), Ok(vec![9, 0, 0, 0]));
}

//! Every datagram command with its working counter, logical addressing, and the distributed clocks' registers.

use core::time::Duration;

use servocrab_sim::personality::{self, Servo};
use servocrab_sim::{Direction, Segment};

use crate::master::{BRD, BWR, FPRD, FPWR, LRW, Master};

const NOP: u8 = 0;
const APRD: u8 = 1;
const APWR: u8 = 2;
const APRW: u8 = 3;
const FPRW: u8 = 6;
const BRW: u8 = 9;
const LRD: u8 = 10;
const LWR: u8 = 11;
const ARMW: u8 = 13;
const FRMW: u8 = 14;

/// Three couplers with the station addresses 1001h to 1003h.
fn three() -> Master {
    let segment = (0..3).fold(Segment::new(), |segment, _| {
        segment.with(personality::coupler())
    });
    let mut master = Master::new(segment);
    for position in 0..3u16 {
        let address = (0x1001 + position).to_le_bytes();
        assert_eq!(
            master
                .exchange(APWR, position.wrapping_neg(), 0x0010, &address)
                .1,
            1
        );
    }
    master
}

#[test]
fn each_command_counts_as_the_standard_says() {
    // Command, address, working counter: ETG.1000.4; the memory at 1000h is plain.
    let cases: [(u8, u16, u16); 14] = [
        (NOP, 0, 0),
        (APRD, 0xFFFF, 1),
        (APRD, 0xFFFD, 0),
        (APWR, 0xFFFF, 1),
        (APRW, 0xFFFF, 3),
        (FPRD, 0x1002, 1),
        (FPRD, 0x1009, 0),
        (FPWR, 0x1002, 1),
        (FPRW, 0x1002, 3),
        (BRD, 0, 3),
        (BWR, 0, 3),
        (BRW, 0, 9),
        (ARMW, 0, 3),
        (FRMW, 0x1001, 3),
    ];
    for (command, address, expected) in cases {
        let mut master = three();
        assert_eq!(
            master.exchange(command, address, 0x1000, &[1, 2]).1,
            expected,
            "{command} {address:04X}h"
        );
    }
}

#[test]
fn memory_that_does_not_exist_counts_nothing() {
    let mut master = three();
    assert_eq!(
        master.exchange(FPRD, 0x1001, 0x3000, &[0; 4]),
        (vec![0; 4], 0)
    );
    assert_eq!(
        master.exchange(FPRD, 0x1001, 0xFFFE, &[0; 4]),
        (vec![0; 4], 0)
    );
}

#[test]
fn a_read_write_gives_the_old_value_and_leaves_the_new_one() {
    let mut master = three();
    master.write(0x1002, 0x1000, &[0x11, 0x22]);
    assert_eq!(
        master.exchange(FPRW, 0x1002, 0x1000, &[0x33, 0x44]).0,
        [0x11, 0x22]
    );
    assert_eq!(master.read::<2>(0x1002, 0x1000), [0x33, 0x44]);
}

#[test]
fn a_read_multiple_write_spreads_the_value_of_the_one_that_is_meant() {
    let mut master = three();
    master.write(0x1001, 0x1000, &[0x77]);
    assert_eq!(master.exchange(FRMW, 0x1001, 0x1000, &[0]).0, [0x77]);
    assert_eq!(master.read::<1>(0x1002, 0x1000), [0x77]);
    assert_eq!(master.read::<1>(0x1003, 0x1000), [0x77]);
}

#[test]
fn logical_reads_and_writes_map_single_bits_of_several_devices() {
    let mut master = three();
    for (address, bit) in [(0x1001u16, 0u8), (0x1002, 1), (0x1003, 2)] {
        // One bit of logical byte 5000h for each device: written to and read from bit 7 of 1000h.
        master.write(
            address,
            0x0600,
            &[
                0x00, 0x50, 0, 0, 1, 0, bit, bit, 0x00, 0x10, 7, 3, 1, 0, 0, 0,
            ],
        );
    }
    assert_eq!(master.exchange(LWR, 0x5000, 0, &[0b1111_1101]).1, 3);
    let mut written = |address| master.read::<1>(address, 0x1000)[0];
    assert_eq!(
        [written(0x1001), written(0x1002), written(0x1003)],
        [0x80, 0x00, 0x80]
    );
    assert_eq!(
        master.exchange(LRD, 0x5000, 0, &[0b1010_1010]),
        (vec![0b1010_1101], 3)
    );
    assert_eq!(
        master.exchange(LRW, 0x5000, 0, &[0b0000_0010]),
        (vec![0b0000_0101], 9)
    );
    assert_eq!(
        master.exchange(LRD, 0x5000, 0, &[0]),
        (vec![0b0000_0010], 3)
    );
    assert_eq!(master.exchange(LRD, 0x5001, 0, &[0]).1, 0);
}

#[test]
fn a_device_without_lrw_leaves_that_command_alone_and_says_so() {
    let mut master = Master::new(Segment::new().with(Servo::akd2g().without_lrw().build()));
    master.bring_to_preop();
    assert_eq!(master.read::<2>(0x1001, 0x0008)[1] & 0x02, 0x02);
    master.fmmu(0x1001, 0, 0, 4, 0x1100, 3);
    assert_eq!(
        master.exchange(LRW, 0, 0, &[1, 2, 3, 4]),
        (vec![1, 2, 3, 4], 0)
    );
    assert_eq!(master.exchange(LWR, 0, 0, &[1, 2, 3, 4]).1, 1);
    assert_eq!(master.exchange(LRD, 0, 0, &[0; 4]), (vec![1, 2, 3, 4], 1));
}

#[test]
fn the_full_bit_of_a_mailbox_can_be_mapped() {
    let mut master = Master::new(Segment::new().with(personality::akd2g()));
    master.bring_to_preop();
    // Logical bit 0 is bit 3 of 080Dh.
    master.write(
        0x1001,
        0x0620,
        &[0, 0x60, 0, 0, 1, 0, 0, 0, 0x0D, 0x08, 3, 1, 1, 0, 0, 0],
    );
    assert_eq!(master.exchange(LRD, 0x6000, 0, &[0]), (vec![0], 1));
    master.post(3, &[0x00, 0x20, 0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0]);
    assert_eq!(master.exchange(LRD, 0x6000, 0, &[0]), (vec![1], 1));
}

#[test]
fn the_alias_serves_as_address_only_when_it_is_switched_on() {
    let mut description = personality::coupler().description().clone();
    description.alias = 0x0042;
    let blueprint = servocrab_sim::Blueprint {
        description,
        drive: None,
        cycle: Duration::from_millis(1),
    };
    let mut master = Master::new(Segment::new().with(servocrab_sim::Device::new(blueprint)));
    assert_eq!(master.exchange(FPRD, 0x0042, 0x0012, &[0; 2]).1, 0);
    master.exchange(BWR, 0, 0x0103, &[1]);
    assert_eq!(
        master.exchange(FPRD, 0x0042, 0x0012, &[0; 2]),
        (vec![0x42, 0], 1)
    );
}

#[test]
fn the_link_status_tells_the_end_of_the_line() {
    let mut master = three();
    assert_eq!(master.read::<2>(0x1001, 0x0110), 0x5A33u16.to_le_bytes());
    assert_eq!(master.read::<2>(0x1003, 0x0110), 0x5613u16.to_le_bytes());
    master.segment.unplug(1);
    assert_eq!(master.read::<2>(0x1001, 0x0110), 0x5613u16.to_le_bytes());
}

#[test]
fn receive_times_are_latched_by_a_write_and_show_the_way_between_the_ports() {
    let mut master = three();
    master.now = Duration::from_millis(5);
    master.exchange(BWR, 0, 0x0900, &[0; 4]);
    master.now = Duration::from_millis(9);
    let mut times = |address| {
        let bytes: [u8; 8] = master.read(address, 0x0900);
        let [a, b, c, d, e, f, g, h] = bytes;
        (
            u32::from_le_bytes([a, b, c, d]),
            u32::from_le_bytes([e, f, g, h]),
        )
    };
    let loop_time = |(port0, port1): (u32, u32)| port1.wrapping_sub(port0);
    let (first, second, last) = (times(0x1001), times(0x1002), times(0x1003));
    assert!(loop_time(first) > loop_time(second));
    assert_eq!(last.1, 0);
}

#[test]
fn the_system_time_runs_and_follows_its_offset() {
    let mut master = three();
    let mut time = |at: u64| {
        master.now = Duration::from_micros(at);
        u64::from_le_bytes(master.read(0x1002, 0x0910))
    };
    let start = time(1000);
    assert_eq!(time(3500) - start, 2_500_000);
    master.write(0x1002, 0x0920, &1_000_000u64.to_le_bytes());
    let mut time = |at: u64| {
        master.now = Duration::from_micros(at);
        u64::from_le_bytes(master.read(0x1002, 0x0910))
    };
    assert_eq!(time(3500) - start, 3_500_000);
    // The distributed time of the first device differs by one hop from the second's.
    master.write(0x1002, 0x0920, &[0; 8]);
    master.exchange(FRMW, 0x1001, 0x0910, &[0; 8]);
    let difference = u32::from_le_bytes(master.read(0x1002, 0x092C));
    assert_eq!(difference, 500);
}

#[test]
fn the_description_tells_the_size_of_the_process_data() {
    let drive = personality::akd2g();
    assert_eq!(
        drive.description().process_data_bytes(Direction::Outputs),
        38
    );
    assert_eq!(
        drive.description().process_data_bytes(Direction::Inputs),
        22
    );
}

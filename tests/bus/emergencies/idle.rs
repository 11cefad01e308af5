//! What goes over the wire while no mailbox is asked for anything: the cyclic frames, and what reads a mail that waits.

use std::time::Duration;

use servocrab::{AxisConfig, DriveConfig, Network, Referencing, drives};
use servocrab_sim::{Segment, personality};

use super::line::{Line, MS, Own, Rig, emergency};

/// Where the simulated drives' mailboxes lie, as their SII says.
const MAILBOX: u16 = 0x1100;
/// The registers of the mailboxes' sync managers.
const STATES: u16 = 0x0800;
const FPRD: u8 = 4;

/// So many single-axis drives in OP, with nothing left of the bring-up.
fn drives_in_op(count: u16) -> (Line, Rig) {
    let segment = (0..count).fold(Segment::new(), |line, _| line.with(personality::generic()));
    let line = Line::new(segment);
    let builder = (0..count).fold(Network::builder().link(line.wire()), |builder, position| {
        let name = format!("axis {position}");
        let config = DriveConfig::new(drives::generic())
            .axis(AxisConfig::new(&name).referencing(Referencing::UnreferencedMovesAllowed));
        builder.drive(position, config)
    });
    let mut rig = Rig::start(builder);
    rig.run_for(100 * MS);
    line.take_frames();
    (line, rig)
}

/// Frames of the next so many cycles: how many were sent in all, and which of them carried no process data.
fn in_cycles(line: &Line, rig: &mut Rig, cycles: u64) -> (u64, Vec<Own>) {
    let end = rig.net.statistics().cycles + cycles;
    while rig.net.statistics().cycles < end {
        assert!(rig.bus.turn());
    }
    // The frame of the last cycle is back.
    rig.run_for(MS / 2);
    line.take_frames()
}

#[test]
fn idle_mailboxes_cost_no_frame_of_their_own() {
    for count in [1, 3, 9, 20] {
        let (line, mut rig) = drives_in_op(count);
        rig.run_for(MS / 2);
        line.take_frames();
        assert_eq!(
            in_cycles(&line, &mut rig, 1_000),
            (1_000, vec![]),
            "{count} drives"
        );
    }
}

#[test]
fn an_emergency_costs_its_reading_and_a_look_behind_it_at_its_own_drive_alone() {
    for count in [1, 3, 9, 20] {
        let (line, mut rig) = drives_in_op(count);
        for position in 0..count {
            rig.run_for(MS / 2);
            line.take_frames();
            let now = rig.bus.now();
            line.inject(usize::from(position), &[emergency(position.into())], now);
            let (frames, own) = in_cycles(&line, &mut rig, 50);
            let [read, look] = own[..] else {
                panic!("drive {position} of {count}: {own:?}");
            };
            assert_eq!(frames, 52);
            assert_eq!((read.command, read.register), (FPRD, MAILBOX));
            assert_eq!((look.command, look.register), (FPRD, STATES));
            assert_eq!(look.station, read.station, "the same drive");
            let emergencies = rig.emergencies(position);
            let got = emergencies.try_next().unwrap().emergency().unwrap();
            assert_eq!(got.emergency, emergency(position.into()));
            assert!(emergencies.try_next().is_none());
            let took = got.at - now;
            assert!(took < 10 * MS, "within eight cycles: {took:?}");
        }
    }
}

#[test]
fn each_of_many_drives_is_seen_by_its_own_bit() {
    const COUNT: u16 = 20;
    let (line, mut rig) = drives_in_op(COUNT);
    let now = rig.bus.now();
    for position in (0..COUNT).step_by(3) {
        line.inject(usize::from(position), &[emergency(position.into())], now);
    }
    rig.run_for(Duration::from_millis(20));
    for position in 0..COUNT {
        let expected = (position % 3 == 0).then(|| emergency(position.into()));
        rig.expect(position, expected.as_slice());
    }
}

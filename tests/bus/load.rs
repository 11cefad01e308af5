//! What a cycle takes on the cable, and what happens at once to a long line.

use std::time::Duration;

use servocrab::{
    DriveConfig, Network, NetworkError,
    bus::{AxisIncident, NetworkBuilder, NetworkEvent},
    drives,
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig};

/// A line of plain drives with one axis each.
fn line(drives: u16) -> (Line, NetworkBuilder) {
    let segment = (0..drives).fold(Segment::new(), |segment, _| {
        segment.with(personality::generic())
    });
    let line = Line::new(segment);
    let builder = (0..drives).fold(Network::builder().link(line.wire()), |builder, position| {
        let drive = DriveConfig::new(drives::generic()).axis(position.to_string());
        builder.drive(position, drive)
    });
    (line, builder)
}

/// 40 drives of 30 bytes: one frame of 14 + 2 + 16 + 12 + 1200 bytes, with five mailbox states of 13 (but at most four in a frame), and
/// the AL status of 14.
const BYTES: usize = 14 + 2 + 16 + 12 + 1200 + 4 * 13 + 14;
/// With the 24 bytes around it, 80 ns each.
const SENDING: Duration = Duration::from_nanos((BYTES as u64 + 24) * 80);

#[test]
fn a_cycle_shorter_than_its_frames_is_refused_before_a_drive_is_in_op() {
    let (line, builder) = line(40);
    let cycle = SENDING - Duration::from_nanos(1);
    let Err(NetworkError::CycleTooShort { load, .. }) = Rig::start(builder.cycle(cycle)).map(drop)
    else {
        panic!("it cannot be kept");
    };
    assert_eq!((load.frames, load.bytes), (1, BYTES));
    assert_eq!(load.sending, SENDING);
    let segment = line.segment();
    assert!(
        segment
            .devices()
            .iter()
            .all(|device| device.axes()[0].ledger().is_empty())
    );
}

#[test]
fn what_a_cycle_takes_on_the_cable_can_be_asked_for() {
    let (_line, builder) = line(40);
    let rig = Rig::start(builder.cycle(Duration::from_micros(200))).unwrap();
    let load = rig.net().cable_load();
    assert_eq!((load.frames, load.bytes), (1, BYTES));
    assert_eq!(load.time(), SENDING + Duration::from_micros(40));
    rig.shutdown();
}

#[test]
fn of_a_whole_line_that_is_lost_at_once_nothing_is_untold() {
    const DRIVES: u16 = 80;
    let (line, builder) = line(DRIVES);
    let mut rig = Rig::start(builder).unwrap();
    let events = rig.net().events();
    rig.run_for(Duration::from_millis(10));
    line.segment().unplug(0);
    let (mut lost, mut boxes) = (Vec::new(), Vec::new());
    for _ in 0..400 {
        rig.run_for(Duration::from_millis(1));
        while let Some(event) = rig.until(smol::future::poll_once(events.next())) {
            match event.unwrap() {
                NetworkEvent::Lost(drive) => lost.push(drive.position),
                NetworkEvent::AxisIncident(black_box) => {
                    assert_eq!(black_box.incident, Some(AxisIncident::Lost));
                    boxes.push(black_box.axis.drive.position);
                }
                other => panic!("{other}"),
            }
        }
        if lost.len() + boxes.len() >= usize::from(2 * DRIVES) {
            break;
        }
    }
    let all: Vec<_> = (0..DRIVES).collect();
    assert_eq!((lost, boxes), (all.clone(), all));
}

//! One emergency after each datagram of a bring-up, from the first one that finds the drive in PREOP.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    thread,
};

use servocrab::{
    bus::{DriveConfig, Network, NetworkBuilder},
    drives,
};
use servocrab_sim::{AlState, Segment, personality};

use crate::line::{At, Line, MS, Rig, emergency};

fn builder(line: &Line) -> NetworkBuilder {
    let drive = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
    Network::builder().link(line.wire()).drive(0, drive)
}

fn one_drive() -> Line {
    Line::new(Segment::new().with(personality::akd2g()))
}

/// How many datagrams a bring-up takes from PREOP on.
fn recorded() -> u64 {
    let line = one_drive();
    let rig = Rig::start(builder(&line));
    drop(rig);
    line.seen()
}

#[test]
fn an_emergency_after_any_datagram_of_a_bring_up_is_delivered_and_op_is_reached() {
    let datagrams = after_each_datagram(|_| None);
    println!("{datagrams} datagrams, as many bring-ups");
}

#[test]
fn an_emergency_in_a_bring_up_is_delivered_once_though_a_frame_right_behind_it_is_lost() {
    // The first frames behind an emergency look at the mailbox and read it, or bring what it has overtaken.
    after_each_datagram(|after| Some(after + 1 + after % 5));
}

/// A bring-up for each datagram, with an emergency after it, and with the datagram of which `lost` gives the number lost
/// on its way back.
fn after_each_datagram(lost: impl Fn(u64) -> Option<u64> + Sync) -> u64 {
    let datagrams = recorded();
    // Reading the SII, the mapping and its reading back, the way to OP: many more than this.
    assert!(datagrams > 300, "only {datagrams} datagrams were recorded");
    let next = AtomicU64::new(1);
    let workers = thread::available_parallelism().map_or(1, usize::from);
    let work = || {
        loop {
            let after = next.fetch_add(1, Ordering::Relaxed);
            if after > datagrams {
                return;
            }
            let _at = At(after);
            one_bring_up(after, lost(after));
        }
    };
    thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(work);
        }
    });
    datagrams
}

fn one_bring_up(after: u64, lost: Option<u64>) {
    let line = one_drive();
    line.arm(after, 0, &[emergency(after)]);
    lost.into_iter().for_each(|datagram| line.lose(datagram));
    let mut rig = Rig::start(builder(&line));
    assert_eq!(line.al_state(0), AlState::Op);
    assert!(!line.is_armed(), "it was sent");
    rig.expect(0, &[emergency(after)]);
    // The exchange goes on, and so does the mailbox.
    rig.run_for(2 * MS);
    assert_eq!(rig.net.statistics().wrong_working_counters, 0);
    let sdo = rig.net.sdo(0).unwrap();
    let product = rig.until(sdo.read_bytes(0x1018, 2)).unwrap();
    assert_eq!(product, 0x414B_4432u32.to_le_bytes());
    // Whatever was asked for again has come by now.
    rig.run_for(25 * MS);
    rig.expect(0, &[]);
}

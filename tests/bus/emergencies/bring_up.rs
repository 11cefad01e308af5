//! One emergency after each datagram of a bring-up, from the first one that finds the drive in PREOP.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    thread,
    time::Duration,
};

use servocrab::{DriveConfig, Network, bus::NetworkBuilder, drives};
use servocrab_sim::{AlState, Segment, personality};

use super::line::{At, Line, Loss, MS, Rig, emergency};

fn builder(line: &Line) -> NetworkBuilder {
    let drive = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
    Network::builder().link(line.wire()).drive(0, drive)
}

/// How a bring-up is disturbed besides the emergency.
#[derive(Clone, Copy)]
struct Disturbance {
    /// How long the drive takes over each mail.
    delay: Duration,
    /// The frame that is lost, by the number of the emergency's datagram.
    lost: fn(u64) -> Option<Loss>,
}

const UNDISTURBED: Disturbance = Disturbance {
    delay: Duration::ZERO,
    lost: |_| None,
};

impl Disturbance {
    fn line(&self) -> Line {
        let mut drive = personality::akd2g();
        drive.set_mailbox_delay(self.delay);
        Line::new(Segment::new().with(drive))
    }
}

/// How many datagrams a bring-up takes from PREOP on.
fn recorded(disturbance: &Disturbance) -> u64 {
    let line = disturbance.line();
    let rig = Rig::start(builder(&line));
    drop(rig);
    line.seen()
}

#[test]
fn an_emergency_after_any_datagram_of_a_bring_up_is_delivered_and_op_is_reached() {
    let datagrams = after_each_datagram(UNDISTURBED);
    println!("{datagrams} datagrams, as many bring-ups");
}

#[test]
fn an_emergency_in_a_bring_up_is_delivered_once_though_a_frame_right_behind_it_is_lost() {
    // The first frames behind an emergency look at the mailbox and read it, or bring what it has overtaken.
    after_each_datagram(Disturbance {
        lost: |after| {
            let datagram = after + 1 + after % 5;
            Some(match after % 3 {
                0 => Loss::Request(datagram),
                _ => Loss::Answer(datagram),
            })
        },
        ..UNDISTURBED
    });
}

#[test]
fn an_emergency_between_any_request_of_a_bring_up_and_its_late_answer_is_delivered() {
    let datagrams = after_each_datagram(Disturbance {
        delay: Duration::from_micros(400),
        ..UNDISTURBED
    });
    println!("{datagrams} datagrams with a slow mailbox, as many bring-ups");
}

/// A bring-up for each of its datagrams, with an emergency after it. Gives their number.
fn after_each_datagram(disturbance: Disturbance) -> u64 {
    let datagrams = recorded(&disturbance);
    // The mailbox, the mapping, the parameters, the way to OP: many more than this.
    assert!(datagrams > 100, "only {datagrams} datagrams were recorded");
    let next = AtomicU64::new(1);
    let workers = thread::available_parallelism().map_or(1, usize::from);
    let work = || {
        loop {
            let after = next.fetch_add(1, Ordering::Relaxed);
            if after > datagrams {
                return;
            }
            let _at = At(after);
            one_bring_up(after, &disturbance);
        }
    };
    thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(work);
        }
    });
    datagrams
}

fn one_bring_up(after: u64, disturbance: &Disturbance) {
    let line = disturbance.line();
    line.arm(after, 0, &[emergency(after)]);
    (disturbance.lost)(after)
        .into_iter()
        .for_each(|loss| line.lose(loss));
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
    // Emergencies overtake answers: with this one, whatever was asked for again has come as well.
    rig.expect(0, &[]);
}

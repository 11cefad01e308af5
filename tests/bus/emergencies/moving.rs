//! One emergency after each datagram of a move, from enabling to disabling, with SDO transfers beside the cycle.

use std::{cell::Cell, thread, time::Duration};

use servocrab::{
    Axis, AxisConfig, DriveConfig, Network, Outcome, Referencing, SetPoint, coe::SdoHandle, drives,
    ds402::State,
};
use servocrab_sim::{Segment, personality::Servo};
use smol::future::zip;

use super::line::{At, Line, Loss, MS, Rig, emergency};

/// A mailbox so short that the simulated drive's text at 5F00h goes in segments.
const MAILBOX: u16 = 64;
const NOTE: u16 = 0x5F00;
const NOTE_BYTES: u8 = 100;

#[test]
fn an_emergency_after_any_datagram_of_a_move_is_delivered_and_the_move_is_done() {
    let (datagrams, moves, transfers) =
        after_datagrams((1..).step_by(every()), Duration::ZERO, |_| None);
    assert!(datagrams > 100, "only {datagrams} datagrams");
    assert!(transfers > 10 * moves, "only {transfers} transfers");
    println!("{datagrams} datagrams, {moves} moves, {transfers} SDO transfers beside them");
}

/// After each datagram one of the next four answers is lost, and after two thirds of them one of the next two requests.
#[test]
fn an_emergency_in_a_move_is_delivered_once_though_any_of_the_next_four_frames_is_lost() {
    thread::scope(|scope| {
        for behind in 1..=4 {
            scope.spawn(move || {
                let places = (behind..).step_by(3 * every());
                after_datagrams(places, Duration::ZERO, |after| {
                    Some(Loss::Answer(after + behind))
                })
            });
        }
        for behind in 1..=2 {
            scope.spawn(move || {
                let places = (behind..).step_by(3 * every());
                after_datagrams(places, Duration::ZERO, |after| {
                    Some(Loss::Request(after + behind))
                })
            });
        }
    });
}

#[test]
fn an_emergency_between_any_request_and_its_late_answer_in_a_move_is_delivered() {
    let late = Duration::from_micros(400);
    let (datagrams, moves, transfers) = after_datagrams((1..).step_by(every()), late, |_| None);
    println!("{datagrams} datagrams, {moves} moves, {transfers} transfers over a slow mailbox");
}

/// Every eleventh datagram; `EMERGENCY_EVERY=n` takes every nth.
fn every() -> usize {
    let every = std::env::var("EMERGENCY_EVERY").ok();
    every.map_or(11, |every| every.parse().unwrap())
}

/// A move for each of these of its datagrams, on a drive that takes this long over each message, with an emergency after it and the
/// frame lost that `lost` gives for its number. Gives the number of datagrams, of moves, and of SDO transfers in all moves.
fn after_datagrams(
    places: impl Iterator<Item = u64>,
    delay: Duration,
    lost: impl Fn(u64) -> Option<Loss>,
) -> (u64, u64, u64) {
    let mut drive = Servo::akd2g().mailbox_bytes(MAILBOX).build();
    drive.set_mailbox_delay(delay);
    let line = Line::new(Segment::new().with(drive));
    let config = DriveConfig::new(drives::akd2g())
        .axis(AxisConfig::new("x").referencing(Referencing::UnreferencedMovesAllowed))
        .axis(AxisConfig::new("y").referencing(Referencing::UnreferencedMovesAllowed));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config));
    let axis = rig.net.axis("x").unwrap();
    let sdo = rig.net.sdo(0).unwrap();
    let mut target = 0;
    let mut transfers = 0;
    for (moves, after) in (0..).zip(places) {
        let _at = At(after);
        target = 20 - target;
        line.arm(after, 0, &[emergency(after)]);
        lost(after).into_iter().for_each(|loss| line.lose(loss));
        transfers += rig.until(a_move_beside_transfers(&axis, &sdo, target));
        if line.is_armed() {
            // The whole move took fewer datagrams: each had its turn.
            assert_eq!(rig.net.statistics().wrong_working_counters, 0);
            return (after - 1, moves, transfers);
        }
        rig.expect(0, &[emergency(after)]);
    }
    unreachable!("the numbers go on");
}

/// Moves there and disables, while values are read and a text is written and read back. Gives the number of transfers.
async fn a_move_beside_transfers(axis: &Axis, sdo: &SdoHandle, target: i32) -> u64 {
    let moving = Cell::new(true);
    let whole_move = async {
        axis.enable().await.unwrap();
        let mode = axis.profile_position().await.unwrap();
        let set_point = SetPoint::new()
            .velocity(100_000)
            .acceleration(10_000_000)
            .deceleration(10_000_000);
        let motion = mode.move_abs(target, set_point).await.unwrap();
        let outcome = motion.done().await.unwrap();
        assert!(
            matches!(outcome, Outcome::Reached { position } if (position - target).abs() < 20),
            "{outcome:?}"
        );
        axis.disable().await.unwrap();
        moving.set(false);
    };
    // Two at a time, so that the next request waits already when an answer comes.
    let notes = async {
        let mut transfers = 0;
        while moving.get() {
            let text: Vec<u8> = (0..NOTE_BYTES).map(|n| n ^ transfers as u8).collect();
            sdo.write_bytes(NOTE, 0, text.clone()).await.unwrap();
            assert_eq!(sdo.read_bytes(NOTE, 0).await.unwrap(), text);
            transfers += 2;
        }
        transfers
    };
    let vendors = async {
        let mut transfers = 0;
        while moving.get() {
            assert_eq!(sdo.read_bytes(0x1018, 1).await.unwrap(), [0x6A, 0, 0, 0]);
            transfers += 1;
        }
        transfers
    };
    let transfers = zip(notes, vendors);
    let ((), (notes, vendors)) = zip(whole_move, transfers).await;
    assert_ne!(axis.status().state, State::OperationEnabled);
    notes + vendors
}

#[test]
fn an_emergency_while_nothing_else_goes_through_the_mailbox_is_delivered_within_two_looks() {
    let line = Line::new(Segment::new().with(Servo::akd2g().build()));
    let config = DriveConfig::new(drives::akd2g())
        .axis(AxisConfig::new("x").referencing(Referencing::UnreferencedMovesAllowed))
        .axis(AxisConfig::new("y").referencing(Referencing::UnreferencedMovesAllowed));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config));
    let emergencies = rig.emergencies(0);
    for number in 0..50 {
        // Another place between two looks each time.
        rig.run_for(30 * MS + number as u32 * MS / 5);
        let now = rig.bus.now();
        line.inject(0, &[emergency(number)], now);
        let got = rig.until(emergencies.next()).unwrap().emergency().unwrap();
        assert_eq!(got.emergency, emergency(number));
        let took = got.at - now;
        assert!(took < 20 * MS, "{took:?}");
    }
    rig.expect(0, &[]);
}

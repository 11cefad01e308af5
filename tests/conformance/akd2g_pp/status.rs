//! "Status" and "Mode-Specific Statusword Bits".

use servocrab::SetPoint;
use servocrab::ds402::{Mode, State as Shown, Statusword};
use servocrab::{
    Failure, Referencing,
    axis::{Command, Completion, Delivery, WaitingFor},
};
use servocrab::{HomingMethod, homing::HomingCommand};
use servocrab_sim::ds402::{AckFault, AckPolicy, Behaviour, Outcome, Plant, ReachedPolicy, State};

use super::profile::akd2g;
use crate::bench::{Drive, assert_near};
use crate::common::Rig;

/// The actual position comes this much later than the demand: 62 counts at the end of a ramp of 50 000 counts/s².
fn lagging(reached: ReachedPolicy) -> Behaviour {
    Behaviour {
        actual_lag_cycles: 50,
        reached,
        ..Behaviour::akd2g()
    }
}

fn distance_to(drive: &Drive, target: i64) -> i64 {
    (drive.axis.position() - target).abs()
}

#[test]
pub(super) fn drive_tells_fault_warning_power_and_progress() {
    let mut drive = akd2g();
    assert_eq!(drive.axis.statusword() & 0x17, 0x17, "power stage on");
    assert!(!drive.bit(7));
    drive.axis.set_warning(true);
    drive.run(1);
    assert!(drive.bit(7), "warning");
    drive.start(0x0F, 5_000);
    assert!(drive.bit(12), "acknowledge");
    drive.settle();
    assert!(drive.bit(10), "target reached");
    drive.axis.inject_fault(0x7305);
    drive.run(100);
    assert!(drive.bit(3), "fault");
    assert!(!drive.bit(2), "power stage off");
}

#[test]
pub(super) fn library_shows_fault_warning_power_and_progress() {
    let mut rig = Rig::ideal_enabled();
    rig.drive.set_warning(true);
    rig.run(2);
    let word = rig.core.snapshot().statusword;
    assert!(word.contains(Statusword::WARNING | Statusword::VOLTAGE_ENABLED));
    assert_eq!(word.state(), Shown::OperationEnabled);
    rig.drive.inject_fault(0x7305);
    rig.run(100);
    let word = rig.core.snapshot().statusword;
    assert!(word.contains(Statusword::FAULT));
    assert_eq!(word.state(), Shown::Fault);
}

/// Homes where it stands (method 37).
const HERE: i64 = 37;

#[test]
pub(super) fn drive_tells_that_home_is_attained() {
    let mut drive = akd2g();
    drive.set(0x6098, HERE);
    drive.set(0x6060, 6);
    drive.word(0x0F);
    drive.run(3);
    assert!(!drive.bit(12), "not before");
    drive.word(0x1F);
    drive.run_until(100, |drive| drive.bit(12));
    assert!(drive.bit(10) && !drive.bit(13));
    assert!(drive.axis.is_referenced());
}

#[test]
pub(super) fn library_knows_that_home_is_attained() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.referencing = Referencing::ByHoming;
    })
    .ideal();
    rig.drive.set(0x6098, 0, HERE).expect("the method");
    rig.enable();
    let refused = rig.abs(5_000, SetPoint::new());
    assert_eq!(rig.outcome(refused), Some(Err(Failure::NotReferenced)));
    let select = rig.send(Command::SelectMode(Mode::Homing));
    assert!(rig.finish(select).is_ok());
    let home = rig.send(Command::Home(HomingCommand {
        method: HomingMethod::CURRENT_POSITION,
        offset: None,
        until: None,
    }));
    assert!(rig.finish(home).is_ok(), "{:?}", rig.outcome(home));
    let select = rig.send(Command::SelectMode(Mode::ProfilePosition));
    assert!(rig.finish(select).is_ok());
    let id = rig.abs(5_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 5_000 }));
}

#[test]
pub(super) fn drive_is_within_its_window_when_it_says_reached() {
    let mut drive = Drive::enabled(lagging(Behaviour::akd2g().reached));
    drive.set(0x6067, 10);
    drive.start(0x0F, 20_000);
    drive.run_until(5_000, |drive| drive.get(0x6062) == 20_000);
    assert!(distance_to(&drive, 20_000) > 10, "still on its way");
    assert!(!drive.bit(10));
    drive.run_until(200, |drive| drive.bit(10));
    assert!(distance_to(&drive, 20_000) <= 10);
}

#[test]
pub(super) fn library_takes_a_bit_10_elsewhere_for_no_arrival() {
    // This drive sets bit 10 for an axis that its shaft's block keeps away from the target.
    let mut rig = Rig::new(lagging(ReachedPolicy::TrajectoryEnd), |_| {}).ideal();
    rig.enable();
    let id = rig.abs(20_000, SetPoint::new());
    rig.run_until(5_000, |rig| rig.drive.get(0x6062, 0) >= Some(19_000));
    rig.drive.disturbances().blocked = true;
    assert!(matches!(
        rig.finish(id),
        Err(Failure::MissedTarget { target: 20_000, .. })
    ));
    assert!(rig.statusword().contains(Statusword::TARGET_REACHED));
}

#[test]
pub(super) fn drive_can_be_set_to_another_meaning_of_reached() {
    let mut cycles = [0; 2];
    let policies = [ReachedPolicy::TrajectoryEnd, ReachedPolicy::WindowAfterEnd];
    for (cycles, policy) in cycles.iter_mut().zip(policies) {
        let mut drive = Drive::enabled(lagging(policy));
        drive.start(0x0F, 20_000);
        drive.run_until(5_000, |drive| drive.get(0x6062) == 20_000);
        drive.run_until(500, |drive| {
            *cycles += 1;
            drive.bit(10)
        });
    }
    assert!(cycles[0] <= 10, "at the trajectory's end: {cycles:?}");
    assert!(cycles[1] > 20, "within the window: {cycles:?}");
}

#[test]
pub(super) fn library_reports_the_arrival_with_either_meaning() {
    for policy in [
        ReachedPolicy::TrajectoryEnd,
        ReachedPolicy::WindowAfterEnd,
        ReachedPolicy::Window,
    ] {
        let mut rig = Rig::new(lagging(policy), |_| {}).ideal();
        rig.enable();
        let id = rig.abs(20_000, SetPoint::new().deceleration(50_000));
        let Ok(Completion::Reached { position }) = rig.finish(id) else {
            panic!("{policy:?}: {:?}", rig.outcome(id));
        };
        assert!((position - 20_000).abs() <= 10, "{policy:?}: {position}");
    }
}

#[test]
pub(super) fn drive_shows_0_before_the_target() {
    let mut drive = akd2g();
    for target in [20_000, 10_000] {
        drive.start(0x0F, target);
        drive.run_until(5_000, |drive| {
            let arrived = drive.axis.position() == target;
            assert!(arrived || !drive.bit(10), "{}", drive.axis.position());
            arrived
        });
        drive.settle();
        drive.run(5);
    }
}

#[test]
pub(super) fn library_reports_nothing_before_bit_10() {
    let mut rig = Rig::ideal_enabled();
    rig.drive.set(0x6068, 0, 300).expect("the window's time");
    let id = rig.abs(20_000, SetPoint::new());
    rig.run_until(5_000, |rig| rig.drive.position() == 20_000);
    rig.run(280);
    assert!(!rig.statusword().contains(Statusword::TARGET_REACHED));
    assert_eq!(rig.outcome(id), None, "at the target, and not yet settled");
    assert!(rig.finish(id).is_ok());
}

#[test]
pub(super) fn drive_shows_0_while_a_halt_decelerates() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(300);
    drive.word(0x11F);
    drive.run(100);
    assert_near(drive.axis.velocity(), 5_000.0);
    assert!(!drive.bit(10));
}

#[test]
pub(super) fn library_ends_a_halt_no_earlier_than_bit_10() {
    let mut rig = Rig::ideal_enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    let halt = rig.send(Command::Halt);
    rig.run(10);
    while rig.outcome(halt).is_none() {
        rig.cycle();
    }
    assert!(rig.outcome(halt).is_some_and(|halt| halt.is_ok()));
    assert!(rig.statusword().contains(Statusword::TARGET_REACHED));
    assert_eq!(rig.drive.velocity(), 0.0);
}

#[test]
pub(super) fn drive_shows_1_at_the_target() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(1);
    drive.run_until(5_000, |drive| drive.bit(10));
    assert_eq!(drive.axis.position(), 20_000);
    drive.lower();
    drive.run(100);
    assert!(drive.bit(10), "and stays");
}

#[test]
pub(super) fn library_reports_the_arrival_with_bit_10() {
    let mut rig = Rig::ideal_enabled();
    let id = rig.abs(20_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(5);
    rig.run_until(5_000, |rig| {
        rig.statusword().contains(Statusword::TARGET_REACHED)
    });
    // Two of the drive's cycles have to show it.
    rig.run(3);
    assert_eq!(
        rig.outcome(id),
        Some(Ok(Completion::Reached { position: 20_000 }))
    );
}

/// A soft axis, of which the drive says from 2 000 counts/s on downwards that its velocity has dropped to AXIS#.ZEROV.
fn soft() -> Plant {
    Plant {
        bandwidth_hz: 3.0,
        standstill_velocity: 2_000,
        ..Plant::ideal()
    }
}

#[test]
pub(super) fn drive_shows_1_at_the_end_of_a_halt() {
    let mut drive = akd2g();
    drive.axis.set_plant(soft());
    drive.start(0x0F, 20_000);
    drive.run(600);
    assert!(drive.get(0x606C) > 5_000);
    drive.word(0x11F);
    drive.run_until(2_000, |drive| drive.bit(10));
    let speed = drive.get(0x606C).abs();
    assert!(
        (1..=2_000).contains(&speed),
        "{speed}: a threshold, not zero"
    );
    assert!(drive.moves(), "it comes to rest after that");
    drive.word(0x1F);
    assert!(!drive.bit(10), "the target is still to be reached");
}

#[test]
pub(super) fn library_takes_no_halt_for_an_arrival() {
    let mut rig = Rig::akd2g().on_plant(soft());
    rig.enable();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(700);
    let halt = rig.send(Command::Halt);
    rig.run(10);
    rig.run_until(2_000, |rig| {
        rig.statusword().contains(Statusword::TARGET_REACHED)
    });
    assert!(
        rig.drive
            .get(0x606C, 0)
            .is_some_and(|speed| speed.abs() > 500)
    );
    rig.run(5);
    assert_eq!(rig.outcome(halt), None, "bit 10 comes while it still moves");
    assert!(rig.finish(halt).is_ok());
    assert!(rig.statusword().contains(Statusword::TARGET_REACHED));
    let stands_at = rig.drive.get(0x6064, 0).expect("6064h");
    rig.run(500);
    let still = rig.drive.get(0x6064, 0).expect("6064h");
    assert!(
        (still - stands_at).abs() <= 100,
        "{stands_at}, then {still}"
    );
    assert_eq!(rig.outcome(id), None);
}

#[test]
pub(super) fn drive_waits_for_a_set_point_with_bit_12_low() {
    let mut drive = akd2g();
    for n in 1..=3 {
        assert!(!drive.bit(12));
        drive.start(0x0F, 1_000 * n);
        assert!(drive.bit(12), "taken");
        drive.lower();
        drive.settle();
    }
    assert_eq!(drive.outcomes(), [Outcome::Reached; 3]);
}

#[test]
pub(super) fn library_raises_bit_4_only_on_a_low_bit_12() {
    let mut rig = Rig::ideal_enabled();
    let mut low = false;
    rig.abs(20_000, SetPoint::new());
    rig.abs(-20_000, SetPoint::new());
    rig.drive.disturbances().ack = AckFault::StuckHigh;
    for n in 0..400 {
        if n == 200 {
            rig.drive.disturbances().ack = AckFault::None;
            low = true;
        }
        rig.cycle();
        assert!(low || rig.word() & 0x10 == 0, "cycle {n}");
    }
    assert_eq!(rig.ledger().len(), 2);
}

#[test]
pub(super) fn drive_accepts_an_overwrite_while_one_is_in_process() {
    let mut drive = akd2g();
    drive.start(0x2F, 20_000);
    drive.run(300);
    assert!(drive.bit(12));
    assert_eq!(drive.outcomes(), [Outcome::Active], "still in process");
    drive.set(0x607A, 5_000);
    drive.word(0x2F);
    drive.word(0x3F);
    assert!(drive.bit(12));
    assert_eq!(drive.outcomes(), [Outcome::Replaced, Outcome::Active]);
}

#[test]
pub(super) fn library_overwrites_a_set_point_in_process() {
    let mut rig = Rig::ideal_enabled();
    let first = rig.abs(100_000, SetPoint::new());
    let second = rig.abs(5_000, SetPoint::new());
    rig.run(100);
    assert!(rig.accepted(second), "long before the first could arrive");
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
}

#[test]
pub(super) fn drive_keeps_bit_12_with_bit_4_after_the_move() {
    let mut drive = akd2g();
    drive.start(0x0F, 5_000);
    drive.settle();
    drive.run(1_000);
    assert!(drive.bit(12));
    assert!(drive.bit(10));
}

#[test]
pub(super) fn library_needs_no_acknowledge_before_the_arrival() {
    let mut rig = Rig::ideal_enabled();
    rig.drive.disturbances().ack_delay_cycles = 300;
    let id = rig.abs(1_000, SetPoint::new());
    rig.run_until(300, |rig| rig.drive.position() == 1_000);
    assert!(!rig.accepted(id));
    assert_eq!(rig.word() & 0x10, 0x10);
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 1_000 }));
    assert_eq!(rig.ledger().len(), 1);
}

#[test]
pub(super) fn drive_drops_bit_12_with_bit_4() {
    let mut drive = akd2g();
    drive.start(0x0F, 5_000);
    assert!(drive.bit(12));
    drive.lower();
    assert!(!drive.bit(12), "during the move");
    drive.settle();
    // And with both places taken: it follows bit 4 alone.
    drive.start(0x0F, 10_000);
    drive.start(0x0F, 15_000);
    assert!(drive.bit(12));
    drive.lower();
    assert!(!drive.bit(12));
    assert_eq!(
        drive.outcomes()[1..],
        [Outcome::Active, Outcome::Queued],
        "with a full buffer too"
    );
}

#[test]
pub(super) fn library_says_so_where_bit_12_does_not_fall() {
    let behaviour = Behaviour {
        ack: AckPolicy::StickyAtEnable,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {}).ideal();
    rig.enable();
    let id = rig.abs(1_000, SetPoint::new());
    rig.run(520);
    assert!(matches!(
        rig.outcome(id),
        Some(Err(Failure::Timeout {
            waiting_for: WaitingFor::AcknowledgeLow,
            delivery: Delivery::NotSent,
            ..
        }))
    ));
}

#[test]
pub(super) fn drive_has_bit_13_low_without_following_error() {
    let mut drive = Drive::enabled(lagging(ReachedPolicy::WindowAfterEnd));
    drive.set(0x6065, 1_000);
    drive.start(0x0F, 20_000);
    for _ in 0..3_000 {
        drive.run(1);
        assert!(!drive.bit(13), "500 counts behind, 1 000 allowed");
    }
    assert_eq!(drive.axis.position(), 20_000);
}

#[test]
pub(super) fn drive_faults_with_bit_13_on_following_error() {
    let mut drive = akd2g();
    drive.set(0x6065, 1_000);
    drive.start(0x0F, 20_000);
    drive.run(300);
    drive.axis.disturbances().blocked = true;
    drive.run_until(1_000, |drive| drive.state() == State::Fault);
    assert!(drive.bit(13));
    assert_eq!(drive.get(0x603F), 0x8611, "following error of DS402");
}

#[test]
pub(super) fn library_ends_a_move_with_the_following_error() {
    let mut rig = Rig::ideal_enabled();
    rig.drive.set(0x6065, 0, 1_000).expect("the window");
    let id = rig.abs(100_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    rig.drive.disturbances().blocked = true;
    rig.run(500);
    assert!(matches!(rig.outcome(id), Some(Err(Failure::Fault { .. }))));
    assert!(rig.statusword().contains(Statusword::FOLLOWING_ERROR));
}

//! Two axes that carry one thing: whatever happens to one, the stop of the other is in the next frame.

use core::sync::atomic::Ordering;

use servocrab::{
    AxisError, Failure, HomingMethod, HomingParameters, Outcome, Referencing, SetPoint,
    axis::{AxisErrorKind, Pair, PairError, PairMove, SkewReport},
    ds402::State,
};
use servocrab_sim::ds402::{self, AckFault, Cause};

use crate::machine::{Machine, Task, Variant, beside_its_switch, kept, lock, output};

/// Beyond them there is a warning, and a stop.
const WARN: i32 = 400;
const STOP: i32 = 1_500;
const TARGET: i32 = 60_000;

fn paired() -> (Machine, Pair) {
    paired_of(&Variant::default(), WARN, STOP)
}

fn paired_of(variant: &Variant, warn: i32, stop: i32) -> (Machine, Pair) {
    let mut machine = Machine::of(2, variant);
    let pairing = machine.axis(0).pair_with(machine.axis(1));
    let pair = pairing.skew(warn, stop).unwrap();
    machine.finish(pair.enable()).unwrap();
    (machine, pair)
}

fn moving(machine: &mut Machine, pair: &Pair) -> PairMove {
    let set_point = SetPoint::new().velocity(50_000).acceleration(500_000);
    let motion = machine.finish(pair.move_abs(TARGET, set_point)).unwrap();
    machine.run(200);
    motion
}

/// Bit 8, or quick stop.
fn stops(word: u16) -> bool {
    word & 0x0100 != 0 || word & 0x0004 == 0
}

fn last_word(machine: &Machine, axis: usize) -> u16 {
    *machine.stations[axis].words.last().unwrap()
}

fn shaft(machine: &Machine, axis: usize) -> i64 {
    lock(&machine.stations[axis].drive).position()
}

/// What the axis' own drive did with its last set-point.
fn fate(machine: &Machine, axis: usize) -> ds402::Outcome {
    let drive = lock(&machine.stations[axis].drive);
    drive.ledger().last().unwrap().outcome
}

/// Runs until the axis is not driven, is halted or lost, and one frame more.
fn run_until_it_falls(machine: &mut Machine, axis: usize) {
    for _ in 0..2_000 {
        let seen = machine.stations[axis].core.snapshot();
        let is_told = stops(last_word(machine, axis));
        if seen.state != State::OperationEnabled || seen.lost || is_told {
            machine.cycle();
            return;
        }
        assert!(!stops(last_word(machine, 1 - axis)), "nothing has happened");
        machine.cycle();
    }
    panic!("it goes on");
}

fn pair_error(error: &AxisError) -> &PairError {
    match &error.kind {
        AxisErrorKind::Pair(error) => error,
        _ => panic!("{error}"),
    }
}

#[test]
fn both_start_in_one_frame_and_arrive() {
    let (mut machine, pair) = paired();
    let motion = machine
        .finish(pair.move_abs(TARGET, SetPoint::new()))
        .unwrap();
    for outcome in machine.finish(motion.done()).unwrap() {
        assert!(matches!(outcome, Outcome::Reached { .. }));
        assert!((outcome.position() - TARGET).abs() <= 10);
    }
    let rises = [0, 1].map(|axis| {
        let words = &machine.stations[axis].words;
        words.iter().position(|word| word & 0x10 != 0).unwrap()
    });
    assert_eq!(rises[0], rises[1]);
    assert!(pair.skew().abs() <= 20);
    assert!(machine.groups.next_skew_report().is_none());
}

/// What has happened to the second axis, in the middle of a move.
type Happens = fn(&mut Machine);
/// Whether this is what its move says of that.
type IsTold = fn(&AxisError) -> bool;

#[test]
fn whatever_happens_to_one_the_stop_of_the_other_is_in_the_next_frame() {
    let cases: [(&str, Happens, IsTold); 8] = [
        (
            "a fault",
            |machine| lock(&machine.stations[1].drive).inject_fault(0x7500),
            |error| matches!(error.failure(), Some(Failure::Fault { .. })),
        ),
        (
            "its enable input",
            |machine| lock(&machine.stations[1].drive).set_inhibited(true),
            |error| matches!(error.failure(), Some(Failure::Disabled { .. })),
        ),
        (
            "its link",
            |machine| machine.stations[1].silent = true,
            |error| matches!(error.failure(), Some(Failure::BusLost { .. })),
        ),
        (
            "no voltage",
            |machine| lock(&machine.stations[1].drive).set_voltage(false),
            |error| error.failure().is_some(),
        ),
        (
            "a stop",
            |machine| machine.axis(1).stop_handle().stop(),
            |error| {
                matches!(
                    error.failure(),
                    Some(Failure::QuickStopped { .. } | Failure::Halted { .. })
                )
            },
        ),
        (
            "a quick stop",
            |machine| machine.axis(1).stop_handle().quick_stop(),
            |error| matches!(error.failure(), Some(Failure::QuickStopped { .. })),
        ),
        (
            "a halt",
            |machine| machine.axis(1).stop_handle().halt(),
            |error| matches!(error.failure(), Some(Failure::Halted { .. })),
        ),
        (
            "a jam with a fault",
            |machine| {
                let mut drive = lock(&machine.stations[1].drive);
                drive.set(0x6065, 0, 400).unwrap();
                drive.disturbances().blocked = true;
            },
            |error| matches!(error.failure(), Some(Failure::Fault { .. })),
        ),
    ];
    for (name, happens, is_told) in cases {
        let (mut machine, pair) = paired_of(&Variant::default(), 1_000_000, 2_000_000);
        let motion = moving(&mut machine, &pair);
        happens(&mut machine);
        run_until_it_falls(&mut machine, 1);
        assert!(stops(last_word(&machine, 0)), "{name}");
        // One that has failed takes its partner down by quick stop.
        let is_asked_for = ["a stop", "a halt"].contains(&name);
        assert!(
            is_asked_for || last_word(&machine, 0) & 0x0004 == 0,
            "{name}"
        );
        let error = machine.finish(motion.done()).unwrap_err();
        assert!(is_told(&error), "{name}: {error}");
        machine.run(3_000);
        let at = shaft(&machine, 0);
        assert!(at < i64::from(TARGET) - 20_000, "{name}: it went to {at}");
        assert!(lock(&machine.stations[0].drive).stands(), "{name}");
        if name != "a halt" {
            let expected = ds402::Outcome::Discarded(Cause::QuickStop);
            assert_eq!(fate(&machine, 0), expected, "{name}");
        }
    }
}

#[test]
fn one_that_jams_stops_both_as_soon_as_the_skew_is_beyond_its_limit() {
    let (mut machine, pair) = paired();
    let motion = moving(&mut machine, &pair);
    lock(&machine.stations[1].drive).disturbances().blocked = true;
    let mut reports = Vec::new();
    while !stops(last_word(&machine, 0)) {
        assert!(pair.skew() <= STOP + 60, "it is stopped too late");
        machine.cycle();
        reports.extend(machine.groups.next_skew_report());
    }
    assert!(stops(last_word(&machine, 1)), "both in one frame");
    let error = machine.finish(motion.done()).unwrap_err();
    assert!(
        matches!(pair_error(&error), PairError::Skew { .. }),
        "{error}"
    );
    let [
        SkewReport { stopped: false, .. },
        SkewReport {
            stopped: true,
            skew,
            ..
        },
    ] = &reports[..]
    else {
        panic!("{reports:?}");
    };
    assert!(*skew > f64::from(STOP) && *skew < f64::from(STOP + 60));
    machine.run(1_000);
    // Nothing is sent while they are so far apart.
    machine.finish(pair.enable()).unwrap();
    let sent = lock(&machine.stations[0].drive).ledger().len();
    let again = machine.finish(pair.move_rel(100, SetPoint::new()));
    assert!(matches!(
        pair_error(&again.unwrap_err()),
        PairError::Skew { .. }
    ));
    machine.run(100);
    assert_eq!(lock(&machine.stations[0].drive).ledger().len(), sent);
}

/// An elastic thing holds the second axis back, more and more.
#[test]
fn a_skew_that_grows_slowly_is_warned_of_once_before_it_stops_both() {
    let (mut machine, pair) = paired();
    lock(&machine.stations[1].drive).put_wall(10_000, 0.5);
    let motion = moving(&mut machine, &pair);
    let error = machine.finish(motion.done()).unwrap_err();
    assert!(
        matches!(pair_error(&error), PairError::Skew { .. }),
        "{error}"
    );
    let warned = machine.groups.next_skew_report().unwrap();
    assert!(!warned.stopped && warned.skew < f64::from(STOP), "{warned}");
    assert!(machine.groups.next_skew_report().unwrap().stopped);
    assert!(machine.groups.next_skew_report().is_none());
    for axis in [0, 1] {
        let expected = ds402::Outcome::Discarded(Cause::QuickStop);
        assert_eq!(fate(&machine, axis), expected);
    }
}

#[test]
fn a_late_acknowledge_alone_stops_nothing() {
    let (mut machine, pair) = paired();
    lock(&machine.stations[1].drive)
        .disturbances()
        .ack_delay_cycles = 30;
    let motion = moving(&mut machine, &pair);
    machine.finish(motion.done()).unwrap();
    assert!((shaft(&machine, 0) - i64::from(TARGET)).abs() <= 10);
}

#[test]
fn one_that_never_acknowledges_stops_the_other() {
    let never: [fn(&mut ds402::Disturbances); 2] = [
        |drive| drive.ack = AckFault::Never,
        |drive| drive.deaf_to_bit_4 = true,
    ];
    for habit in never {
        for (warn, stop) in [(WARN, STOP), (1_000_000, 2_000_000)] {
            let (mut machine, pair) = paired_of(&Variant::default(), warn, stop);
            habit(lock(&machine.stations[1].drive).disturbances());
            let slow = SetPoint::new().velocity(20_000);
            let mut started = Task::new(pair.move_abs(TARGET, slow));
            machine.run_beside(&mut started, 20);
            // The program does nothing more: the bus thread stops both.
            machine.run(1_500);
            assert!(lock(&machine.stations[0].drive).stands());
            let at = shaft(&machine, 0);
            assert!(at < 15_000, "it went to {at}");
            assert!(stops(last_word(&machine, 0)) && stops(last_word(&machine, 1)));
            machine.finish_task(&mut started).unwrap_err();
        }
    }
}

#[test]
fn a_pair_that_is_dropped_in_motion_stops_and_one_handle_that_is_dropped_does_nothing() {
    let (mut machine, pair) = paired();
    let motion = moving(&mut machine, &pair);
    drop(machine.axis(1));
    machine.run(50);
    assert!(!stops(last_word(&machine, 0)));
    drop(pair);
    machine.run(50);
    assert!(!stops(last_word(&machine, 0)), "its move holds it");
    drop(motion);
    machine.cycle();
    assert!(stops(last_word(&machine, 0)) && stops(last_word(&machine, 1)));
    machine.run(2_000);
    let apart = shaft(&machine, 0) - shaft(&machine, 1);
    assert!(apart.abs() < 100 && shaft(&machine, 0) < 40_000, "{apart}");
    // The axes are free again.
    let axis = machine.axis(1);
    machine.finish(axis.enable()).unwrap();
    machine.finish(axis.profile_position()).unwrap();
}

#[test]
fn stops_of_the_pair_are_of_both_in_one_frame_also_where_a_cycle_takes_one_alone() {
    for between in [false, true] {
        let (mut machine, pair) = paired();
        let motion = moving(&mut machine, &pair);
        let mut halt = Task::new(pair.halt());
        if between {
            // The cycle has looked at the first axis already.
            machine.cycle_between(1, || assert!(halt.poll().is_none()));
        } else {
            assert!(halt.poll().is_none());
            machine.cycle();
        }
        let halted = [0, 1].map(|axis| last_word(&machine, axis) & 0x0100 != 0);
        assert_eq!(halted, [true; 2]);
        machine.finish_task(&mut halt).unwrap();

        let mut resume = Task::new(pair.resume());
        if between {
            machine.cycle_between(1, || assert!(resume.poll().is_none()));
        }
        machine.finish_task(&mut resume).unwrap();
        let falls = [0, 1].map(|axis| {
            let words = &machine.stations[axis].words;
            words.iter().rposition(|word| word & 0x0100 != 0).unwrap()
        });
        assert_eq!(falls[0], falls[1], "they go on in one frame");
        machine.finish(motion.done_through_halt()).unwrap();
        assert!(pair.skew().abs() <= 20);
    }
}

#[test]
fn one_axis_of_a_pair_is_not_moved_alone() {
    let (mut machine, pair) = paired();
    let one = machine.axis(0);
    let is_paired = |error: AxisError| *pair_error(&error) == PairError::Paired;
    assert!(is_paired(
        machine.finish(one.profile_position()).unwrap_err()
    ));
    assert!(is_paired(machine.finish(one.homing()).unwrap_err()));
    assert!(is_paired(machine.finish(one.resume()).unwrap_err()));
    assert!(is_paired(
        machine.finish(one.set_override(0.5)).unwrap_err()
    ));
    assert!(is_paired(machine.finish(one.stop_and_hold()).unwrap_err()));
    let twice = machine.axis(0).pair_with(machine.axis(1)).skew(1, 2);
    assert!(is_paired(twice.unwrap_err()));
    drop(pair);
    machine.cycle();
    assert!(machine.finish(one.profile_position()).is_ok());
}

#[test]
fn what_is_no_pair_is_refused() {
    let machine = Machine::new(2);
    let other = Machine::new(1);
    let refused = |one, another, warn, stop| {
        let machine: &Machine = another;
        let pairing =
            self::Machine::axis(one, 0).pair_with(machine.axis(machine.stations.len() - 1));
        let error = pairing.skew(warn, stop).unwrap_err();
        pair_error(&error).clone()
    };
    assert_eq!(refused(&other, &other, 1, 2), PairError::NotTwo);
    assert_eq!(refused(&machine, &other, 1, 2), PairError::NotTwo);
    for (warn, stop) in [(0, 5), (5, 5), (7, 5), (-2, -1)] {
        let error = refused(&machine, &machine, warn, stop);
        assert!(matches!(error, PairError::Limits { .. }), "{error}");
    }
}

/// The second axis stands 1 700 counts further from its switch than the first: more than the pair may have once it is square.
fn beside_their_switches() -> (Machine, Pair) {
    let variant = Variant {
        behaviour: ds402::Behaviour {
            machine: beside_its_switch(),
            ..ds402::Behaviour::akd2g()
        },
        referencing: Referencing::ByHoming,
        ..Variant::default()
    };
    let mut machine = Machine::of(2, &variant);
    // In the coordinates of its drive, which was switched on there.
    lock(&machine.stations[1].drive).place(1_700);
    machine.run(5);
    let pair = machine.axis(0).pair_with(machine.axis(1));
    let pair = pair.skew(WARN, STOP).unwrap();
    machine.finish(pair.enable()).unwrap();
    (machine, pair)
}

fn to_the_switch() -> [HomingParameters; 2] {
    let one = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(20_000, 2_000)
        .acceleration(500_000);
    [one; 2]
}

#[test]
fn a_pair_is_squared_by_both_switches() {
    let (mut machine, pair) = beside_their_switches();
    let homings = to_the_switch();
    let skew = machine.finish(pair.square(homings, 3_000)).unwrap();
    assert!(skew.abs() < 200, "{skew}");
    assert!(pair.status().iter().all(|status| status.referenced));
    let motion = machine.finish(pair.move_abs(3_000, SetPoint::new()));
    machine.finish(motion.unwrap().done()).unwrap();
    let ends = [0, 1].map(|axis| lock(&machine.stations[axis].drive).mechanical_position());
    assert!((ends[0] - ends[1]).abs() <= 20, "they are square: {ends:?}");
}

#[test]
fn a_squaring_beyond_its_own_limit_stops_both_and_the_pair_is_not_square() {
    let (mut machine, pair) = beside_their_switches();
    let mut squaring = Task::new(pair.square(to_the_switch(), 500));
    let result = machine.finish_task(&mut squaring);
    let error = result.unwrap_err();
    let PairError::Skew { limit, .. } = pair_error(&error) else {
        panic!("{error}");
    };
    assert_eq!(*limit, 500.0);
    drop(squaring);
    machine.run(2_000);
    for station in &machine.stations {
        assert!(lock(&station.drive).stands());
    }
    machine.finish(pair.enable()).unwrap();
    let moved = machine.finish(pair.move_rel(100, SetPoint::new()));
    assert_eq!(*pair_error(&moved.unwrap_err()), PairError::NotSquare);
    let skew = machine.finish(pair.square(to_the_switch(), 3_000));
    assert!(skew.is_ok(), "{skew:?}");
}

#[test]
fn a_squaring_in_which_one_fails_or_that_is_dropped_stops_both() {
    for dropped in [false, true] {
        let (mut machine, pair) = beside_their_switches();
        let mut squaring = Task::new(pair.square(to_the_switch(), 3_000));
        machine.run_beside(&mut squaring, 120);
        if dropped {
            drop(squaring);
            machine.cycle();
        } else {
            lock(&machine.stations[1].drive).inject_fault(0x7500);
            run_until_it_falls(&mut machine, 1);
        }
        assert!(stops(last_word(&machine, 0)));
        machine.run(1_000);
        assert!(lock(&machine.stations[0].drive).stands());
        let at = lock(&machine.stations[0].drive).mechanical_position();
        assert!(at > 15_000, "it did not go on to its switch: {at}");
    }
}

/// The first axis has arrived, and the second, whose way was longer, has not.
fn one_has_arrived(machine: &mut Machine) -> (Pair, PairMove) {
    let pairing = machine.axis(0).pair_with(machine.axis(1));
    let pair = pairing.skew(1_000_000, 2_000_000).unwrap();
    lock(&machine.stations[1].drive).place(-30_000);
    machine.run(5);
    machine.finish(pair.enable()).unwrap();
    let motion = moving(machine, &pair);
    while machine.stations[0].core.snapshot().has_set_point {
        machine.cycle();
    }
    // Until it stands.
    machine.run(100);
    assert!(machine.stations[1].core.snapshot().has_set_point);
    (pair, motion)
}

#[test]
fn a_stop_of_the_one_that_has_arrived_is_that_of_the_other() {
    let cases: [fn(&mut Machine, &Pair); 4] = [
        |_, pair| pair.stop_handle().stop(),
        |_, pair| pair.stop_handle().halt(),
        |_, pair| pair.stop_handle().quick_stop(),
        |machine, _| assert!(Task::new(machine.axis(0).stop()).poll().is_none()),
    ];
    for (case, stop) in cases.into_iter().enumerate() {
        let mut machine = Machine::new(2);
        let (pair, motion) = one_has_arrived(&mut machine);
        assert!(!stops(last_word(&machine, 1)));
        stop(&mut machine, &pair);
        machine.cycle();
        assert!(stops(last_word(&machine, 1)), "case {case}");
        let error = machine.finish(motion.done()).unwrap_err();
        assert!(
            matches!(
                error.failure(),
                Some(Failure::QuickStopped { .. } | Failure::Halted { .. })
            ),
            "case {case}: {error}"
        );
        machine.run(3_000);
        let at = shaft(&machine, 1);
        assert!(at < i64::from(TARGET) - 5_000, "case {case}: at {at}");
        assert!(lock(&machine.stations[1].drive).stands());
    }
}

#[test]
fn a_stop_of_one_while_a_squaring_writes_its_parameters_lets_neither_home() {
    for stopped in [0, 1] {
        let (mut machine, pair) = beside_their_switches();
        for station in &machine.stations {
            station.sdo.slow_writes.store(true, Ordering::Relaxed);
        }
        let mut squaring = Task::new(pair.square(to_the_switch(), 3_000));
        kept(&mut machine, &mut squaring);
        machine.axis(stopped).stop_handle().stop();
        let error = machine.finish_task(&mut squaring).unwrap_err();
        assert!(
            matches!(error.failure(), Some(Failure::QuickStopped { .. })),
            "{error}"
        );
        for station in &machine.stations {
            assert!(lock(&station.drive).homings().is_empty());
        }
    }
}

#[test]
fn a_squaring_that_one_drive_does_not_begin_stops_the_other_before_its_switch() {
    let (mut machine, pair) = beside_their_switches();
    // A homing error at a stand.
    lock(&machine.stations[1].drive).set(0x6099, 1, 0).unwrap();
    let [one, _] = to_the_switch();
    let other = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT);
    let error = machine
        .finish(pair.square([one, other], 3_000))
        .unwrap_err();
    assert!(
        matches!(error.failure(), Some(Failure::HomingError { .. })),
        "{error}"
    );
    machine.cycle();
    assert!(stops(last_word(&machine, 0)));
    machine.run(1_000);
    assert!(lock(&machine.stations[0].drive).stands());
    let at = lock(&machine.stations[0].drive).mechanical_position();
    assert!(at > 15_000, "it did not go on to its switch: {at}");
}

#[test]
fn an_error_that_the_skew_has_not_made_is_told_as_what_it_is() {
    let (mut machine, pair) = paired();
    let motion = moving(&mut machine, &pair);
    lock(&machine.stations[1].drive).disturbances().blocked = true;
    while !stops(last_word(&machine, 0)) {
        machine.cycle();
    }
    // The one that jams has a fault as well.
    lock(&machine.stations[1].drive).inject_fault(0x7500);
    let error = machine.finish(motion.done()).unwrap_err();
    assert!(
        matches!(error.failure(), Some(Failure::Fault { .. })),
        "{error}"
    );
    machine.run(1_000);
    let error = machine.finish(pair.enable()).unwrap_err();
    assert!(
        matches!(error.failure(), Some(Failure::Fault { .. })),
        "{error}"
    );
}

#[test]
fn overrides_of_before_do_not_pull_a_pair_apart() {
    let mut machine = Machine::new(2);
    let one = machine.axis(0);
    machine.finish(one.set_override(0.5)).unwrap();
    let pair = one.pair_with(machine.axis(1)).skew(WARN, STOP).unwrap();
    machine.finish(pair.enable()).unwrap();
    let motion = moving(&mut machine, &pair);
    machine.finish(motion.done()).unwrap();
    let speeds = [0, 1].map(|axis| {
        let station = &machine.stations[axis];
        output(station, station.frames.last().unwrap(), 0x6081)
    });
    assert_eq!(speeds, [50_000; 2]);
}

#[test]
fn a_pair_is_not_made_of_an_axis_that_is_lost() {
    let mut machine = Machine::new(2);
    machine.stations[1].silent = true;
    while !machine.stations[1].core.snapshot().lost {
        machine.cycle();
    }
    let error = machine.axis(0).pair_with(machine.axis(1)).skew(WARN, STOP);
    assert!(
        matches!(
            error.as_ref().unwrap_err().failure(),
            Some(Failure::BusLost { .. })
        ),
        "{error:?}"
    );
}

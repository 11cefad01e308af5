//! Homing: what the future tells, what the drive's ledger says, and what is left on the wire for the next mode.

use core::{sync::atomic::Ordering, time::Duration};

use servocrab::{
    Failure, HomingMethod, HomingParameters, Referencing, SetPoint,
    axis::{AxisErrorKind, Delivery, ParameterFault, Unsupported, WaitingFor},
    coe::obj,
    ds402::{Mode, State},
    homing::Homed,
    profile_position::{LimitsRule, PositionRange},
};
use servocrab_sim::ds402::{Axis as Drive, Behaviour, Cause, HomingOutcome};

use crate::machine::{Machine, Task, Variant, at_target, beside_its_switch, output};

const BIT_4: u16 = 0x0010;
const HALT: u16 = 0x0100;

fn variant() -> Variant {
    Variant {
        behaviour: Behaviour {
            machine: beside_its_switch(),
            homing_method_refused_at_write: true,
            ..Behaviour::akd2g()
        },
        referencing: Referencing::ByHoming,
        ..Variant::default()
    }
}

fn to_the_switch() -> HomingParameters {
    HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(20_000, 2_000)
        .acceleration(200_000)
        .offset(0)
}

/// Until it is written and queued, and nothing of it is sent.
fn begin_homing<T>(machine: &mut Machine, home: &mut Task<'_, T>) {
    assert!(home.poll().is_none());
    machine.cycle();
    assert!(home.poll().is_none());
}

/// Loads push a shaft that stands by less than that.
fn is_near(machine: &Machine, mechanical: i64) -> bool {
    (machine.drive().mechanical_position() - mechanical).abs() <= 10
}

fn outcomes(drive: &Drive) -> Vec<HomingOutcome> {
    drive.homings().iter().map(|line| line.outcome).collect()
}

/// Bit 4 and mode of each frame from `from` on, each pair once in a row.
fn bit_4_and_mode(machine: &Machine, from: usize) -> Vec<(bool, i32)> {
    let station = &machine.stations[0];
    let mut pairs: Vec<_> = station.frames[from..]
        .iter()
        .map(|frame| {
            let word = output(station, frame, 0x6040) as u16;
            (word & BIT_4 != 0, output(station, frame, 0x6060))
        })
        .collect();
    pairs.dedup();
    pairs
}

#[test]
fn an_axis_is_homed_by_its_limit_switch_and_then_knows_where_it_is() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let refused = machine.finish(pp.move_abs(1_000, SetPoint::new()));
    assert_eq!(refused.unwrap_err().failure(), Some(Failure::NotReferenced));
    machine.finish(pp.release()).unwrap();
    assert!(machine.drive().ledger().is_empty());

    let from = machine.stations[0].frames.len();
    let homing = machine.finish(axis.homing()).unwrap();
    let mut home = Task::new(homing.home(to_the_switch()));
    machine.run_beside(&mut home, 50);
    assert!(!axis.status().referenced && axis.status().has_set_point);
    let Homed { position, .. } = machine.finish_task(&mut home).unwrap();
    assert!(axis.status().referenced && machine.drive().is_referenced());
    assert!(machine.stands() && machine.is_at(position.into()));
    let line = machine.drive().homings()[0].clone();
    assert_eq!((line.method, line.outcome), (17, HomingOutcome::Attained));

    drop(home);
    machine.finish(homing.release()).unwrap();
    assert_eq!(axis.status().state, State::OperationEnabled);
    let pp = machine.finish(axis.profile_position()).unwrap();
    assert_eq!(
        bit_4_and_mode(&machine, from),
        [(false, 6), (true, 6), (false, 6), (false, 1)],
        "bit 4 is up once, and down on both sides of each change of mode"
    );
    let moved = machine.finish(pp.move_abs(1_000, SetPoint::new())).unwrap();
    at_target(machine.finish(moved.done()).unwrap(), 1_000);
    let home = line.home.unwrap();
    assert!(is_near(&machine, home + 1_000));
}

#[test]
fn parameters_are_written_before_bit_4_rises_and_those_left_out_stay() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let homing = machine.finish(axis.homing()).unwrap();
    let parameters = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT).offset(-70);
    machine.finish(homing.home(parameters)).unwrap();
    let written = machine.stations[0].sdo.written.lock().unwrap().clone();
    let written: Vec<_> = written.iter().map(|(index, _)| *index).collect();
    assert_eq!(written, [0x6098, 0x607C]);
    assert_eq!(machine.drive().homings()[0].offset, Some(-70));
}

#[test]
fn a_parameter_that_is_mapped_goes_with_the_process_data_and_not_by_sdo() {
    let mut variant = variant();
    variant.mapped_too = vec![obj::HOMING_METHOD.into(), obj::HOMING_ACCELERATION.into()];
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let homing = machine.finish(axis.homing()).unwrap();
    machine.finish(homing.home(to_the_switch())).unwrap();
    let line = machine.drive().homings()[0].clone();
    assert_eq!((line.method, line.outcome), (17, HomingOutcome::Attained));
    let written = machine.stations[0].sdo.written.lock().unwrap().clone();
    assert!(written.iter().all(|(index, _)| *index != 0x6098));
    assert_eq!(machine.drive().get(0x609A, 0), Some(200_000));
}

#[test]
fn a_method_that_the_drive_does_not_list_is_refused_with_those_that_it_lists() {
    let mut variant = variant();
    variant.behaviour.homing_method_refused_at_write = false;
    variant.behaviour.homing_methods = &[35, -3, 17];
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let homing = machine.finish(axis.homing()).unwrap();
    let written = |machine: &Machine| machine.stations[0].sdo.written.lock().unwrap().len();
    let before = written(&machine);
    let error = machine.finish(homing.home(HomingMethod(18))).unwrap_err();
    assert_eq!(written(&machine), before);
    let text = error.to_string();
    assert!(
        text.contains("homing method 18: by 60E3h it has 35, -3, 17"),
        "{text}"
    );
    machine.run(100);
    assert!(machine.drive().homings().is_empty());
    machine.finish(homing.home(to_the_switch())).unwrap();
    assert!(axis.status().referenced);
}

#[test]
fn a_method_that_the_drive_does_not_have_is_refused_with_its_abort_and_nothing_starts() {
    let mut variant = variant();
    variant.behaviour.without = &[0x60E3];
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let homing = machine.finish(axis.homing()).unwrap();
    let error = machine.finish(homing.home(HomingMethod(99))).unwrap_err();
    let AxisErrorKind::Sdo(sdo) = &error.kind else {
        panic!("{error:?}");
    };
    assert!(sdo.abort_code().is_some());
    assert!(error.to_string().contains("6098"), "{error}");
    assert!(error.to_string().contains("AKD2G"), "{error}");
    machine.run(100);
    assert!(machine.drive().homings().is_empty());

    let zero = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT).speeds(0, 100);
    let error = machine.finish(homing.home(zero)).unwrap_err();
    assert!(matches!(
        error.failure(),
        Some(Failure::Parameter {
            fault: ParameterFault::Zero,
            ..
        })
    ));
}

#[test]
fn a_method_that_the_drive_finds_out_about_at_the_start_is_a_homing_error() {
    let mut variant = variant();
    variant.behaviour.homing_method_refused_at_write = false;
    variant.behaviour.without = &[0x60E3];
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let homing = machine.finish(axis.homing()).unwrap();
    for _ in 0..2 {
        // The second time the error of the first still stands.
        let error = machine.finish(homing.home(HomingMethod(99))).unwrap_err();
        assert_eq!(
            error.failure(),
            Some(Failure::HomingError { moving: false })
        );
        assert!(!axis.status().referenced);
    }
    // And a homing that works is not taken for failed by it.
    machine.finish(homing.home(to_the_switch())).unwrap();
    assert!(axis.status().referenced);
}

#[test]
fn the_second_homing_is_attained_by_its_own_bits_and_not_by_those_of_the_first() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let homing = machine.finish(axis.homing()).unwrap();
    for number in 1..=3 {
        machine.finish(homing.home(to_the_switch())).unwrap();
        assert_eq!(
            outcomes(&machine.drive()),
            vec![HomingOutcome::Attained; number],
            "it resolves when the drive has homed, not before"
        );
    }
}

#[test]
fn a_drive_that_does_not_see_bit_4_has_not_homed_whatever_it_still_shows() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let homing = machine.finish(axis.homing()).unwrap();
    machine.finish(homing.home(to_the_switch())).unwrap();
    machine.drive().set_remote(false);
    let error = machine.finish(homing.home(to_the_switch())).unwrap_err();
    assert!(
        matches!(
            error.failure(),
            Some(Failure::Timeout {
                waiting_for: WaitingFor::HomingStart,
                ..
            })
        ),
        "{error}"
    );
    assert!(!axis.status().referenced);
    // Whether it has begun is unknown: only a stop leads on.
    machine.drive().set_remote(true);
    let error = machine.finish(homing.home(to_the_switch())).unwrap_err();
    assert_eq!(error.failure(), Some(Failure::NeedsStop));
    machine.finish(axis.stop()).unwrap();
    machine.finish(axis.enable()).unwrap();
    machine.finish(homing.home(to_the_switch())).unwrap();
    assert!(axis.status().referenced);
}

#[test]
fn a_drive_that_does_not_see_bit_4_has_not_homed_where_it_stands_at_zero() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let homing = machine.finish(axis.homing()).unwrap();
    // It comes to rest a little behind home, and bit 12 stays high.
    machine
        .finish(homing.home(to_the_switch().offset(-11)))
        .unwrap();
    let position = axis.status().position;
    assert!(position.abs() <= 5, "{position}");
    machine.drive().set(0x607C, 0, -10_000).unwrap();
    // At home it would read what 607Ch holds.
    machine.drive().set_remote(false);
    let mut without_offset = to_the_switch();
    without_offset.offset = None;
    let mut home = Task::new(homing.home(without_offset));
    begin_homing(&mut machine, &mut home);
    while machine.stations[0].words.last().unwrap() & BIT_4 == 0 {
        assert!(home.poll().is_none());
        machine.cycle();
    }
    machine.run(20);
    // One wrong word.
    machine.stations[0].lacks = 0x1000;
    let error = machine.finish_task(&mut home).unwrap_err();
    assert!(
        matches!(error.failure(), Some(Failure::Timeout { .. })),
        "{error}"
    );
    assert!(!axis.status().referenced);
}

#[test]
fn a_drive_that_shows_progress_before_it_homes_has_begun_when_it_moves_and_not_before() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    machine.drive().disturbances().progress_before_homing = true;
    let homing = machine.finish(axis.homing()).unwrap();
    machine.drive().disturbances().deaf_to_bit_4 = true;
    let error = machine.finish(homing.home(to_the_switch())).unwrap_err();
    assert!(
        matches!(
            error.failure(),
            Some(Failure::Timeout {
                waiting_for: WaitingFor::HomingStart,
                ..
            })
        ),
        "{error}"
    );
    assert!(machine.drive().homings().is_empty());
    machine.drive().disturbances().deaf_to_bit_4 = false;
    machine.finish(axis.stop()).unwrap();
    machine.finish(axis.enable()).unwrap();
    for parameters in [
        to_the_switch(),
        HomingParameters::new(HomingMethod::CURRENT_POSITION),
    ] {
        machine.finish(homing.home(parameters)).unwrap();
    }
    assert_eq!(outcomes(&machine.drive()), [HomingOutcome::Attained; 2]);
}

#[test]
fn the_present_position_becomes_home_without_motion_also_a_second_time() {
    for method in [HomingMethod::CURRENT_POSITION, HomingMethod(35)] {
        let (mut machine, axis) = Machine::enabled_of(&variant());
        let homing = machine.finish(axis.homing()).unwrap();
        for offset in [500, 500, -300] {
            let here = HomingParameters::new(method).offset(offset);
            let homed = machine.finish(homing.home(here)).unwrap();
            assert!((homed.position - offset).abs() <= 10, "{homed:?}");
            assert!(is_near(&machine, 20_000));
        }
        assert_eq!(outcomes(&machine.drive()), [HomingOutcome::Attained; 3]);
    }
}

#[test]
fn a_halt_ends_a_homing_and_no_resume_brings_it_back() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let homing = machine.finish(axis.homing()).unwrap();
    let mut home = Task::new(homing.home(to_the_switch()));
    begin_homing(&mut machine, &mut home);
    machine.run(60);
    assert!(home.poll().is_none());
    axis.stop_handle().halt();
    machine.cycle();
    assert!(machine.stations[0].words.last().unwrap() & HALT != 0);
    let error = machine.finish_task(&mut home).unwrap_err();
    assert_eq!(
        error.failure(),
        Some(Failure::Halted {
            delivery: Delivery::Accepted
        })
    );
    // A halted homing is not resumed: see the next refusal.
    let text = error.to_string();
    assert!(!text.contains("resume it"), "{text}");
    assert!(
        text.ends_with("the homing is over: stop it, enable it and home again"),
        "{text}"
    );
    assert!(machine.stands());
    let stood = machine.drive().mechanical_position();
    let refused = machine.finish(axis.resume()).unwrap_err();
    assert_eq!(
        refused.failure(),
        Some(Failure::Unsupported(Unsupported::ResumeHoming))
    );
    let refused = machine.finish(homing.home(to_the_switch())).unwrap_err();
    assert_eq!(
        refused.failure(),
        Some(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    machine.run(200);
    assert!(is_near(&machine, stood));

    machine.finish(axis.stop()).unwrap();
    machine.finish(axis.enable()).unwrap();
    machine.run(200);
    assert!(is_near(&machine, stood));
    assert!(!axis.status().referenced);
    machine.finish(homing.home(to_the_switch())).unwrap();
    assert!(axis.status().referenced);
}

type End = fn(&mut Machine, &servocrab::Axis);
type Expected = fn(Failure) -> bool;

#[test]
fn every_end_of_a_homing_has_its_name_and_nothing_moves_after_it() {
    let ends: [(End, Expected); 5] = [
        (
            |_, axis| axis.stop_handle().stop(),
            |f| {
                f == Failure::QuickStopped {
                    delivery: Delivery::Accepted,
                }
            },
        ),
        (
            |_, axis| axis.stop_handle().quick_stop(),
            |f| {
                f == Failure::QuickStopped {
                    delivery: Delivery::Accepted,
                }
            },
        ),
        (
            |machine, axis| {
                machine.finish(axis.disable()).unwrap();
            },
            |f| matches!(f, Failure::Disabled { .. }),
        ),
        (
            |machine, _| machine.drive().inject_fault(0x7305),
            |f| matches!(f, Failure::Fault { .. }),
        ),
        (
            |machine, _| machine.silent = true,
            |f| matches!(f, Failure::BusLost { .. }),
        ),
    ];
    for (number, (end, expected)) in ends.into_iter().enumerate() {
        let (mut machine, axis) = Machine::enabled_of(&variant());
        let homing = machine.finish(axis.homing()).unwrap();
        let mut home = Task::new(homing.home(to_the_switch()));
        begin_homing(&mut machine, &mut home);
        machine.run(60);
        assert!(home.poll().is_none());
        end(&mut machine, &axis);
        let failure = machine.finish_task(&mut home).unwrap_err().failure();
        assert!(failure.is_some_and(expected), "{number}: {failure:?}");
        assert!(!axis.status().referenced);
        machine.silent = false;
        machine.run(1_000);
        let stood = machine.drive().mechanical_position();
        if axis.status().state == State::Fault {
            machine.finish(axis.reset_fault()).unwrap();
        }
        machine.finish(axis.enable()).unwrap();
        machine.run(300);
        assert!(is_near(&machine, stood), "{number}");
        assert!(matches!(
            machine.drive().homings()[0].outcome,
            HomingOutcome::Discarded(Cause::QuickStop | Cause::Disabled | Cause::Fault)
                | HomingOutcome::Interrupted
        ));
    }
}

#[test]
fn a_homing_that_is_dropped_is_withdrawn_before_bit_4_and_stopped_after_it() {
    // Bit 4 rises in one of these cycles, and in some the frame is under way.
    for cycles in 0..40 {
        let (mut machine, axis) = Machine::enabled_of(&variant());
        let homing = machine.finish(axis.homing()).unwrap();
        let mut home = Task::new(homing.home(to_the_switch()));
        machine.run_beside(&mut home, cycles);
        let was_sent = axis.status().has_set_point;
        machine.cycle_while(|| drop(home));
        machine.cycle();
        let word = *machine.stations[0].words.last().unwrap();
        assert_eq!(
            word & HALT != 0,
            was_sent || !machine.drive().homings().is_empty()
        );
        machine.run(1_500);
        let (at, state) = (machine.drive().mechanical_position(), axis.status().state);
        assert!(
            at > 19_000,
            "dropped after {cycles} cycles it went on to {at}"
        );
        assert_eq!(
            state == State::OperationEnabled,
            machine.drive().homings().is_empty()
        );
        assert!(!axis.status().referenced);
        // And the next one works.
        machine.finish(axis.enable()).unwrap();
        machine.finish(homing.home(to_the_switch())).unwrap();
    }
}

#[test]
fn a_homing_that_does_not_end_in_its_time_is_stopped_polled_or_not() {
    for is_polled in [true, false] {
        let (mut machine, axis) = Machine::enabled_of(&variant());
        let homing = machine.finish(axis.homing()).unwrap();
        let limit = Duration::from_millis(100);
        let mut home = Task::new(homing.home(to_the_switch()).within(limit));
        let begin = machine.now;
        begin_homing(&mut machine, &mut home);
        while machine.now < begin + limit {
            assert_eq!(machine.stations[0].words.last().unwrap() & HALT, 0);
            if is_polled {
                assert!(home.poll().is_none());
            }
            machine.cycle();
        }
        machine.cycle();
        assert_eq!(machine.stations[0].words.last().unwrap() & HALT, HALT);
        machine.run(1_000);
        assert!(machine.stands());
        assert!(machine.drive().mechanical_position() > 17_000);
        assert_eq!(axis.status().state, State::SwitchOnDisabled);
        let error = machine.finish_task(&mut home).unwrap_err();
        assert!(
            matches!(
                error.failure(),
                Some(Failure::Timeout {
                    waiting_for: WaitingFor::HomingEnd,
                    delivery: Delivery::Accepted,
                    ..
                })
            ),
            "{error}"
        );
        assert!(!axis.status().referenced);
    }
}

#[test]
fn a_homing_whose_time_is_over_before_bit_4_is_not_started() {
    let mut not_sent = 0;
    for ms in 0..14 {
        let (mut machine, axis) = Machine::enabled_of(&variant());
        let sdo = &machine.stations[0].sdo;
        sdo.slow_writes.store(true, Ordering::Relaxed);
        let homing = machine.finish(axis.homing()).unwrap();
        let from = machine.stations[0].words.len();
        let limit = Duration::from_millis(ms);
        let home = homing.home(to_the_switch()).within(limit);
        let error = machine.finish(home).unwrap_err();
        let Some(Failure::Timeout {
            waiting_for: WaitingFor::HomingEnd,
            delivery,
            ..
        }) = error.failure()
        else {
            panic!("{ms} ms: {error}");
        };
        machine.run(500);
        let words = &machine.stations[0].words[from..];
        let rise = words.iter().position(|word| word & BIT_4 != 0);
        let rise = rise.map(|cycles| Duration::from_millis(cycles as u64 + 1));
        assert!(rise.is_none_or(|rise| rise <= limit), "{ms} ms: {rise:?}");
        assert_eq!(rise.is_none(), delivery == Delivery::NotSent, "{ms} ms");
        not_sent += usize::from(rise.is_none());
        machine.finish(axis.enable()).unwrap();
        machine.finish(homing.home(to_the_switch())).unwrap();
    }
    assert!((6..13).contains(&not_sent), "{not_sent}");
}

#[test]
fn a_homing_goes_on_without_its_future_only_where_that_was_asked_for_in_words() {
    for is_limited in [true, false] {
        let (mut machine, axis) = Machine::enabled_of(&variant());
        let homing = machine.finish(axis.homing()).unwrap();
        let home = homing
            .home(to_the_switch())
            .keep_homing("the panel's stop button is watched elsewhere");
        if is_limited {
            let late = machine.finish(home.within(Duration::from_millis(60)));
            assert!(matches!(late.unwrap_err().kind, AxisErrorKind::Late { .. }));
        } else {
            let mut home = Task::new(home);
            begin_homing(&mut machine, &mut home);
            machine.run(20);
            drop(home);
        }
        let busy = machine.finish(homing.home(to_the_switch())).unwrap_err();
        assert_eq!(busy.failure(), Some(Failure::Busy));
        machine.run(3_000);
        assert_eq!(outcomes(&machine.drive()), [HomingOutcome::Attained]);
        assert!(axis.status().referenced);
    }
}

#[test]
fn a_stop_while_parameters_are_being_written_stops_the_homing_too() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let homing = machine.finish(axis.homing()).unwrap();
    let mut home = Task::new(homing.home(to_the_switch()));
    begin_homing(&mut machine, &mut home);
    axis.stop_handle().halt();
    let error = machine.finish_task(&mut home).unwrap_err();
    assert_eq!(
        error.failure(),
        Some(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    machine.run(100);
    assert!(machine.drive().homings().is_empty());
    // Nothing had begun: the halt is a halt like any other.
    machine.finish(axis.resume()).unwrap();
    machine.finish(homing.home(to_the_switch())).unwrap();
}

/// What becomes of a homing whose offset is written.
#[derive(Clone, Copy, PartialEq)]
enum Given {
    /// It is halted.
    Up,
    /// It is dropped before the drive has the offset, or before its answer.
    UpUnsent,
    UpUnanswered,
}

/// The drive counts its software position limits from it.
#[test]
fn the_home_offset_that_the_drive_has_counts_whatever_becomes_of_its_homing() {
    for given in [Given::Up, Given::UpUnsent, Given::UpUnanswered] {
        let mut variant = variant();
        variant.referencing = Referencing::UnreferencedMovesAllowed;
        variant.traits.limits = LimitsRule::cia402();
        variant.limits.software = Some(PositionRange {
            min: -50_000,
            max: 50_000,
        });
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let homing = machine.finish(axis.homing()).unwrap();
        let mut home = Task::new(homing.home(to_the_switch().offset(-10_000)));
        if given == Given::Up {
            begin_homing(&mut machine, &mut home);
            axis.stop_handle().halt();
            machine.finish_task(&mut home).unwrap_err();
            machine.finish(axis.resume()).unwrap();
        } else {
            let sdo = &machine.stations[0].sdo;
            let (slow, writes) = match given {
                Given::UpUnanswered => (&sdo.late_answers, 5),
                _ => (&sdo.slow_writes, 4),
            };
            slow.store(true, Ordering::Relaxed);
            // The fifth write is under way.
            while machine.stations[0].sdo.written.lock().unwrap().len() < writes {
                assert!(home.poll().is_none());
                machine.cycle();
            }
        }
        drop(home);
        machine.run(2);
        assert!(machine.drive().homings().is_empty());
        drop(homing);
        let has_it = machine.drive().get(0x607C, 0) == Some(-10_000);
        assert_eq!(has_it, given != Given::UpUnsent);
        let pp = machine.finish(axis.profile_position()).unwrap();
        let (within, beyond) = if has_it {
            (55_000, -45_000)
        } else {
            (-45_000, 55_000)
        };
        drop(
            machine
                .finish(pp.move_abs(within, SetPoint::new()))
                .unwrap(),
        );
        let error = machine
            .finish(pp.move_abs(beyond, SetPoint::new()))
            .unwrap_err();
        assert!(error.to_string().contains("607Dh"), "{error}");
    }
}

#[test]
fn a_lost_drive_is_not_referenced_any_more_unless_it_has_an_absolute_encoder() {
    for referencing in [Referencing::ByHoming, Referencing::AbsoluteEncoder] {
        let mut variant = variant();
        variant.referencing = referencing;
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let homing = machine.finish(axis.homing()).unwrap();
        machine.finish(homing.home(to_the_switch())).unwrap();
        assert!(axis.status().referenced);
        machine.silent = true;
        machine.run(30);
        machine.silent = false;
        machine.run(30);
        assert!(!axis.status().lost);
        let expected = referencing == Referencing::AbsoluteEncoder;
        assert_eq!(axis.status().referenced, expected);
    }
}

#[test]
fn pitfall_28_a_drive_that_takes_bit_4_at_its_level_when_the_mode_changes_does_not_move() {
    let mut variant = variant();
    variant.behaviour.edge_at_mode_change = true;
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let homing = machine.finish(axis.homing()).unwrap();
    machine.finish(homing.home(to_the_switch())).unwrap();
    drop(homing);
    let _pp = machine.finish(axis.profile_position()).unwrap();
    machine.run(300);
    assert_eq!(axis.status().mode, Mode::ProfilePosition);
    assert!(machine.drive().ledger().is_empty());
}

#[test]
fn pitfall_28_a_mode_is_changed_only_after_bit_4_was_seen_low() {
    // By SDO as well: nothing is written before.
    for not_mapped in [vec![], vec![0x6060]] {
        let variant = Variant {
            not_mapped,
            ..variant()
        };
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let homing = machine.finish(axis.homing()).unwrap();
        machine.finish(homing.home(to_the_switch())).unwrap();
        drop(homing);
        let from = machine.stations[0].words.len();
        let mut asking = Task::new(axis.profile_position());
        for _ in 0..100 {
            assert!(
                machine.drive().get(0x6060, 0) == Some(6) || {
                    let words = &machine.stations[0].words;
                    words[from..].iter().take(2).all(|word| word & BIT_4 == 0)
                        && words.len() > from + 1
                }
            );
            if asking.poll().is_some() {
                break;
            }
            machine.cycle();
        }
        assert_eq!(machine.drive().get(0x6060, 0), Some(1));
    }
}

/// A homing that is refused must not change the offset, speeds and method of the one that is under way.
#[test]
fn a_homing_that_is_refused_writes_nothing() {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let homing = machine.finish(axis.homing()).unwrap();
    let written = |machine: &Machine| machine.stations[0].sdo.written.lock().unwrap().len();
    let other = || to_the_switch().offset(7_000).speeds(90_000, 9_000);
    let refused = |machine: &mut Machine, expected: fn(Failure) -> bool| {
        let before = written(machine);
        let error = machine.finish(homing.home(other())).unwrap_err();
        assert!(error.failure().is_some_and(expected), "{error}");
        assert_eq!(written(machine), before, "after {error}");
    };

    let mut home = Task::new(homing.home(to_the_switch()));
    machine.run_beside(&mut home, 40);
    refused(&mut machine, |failure| failure == Failure::Busy);
    let homed = machine.finish_task(&mut home).unwrap();
    assert!(homed.position.abs() < 100, "{homed:?}");

    machine.finish(axis.halt()).unwrap();
    refused(&mut machine, |failure| {
        failure
            == Failure::Halted {
                delivery: Delivery::NotSent,
            }
    });
    machine.finish(axis.disable()).unwrap();
    refused(&mut machine, |failure| {
        matches!(failure, Failure::NotEnabled { .. })
    });
}

/// `Late` says that it goes on, unless it is stopped.
#[test]
fn a_homing_that_is_to_go_on_without_its_future_goes_on_or_is_not_said_to() {
    let mut begun = 0;
    for ms in 0..21 {
        let (mut machine, axis) = Machine::enabled_of(&variant());
        let sdo = &machine.stations[0].sdo;
        sdo.slow_writes.store(true, Ordering::Relaxed);
        let homing = machine.finish(axis.homing()).unwrap();
        let home = homing
            .home(to_the_switch())
            .keep_homing("the panel's stop button is watched elsewhere")
            .within(Duration::from_millis(ms));
        let error = machine.finish(home).unwrap_err();
        let goes_on = matches!(error.kind, AxisErrorKind::Late { .. });
        let is_not_sent = matches!(
            error.failure(),
            Some(Failure::Timeout {
                waiting_for: WaitingFor::HomingEnd,
                delivery: Delivery::NotSent,
                ..
            })
        );
        assert_ne!(goes_on, is_not_sent, "{ms} ms: {error}");
        begun += usize::from(goes_on);
        machine.run(3_000);
        let homings = machine.drive().homings().len();
        assert_eq!(
            goes_on,
            homings == 1,
            "{ms} ms: {error}, and the drive has had {homings} homings"
        );
    }
    assert!((3..18).contains(&begun), "{begun}");
}

/// Another task reads the limits meanwhile, among them the home offset of before.
#[test]
fn limits_that_were_being_read_do_not_bring_back_an_earlier_home_offset() {
    let mut variant = variant();
    variant.traits.limits = LimitsRule::cia402();
    let (mut machine, axis) = Machine::enabled_of(&variant);
    machine.drive().set(0x607D, 1, -50_000).unwrap();
    machine.drive().set(0x607D, 2, 50_000).unwrap();
    let homing = machine.finish(axis.homing()).unwrap();
    machine.stations[0].sdo.slow.store(true, Ordering::Relaxed);
    let mut read = Task::new(axis.read_limits());
    assert!(read.poll().is_none());
    assert!(read.poll().is_none(), "607Ch is read first");
    machine
        .finish(homing.home(to_the_switch().offset(-10_000)))
        .unwrap();
    drop(homing);
    machine.finish_task(&mut read).unwrap();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let error = machine
        .finish(pp.move_abs(-45_000, SetPoint::new()))
        .unwrap_err();
    assert!(error.to_string().contains("607Dh"), "{error}");
    drop(
        machine
            .finish(pp.move_abs(55_000, SetPoint::new()))
            .unwrap(),
    );
}

//! Jogging: a velocity for as long as it is held, and 0 in the frame after that.

use std::time::Duration;

use servocrab::{
    Axis, Failure, ProfileVelocity, Referencing, SetPoint,
    axis::{AxisErrorKind, Delivery, ParameterFault},
    coe::obj,
    ds402::State,
    profile_position::MinVelocity,
    profile_velocity::{Jog, JogSetPoint},
};
use servocrab_sim::ds402::{Behaviour, Plant, VelocityEnd};

use crate::machine::{CYCLE, Machine, Task, Variant, at_target, output};

fn variant() -> Variant {
    Variant {
        mapped_too: vec![obj::TARGET_VELOCITY.into()],
        behaviour: Behaviour::akd2g(),
        // Jogging needs none.
        referencing: Referencing::ByHoming,
        ..Variant::default()
    }
}

fn jogging() -> (Machine, Axis, ProfileVelocity) {
    let (mut machine, axis) = Machine::enabled_of(&variant());
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    (machine, axis, pv)
}

/// A jog of 20 000 counts/s at full speed.
fn held() -> (Machine, Axis, ProfileVelocity, Jog) {
    let (mut machine, axis, pv) = jogging();
    let jog = machine.finish(pv.jog(20_000)).unwrap();
    machine.run(100);
    assert!(machine.goes_at(20_000.0));
    (machine, axis, pv, jog)
}

/// Target velocities of the frames from `from` on, each once in a row.
fn velocities(machine: &Machine, from: usize) -> Vec<i32> {
    let station = &machine.stations[0];
    let frames = station.frames[from..].iter();
    let mut velocities: Vec<_> = frames.map(|frame| output(station, frame, 0x60FF)).collect();
    velocities.dedup();
    velocities
}

fn frames(machine: &Machine) -> usize {
    machine.stations[0].frames.len()
}

#[test]
fn the_axis_moves_while_the_jog_is_held_and_stands_when_it_is_released() {
    let (mut machine, axis, pv) = jogging();
    let from = frames(&machine);
    let jog = machine.finish(pv.jog(20_000)).unwrap();
    machine.run(100);
    assert!(machine.goes_at(20_000.0));
    assert!((axis.status().velocity - 20_000).abs() < 2_000);
    assert!(axis.status().has_set_point);
    jog.set(-5_000).unwrap();
    machine.run(150);
    assert!(machine.goes_at(-5_000.0));
    jog.set(0).unwrap();
    machine.run(100);
    assert!(machine.stands());
    jog.set(300).unwrap();
    machine.run(100);
    machine.finish(jog.release()).unwrap();
    assert!(machine.stands());
    assert!(!axis.status().has_set_point);
    assert_eq!(velocities(&machine, from), [20_000, -5_000, 0, 300, 0]);
    let targets: Vec<_> = machine
        .drive()
        .velocity_phases()
        .iter()
        .map(|phase| phase.target)
        .collect();
    assert_eq!(targets, [20_000, -5_000, 300]);
    machine.finish(pv.release()).unwrap();
    assert_eq!(axis.status().state, State::OperationEnabled);
}

#[test]
fn a_release_and_a_drop_are_in_the_next_frame_even_with_a_full_queue() {
    for release in [true, false] {
        let (mut machine, axis, _pv, jog) = held();
        // Commands until there is no place for another one.
        let mut waiting = Vec::new();
        loop {
            let mut halting = Task::new(axis.resume());
            match halting.poll() {
                None => waiting.push(halting),
                Some(result) => {
                    let error = result.unwrap_err();
                    assert!(matches!(error.kind, AxisErrorKind::QueueFull));
                    break;
                }
            }
        }
        let from = frames(&machine);
        let mut releasing = None;
        if release {
            let mut task = Task::new(jog.release());
            assert!(task.poll().is_none());
            releasing = Some(task);
        } else {
            drop(jog);
        }
        machine.run(200);
        assert_eq!(velocities(&machine, from), [0], "from the first frame on");
        assert!(machine.stands());
        if let Some(mut task) = releasing {
            assert!(machine.finish_task(&mut task).is_ok());
        }
    }
}

#[test]
fn a_jog_that_is_let_go_as_it_starts_never_leaves_zero() {
    let (mut machine, _axis, pv) = jogging();
    let from = frames(&machine);
    let mut starting = Task::new(pv.jog(20_000));
    assert!(starting.poll().is_none());
    drop(starting);
    machine.run(100);
    assert_eq!(velocities(&machine, from), [0]);
    assert!(machine.drive().velocity_phases().is_empty());

    // Sent, and let go before it was seen that the drive has it.
    let mut starting = Task::new(pv.jog(20_000));
    assert!(starting.poll().is_none());
    machine.silent = true;
    machine.run(2);
    drop(starting);
    machine.silent = false;
    machine.run(100);
    assert_eq!(velocities(&machine, from), [0, 20_000, 0]);
    assert!(machine.stands());
    // The next one finds nothing of it.
    let jog = machine.finish(pv.jog(100)).unwrap();
    machine.finish(jog.release()).unwrap();
}

#[test]
fn another_jog_takes_over_from_one_that_comes_to_rest_but_not_from_one_that_is_held() {
    let (mut machine, _axis, pv, jog) = held();
    let busy = machine.finish(pv.jog(1)).unwrap_err();
    assert_eq!(busy.failure(), Some(Failure::Busy));
    assert!(busy.to_string().contains("let go of the jog"), "{busy}");
    let mut releasing = Task::new(jog.release());
    assert!(releasing.poll().is_none());
    let again = machine.finish(pv.jog(7_000)).unwrap();
    let superseded = machine.finish_task(&mut releasing).unwrap_err();
    assert_eq!(superseded.failure(), Some(Failure::Superseded));
    machine.run(100);
    assert!(machine.goes_at(7_000.0));
    machine.finish(again.release()).unwrap();
}

type End = fn(&mut Machine, &Axis);
type Expected = fn(Failure) -> bool;

#[test]
fn every_end_of_a_jog_has_its_name_and_no_motion_comes_back() {
    let ends: [(End, Expected); 6] = [
        (
            |_, axis| axis.stop_handle().halt(),
            |f| {
                f == Failure::Halted {
                    delivery: Delivery::Accepted,
                }
            },
        ),
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
            |machine, _| {
                machine.silent = true;
                machine.run(30);
            },
            |f| matches!(f, Failure::BusLost { .. }),
        ),
    ];
    for (number, (end, expected)) in ends.into_iter().enumerate() {
        let (mut machine, axis, pv, jog) = held();
        let from = frames(&machine);
        end(&mut machine, &axis);
        machine.run(2);
        machine.silent = false;
        let failure = jog.set(10_000).unwrap_err().failure();
        assert!(failure.is_some_and(expected), "{number}: {failure:?}");
        assert_eq!(jog.ended(), failure);
        machine.run(500);
        assert!(machine.stands(), "{number}");
        let stood = machine.drive().position();
        // Whatever leads back to Operation enabled.
        if axis.status().state == State::Fault {
            machine.finish(axis.reset_fault()).unwrap();
        }
        if axis.status().state != State::OperationEnabled {
            machine.finish(axis.enable()).unwrap();
        }
        machine.finish(axis.resume()).unwrap();
        assert!(jog.set(10_000).is_err());
        machine.run(300);
        assert!(machine.is_at(stood), "{number}");
        assert!(
            velocities(&machine, from)
                .iter()
                .skip_while(|velocity| **velocity != 0)
                .all(|velocity| *velocity == 0),
            "{number}"
        );
        let failure = machine.finish(jog.release()).unwrap_err().failure();
        assert!(failure.is_some_and(expected));
        // A new one moves.
        let jog = machine.finish(pv.jog(1_000)).unwrap();
        machine.run(50);
        assert!(machine.goes_at(1_000.0));
        machine.finish(jog.release()).unwrap();
    }
}

/// The drive would go on when bit 8 falls, as its controlword's page says of every mode. Its holder may be gone by then.
#[test]
fn a_resume_after_a_halt_brings_no_jog_back_whether_its_holder_is_there_or_gone() {
    for is_there in [true, false] {
        let (mut machine, axis, pv) = jogging();
        let time = Duration::from_millis(50);
        let jog = machine
            .finish(pv.jog(JogSetPoint::new(20_000).dead_man(time)))
            .unwrap();
        for _ in 0..10 {
            machine.run(10);
            jog.hold().unwrap();
        }
        assert!(machine.goes_at(20_000.0));
        machine.finish(axis.halt()).unwrap();
        let stood = machine.drive().position();
        let halted = Some(Failure::Halted {
            delivery: Delivery::Accepted,
        });
        let from = frames(&machine);
        for _ in 0..20 {
            machine.run(10);
            if is_there {
                assert_eq!(jog.hold().unwrap_err().failure(), halted);
            }
        }
        machine.finish(axis.resume()).unwrap();
        assert_eq!(axis.status().state, State::OperationEnabled);
        for _ in 0..20 {
            machine.run(10);
            if is_there {
                assert_eq!(jog.set(20_000).unwrap_err().failure(), halted);
            }
        }
        assert_eq!(jog.ended(), halted);
        assert_eq!(velocities(&machine, from), [0]);
        assert!(machine.is_at(stood), "{is_there}");
        // To go on somebody begins a new one, and holds it.
        let again = machine.finish(pv.jog(1_000)).unwrap();
        machine.run(50);
        assert!(machine.goes_at(1_000.0));
        machine.finish(again.release()).unwrap();
    }
}

#[test]
fn a_jog_that_gets_slower_than_2010h_allows_stands_and_is_held() {
    let mut variant = variant();
    variant.traits.limits.min_velocity = MinVelocity::AsProfileVelocity;
    variant.limits.min_velocity = Some(300);
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let too_slow = |asked| Some(Failure::TooSlow { asked, least: 300 });
    let from = frames(&machine);
    let error = machine.finish(pv.jog(-299)).unwrap_err();
    assert_eq!(error.failure(), too_slow(299));
    let text = error.to_string();
    assert!(text.contains("299") && text.contains("300"), "{text}");
    assert!(text.contains("min profile velocity 2010h"), "{text}");
    let jog = machine.finish(pv.jog(-2_000)).unwrap();
    machine.run(50);
    let error = jog.set(-299).unwrap_err();
    assert_eq!(error.failure(), too_slow(299));
    machine.run(100);
    assert!(machine.stands());
    assert_eq!(jog.ended(), None);
    jog.set(300).unwrap();
    machine.run(50);
    machine.finish(jog.release()).unwrap();
    assert_eq!(velocities(&machine, from), [0, -2_000, 0, 300, 0]);
}

#[test]
fn a_halt_has_the_velocity_zero_in_its_own_frame() {
    let (mut machine, axis, pv, jog) = held();
    axis.stop_handle().halt();
    // As the last thing before the frame goes out, after what the holder asks for.
    jog.set(15_000).unwrap();
    machine.cycle();
    let station = &machine.stations[0];
    let frame = station.frames.last().unwrap();
    assert_eq!(output(station, frame, 0x6040), 0x010F);
    assert_eq!(output(station, frame, 0x60FF), 0);
    machine.finish(axis.halt()).unwrap();
    let halted: Vec<_> = machine
        .drive()
        .velocity_phases()
        .iter()
        .map(|phase| phase.end)
        .collect();
    assert_eq!(halted, [VelocityEnd::Halted]);
    let error = jog.set(15_000).unwrap_err().to_string();
    assert!(
        error.ends_with("the jog is over: resume the axis, then begin a new one"),
        "{error}"
    );
    machine.finish(axis.resume()).unwrap();
    let _again = machine.finish(pv.jog(1_000)).unwrap();
}

#[test]
fn the_last_handle_that_goes_stops_the_axis() {
    let (mut machine, axis, pv, jog) = held();
    drop(pv);
    drop(axis);
    machine.run(50);
    assert!(machine.goes_at(20_000.0), "the jog is held");
    drop(jog);
    machine.run(300);
    assert!(machine.stands());
}

#[test]
fn ramps_go_the_way_that_they_are_mapped() {
    let mut variant = variant();
    variant.not_mapped = vec![0x6083, 0x6084];
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let gentle = JogSetPoint::new(1_000)
        .acceleration(10_000)
        .deceleration(5_000);
    let jog = machine.finish(pv.jog(gentle)).unwrap();
    assert_eq!(machine.drive().get(0x6083, 0), Some(10_000));
    assert_eq!(machine.drive().get(0x6084, 0), Some(5_000));
    machine.finish(jog.release()).unwrap();
    let zero = machine.finish(pv.jog(gentle.deceleration(0))).unwrap_err();
    assert!(matches!(
        zero.failure(),
        Some(Failure::Parameter {
            fault: ParameterFault::Zero,
            ..
        })
    ));

    let (mut machine, _axis, pv) = jogging();
    let jog = machine.finish(pv.jog(gentle)).unwrap();
    assert_eq!(machine.drive().get(0x6083, 0), Some(10_000));
    machine.finish(jog.release()).unwrap();
    let jog = machine.finish(pv.jog(1_000)).unwrap();
    assert_eq!(
        machine.drive().get(0x6083, 0),
        Some(500_000),
        "left out: what the drive held when the axis attached"
    );
    machine.finish(jog.release()).unwrap();
}

#[test]
fn what_cannot_be_jogged_is_refused_with_the_reason_and_nothing_is_sent() {
    // 60FFh is not mapped.
    let mut machine = Machine::new(1);
    let axis = machine.axis(0);
    machine.finish(axis.enable()).unwrap();
    let error = machine.finish(axis.profile_velocity()).unwrap_err();
    assert!(matches!(
        error.failure(),
        Some(Failure::Parameter {
            fault: ParameterFault::NotMapped,
            ..
        })
    ));
    machine.run(20);
    assert_eq!(machine.drive().get(0x6061, 0), Some(1));

    // Disabled, halted, in another mode.
    let (mut machine, axis, pv) = jogging();
    let from = frames(&machine);
    machine.finish(axis.halt()).unwrap();
    let error = machine.finish(pv.jog(1)).unwrap_err();
    assert_eq!(
        error.failure(),
        Some(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    machine.finish(axis.resume()).unwrap();
    machine.finish(axis.disable()).unwrap();
    let error = machine.finish(pv.jog(1)).unwrap_err();
    assert!(matches!(error.failure(), Some(Failure::NotEnabled { .. })));
    assert_eq!(velocities(&machine, from), [0]);
}

#[test]
fn after_a_jog_the_next_mode_finds_a_standing_axis_and_the_velocity_zero() {
    let mut variant = variant();
    variant.referencing = Referencing::AbsoluteEncoder;
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let jog = machine.finish(pv.jog(20_000)).unwrap();
    machine.run(100);
    drop(pv);
    let moving = machine.finish(axis.profile_position()).unwrap_err();
    assert_eq!(moving.failure(), Some(Failure::Moving));
    machine.finish(jog.release()).unwrap();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let stood = machine.drive().position();
    machine.run(100);
    assert!(machine.is_at(stood));
    let moved = machine.finish(pp.move_abs(100, SetPoint::new())).unwrap();
    at_target(machine.finish(moved.done()).unwrap(), 100);
    let station = &machine.stations[0];
    let in_another_mode = station
        .frames
        .iter()
        .filter(|frame| output(station, frame, 0x6060) != 3);
    assert!(
        in_another_mode
            .map(|frame| output(station, frame, 0x60FF))
            .all(|velocity| velocity == 0)
    );
}

/// The ramps of a jog that is refused must not become those of the one that is held.
#[test]
fn a_jog_that_is_refused_writes_nothing() {
    let mut variant = variant();
    variant.not_mapped = vec![0x6083, 0x6084];
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let jog = machine.finish(pv.jog(20_000)).unwrap();
    let other = JogSetPoint::from(30_000)
        .acceleration(7_000)
        .deceleration(7_000);
    let busy = machine.finish(pv.jog(other)).unwrap_err();
    assert_eq!(busy.failure(), Some(Failure::Busy));
    machine.finish(jog.release()).unwrap();
    machine.finish(axis.disable()).unwrap();
    let disabled = machine.finish(pv.jog(other)).unwrap_err();
    assert!(matches!(
        disabled.failure(),
        Some(Failure::NotEnabled { .. })
    ));
    let written = machine.stations[0].sdo.written.lock().unwrap().clone();
    assert_eq!(written, []);
}

#[test]
fn a_dead_man_time_that_is_none_is_refused_before_anything_is_sent() {
    let (mut machine, _axis, pv) = jogging();
    let from = frames(&machine);
    for (got, wrong) in [
        (Duration::ZERO, true),
        (Duration::from_micros(999), true),
        (Duration::from_millis(10_001), true),
        (Duration::MAX, true),
        (Duration::from_millis(1), false),
        (Duration::from_secs(10), false),
    ] {
        let jog = machine.finish(pv.jog(JogSetPoint::new(20_000).dead_man(got)));
        let failure = jog.as_ref().err().and_then(servocrab::AxisError::failure);
        let refused = matches!(
            failure,
            Some(Failure::Parameter {
                fault: ParameterFault::OutOfRange(_),
                ..
            })
        );
        assert_eq!(refused, wrong, "{got:?}: {failure:?}");
        if wrong {
            machine.run(5);
            assert_eq!(velocities(&machine, from), [0], "{got:?}");
        }
        drop(jog);
        machine.run(500);
    }
}

#[test]
fn a_jog_whose_holder_falls_silent_is_let_go_and_later_words_move_nothing() {
    let (mut machine, axis, pv) = jogging();
    let set_point = JogSetPoint::new(20_000).dead_man(20 * CYCLE);
    let jog = machine.finish(pv.jog(set_point)).unwrap();
    for _ in 0..20 {
        machine.run(20);
        jog.hold().unwrap();
    }
    assert!(machine.goes_at(20_000.0));
    jog.set(-10_000).unwrap();
    machine.run(1);
    let from = frames(&machine);
    machine.run(20);
    assert_eq!(velocities(&machine, from), [-10_000], "it is not late yet");
    let from = frames(&machine);
    machine.run(1);
    assert_eq!(
        velocities(&machine, from),
        [0],
        "in the first frame after its time"
    );
    // Before the axis stands, and after: what was delayed on its way moves nothing.
    for _ in 0..400 {
        for late in [jog.hold(), jog.set(20_000)] {
            assert_eq!(late.unwrap_err().failure(), Some(Failure::NotHeld));
        }
        machine.run(1);
    }
    assert_eq!(velocities(&machine, from), [0]);
    assert!(machine.stands());
    assert_eq!(jog.ended(), Some(Failure::NotHeld));
    let released = machine.finish(jog.release());
    assert_eq!(released.unwrap_err().failure(), Some(Failure::NotHeld));
    // The axis is enabled, and the next jog begins as if nothing had been.
    assert_eq!(axis.status().state, State::OperationEnabled);
    let jog = machine.finish(pv.jog(5_000)).unwrap();
    machine.run(300);
    assert!(
        machine.goes_at(5_000.0),
        "without a dead-man time it is held"
    );
    machine.finish(jog.release()).unwrap();
}

/// It has shown its way to rest before, and changes nothing any more.
#[test]
fn a_jog_that_has_come_to_rest_at_0_is_released_by_an_axis_that_shows_nothing_new() {
    let (mut machine, axis) = Machine::enabled_of(&Variant {
        behaviour: Behaviour::akd2g().with_plant(Plant::ideal()),
        ..variant()
    });
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let jog = machine.finish(pv.jog(20_000)).unwrap();
    machine.run(100);
    jog.set(0).unwrap();
    let without_bit_10 = |machine: &mut Machine| {
        machine.stations[0].lacks = 0x0400;
        machine.cycle();
    };
    for _ in 0..500 {
        without_bit_10(&mut machine);
    }
    assert!(machine.stands());
    let mut releasing = Task::new(jog.release());
    let released = (0..1_000).find_map(|_| {
        without_bit_10(&mut machine);
        releasing.poll()
    });
    released.expect("an end").unwrap();
}

/// It comes to rest by its own ramp, which goes by SDO.
#[test]
fn a_jog_that_is_refused_for_a_mapped_ramp_of_zero_has_written_no_other_one() {
    let variant = Variant {
        not_mapped: vec![0x6084],
        mapped_too: vec![obj::TARGET_VELOCITY.into()],
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let jog = machine.finish(pv.jog(20_000)).unwrap();
    machine.run(200);
    let mut release = Task::new(jog.release());
    assert!(release.poll().is_none());
    let refused = JogSetPoint::new(20_000).acceleration(0).deceleration(10);
    let error = machine.finish(pv.jog(refused)).unwrap_err();
    let zero = Failure::Parameter {
        name: "profile acceleration 6083h",
        fault: ParameterFault::Zero,
    };
    assert_eq!(error.failure(), Some(zero));
    machine.finish_task(&mut release).unwrap();
    assert!(machine.stations[0].sdo.written.lock().unwrap().is_empty());
}

//! Halts, stops, the stop lane, and what dropping handles does.

use servocrab::{
    Axis, AxisError, BufferMode, Failure, Outcome, SetPoint,
    axis::{AxisErrorKind, Delivery},
    coe::{AnyObject, obj},
    ds402::{State, StopOptions},
};
use servocrab_sim::ds402;

use crate::machine::{Machine, Task, Variant, at_target, kept, slow};

const HALT: u16 = 0x0100;

#[test]
fn a_halted_move_says_so_once_and_goes_on_to_its_target_after_resume() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(20_000, SetPoint::new()))
        .unwrap();
    machine.run(20);
    machine.finish(axis.halt()).unwrap();
    assert!(machine.stands());
    let halted = machine.finish(moved.done()).unwrap_err();
    assert_eq!(
        halted.failure(),
        Some(Failure::Halted {
            delivery: Delivery::Accepted
        })
    );
    let mut through = Task::new(moved.done_through_halt());
    let mut again = Task::new(moved.done());
    for _ in 0..100 {
        assert!(through.poll().is_none() && again.poll().is_none());
        machine.cycle();
    }
    let refused = machine.finish(pp.move_abs(1, SetPoint::new())).unwrap_err();
    assert_eq!(
        refused.failure(),
        Some(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    machine.finish(axis.resume()).unwrap();
    let reached = at_target(machine.finish_task(&mut through).unwrap(), 20_000);
    assert_eq!(machine.finish_task(&mut again).unwrap(), reached);
    assert_eq!(machine.drive().ledger().len(), 1);
}

#[test]
fn an_axis_is_stopped_and_held_where_its_drive_can_do_that() {
    let mut variant = Variant::default();
    variant.traits.acknowledges_while_halted = true;
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(20_000, SetPoint::new()))
        .unwrap();
    machine.run(20);
    machine.finish(axis.stop_and_hold()).unwrap();
    assert!(machine.stands());
    let replaced = machine.finish(moved.done()).unwrap_err();
    assert_eq!(replaced.failure(), Some(Failure::Superseded));
    assert_eq!(axis.status().state, State::OperationEnabled);
    let next = machine.finish(pp.move_abs(0, SetPoint::new())).unwrap();
    at_target(machine.finish(next.done()).unwrap(), 0);

    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(20_000, SetPoint::new()))
        .unwrap();
    let refused = machine.finish(axis.stop_and_hold()).unwrap_err();
    assert!(refused.to_string().contains("stop() it"), "{refused}");
    at_target(machine.finish(moved.done()).unwrap(), 20_000);
}

#[test]
fn all_who_wait_for_a_move_hear_that_it_was_halted() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(20_000, SetPoint::new()))
        .unwrap();
    let mut waits = [Task::new(moved.done()), Task::new(moved.done())];
    assert!(waits.iter_mut().all(|wait| wait.poll().is_none()));
    axis.stop_handle().halt();
    for wait in &mut waits {
        let halted = machine.finish_task(wait).unwrap_err();
        assert_eq!(
            halted.failure(),
            Some(Failure::Halted {
                delivery: Delivery::Accepted
            })
        );
    }
}

#[test]
fn a_quick_stop_says_where_the_drive_stands_and_ends_the_move() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    machine.run(100);
    // 605Ah is 2 in the simulated drive: it ends in Switch on disabled.
    let state = machine.finish(axis.quick_stop()).unwrap();
    assert_eq!(state, State::SwitchOnDisabled);
    let ended = machine.finish(moved.done()).unwrap_err();
    assert_eq!(
        ended.failure(),
        Some(Failure::QuickStopped {
            delivery: Delivery::Accepted
        })
    );
    let stands = machine.drive().position();
    machine.finish(axis.enable()).unwrap();
    machine.run(200);
    assert!(machine.is_at(stands), "no motion follows from enabling");
}

#[test]
fn the_stop_lane_is_in_the_next_frame_whatever_is_queued() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    let mut queued: Vec<_> = (0..100)
        .map(|n| Task::new(pp.move_abs(n, SetPoint::new())))
        .collect();
    let full = queued.iter_mut().filter_map(Task::poll).collect::<Vec<_>>();
    assert!(!full.is_empty());
    for refused in full {
        let refused = refused.unwrap_err();
        assert!(
            matches!(refused.kind, AxisErrorKind::QueueFull),
            "{refused}"
        );
    }
    axis.stop_handle().halt();
    machine.cycle();
    assert_eq!(
        machine.stations[0].words.last().unwrap() & (HALT | 0x10),
        HALT
    );
    axis.stop_handle().quick_stop();
    machine.cycle();
    assert_eq!(machine.stations[0].words.last().unwrap() & 0x04, 0);
    machine.finish(moved.done_through_halt()).unwrap_err();
    drop(queued);
    machine.run(1_000);
    assert_eq!(
        machine.drive().ledger().len(),
        1,
        "nothing that was queued was started"
    );
}

#[test]
fn a_halt_or_disable_that_finds_the_queue_full_is_in_the_next_frame_and_resolves() {
    for (disables, ending) in [
        (
            false,
            Failure::Halted {
                delivery: Delivery::Accepted,
            },
        ),
        (
            true,
            Failure::QuickStopped {
                delivery: Delivery::Accepted,
            },
        ),
    ] {
        let (mut machine, axis) = Machine::enabled();
        let pp = machine.finish(axis.profile_position()).unwrap();
        let moved = machine
            .finish(pp.move_abs(90_000, SetPoint::new()))
            .unwrap();
        machine.run(10);
        let mut queued: Vec<_> = (0..40)
            .map(|n| Task::new(pp.move_abs(n, SetPoint::new())))
            .collect();
        let refused = queued.iter_mut().filter_map(Task::poll).count();
        assert!(refused > 0, "the queue is full");
        let mut stopping = if disables {
            Task::new(axis.disable())
        } else {
            Task::new(axis.halt())
        };
        assert!(stopping.poll().is_none());
        machine.cycle();
        assert_eq!(machine.stations[0].words.last().unwrap() & HALT, HALT);
        machine.finish_task(&mut stopping).unwrap();
        let ended = if disables {
            moved.done_through_halt()
        } else {
            moved.done()
        };
        let ended = machine.finish(ended).unwrap_err().failure();
        let expected = if disables {
            matches!(ended, Some(Failure::Disabled { .. }))
        } else {
            ended == Some(ending)
        };
        assert!(expected, "{ended:?}");
    }
}

/// As a program keeps them that looks at the outcome of a whole shift later.
#[test]
fn finished_moves_that_are_held_take_no_place_of_anything() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut held = Vec::new();
    for n in 0..70 {
        let moved = machine
            .finish(pp.move_abs(n % 2 * 20, SetPoint::new()))
            .unwrap();
        while axis.status().has_set_point {
            machine.cycle();
        }
        held.push(moved);
    }
    machine.finish(axis.halt()).unwrap();
    machine.finish(axis.resume()).unwrap();
    machine.finish(axis.stop()).unwrap();
    machine.finish(axis.quick_stop()).unwrap();
    machine.finish(axis.disable()).unwrap();
    machine.finish(axis.enable()).unwrap();
    for (n, moved) in held.iter().enumerate() {
        let position = n as i32 % 2 * 20;
        for _ in 0..2 {
            let outcome = machine.finish(moved.done()).unwrap();
            at_target(outcome, position);
        }
    }
}

fn asked_again<'a>(axis: &'a Axis, kind: usize) -> Task<'a, Result<State, AxisError>> {
    match kind {
        0 => Task::new(axis.stop()),
        1 => Task::new(axis.quick_stop()),
        2 => Task::new(async {
            axis.halt().await?;
            Ok(axis.status().state)
        }),
        _ => Task::new(async {
            axis.disable().await?;
            Ok(axis.status().state)
        }),
    }
}

#[test]
fn stops_that_are_asked_for_while_one_is_under_way_share_its_end() {
    for kind in 0..4 {
        let (mut machine, axis) = Machine::enabled();
        let pp = machine.finish(axis.profile_position()).unwrap();
        let _moved = machine
            .finish(pp.move_abs(90_000, SetPoint::new()))
            .unwrap();
        machine.run(200);
        let mut stops = Vec::new();
        for _ in 0..25 {
            for _ in 0..4 {
                let mut stop = asked_again(&axis, kind);
                assert!(stop.poll().is_none(), "kind {kind}");
                stops.push(stop);
            }
            machine.cycle();
        }
        let ends: Vec<_> = stops
            .iter_mut()
            .map(|stop| machine.finish_task(stop).unwrap())
            .collect();
        assert!(ends.iter().all(|end| *end == ends[0]), "kind {kind}");
        assert!(machine.stands(), "kind {kind}");
    }
}

#[test]
fn disables_of_a_standing_axis_share_its_end() {
    let (mut machine, axis) = Machine::enabled();
    machine.run(200);
    let mut disables = Vec::new();
    while axis.status().state == State::OperationEnabled {
        let mut disable = Task::new(axis.disable());
        assert!(disable.poll().is_none());
        disables.push(disable);
        machine.cycle();
    }
    assert!(disables.len() > 1);
    for disable in &mut disables {
        machine.finish_task(disable).unwrap();
    }
}

/// However often it was asked for, and whatever was asked for in between.
#[test]
fn a_stop_that_is_shared_ends_what_was_asked_for_before_each_of_those_who_share_it() {
    for kind in 0..4 {
        let (mut machine, axis) = Machine::enabled();
        let pp = machine.finish(axis.profile_position()).unwrap();
        machine.run(50);
        let mut moves = Vec::new();
        let mut stops = Vec::new();
        for n in 1..=12 {
            let mut stop = asked_again(&axis, kind);
            assert!(stop.poll().is_none());
            stops.push(stop);
            let mut moving = Task::new(pp.move_abs(n * 1_000, SetPoint::new()));
            assert!(moving.poll().is_none());
            moves.push(moving);
        }
        let mut last = asked_again(&axis, kind);
        assert!(last.poll().is_none());
        stops.push(last);
        machine.cycle();
        for moving in &mut moves {
            let refused = moving.poll().expect("it is over").unwrap_err();
            assert!(refused.failure().is_some(), "kind {kind}: {refused}");
        }
        for stop in &mut stops {
            machine.finish_task(stop).unwrap();
        }
        machine.run(500);
        assert!(machine.drive().ledger().is_empty(), "kind {kind}");
        assert!(machine.is_at(0), "kind {kind}");
    }
}

/// The next stop does not take its result away.
#[test]
fn a_stop_that_nobody_has_looked_at_keeps_its_own_end() {
    let (mut machine, axis) = Machine::enabled();
    // It is known to stand.
    machine.run(200);
    let mut first = Task::new(axis.stop());
    assert!(first.poll().is_none());
    machine.run(3);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let _moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    machine.run(50);
    let second = machine.finish(axis.stop()).unwrap();
    assert_eq!(second, State::SwitchOnDisabled);
    assert_eq!(first.poll().unwrap().unwrap(), State::OperationEnabled);
}

#[test]
fn pitfall_19_an_awaited_halt_is_in_the_next_frame() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let _moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    let mut halting = Task::new(axis.halt());
    assert!(halting.poll().is_none());
    machine.cycle();
    assert_eq!(machine.stations[0].words.last().unwrap() & HALT, HALT);
    machine.finish_task(&mut halting).unwrap();
}

#[test]
fn a_move_that_was_queued_before_a_stop_is_not_started_after_it() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut moving = Task::new(pp.move_abs(5_000, SetPoint::new()));
    assert!(moving.poll().is_none());
    axis.stop_handle().stop();
    let refused = machine.finish_task(&mut moving).unwrap_err();
    assert_eq!(
        refused.failure(),
        Some(Failure::QuickStopped {
            delivery: Delivery::NotSent
        })
    );
    machine.run(200);
    assert!(machine.drive().ledger().is_empty());
}

#[test]
fn a_halt_taken_back_in_the_same_cycle_is_no_halt() {
    let (mut machine, axis) = Machine::enabled();
    machine.run(150);
    let mut halting = Task::new(axis.halt());
    let mut resuming = Task::new(axis.resume());
    let _ = (halting.poll(), resuming.poll());
    machine.finish_task(&mut resuming).unwrap();
    machine.run(5);
    assert!(!axis.status().halted);
    assert_eq!(machine.stations[0].words.last().unwrap() & HALT, 0);
}

/// The frame of the resume is under way when the second halt is asked for. The first one still waits.
#[test]
fn a_halt_that_is_asked_for_while_a_resume_is_sent_ends_with_its_own_standstill() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let _moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    machine.run(100);
    let mut first = Task::new(axis.halt());
    assert!(first.poll().is_none());
    machine.run(5);
    let mut resume = Task::new(axis.resume());
    assert!(resume.poll().is_none());
    let mut second = Task::new(axis.halt());
    machine.cycle_while(|| assert!(second.poll().is_none()));
    machine.finish_task(&mut resume).unwrap();
    machine.finish_task(&mut second).unwrap();
    machine.finish_task(&mut first).unwrap();
    assert!(machine.stands() && axis.status().halted);
}

/// As the text says, whether it has kept a set-point or none. A stop leads one without a set-point nowhere, and bit 8 stays.
#[test]
fn a_halted_axis_that_refuses_a_move_takes_one_after_a_resume_or_after_a_disable_and_an_enable() {
    for has_set_point in [false, true] {
        for resumes in [false, true] {
            let (mut machine, axis) = Machine::enabled();
            let pp = machine.finish(axis.profile_position()).unwrap();
            let before = has_set_point.then(|| {
                let moved = machine.finish(pp.move_abs(9_000, SetPoint::new()));
                machine.run(30);
                moved.unwrap()
            });
            machine.finish(axis.halt()).unwrap();
            let refused = machine.finish(pp.move_abs(5, SetPoint::new())).unwrap_err();
            let text = refused.to_string();
            assert!(
                text.contains("halted: resume it, or disable it and enable it again"),
                "{text}"
            );
            if resumes {
                machine.finish(axis.resume()).unwrap();
            } else {
                machine.finish(axis.disable()).unwrap();
                machine.finish(axis.enable()).unwrap();
                let at = machine.drive().position();
                machine.run(300);
                assert!(machine.stands(), "nothing goes on");
                assert!((machine.drive().position() - at).abs() < 20);
            }
            assert!(!axis.status().halted);
            let moved = machine.finish(pp.move_abs(500, SetPoint::new())).unwrap();
            at_target(machine.finish(moved.done()).unwrap(), 500);
            drop(before);
        }
    }
}

#[test]
fn dropping_the_last_handle_stops_a_moving_axis() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(1_000_000, SetPoint::new()))
        .unwrap();
    machine.run(100);
    drop(axis);
    drop(pp);
    machine.run(100);
    assert!(
        machine.drive().velocity() > 0.0,
        "the move itself is a handle yet"
    );
    drop(moved);
    machine.run(1_000);
    assert!(machine.stands());
    assert_ne!(machine.drive().state(), ds402::State::OperationEnabled);
    assert!(machine.drive().position() < 100_000);
}

/// Its bit 4 is in the frame under way, and no snapshot shows it yet.
#[test]
fn dropping_the_last_handle_stops_a_move_that_is_just_being_sent() {
    let (mut machine, axis) = Machine::enabled();
    machine.run(200);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut moving = Task::new(async move {
        let _axis = axis;
        // It needs no bit but 4, and so rises at once.
        let set_point = SetPoint::new().buffer_mode(BufferMode::Buffered);
        pp.move_abs(1_000_000, set_point).await.map(drop)
    });
    assert!(moving.poll().is_none());
    machine.cycle_while(|| drop(moving));
    machine.run(1_000);
    assert_eq!(machine.drive().ledger().len(), 1, "the drive has taken it");
    assert!(machine.stands());
    assert_ne!(machine.drive().state(), ds402::State::OperationEnabled);
    assert!(machine.drive().position() < 100_000);
}

#[test]
fn dropping_the_last_handle_stops_an_axis_that_goes_on_at_its_end_velocity() {
    for by_sdo in [false, true] {
        let end_velocity: AnyObject = obj::END_VELOCITY.into();
        let (mut machine, axis) = Machine::enabled_of(&Variant {
            not_mapped: vec![0x606C],
            mapped_too: if by_sdo { vec![] } else { vec![end_velocity] },
            behaviour: ds402::Behaviour {
                goes_on_at_end_velocity: true,
                reached: ds402::ReachedPolicy::Window,
                ..ds402::Behaviour::akd2g()
            },
            ..Variant::default()
        });
        let pp = machine.finish(axis.profile_position()).unwrap();
        let set_point = SetPoint::new().velocity(20_000).end_velocity(5_000);
        let moved = machine.finish(pp.move_abs(4_000, set_point)).unwrap();
        let reached = machine.finish(moved.done()).unwrap();
        assert!(matches!(reached, Outcome::Reached { .. }), "{reached:?}");
        machine.run(150);
        assert!(machine.goes_at(5_000.0));
        let status = axis.status();
        assert_eq!(status.velocity, 0, "it is not mapped");
        assert!(status.has_set_point, "by SDO: {by_sdo}");
        drop((moved, pp, axis));
        machine.cycle();
        let word = *machine.stations[0].words.last().unwrap();
        assert_ne!(word & HALT, 0, "by SDO: {by_sdo}: {word:04X}");
        machine.run(1_000);
        assert!(machine.stands(), "by SDO: {by_sdo}");
        assert_ne!(machine.drive().state(), ds402::State::OperationEnabled);
    }
}

#[test]
fn dropping_the_last_handle_of_a_standing_axis_leaves_it_enabled() {
    let (mut machine, axis) = Machine::enabled();
    machine.run(200);
    drop(axis);
    machine.run(200);
    assert_eq!(machine.drive().state(), ds402::State::OperationEnabled);
    assert_eq!(machine.stations[0].words.last().unwrap() & HALT, 0);
}

#[test]
fn an_axis_that_is_to_keep_moving_arrives_without_any_handle() {
    let (mut machine, axis) = Machine::enabled();
    axis.keep_moving_on_drop("the conveyor must be emptied");
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(50_000, SetPoint::new()))
        .unwrap();
    drop((axis, pp, moved));
    machine.run(3_000);
    assert!(machine.is_at(50_000));
}

#[test]
fn a_move_that_halts_on_drop_halts_only_before_its_outcome() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let halting = SetPoint::new().halt_on_drop();
    let moved = machine.finish(pp.move_abs(100, halting)).unwrap();
    machine.finish(moved.done()).unwrap();
    drop(moved);
    machine.run(10);
    assert!(!axis.status().halted);
    let moved = machine.finish(pp.move_abs(100_000, halting)).unwrap();
    drop(moved);
    machine.cycle();
    assert!(axis.status().halted);
}

#[test]
fn a_halt_on_drop_stops_a_move_too_that_was_being_written_and_a_resume_does_not_start_it() {
    let (mut machine, axis) = slow();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = pp.move_abs(90_000, SetPoint::new().halt_on_drop());
    let moved = machine.finish(moved).unwrap();
    let behind = SetPoint::new()
        .buffer_mode(BufferMode::Buffered)
        .velocity(7_000)
        .acceleration(700_000);
    let mut written = Task::new(pp.move_rel(500, behind));
    kept(&mut machine, &mut written);
    drop(moved);
    machine.cycle();
    assert!(axis.status().halted);
    machine.finish(axis.resume()).unwrap();
    let error = machine.finish_task(&mut written).unwrap_err();
    let delivery = Delivery::NotSent;
    assert_eq!(error.failure(), Some(Failure::Halted { delivery }));
    assert_eq!(machine.drive().ledger().len(), 1, "the first alone");
}

#[test]
fn a_move_that_halts_on_drop_and_is_dropped_before_it_was_sent_halts_nothing() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut task = Task::new(pp.move_abs(9_000, SetPoint::new().halt_on_drop()));
    assert!(task.poll().is_none());
    drop(task);
    machine.run(50);
    assert!(!axis.status().halted);
    assert_eq!(machine.drive().ledger().len(), 0);
}

#[test]
fn a_stop_tells_where_the_drive_stands_and_leaves_a_standing_axis_as_it_is() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let _moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    machine.run(50);
    let state = machine.finish(axis.stop()).unwrap();
    assert_eq!(state, axis.status().state);
    assert_eq!(state, State::SwitchOnDisabled);
    machine.run(300);
    machine.finish(axis.enable()).unwrap();
    let standing = machine.finish(axis.stop()).unwrap();
    assert_eq!(
        standing,
        State::OperationEnabled,
        "a standing axis stays as it is"
    );
}

/// It has arrived within the window, and settles by more than the window from where it is then.
#[test]
fn an_axis_that_has_just_arrived_stays_enabled_when_it_is_released_stopped_or_left() {
    for seed in 0..60 {
        let variant = Variant {
            behaviour: ds402::Behaviour::akd2g().with_plant(ds402::Plant::seeded(seed)),
            ..Variant::default()
        };
        for distance in [77, -500] {
            for end in 0..3 {
                let (mut machine, axis) = Machine::enabled_of(&variant);
                let pp = machine.finish(axis.profile_position()).unwrap();
                let set_point = SetPoint::new().velocity(20_000);
                let moved = machine.finish(pp.move_rel(distance, set_point)).unwrap();
                machine.finish(moved.done()).unwrap();
                drop(moved);
                match end {
                    0 => machine.finish(pp.release()).unwrap(),
                    1 => drop(machine.finish(axis.stop()).unwrap()),
                    _ => drop((axis, pp)),
                }
                machine.run(400);
                let state = machine.drive().state();
                assert_eq!(
                    state,
                    ds402::State::OperationEnabled,
                    "plant {seed}, {distance} counts, end {end}"
                );
            }
        }
    }
}

/// The program drops everything of the axis while a frame is under way, at each cycle of a move's beginning: in one of them
/// bit 4 is in that frame.
#[test]
fn the_last_handle_stops_a_move_that_is_just_being_sent() {
    for cycles in 0..12 {
        let (mut machine, axis) = Machine::enabled();
        let pp = machine.finish(axis.profile_position()).unwrap();
        drop(axis);
        let mut moving = Task::new(async move {
            let moved = pp.move_abs(20_000, SetPoint::new()).await?;
            moved.done().await
        });
        assert!(moving.poll().is_none());
        for _ in 0..cycles {
            machine.cycle();
            assert!(moving.poll().is_none());
        }
        machine.cycle_while(|| drop(moving));
        machine.run(2_000);
        let at = machine.drive().position();
        assert!(
            at < 5_000,
            "dropped after {cycles} cycles, the axis went on to {at}"
        );
    }
}

/// In a fault the core refuses both in one go.
#[test]
fn two_stops_that_fail_in_one_cycle_both_end() {
    for kind in [1, 2] {
        let (mut machine, axis) = Machine::enabled();
        machine.drive().inject_fault(0x7305);
        machine.run(100);
        assert_eq!(axis.status().state, State::Fault);
        let mut stops = [0, 1, 2].map(|_| asked_again(&axis, kind));
        for stop in &mut stops {
            assert!(stop.poll().is_none());
        }
        machine.run(2);
        for stop in &mut stops {
            let failure = stop.poll().expect("it has ended").unwrap_err().failure();
            assert!(
                matches!(failure, Some(Failure::Fault { .. })),
                "{failure:?}"
            );
        }
    }
}

/// By a move of 600 000 counts.
fn on_its_way(machine: &mut Machine, axis: &Axis) {
    let pp = machine.finish(axis.profile_position()).unwrap();
    let far = SetPoint::new().velocity(10_000);
    let _moved = machine.finish(pp.move_abs(600_000, far)).unwrap();
    machine.run(200);
    assert!(machine.goes_at(10_000.0));
}

fn is_quick_stopped(machine: &Machine) -> bool {
    let words = &machine.stations[0].words;
    words
        .iter()
        .rev()
        .take(500)
        .any(|word| word & 0x0006 == 0x0002)
}

/// Nobody is left who could be told that the halt does not stop the axis.
#[test]
fn a_halt_whose_future_was_dropped_stops_an_axis_whose_drive_ignores_bit_8() {
    for cycles in [0, 1, 50, 190] {
        let (mut machine, axis) = Machine::enabled();
        on_its_way(&mut machine, &axis);
        machine.drive().disturbances().deaf_to_halt = true;
        let mut halts = [Task::new(axis.halt()), Task::new(axis.halt())];
        assert!(halts.iter_mut().all(|halt| halt.poll().is_none()));
        machine.run(cycles);
        drop(halts);
        machine.run(500);
        assert!(
            is_quick_stopped(&machine) && machine.stands(),
            "after {cycles} cycles"
        );
    }
}

#[test]
fn a_halt_whose_future_was_dropped_stops_an_axis_that_would_coast_at_bit_8() {
    let variant = Variant {
        stop_options: StopOptions {
            halt: Some(0),
            ..StopOptions::default()
        },
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    on_its_way(&mut machine, &axis);
    let mut halt = Task::new(axis.halt());
    assert!(halt.poll().is_none());
    drop(halt);
    machine.run(500);
    assert!(is_quick_stopped(&machine) && machine.stands());
}

/// It decides what comes next, whoever else has given up.
#[test]
fn who_still_waits_for_a_halt_is_told_that_the_drive_ignores_bit_8() {
    let (mut machine, axis) = Machine::enabled();
    on_its_way(&mut machine, &axis);
    machine.drive().disturbances().deaf_to_halt = true;
    let mut halts = [Task::new(axis.halt()), Task::new(axis.halt())];
    assert!(halts.iter_mut().all(|halt| halt.poll().is_none()));
    let [dropped, mut kept] = halts;
    drop(dropped);
    let error = machine.finish_task(&mut kept).unwrap_err();
    assert_eq!(error.failure(), Some(Failure::HaltIgnored));
    machine.run(300);
    assert!(!is_quick_stopped(&machine) && machine.goes_at(10_000.0));
    machine.finish(axis.stop()).unwrap();
}

/// An enabled axis on its way, whose drive takes set-points while it is halted.
fn holdable() -> (Machine, Axis) {
    let mut variant = Variant::default();
    variant.traits.acknowledges_while_halted = true;
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    machine.run(20);
    drop((moved, pp));
    (machine, axis)
}

#[test]
fn a_stop_and_a_hold_asked_for_in_one_cycle_are_two() {
    for stop_first in [true, false] {
        let (mut machine, axis) = holdable();
        let (mut hold, mut stop) = (Task::new(axis.stop_and_hold()), Task::new(axis.stop()));
        if stop_first {
            assert!(stop.poll().is_none() && hold.poll().is_none());
        } else {
            assert!(hold.poll().is_none() && stop.poll().is_none());
        }
        machine.finish_task(&mut stop).unwrap();
        assert!(machine.finish_task(&mut hold).is_err(), "{stop_first}");
        assert!(machine.stands());
        assert_ne!(axis.status().state, State::OperationEnabled);
    }
}

#[test]
fn all_who_ask_to_hold_an_axis_get_it_held() {
    for later in [0, 3, 60] {
        let (mut machine, axis) = holdable();
        let mut first = Task::new(axis.stop_and_hold());
        assert!(first.poll().is_none());
        for _ in 0..later {
            machine.cycle();
        }
        let mut second = Task::new(axis.stop_and_hold());
        assert!(second.poll().is_none());
        machine.finish_task(&mut first).unwrap();
        machine.finish_task(&mut second).unwrap();
        machine.run(100);
        assert!(machine.stands());
        assert_eq!(axis.status().state, State::OperationEnabled);
        assert_eq!(machine.drive().ledger().len(), 2, "{later}");
    }
}

#[test]
fn a_halt_behind_the_set_point_of_a_hold_ends_that() {
    let (mut machine, axis) = holdable();
    let mut hold = Task::new(axis.stop_and_hold());
    assert!(hold.poll().is_none());
    while machine.drive().ledger().len() < 2 {
        machine.cycle();
        assert!(hold.poll().is_none());
    }
    axis.stop_handle().halt();
    let ended = machine.finish_task(&mut hold).unwrap_err();
    assert!(matches!(ended.failure(), Some(Failure::Halted { .. })));
    machine.run(100);
    assert!(axis.status().halted);
}

//! The ordinary scenario of an axis: enable, moves, halt, stops, faults; judged by the drive's ledger.
#![allow(missing_docs)]

mod common;

use core::time::Duration;

use common::{Link, Rig};
use servocrab::axis::{Command, Completion, Delivery, Event, Failure, Referencing, StopRequest};
use servocrab::ds402::{QuickStopOption, State};
use servocrab::profile_position::{BufferMode, SetPoint};
use servocrab_sim::ds402::{Behaviour, Executed, FullBuffer, Outcome};

#[test]
fn an_axis_is_enabled_step_by_step_and_nothing_moves() {
    let mut rig = Rig::akd2g();
    rig.drive.place(777);
    rig.enable();
    rig.run(100);
    // Quick stop as long as nothing is known of the drive.
    assert_eq!(rig.distinct_words(1), [0x0B, 0x00, 0x06, 0x07, 0x0F]);
    rig.assert_at(777);
    assert!(rig.ledger().is_empty());
}

#[test]
fn an_absolute_move_is_executed_once_and_reaches_its_target() {
    let mut rig = Rig::enabled();
    let id = rig.abs(10_000, SetPoint::new().velocity(50_000));
    rig.assert_reached(id, 10_000);
    assert_eq!(rig.ledger().len(), 1);
    assert_eq!(rig.ledger()[0].outcome, Outcome::Reached);
    assert_eq!(rig.reports(id).first(), Some(&Event::Accepted));
}

#[test]
fn relative_moves_add_up() {
    let mut rig = Rig::enabled();
    for n in 1..=3 {
        let id = rig.rel(-1_000, SetPoint::new());
        assert!(matches!(rig.finish(id), Ok(Completion::Reached { .. })));
        rig.assert_at(-1_000 * n);
    }
    assert_eq!(rig.ledger().len(), 3);
}

#[test]
fn a_move_with_immediately_supersedes_the_one_under_way() {
    let mut rig = Rig::enabled();
    let first = rig.abs(100_000, SetPoint::new());
    rig.wait_accepted(first);
    rig.run(100);
    let second = rig.abs(-5_000, SetPoint::new());
    rig.assert_reached(second, -5_000);
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
    assert_eq!(rig.ledger()[0].outcome, Outcome::Replaced);
}

#[test]
fn queued_and_blended_moves_end_in_order() {
    let mut rig = Rig::enabled();
    let a = rig.abs(10_000, SetPoint::new());
    let b = rig.abs(20_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    let c = rig.abs(30_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    rig.assert_reached(c, 30_000);
    assert!(matches!(
        rig.outcome(a),
        Some(Ok(Completion::Reached { .. }))
    ));
    assert!(matches!(
        rig.outcome(b),
        Some(Ok(Completion::Passed { .. }))
    ));
    let outcomes: Vec<_> = rig.ledger().iter().map(|e| e.outcome).collect();
    assert_eq!(
        outcomes,
        [Outcome::Reached, Outcome::Passed, Outcome::Reached]
    );
}

#[test]
fn a_halt_keeps_the_set_point_and_resume_completes_it() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let halt = rig.send(Command::Halt);
    assert_eq!(
        rig.finish(halt),
        Ok(Completion::Stopped {
            state: State::OperationEnabled
        })
    );
    assert_eq!(rig.drive.velocity(), 0.0);
    assert_eq!(rig.reports(id), [Event::Accepted, Event::Halted]);
    let refused = rig.abs(0, SetPoint::new());
    assert_eq!(
        rig.outcome(refused),
        Some(Err(Failure::Halted {
            delivery: Delivery::NotSent
        }))
    );
    rig.run(500);
    assert!(rig.outcome(id).is_none());
    let resume = rig.send(Command::Resume);
    rig.cycle();
    assert_eq!(rig.outcome(resume), Some(Ok(Completion::Done)));
    // Bit 10 is that of the set-point again, which is over with it.
    rig.run(20);
    rig.run_until(5_000, |rig| rig.drive.statusword() & 0x0400 != 0);
    rig.run(2);
    assert!(rig.outcome(id).is_some());
    rig.assert_reached(id, 50_000);
    assert_eq!(rig.ledger().len(), 1);
}

#[test]
fn a_move_that_is_stopped_or_disabled_is_not_told_that_it_is_halted() {
    for (command, failure) in [
        (
            Command::Stop,
            Failure::QuickStopped {
                delivery: Delivery::Accepted,
            },
        ),
        (
            Command::Disable,
            Failure::Disabled {
                state: State::SwitchOnDisabled,
            },
        ),
    ] {
        let mut rig = Rig::enabled();
        let id = rig.abs(50_000, SetPoint::new());
        rig.wait_accepted(id);
        rig.run(200);
        let stop = rig.send(command);
        assert!(rig.finish(stop).is_ok());
        let told = [Event::Accepted, Event::Done(Err(failure))];
        assert_eq!(rig.reports(id), told, "{command:?}");
    }
}

/// What ends a move says whether its bit 4 had gone out, and whether the drive had acknowledged it.
#[test]
fn a_move_that_is_stopped_says_how_far_its_set_point_came() {
    for (command, came) in [
        (Command::Stop, Delivery::NotSent),
        // The halt of a stop leaves the drive the time for its acknowledge.
        (Command::Stop, Delivery::Accepted),
        (Command::QuickStop, Delivery::NotSent),
        (Command::QuickStop, Delivery::Unknown),
        (Command::QuickStop, Delivery::Accepted),
    ] {
        let mut rig = Rig::enabled();
        let id = rig.abs(50_000, SetPoint::new());
        match came {
            Delivery::NotSent => {}
            Delivery::Unknown => {
                rig.run_until(10, |rig| rig.word() & 0x10 != 0);
                rig.run(1);
                assert!(!rig.accepted(id), "{command:?}");
            }
            Delivery::Accepted => rig.wait_accepted(id),
        }
        let stop = rig.send(command);
        assert!(rig.finish(stop).is_ok());
        let failure = Failure::QuickStopped { delivery: came };
        assert_eq!(rig.outcome(id), Some(Err(failure)), "{command:?} {came:?}");
    }
    let mut rig = Rig::enabled();
    let unsent = rig.abs(50_000, SetPoint::new());
    rig.send(Command::Halt);
    let delivery = Delivery::NotSent;
    assert_eq!(rig.outcome(unsent), Some(Err(Failure::Halted { delivery })));
}

#[test]
fn a_halt_during_a_quick_stop_is_done_with_that() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let state = State::SwitchOnDisabled;
    let stops = [Command::Halt, Command::QuickStop, Command::Halt].map(|command| {
        let stop = rig.send(command);
        rig.cycle();
        stop
    });
    for stop in stops {
        assert_eq!(rig.finish(stop), Ok(Completion::Stopped { state }));
    }
}

#[test]
fn a_quick_stop_loses_the_set_point_and_enabling_again_moves_nothing() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let stop = rig.send(Command::QuickStop);
    assert_eq!(
        rig.finish(stop),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    );
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Accepted
        }))
    );
    let stood = rig.drive.position();
    rig.enable();
    rig.run(500);
    assert_eq!(rig.drive.position(), stood);
}

/// With 605Ah = 6 the drive stays in Quick stop active. The deadline is shorter than its ramp.
#[test]
fn a_stop_that_lasts_too_long_ends_without_power() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.quick_stop = QuickStopOption(6);
        config.deadlines.standstill = Duration::from_millis(200);
    });
    rig.drive.set(0x605A, 0, 6).unwrap();
    rig.drive.set(0x6085, 0, 50_000).unwrap();
    rig.enable();
    let id = rig.abs(500_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(300);
    let stop = rig.send(Command::QuickStop);
    let end = rig.finish(stop);
    assert!(matches!(end, Err(Failure::Timeout { .. })), "{end:?}");
    assert!(rig.moves());
    assert_eq!(rig.word(), 0);
    rig.run(2_000);
    assert!(!rig.moves());
    assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
}

#[test]
fn a_disable_is_done_with_the_word_that_shows_it() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let disable = rig.send(Command::Disable);
    let shown = |rig: &Rig| rig.core.snapshot().state == State::SwitchOnDisabled;
    rig.run_until(2_000, |rig| shown(rig));
    assert_eq!(
        rig.outcome(disable),
        Some(Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        }))
    );
}

#[test]
fn an_axis_stopped_while_bit_4_is_high_moves_again_when_it_is_enabled_again() {
    const NEW_SET_POINT: u16 = 1 << 4;
    for command in [Command::Stop, Command::QuickStop, Command::Disable] {
        let mut rig = Rig::enabled();
        let first = rig.abs(10_000, SetPoint::new());
        rig.run_until(10, |rig| rig.word() & NEW_SET_POINT != 0);
        rig.run(1);
        assert!(!rig.accepted(first) && rig.word() & NEW_SET_POINT != 0);
        let stop = rig.send(command);
        assert!(rig.finish(stop).is_ok(), "{command:?}");
        assert!(rig.outcome(first).is_some_and(|end| end.is_err()));
        rig.enable();
        let second = rig.abs(-10_000, SetPoint::new());
        rig.assert_reached(second, -10_000);
    }
}

#[test]
fn stop_halts_first_and_then_abandons() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let from = rig.words.len();
    let stop = rig.send(Command::Stop);
    assert!(matches!(
        rig.finish(stop),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    ));
    assert_eq!(rig.distinct_words(from), [0x10F, 0x10B]);
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Accepted
        }))
    );
}

#[test]
fn disabling_a_moving_axis_stops_it_and_a_standing_one_is_shut_down() {
    let mut rig = Rig::enabled();
    let off = rig.send(Command::Disable);
    assert_eq!(
        rig.finish(off),
        Ok(Completion::Stopped {
            state: State::ReadyToSwitchOn
        })
    );
    rig.enable();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    let off = rig.send(Command::Disable);
    assert!(matches!(
        rig.finish(off),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    ));
    assert!(matches!(
        rig.outcome(id),
        Some(Err(Failure::Disabled { .. }))
    ));
}

#[test]
fn an_axis_that_was_not_homed_moves_by_distances_only_and_nothing_of_an_absolute_move_is_sent() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.referencing = Referencing::ByHoming;
    });
    rig.enable();
    assert!(!rig.core.snapshot().referenced);
    let from = rig.words.len();
    let refused = rig.abs(10_000, SetPoint::new());
    assert_eq!(rig.outcome(refused), Some(Err(Failure::NotReferenced)));
    rig.run(200);
    assert_eq!(rig.distinct_words(from), [0x000F]);
    assert!(rig.ledger().is_empty());

    let relative = rig.rel(10_000, SetPoint::new());
    assert!(rig.finish(relative).is_ok());
    rig.assert_at(10_000);
}

#[test]
fn an_absolute_encoder_is_a_reference_from_the_first_cycle_on() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.referencing = Referencing::AbsoluteEncoder;
    });
    rig.enable();
    assert!(rig.core.snapshot().referenced);
    let id = rig.abs(10_000, SetPoint::new());
    rig.assert_reached(id, 10_000);
}

#[test]
fn a_fault_ends_the_move_and_its_reset_enables_nothing() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    rig.drive.inject_fault(0x7305);
    assert!(matches!(rig.finish(id), Err(Failure::Fault { .. })));
    rig.run(500);
    let refused = rig.send(Command::Enable);
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::Fault { .. }))
    ));
    let reset = rig.send(Command::ResetFault);
    assert_eq!(
        rig.finish(reset),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    );
    let stood = rig.drive.position();
    rig.run(500);
    assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
    assert_eq!(rig.drive.position(), stood);
}

/// Whether every set-point was executed once and in this order, with none lost in a buffer that was still full.
fn ends(rig: &Rig) -> Vec<(Option<i64>, Outcome)> {
    let of = |e: &Executed| (e.target, e.outcome);
    rig.ledger().iter().map(of).collect()
}

#[test]
fn a_move_that_comes_back_to_its_end_makes_room_only_when_it_has_ended() {
    // Too fast to stop at 3000, it overshoots: nothing but the end of what waits behind it shows its own.
    for full_buffer in [FullBuffer::Ignore, FullBuffer::OverwritePending] {
        let mut rig = Rig::new(
            Behaviour {
                full_buffer,
                ..Behaviour::akd2g()
            },
            |_| {},
        );
        rig.enable();
        rig.abs(100_000, SetPoint::new());
        rig.run_until(1_000, |rig| rig.drive.position() > 2_000);
        let gentle = SetPoint::new().deceleration(200_000);
        let first = rig.abs(3_000, gentle);
        rig.wait_accepted(first);
        let second = rig.abs(-4_000, SetPoint::new().buffer_mode(BufferMode::Blending));
        rig.wait_accepted(second);
        let third = rig.abs(500, SetPoint::new().buffer_mode(BufferMode::Buffered));
        rig.run_until(1_000, |rig| rig.drive.position() > 4_000);
        assert_eq!(rig.outcome(first), None, "it is on its way back to 3000");
        assert!(rig.finish(first).is_ok());
        assert!(rig.finish(second).is_ok());
        rig.assert_reached(third, 500);
        assert_eq!(
            ends(&rig)[1..],
            [
                (Some(3_000), Outcome::Reached),
                (Some(-4_000), Outcome::Reached),
                (Some(500), Outcome::Reached)
            ]
        );
    }
}

#[test]
fn a_queued_move_that_is_executed_before_its_late_acknowledge_is_seen_is_not_the_end_of_the_one_before()
 {
    // It executes at once and acknowledges late.
    let mut rig = Rig::enabled();
    rig.drive.disturbances().ack_delay_cycles = 400;
    let first = rig.abs(696, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(711, SetPoint::new().buffer_mode(BufferMode::Buffered));
    assert!(rig.finish(second).is_ok());
    assert!(rig.finish(first).is_ok(), "{:?}", rig.outcome(first));
}

#[test]
fn a_replacement_to_nearly_the_same_end_is_not_the_end_of_the_move_that_it_replaces() {
    use core::time::Duration;
    for (deadline, late) in [(5_000, false), (300, true)] {
        // It executes at once and acknowledges late.
        let mut rig = Rig::new(Behaviour::akd2g(), |config| {
            config.deadlines.acknowledge = Duration::from_millis(deadline);
        });
        rig.enable();
        let first = rig.abs(10_000, SetPoint::new());
        rig.wait_accepted(first);
        rig.run(20);
        rig.drive.disturbances().ack_delay_cycles = 2_000;
        let second = rig.abs(10_008, SetPoint::new());
        let end = rig.finish(second);
        if late {
            assert!(matches!(end, Err(Failure::Timeout { .. })), "{end:?}");
            assert!(
                matches!(rig.finish(first), Err(Failure::PerhapsSuperseded { .. })),
                "{:?}",
                rig.outcome(first)
            );
        } else {
            assert!(matches!(end, Ok(Completion::Reached { .. })), "{end:?}");
            assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
        }
    }
}

/// On its ramp of a fault reaction, with this deceleration.
fn in_a_fault_reaction(deceleration: u32) -> Rig {
    let mut rig = Rig::ideal_enabled();
    rig.drive.set(0x605E, 0, 1).expect("slow down");
    let fast = SetPoint::new()
        .velocity(1_000_000)
        .acceleration(100_000_000)
        .deceleration(deceleration);
    let id = rig.abs(i32::MAX, fast);
    rig.wait_accepted(id);
    rig.run(50);
    rig.drive.inject_fault(0x7305);
    rig.run(20);
    let state = rig.core.snapshot().state;
    assert_eq!(state, State::FaultReactionActive);
    rig
}

#[test]
fn a_reset_during_a_fault_reaction_that_never_ends_is_given_up() {
    let mut rig = in_a_fault_reaction(1);
    let reset = rig.send(Command::ResetFault);
    assert!(rig.finish(reset).is_err());
}

#[test]
fn a_drive_that_is_lost_in_its_fault_reaction_is_not_left_to_coast() {
    let mut rig = in_a_fault_reaction(1_000_000);
    let from = rig.words.len();
    for _ in 0..100 {
        rig.cycle_over(Link::ReplyLost);
    }
    let quick_stop = |word: u16| word & 0x06 == 0x02;
    assert!(rig.words[from..].iter().all(|word| word & 0x02 != 0));
    assert!(rig.moves() && quick_stop(rig.word()), "{:04X}", rig.word());
}

#[test]
fn a_resume_beside_a_stop_in_the_same_cycle_says_that_bit_8_did_not_fall() {
    let not_sent = Delivery::NotSent;
    let halted = Failure::Halted { delivery: not_sent };
    let stopped = Failure::QuickStopped { delivery: not_sent };
    for (lane, failure) in [
        (StopRequest::HALT, halted),
        (StopRequest::STOP, stopped),
        (StopRequest::QUICK_STOP, stopped),
    ] {
        for moves in [true, false] {
            let mut rig = Rig::ideal_enabled();
            if moves {
                let id = rig.abs(1_000_000, SetPoint::new());
                rig.wait_accepted(id);
                rig.run(100);
            }
            let halt = rig.send(Command::Halt);
            assert!(rig.finish(halt).is_ok());
            let resume = rig.send(Command::Resume);
            assert_eq!(rig.outcome(resume), None, "nothing is sent yet");
            rig.stop = lane;
            rig.cycle();
            let sent = rig.words.last().copied().unwrap_or_default();
            let falls = sent & 0x0104 == 0x0004;
            let expected = if falls {
                Ok(Completion::Done)
            } else {
                Err(failure)
            };
            assert_eq!(rig.finish(resume), expected, "{lane:?}, {moves}");
            // A stop of an axis that stands without a set-point is nothing that bit 8 would have to stay for.
            assert_eq!(falls, lane == StopRequest::STOP && !moves);
        }
    }
}

#[test]
fn a_resume_is_done_with_the_frame_that_was_sent_and_not_beside_a_halt() {
    let mut rig = Rig::ideal_enabled();
    let resume = rig.send(Command::Resume);
    let another = rig.send(Command::Resume);
    assert_eq!(rig.finish(another), Err(Failure::Busy));
    rig.stop = StopRequest::HALT;
    rig.cycle();
    let halted = Failure::Halted {
        delivery: Delivery::NotSent,
    };
    assert_eq!(rig.outcome(resume), Some(Err(halted)));
    let resume = rig.send(Command::Resume);
    rig.cycle_over(Link::ReplyLost);
    assert_eq!(rig.outcome(resume), Some(Ok(Completion::Done)));
}

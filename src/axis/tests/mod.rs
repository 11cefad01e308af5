//! An axis core against a drive that is played word by word.

mod changing;
mod groups;
mod homing;
mod jogs;
mod played;
mod power;
mod resting;
mod stops;

mod loss {
    //! Drives that do not answer, or do not take their outputs; and programs that are not alive.

    use super::played::{
        ACKNOWLEDGED, Brings, ENABLED, HOME, Played, QUICK_STOP, REACHED, SWITCH_ON_DISABLED,
        absolute,
    };
    use crate::{
        Failure,
        axis::{Command, Completion, Delivery, Event, Inputs},
        ds402::{Controlword, Mode, State},
        profile_position::Limits,
        profile_velocity::JogSetPoint,
    };

    const NOT_SENT: Delivery = Delivery::NotSent;
    const BUS_LOST: Failure = Failure::BusLost { delivery: NOT_SENT };
    const UNDELIVERED: Failure = Failure::Undelivered {
        delivery: NOT_SENT,
        counter: None,
    };

    /// Those that enable, start or resume, and those that ask for it.
    fn that_set_going() -> [Command; 8] {
        [
            Command::Enable,
            Command::Resume,
            HOME,
            Command::Jog(JogSetPoint::new(5)),
            Command::Move(absolute(5)),
            Command::CheckMove(absolute(5)),
            Command::CheckHome,
            Command::CheckJog(5),
        ]
    }

    const STOPS: [Command; 5] = [
        Command::Halt,
        Command::Stop,
        Command::Release,
        Command::QuickStop,
        Command::Disable,
    ];

    fn that_do_not() -> [Command; 4] {
        [
            Command::ResetFault,
            Command::SelectMode(Mode::Homing),
            Command::PrepareMode(Mode::Homing),
            Command::SetLimits(Limits::trust_drive()),
        ]
    }

    #[test]
    fn an_axis_of_a_program_that_is_not_alive_is_not_set_going() {
        let expired = Some(Err(Failure::LivenessExpired));
        for command in that_set_going() {
            for mut drive in [
                Played::disabled(Played::config()),
                Played::enabled(Played::config()),
            ] {
                drive.core.set_expired(true);
                let outputs = drive.outputs;
                assert_eq!(drive.answer(command), expired, "{command:?}");
                assert_eq!(drive.outputs, outputs, "{command:?}");
                drive.core.set_expired(false);
                assert_ne!(drive.answer(command), expired, "{command:?}");
            }
        }
        for command in STOPS.into_iter().chain(that_do_not()) {
            let mut drive = Played::enabled(Played::config());
            drive.core.set_expired(true);
            assert_ne!(drive.answer(command), expired, "{command:?}");
        }
    }

    #[test]
    fn a_silent_drive_is_lost_in_the_tenth_cycle_and_found_by_the_next_answer() {
        let at_rest = Played::enabled(Played::config());
        let mut halted = Played::enabled(Played::config());
        halted.submit(Command::Halt);
        for mut drive in [at_rest, halted] {
            drive.shows_for(5, REACHED);
            for _ in 0..2 {
                drive.cycles(9, Brings::Nothing, REACHED);
                let snapshot = drive.core.snapshot();
                assert_eq!((snapshot.lost, snapshot.age), (false, 9));
                drive.shows(REACHED);
                let snapshot = drive.core.snapshot();
                assert_eq!((snapshot.lost, snapshot.age), (false, 0));
            }
            drive.cycles(10, Brings::Nothing, REACHED);
            assert!(drive.core.snapshot().lost);
            assert_eq!(drive.word() & 0x000F, QUICK_STOP);
            drive.cycle(Brings::Answered, REACHED);
            assert!(drive.core.snapshot().lost, "what it gets is not known");
            drive.shows(REACHED);
            assert!(!drive.core.snapshot().lost);
            assert_eq!(drive.word() & 0x000F, QUICK_STOP);
        }
    }

    #[test]
    fn a_drive_is_lost_in_the_thirtieth_cycle_in_which_its_outputs_are_not_known_to_arrive() {
        let mut drive = Played::enabled(Played::config());
        drive.cycles(29, Brings::Answered, REACHED);
        assert!(!drive.core.snapshot().lost);
        drive.cycle(Brings::Answered, REACHED);
        assert!(drive.core.snapshot().lost);

        // Cycles without an answer count as well.
        let mut drive = Played::enabled(Played::config());
        drive.cycles(25, Brings::Answered, REACHED);
        drive.cycles(4, Brings::Nothing, REACHED);
        assert!(!drive.core.snapshot().lost);
        drive.cycle(Brings::Nothing, REACHED);
        assert!(drive.core.snapshot().lost);

        // An axis with few of them allowed is lost by these first, also at rest.
        let mut config = Played::config();
        config.loss.undelivered_cycles = 5;
        let mut drive = Played::enabled(config);
        drive.cycles(4, Brings::Nothing, REACHED);
        assert!(!drive.core.snapshot().lost);
        drive.cycle(Brings::Nothing, REACHED);
        assert!(drive.core.snapshot().lost);
    }

    #[test]
    fn what_was_under_way_when_a_drive_was_lost_ends_with_how_far_it_came() {
        for (brings, cycles, failure) in [
            (
                Brings::Nothing,
                10,
                Failure::BusLost {
                    delivery: Delivery::Accepted,
                },
            ),
            (
                Brings::Answered,
                30,
                Failure::Undelivered {
                    delivery: Delivery::Accepted,
                    counter: None,
                },
            ),
        ] {
            let (mut drive, moving) = Played::moving(Played::config(), 100_000);
            drive.cycles(cycles - 1, brings, ENABLED);
            assert_eq!(drive.outcome(moving), None);
            drive.cycle(brings, ENABLED);
            assert_eq!(drive.outcome(moving), Some(Err(failure)));
            assert_eq!(drive.word(), QUICK_STOP);
            // 607Ah holds what was sent, for as long as it is enabled and moves.
            assert_eq!(drive.target(), 100_000);
        }
    }

    #[test]
    fn a_lost_drive_takes_stops_alone_and_only_while_it_answers() {
        let lost = |brings, cycles| {
            let (mut drive, _) = Played::moving(Played::config(), 100_000);
            drive.cycles(cycles, brings, ENABLED);
            assert!(drive.core.snapshot().lost);
            drive
        };
        for command in that_set_going().into_iter().chain(that_do_not()) {
            let mut drive = lost(Brings::Answered, 30);
            assert_eq!(drive.answer(command), Some(Err(UNDELIVERED)), "{command:?}");
            let mut drive = lost(Brings::Nothing, 10);
            assert_eq!(drive.answer(command), Some(Err(BUS_LOST)), "{command:?}");
        }
        for command in STOPS {
            let mut drive = lost(Brings::Nothing, 10);
            assert_eq!(drive.answer(command), Some(Err(BUS_LOST)), "{command:?}");
            // Of one that answers until now it ends by what that shows, or when it falls silent.
            let mut drive = lost(Brings::Answered, 30);
            let stopping = drive.submit(command);
            drive.cycles(9, Brings::Nothing, ENABLED);
            assert_eq!(drive.outcome(stopping), None, "{command:?}");
            drive.cycle(Brings::Nothing, ENABLED);
            assert_eq!(drive.outcome(stopping), Some(Err(BUS_LOST)), "{command:?}");

            let mut drive = lost(Brings::Answered, 30);
            let stopping = drive.submit(command);
            drive.velocity = 0;
            drive.cycles(60, Brings::Answered, ENABLED);
            drive.cycles(200, Brings::Answered, SWITCH_ON_DISABLED);
            let state = State::SwitchOnDisabled;
            let stopped = Some(Ok(Completion::Stopped { state }));
            assert_eq!(drive.outcome(stopping), stopped, "{command:?}");
        }
    }

    #[test]
    fn a_move_rises_in_the_next_frame_if_the_last_one_came_back_whole() {
        let rises = |prepare: &dyn Fn(&mut Played)| {
            let mut drive = Played::enabled(Played::config());
            prepare(&mut drive);
            let moving = drive.move_to(5_000);
            assert_eq!(drive.outcome(moving), None);
            drive.word() & 0x10 != 0
        };
        assert!(rises(&|_| {}));
        assert!(!rises(&|drive| drive.cycle(Brings::Answered, REACHED)));
        assert!(!rises(&|drive| drive.cycle(Brings::Nothing, REACHED)));
        assert!(rises(&|drive| {
            drive.cycle(Brings::Answered, REACHED);
            drive.shows(REACHED);
        }));
        // A stop in the same frame.
        assert!(!rises(&|drive| {
            drive.submit(Command::Stop);
        }));
        // The frame with which bit 8 falls is not sent.
        assert!(!rises(&|drive| {
            drive.submit(Command::Halt);
            drive.shows_for(5, REACHED);
            drive.submit(Command::Resume);
        }));
        // Bit 12 of the move before.
        assert!(!rises(&|drive| {
            drive.move_to(1_000);
            drive.shows(REACHED);
            drive.shows(ACKNOWLEDGED);
        }));
    }

    #[test]
    fn a_gated_move_rises_when_it_is_fired_on_fresh_inputs() {
        let mut gated = absolute(5_000);
        gated.gated = true;
        let armed = || {
            let mut drive = Played::enabled(Played::config());
            let id = drive.submit(Command::Move(gated));
            drive.shows(REACHED);
            assert!(drive.core.is_armed(id));
            assert_eq!(drive.word() & 0x10, 0);
            (drive, id)
        };
        let (mut drive, id) = armed();
        drive.core.fire(drive.now, id, &mut drive.outputs);
        assert_eq!(drive.word() & 0x10, 0x10);
        for brings in [Brings::Answered, Brings::Nothing] {
            let (mut drive, id) = armed();
            drive.cycle(brings, REACHED);
            assert!(!drive.core.is_armed(id), "{brings:?}");
            drive.core.fire(drive.now, id, &mut drive.outputs);
            assert_eq!(drive.word() & 0x10, 0, "{brings:?}");
        }
    }

    #[test]
    fn what_is_not_sent_is_withdrawn_by_its_number_alone() {
        let mut drive = Played::enabled(Played::config());
        let moving = drive.move_to(5_000);
        let other = crate::axis::CommandId(900);
        assert!(!drive.core.withdraw(drive.now, other, &mut drive.outputs));
        assert_eq!(drive.word() & 0x10, 0x10);
        assert!(drive.core.withdraw(drive.now, moving, &mut drive.outputs));
        drive.drain();
        assert_eq!(drive.word() & 0x10, 0);
        assert_eq!(drive.outcome(moving), Some(Err(Failure::Withdrawn)));

        let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
        let jog = drive.submit(Command::Jog(JogSetPoint::new(7)));
        assert!(drive.core.withdraw(drive.now, jog, &mut drive.outputs));
        assert_eq!(drive.target_velocity(), 0);

        let mut drive = Played::enabled_in(Mode::Homing, Played::config());
        let homing = drive.submit(HOME);
        assert!(drive.core.withdraw(drive.now, homing, &mut drive.outputs));
        drive.shows_for(10, REACHED);
        assert_eq!(drive.word() & 0x10, 0);

        // A change of mode, before and after it is written.
        for cycles in [0, 5] {
            let mut drive = Played::enabled(Played::config());
            let selecting = drive.submit(Command::SelectMode(Mode::Homing));
            drive.shows_for(cycles, REACHED);
            assert!(!drive.core.withdraw(drive.now, other, &mut drive.outputs));
            assert!(
                drive
                    .core
                    .withdraw(drive.now, selecting, &mut drive.outputs)
            );
            drive.drain();
            assert_eq!(drive.outcome(selecting), Some(Err(Failure::Withdrawn)));
            assert_eq!(drive.outputs[6], 1);
            assert!(
                !drive
                    .core
                    .withdraw(drive.now, selecting, &mut drive.outputs)
            );
        }
    }

    #[test]
    fn manufacturer_bits_are_the_users_and_no_others() {
        let mut drive = Played::enabled(Played::config());
        let bits = Controlword::from_bits_retain(0xA80F | 0x0170);
        drive.core.set_manufacturer_bits(bits);
        drive.shows(REACHED);
        assert_eq!(drive.word(), 0xA80F);
        drive.submit(Command::QuickStop);
        assert_eq!(drive.word(), 0xA80B);
        drive.core.set_manufacturer_bits(Controlword::empty());
        drive.shows(REACHED);
        assert_eq!(drive.word(), 0x000B);
    }

    #[test]
    fn a_snapshot_shows_what_came_last() {
        let mut drive = Played::enabled(Played::config());
        drive.position = -70_000;
        drive.velocity = -3;
        let cycles = drive.core.snapshot().cycle;
        drive.shows(ENABLED);
        drive.cycles(3, Brings::Nothing, REACHED);
        let snapshot = drive.core.snapshot();
        assert_eq!(snapshot.cycle, cycles + 4);
        assert_eq!((snapshot.position, snapshot.velocity), (-70_003, -3));
        assert_eq!((snapshot.age, snapshot.answered), (3, false));
        assert_eq!(snapshot.statusword.bits(), ENABLED);
        assert_eq!(snapshot.controlword.bits(), 0x0F);
        assert!(!snapshot.halted && !snapshot.has_set_point);
    }

    #[test]
    fn an_axis_that_is_lost_is_referenced_no_more() {
        let mut config = Played::config();
        config.homed = true;
        config.referencing = crate::Referencing::ByHoming;
        let mut drive = Played::enabled(config);
        assert!(drive.core.snapshot().referenced);
        drive.cycles(10, Brings::Nothing, REACHED);
        drive.shows(REACHED);
        assert!(!drive.core.snapshot().referenced);
    }

    #[test]
    fn unanswered_inputs_say_nothing() {
        let mut drive = Played::enabled(Played::config());
        // The bits of no state.
        for word in [0x0001, 0x0204, 0x022A] {
            let bytes = drive.inputs(word);
            drive.now += core::time::Duration::from_millis(1);
            drive
                .core
                .step(drive.now, Inputs::Fresh(&bytes), &mut drive.outputs);
            assert!(!drive.core.snapshot().answered, "{word:04X}");
            assert_eq!(drive.core.snapshot().state, State::OperationEnabled);
        }
        assert!(
            !drive
                .reports
                .iter()
                .any(|(_, event)| *event == Event::Halted)
        );
    }

    #[cfg(feature = "std")]
    mod on_the_way_into_op {
        use super::*;

        #[test]
        fn a_drive_is_not_lost_by_outputs_that_it_does_not_take_yet() {
            let mut drive = Played::enabled(Played::config());
            drive.core.await_op(true);
            drive.cycles(100, Brings::Answered, REACHED);
            assert!(!drive.core.snapshot().lost);
            // From there on they count anew.
            drive.core.await_op(false);
            drive.cycles(28, Brings::Answered, REACHED);
            assert!(!drive.core.snapshot().lost);
            drive.cycle(Brings::Answered, REACHED);
            assert!(drive.core.snapshot().lost);
            // One that is silent is lost all the same.
            let mut drive = Played::enabled(Played::config());
            drive.core.await_op(true);
            drive.cycles(10, Brings::Nothing, REACHED);
            assert!(drive.core.snapshot().lost);
        }

        #[test]
        fn one_that_takes_its_outputs_goes_on_in_the_next_frame() {
            let mut drive = Played::enabled(Played::config());
            drive.core.await_op(false);
            drive.move_to(5_000);
            assert_eq!(drive.word() & 0x10, 0x10);
        }
    }
}

mod modes {
    //! Modes against a drive that is played word by word: what a simulated one never does.

    use super::played::{FIELDS, HOME, Played};
    use crate::{
        Failure,
        axis::{Command, Completion, CoreConfig, Delivery},
        ds402::Mode,
        profile_velocity::JogSetPoint,
    };

    /// In Operation enabled, in this mode, with the deadlines of every axis.
    fn enabled(mode: Mode) -> Played {
        let mut config = CoreConfig::new(FIELDS);
        config.tolerances.settle = core::time::Duration::from_millis(12);
        Played::enabled_in(mode, config)
    }

    #[test]
    fn a_homing_error_that_does_not_come_to_rest_is_ended_by_a_quick_stop() {
        let mut drive = enabled(Mode::Homing);
        let homing = drive.submit(HOME);
        drive.shows_for(4, 0x0637);
        assert_eq!(drive.word(), 0x001F);
        drive.velocity = -300;
        drive.shows_for(20, 0x0237);
        // An error, and it goes on moving, for longer than a standstill may take.
        drive.shows_for(9_990, 0x2237);
        assert_eq!((drive.outcome(homing), drive.word()), (None, 0x001F));
        drive.shows_for(20, 0x2237);
        let moving = Failure::HomingError { moving: true };
        assert_eq!(drive.outcome(homing), Some(Err(moving)));
        assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
        drive.velocity = 0;
        drive.shows_for(20, 0x0250);
        assert_eq!(drive.word() & 0x0010, 0);
        assert!(!drive.core.snapshot().has_set_point);
    }

    #[test]
    fn a_drive_that_leaves_the_mode_by_itself_is_stopped_with_nothing_left_in_the_outputs() {
        let wrong = |expected| Failure::WrongMode {
            delivery: Delivery::Accepted,
            expected,
            shown: Mode::ProfilePosition,
        };
        let mut drive = enabled(Mode::Homing);
        let homing = drive.submit(HOME);
        drive.shows_for(4, 0x0637);
        drive.shows_for(20, 0x0237);
        drive.mode = 1;
        drive.shows(0x0237);
        assert_eq!(drive.outcome(homing), Some(Err(wrong(Mode::Homing))));
        assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");

        let mut drive = enabled(Mode::ProfileVelocity);
        let jog = drive.submit(Command::Jog(JogSetPoint::new(-700)));
        assert_eq!(drive.target_velocity(), -700);
        drive.shows_for(5, 0x0237);
        drive.mode = 1;
        drive.shows(0x0237);
        assert_eq!(drive.outcome(jog), Some(Err(wrong(Mode::ProfileVelocity))));
        assert_eq!(drive.target_velocity(), 0);
        assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
    }

    #[test]
    fn a_jog_that_was_let_go_is_at_rest_only_after_the_drive_has_had_the_zero() {
        let mut drive = enabled(Mode::ProfileVelocity);
        let jog = drive.submit(Command::Jog(JogSetPoint::new(700)));
        drive.shows(0x0237);
        let (core, outputs) = (&mut drive.core, &mut drive.outputs);
        assert!(core.release_jog(drive.now, jog, outputs));
        assert_eq!(drive.target_velocity(), 0);
        // What it shows is the rest from which it is only just starting.
        drive.shows(0x0237);
        drive.shows(0x0237);
        assert_eq!(drive.outcome(jog), None);
        drive.velocity = 40;
        drive.shows_for(50, 0x0237);
        assert_eq!(drive.outcome(jog), None);
        drive.velocity = 0;
        drive.shows_for(14, 0x0637);
        assert!(matches!(
            drive.outcome(jog),
            Some(Ok(Completion::Stopped { .. }))
        ));
    }
}

mod resetting {
    //! The reset of a fault: each edge of bit 7, to the cycle.

    use alloc::vec::Vec;
    use core::time::Duration;

    use super::played::{
        Brings, ENABLED, FAULT, FAULT_REACTION, NOT_READY, Played, QUICK_STOP_ACTIVE, READY,
        SWITCH_ON_DISABLED, SWITCHED_ON, stopped,
    };
    use crate::{
        Failure,
        axis::{Command, CommandId, Completion, CoreConfig, WaitingFor},
        ds402::{State, Statusword},
    };

    const RESET: u16 = 0x80;
    const LOW: u16 = 0x00;

    /// At rest with a fault, and asked to reset it.
    fn resetting(config: CoreConfig) -> (Played, CommandId) {
        let mut drive = Played::enabled(config);
        drive.shows_for(20, FAULT);
        assert_eq!(drive.word(), LOW);
        let id = drive.submit(Command::ResetFault);
        assert_eq!(drive.word(), LOW);
        (drive, id)
    }

    /// The same, with bit 7 high.
    fn reset_once() -> (Played, CommandId) {
        let (mut drive, id) = resetting(Played::config());
        assert_eq!(drive.cycles_until(RESET, FAULT), 1);
        (drive, id)
    }

    #[track_caller]
    fn assert_waited_for(result: Result<Completion, Failure>, expected: WaitingFor) {
        let Err(Failure::Timeout { waiting_for, .. }) = result else {
            panic!("{result:?}");
        };
        assert_eq!(waiting_for, expected);
    }

    #[test]
    fn a_fault_that_stays_gets_three_edges_and_ends_the_reset() {
        let (mut drive, id) = resetting(Played::config());
        drive.error_code = 0x8611;
        let mut lengths = Vec::new();
        for _ in 0..3 {
            lengths.push(drive.cycles_until(RESET, FAULT));
            lengths.push(drive.cycles_until(LOW, FAULT));
        }
        // Each edge's time, and the pause.
        assert_eq!(lengths, [1, 30, 100, 30, 100, 30]);
        let code = Some(0x8611);
        assert_eq!(
            drive.outcome(id),
            Some(Err(Failure::Fault {
                code,
                following_error: false
            }))
        );
        drive.shows_for(300, FAULT);
        assert_eq!(drive.word(), LOW);
    }

    #[test]
    fn an_edge_is_high_for_four_cycles_of_the_drive_however_short_its_deadline_is() {
        let mut config = Played::config();
        config.traits.drive_cycle = Duration::from_millis(8);
        let mut drive = Played::new(config);
        drive.shows_for(20, FAULT);
        drive.submit(Command::ResetFault);
        drive.cycles_until(RESET, FAULT);
        assert_eq!(drive.cycles_until(LOW, FAULT), 32);
    }

    #[test]
    fn an_edge_comes_only_when_the_low_is_known_to_be_delivered() {
        let (mut drive, _) = resetting(Played::config());
        drive.cycles(20, Brings::Answered, FAULT);
        assert_eq!(drive.word(), LOW);
        drive.shows(FAULT);
        assert_eq!(drive.word(), RESET);
    }

    #[test]
    fn it_is_done_when_the_drive_shows_a_state_without_power() {
        for (statusword, state) in [
            (SWITCH_ON_DISABLED, State::SwitchOnDisabled),
            (NOT_READY, State::NotReadyToSwitchOn),
            (READY, State::ReadyToSwitchOn),
        ] {
            let (mut drive, id) = reset_once();
            drive.shows_for(2, statusword);
            assert_eq!(drive.outcome(id), stopped(state));
            drive.shows_for(50, statusword);
            assert_eq!(drive.word(), LOW, "nothing is enabled");
        }
    }

    #[test]
    fn a_fault_that_is_gone_before_the_edge_is_done_as_well() {
        let (mut drive, id) = resetting(Played::config());
        drive.shows_for(3, SWITCH_ON_DISABLED);
        assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));
        assert_eq!(drive.word(), LOW);
    }

    #[test]
    fn a_fault_that_comes_back_gets_the_next_edge_after_the_pause() {
        let (mut drive, id) = reset_once();
        drive.shows(SWITCHED_ON);
        assert_eq!(drive.word(), LOW);
        assert_eq!(drive.cycles_until(RESET, FAULT), 101);
        drive.shows(SWITCHED_ON);
        assert_eq!(drive.cycles_until(RESET, FAULT), 101);
        // The last edge is spent: it ends at once when the fault comes back.
        drive.shows(SWITCHED_ON);
        assert_eq!(drive.outcome(id), None);
        drive.shows(FAULT);
        let code = None;
        assert_eq!(
            drive.outcome(id),
            Some(Err(Failure::Fault {
                code,
                following_error: false
            }))
        );
    }

    #[test]
    fn a_drive_that_does_not_come_to_a_state_without_power_is_given_up_at_the_deadline() {
        for statusword in [SWITCHED_ON, ENABLED, QUICK_STOP_ACTIVE] {
            let (mut drive, id) = reset_once();
            drive.shows(statusword);
            let (cycles, result) = drive.cycles_to_end(id, statusword);
            assert_eq!(cycles, 400, "{statusword:04X}");
            assert_waited_for(result, WaitingFor::State(State::SwitchOnDisabled));
        }
    }

    #[test]
    fn it_waits_for_the_fault_reaction_and_for_the_standstill_until_the_deadline() {
        let mut drive = Played::enabled(Played::config());
        drive.shows_for(2, FAULT_REACTION);
        let id = drive.submit(Command::ResetFault);
        let (cycles, result) = drive.cycles_to_end(id, FAULT_REACTION);
        assert_eq!(cycles, 400);
        assert_waited_for(result, WaitingFor::State(State::Fault));

        let mut drive = Played::enabled(Played::config());
        drive.velocity = 30;
        drive.shows_for(20, FAULT);
        let id = drive.submit(Command::ResetFault);
        let begun = drive.position;
        let (cycles, result) = drive.cycles_to_end(id, FAULT);
        assert_eq!(cycles, 400);
        let Err(Failure::Timeout {
            waiting_for: WaitingFor::Standstill(seen),
            statusword,
            ..
        }) = result
        else {
            panic!("{result:?}");
        };
        assert_eq!(statusword, Statusword::from_bits_retain(FAULT));
        let (least, greatest) = seen.positions;
        assert!(least > begun && greatest == drive.position, "{seen:?}");

        // It comes to rest in time.
        let mut drive = Played::enabled(Played::config());
        drive.velocity = 30;
        drive.shows_for(20, FAULT);
        drive.submit(Command::ResetFault);
        drive.shows_for(50, FAULT);
        assert_eq!(drive.word() & RESET, 0);
        drive.velocity = 0;
        assert_eq!(drive.cycles_until(RESET, FAULT), 12);
    }

    #[test]
    fn a_disable_of_a_drive_whose_fault_is_gone_ends_the_reset_and_waits_for_a_state_without_power()
    {
        for (statusword, state) in [
            (SWITCHED_ON, State::SwitchedOn),
            (ENABLED, State::OperationEnabled),
        ] {
            let (mut drive, id) = reset_once();
            drive.shows(statusword);
            let disabling = drive.submit(Command::Disable);
            let disabled = Failure::Disabled { state };
            assert_eq!(drive.outcome(id), Some(Err(disabled)), "{state:?}");
            drive.shows_for(30, statusword);
            assert_eq!((drive.outcome(disabling), drive.word()), (None, LOW));
            drive.shows_for(3, SWITCH_ON_DISABLED);
            assert_eq!(drive.outcome(disabling), stopped(State::SwitchOnDisabled));
        }
    }

    #[test]
    fn without_a_fault_there_is_nothing_to_reset_and_one_reset_goes_on_at_a_time() {
        let mut drive = Played::enabled(Played::config());
        let done = Some(Ok(Completion::Done));
        assert_eq!(drive.answer(Command::ResetFault), done);
        let (mut drive, id) = reset_once();
        assert_eq!(drive.answer(Command::ResetFault), Some(Err(Failure::Busy)));
        // Also while the drive shows none, as long as it may come back.
        let (mut gone, _) = reset_once();
        gone.shows(SWITCHED_ON);
        assert_eq!(gone.answer(Command::ResetFault), Some(Err(Failure::Busy)));
        // A disable is done at standstill, and leaves the reset to go on.
        assert_eq!(drive.answer(Command::Disable), stopped(State::Fault));
        let code = None;
        assert_eq!(
            drive.answer(Command::Enable),
            Some(Err(Failure::Fault {
                code,
                following_error: false
            }))
        );
        assert_eq!((drive.word(), drive.outcome(id)), (RESET, None));
        drive.shows(SWITCHED_ON);
        assert_eq!(drive.answer(Command::Enable), Some(Err(Failure::Busy)));
    }
}

mod standing {
    //! What counts as a standstill when a stop begins, and what is taken for none.

    use super::played::{
        ACKNOWLEDGED, ENABLED, GO, HALT, HOME, Played, QUICK_STOP, QUICK_STOP_ACTIVE, REACHED,
        SWITCH_ON_DISABLED, stopped,
    };
    use crate::{
        Failure, StopRequest,
        axis::{Command, CommandId, CoreConfig},
        ds402::{Mode, State, StopOptions},
        profile_velocity::JogSetPoint,
    };

    /// Without a set-point, in Operation enabled, and just come to this position.
    fn shifted(by: i32) -> Played {
        let mut drive = Played::enabled(Played::config());
        drive.position += by;
        drive.shows(REACHED);
        drive
    }

    /// Halted at rest, with a set-point.
    fn halted(config: CoreConfig) -> Played {
        let (mut drive, _) = Played::moving(config, 100_000);
        drive.halt_to_rest();
        drive.shows_for(20, ENABLED);
        drive
    }

    /// Whether a quick stop follows the bit 8 of this command, and what the word is when the axis has stood for a while.
    fn ends(drive: &mut Played, command: Command) -> (CommandId, u16) {
        let id = drive.submit(command);
        assert_eq!(drive.word(), HALT, "{command:?}");
        assert_eq!(drive.outcome(id), None, "{command:?}");
        drive.shows_for(30, REACHED);
        (id, drive.word())
    }

    #[test]
    fn an_axis_that_settles_where_it_is_keeps_its_power_at_a_stop() {
        for command in [Command::Stop, Command::Release] {
            let mut drive = shifted(15);
            let (id, word) = ends(&mut drive, command);
            assert_eq!(word, GO, "bit 8 falls again");
            assert_eq!(drive.outcome(id), stopped(State::OperationEnabled));
        }
        // Bit 8 stays where somebody asks for a halt meanwhile.
        let mut drive = shifted(15);
        drive.submit(Command::Stop);
        drive.submit(Command::Halt);
        drive.shows_for(30, REACHED);
        assert_eq!(drive.word(), HALT);

        // One that is to be disabled, or was halted before, gets the quick stop; so does one that a set-point may set off.
        let (id, word) = ends(&mut shifted(15), Command::Disable);
        assert_eq!((id, word), (CommandId(2), QUICK_STOP | 0x100));
        let mut drive = Played::enabled(Played::config());
        drive.submit(Command::Halt);
        drive.shows_for(30, REACHED);
        drive.position += 15;
        drive.shows(REACHED);
        assert_eq!(ends(&mut drive, Command::Stop).1, QUICK_STOP | 0x100);
        let (mut drive, _) = Played::moving(Played::config(), 100_000);
        drive.velocity = 0;
        assert_eq!(ends(&mut drive, Command::Stop).1, QUICK_STOP | 0x100);
    }

    #[test]
    fn one_that_leaves_its_place_by_more_than_four_windows_gets_the_quick_stop() {
        for (further, word) in [(40, GO), (41, QUICK_STOP | 0x100)] {
            for sign in [1, -1] {
                let mut drive = shifted(15);
                drive.submit(Command::Stop);
                drive.shows(REACHED);
                drive.position += sign * further;
                drive.shows(REACHED);
                // Also if it comes back.
                drive.position -= sign * 30;
                drive.shows_for(30, REACHED);
                assert_eq!(drive.word(), word, "{further}");
            }
        }
        // A disable that is asked for later does not leave it its power.
        let mut drive = shifted(15);
        drive.submit(Command::Stop);
        drive.submit(Command::Disable);
        drive.shows_for(30, REACHED);
        assert_eq!(drive.word(), QUICK_STOP | 0x100);
    }

    #[test]
    fn a_stop_that_does_not_bring_it_to_rest_goes_on_to_a_quick_stop_after_three_quarters_of_its_time()
     {
        let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
        drive.submit(Command::Stop);
        for cycle in 0..299 {
            // It gets slower all the time.
            drive.velocity = 500 - cycle;
            drive.shows(ENABLED);
        }
        assert_eq!(drive.word(), HALT);
        drive.shows(ENABLED);
        assert_eq!(drive.word(), QUICK_STOP | 0x100);
    }

    #[test]
    fn where_bit_8_would_let_it_coast_every_stop_is_a_quick_stop_at_once() {
        let coasting = || CoreConfig {
            stop_options: StopOptions {
                halt: Some(0),
                ..StopOptions::default()
            },
            ..Played::config()
        };
        for stop in [StopRequest::HALT, StopRequest::STOP] {
            let (mut drive, _) = Played::moving(coasting(), 100_000);
            drive.stop_lane(stop);
            assert_eq!(drive.word(), QUICK_STOP, "{stop:?}");
        }
        let (mut drive, moving) = Played::moving(coasting(), 100_000);
        let refused = Some(Err(Failure::Unsupported(crate::axis::Unsupported::Halt)));
        assert_eq!(drive.answer(Command::Halt), refused);
        assert_eq!((drive.word(), drive.outcome(moving)), (GO, None));
        // During the quick stop it waits for that, and without power there is nothing that bit 8 could do.
        drive.submit(Command::QuickStop);
        assert_eq!(drive.answer(Command::Halt), None);
        let mut drive = Played::disabled(coasting());
        let state = State::SwitchOnDisabled;
        assert_eq!(drive.answer(Command::Halt), stopped(state));
    }

    #[test]
    fn a_quick_stop_of_a_halted_axis_is_done_when_the_drive_has_followed_it() {
        // The rest from bit 8 counts.
        let mut drive = halted(Played::config());
        let id = drive.submit(Command::QuickStop);
        assert_eq!(drive.cycles_to_end(id, SWITCH_ON_DISABLED).0, 1);
        let mut drive = halted(Played::staying());
        let id = drive.submit(Command::QuickStop);
        assert_eq!(drive.cycles_to_end(id, QUICK_STOP_ACTIVE).0, 1);
    }

    #[test]
    fn what_a_drive_does_by_itself_begins_a_standstill_anew() {
        // It begins a quick stop of its own, or of somebody else.
        for (statusword, state) in [
            (QUICK_STOP_ACTIVE, State::QuickStopActive),
            (SWITCH_ON_DISABLED, State::SwitchOnDisabled),
        ] {
            let mut drive = halted(Played::staying());
            drive.shows(statusword);
            let id = drive.submit(Command::Stop);
            assert_eq!(drive.outcome(id), None, "{state:?}");
            let (cycles, result) = drive.cycles_to_end(id, statusword);
            assert_eq!((cycles, Some(result)), (13, stopped(state)));
        }
    }

    #[test]
    fn an_axis_that_is_found_enabled_is_stopped_by_whoever_asks() {
        // It stands: there is something to switch off all the same.
        let mut drive = Played::new(Played::config());
        drive.shows_for(30, REACHED);
        assert_eq!(drive.word(), 0);
        let id = drive.submit(Command::QuickStop);
        assert_eq!((drive.outcome(id), drive.word()), (None, QUICK_STOP));
        drive.shows_for(3, SWITCH_ON_DISABLED);
        assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));

        // It moves, and its drive ignores quick stop: that shows after two spans of 100 ms.
        for stop in [
            StopRequest::HALT,
            StopRequest::STOP,
            StopRequest::QUICK_STOP,
        ] {
            let mut drive = Played::new(Played::config());
            drive.velocity = 50;
            drive.shows_for(5, ENABLED);
            assert_eq!(drive.word(), QUICK_STOP);
            drive.stop_lane(stop);
            assert_eq!(drive.cycles_until(0, ENABLED), 203, "{stop:?}");
        }
    }

    #[test]
    fn the_rest_before_a_motion_is_not_the_rest_after_it() {
        // A jog whose velocity was sent once, and a stop: the axis may be setting off all the same, until the drive has taken the stop in.
        let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
        drive.submit(Command::Jog(JogSetPoint::new(700)));
        drive.shows(REACHED);
        drive.submit(Command::Stop);
        assert_eq!(drive.cycles_until(QUICK_STOP | 0x100, REACHED), 13);

        // A homing that reports an error as it sets off.
        let mut drive = Played::enabled_in(Mode::Homing, Played::config());
        let homing = drive.submit(HOME);
        drive.cycles_until(0x001F, REACHED);
        drive.shows(REACHED);
        let (cycles, result) = drive.cycles_to_end(homing, 0x2237);
        let failure = Failure::HomingError { moving: false };
        assert_eq!((cycles, result), (12, Err(failure)));
    }

    #[test]
    fn an_axis_that_is_found_moving_is_held_for_its_time_and_then_loses_its_power() {
        let mut drive = Played::new(Played::config());
        drive.velocity = 50;
        drive.shows(ENABLED);
        assert_eq!(drive.word(), QUICK_STOP);
        assert_eq!(drive.cycles_until(0, ENABLED), 400);
    }

    /// An input of its drive may hold it, and let it go on at any time.
    #[test]
    fn an_end_velocity_is_a_motion_until_its_drive_is_stopped() {
        let mut drive = Played::at_end_velocity();
        assert!(drive.core.snapshot().has_set_point);
        drive.velocity = 0;
        drive.shows_for(300, REACHED);
        assert!(drive.core.snapshot().has_set_point);
        let stopping = drive.submit(Command::Stop);
        assert_eq!(drive.word(), HALT);
        drive.cycles_until(QUICK_STOP | 0x0100, REACHED);
        drive.shows_for(2, QUICK_STOP_ACTIVE);
        let (_, result) = drive.cycles_to_end(stopping, SWITCH_ON_DISABLED);
        assert!(result.is_ok(), "{result:?}");
        assert!(!drive.core.snapshot().has_set_point);
    }

    /// The next one, which ends at rest, is in the outputs and not sent when the stop is asked for.
    #[test]
    fn a_stop_before_the_next_set_point_is_sent_stops_what_goes_on_at_its_end_velocity() {
        let mut drive = Played::at_end_velocity();
        // An input holds it.
        drive.velocity = 0;
        drive.shows_for(300, REACHED);
        let next = drive.move_to(200);
        drive.cycles_until(GO | 0x0030, REACHED);
        let stopping = drive.submit(Command::Stop);
        assert_eq!(drive.word(), HALT);
        assert!(matches!(drive.outcome(next), Some(Err(_))));
        drive.shows_for(3, ENABLED);
        assert_eq!(drive.outcome(stopping), None);
    }

    /// It was written by SDO before the move was sent.
    #[test]
    fn a_stop_at_standstill_stops_what_goes_on_at_an_end_velocity_that_is_not_mapped() {
        let mut drive = Played::at_end_velocity_of(Played::config());
        assert!(drive.core.snapshot().has_set_point);
        // An input holds it.
        drive.velocity = 0;
        drive.shows_for(300, REACHED);
        let stopping = drive.submit(Command::Stop);
        assert_eq!(drive.word(), HALT);
        drive.shows_for(3, ENABLED);
        assert_eq!(drive.outcome(stopping), None);
    }

    /// Its drive has taken one that ends at rest: that is over with its end.
    #[test]
    fn a_set_point_that_ends_at_rest_ends_an_end_velocity() {
        let mut drive = Played::at_end_velocity();
        let next = drive.move_to(drive.position + 200);
        drive.cycles_until(GO | 0x0030, REACHED);
        drive.shows(REACHED);
        drive.shows(ACKNOWLEDGED);
        drive.shows_for(8, ENABLED);
        drive.velocity = 0;
        let (_, result) = drive.cycles_to_end(next, REACHED);
        assert!(result.is_ok(), "{result:?}");
        assert!(!drive.core.snapshot().has_set_point);
    }

    /// In no cycle is the axis within the window, and it goes on.
    #[test]
    fn a_set_point_that_ends_in_motion_ends_between_two_cycles() {
        let mut drive = Played::enabled(Played::passing());
        let id = drive.passes(1_000, 300);
        drive.shows_for(3, ENABLED);
        assert_eq!((drive.position, drive.outcome(id)), (900, None));
        let (cycles, result) = drive.cycles_to_end(id, REACHED);
        assert!(cycles < 18 && result.is_ok(), "{cycles}: {result:?}");
        assert!(drive.core.snapshot().has_set_point);
    }
}

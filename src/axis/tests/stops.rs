//! Halts, stops and quick stops: what is sent, who is told, and when.

use core::time::Duration;

use super::played::{
    ACKNOWLEDGED, Brings, ENABLED, FAULT, FAULT_REACTION, FIELDS, GO, HALT, HOME, Played,
    QUICK_STOP, QUICK_STOP_ACTIVE, REACHED, READY, SWITCH_ON_DISABLED, SWITCHED_ON, stopped,
};
use crate::{
    Failure, StopRequest,
    axis::{
        AxisFields, Command, CommandId, Completion, Delivery, Event, Inputs, Unsupported,
        WaitingFor,
    },
    ds402::{Mode, State},
    profile_velocity::JogSetPoint,
};

/// It was waited for in vain, and where the axis is now was seen last.
#[track_caller]
fn assert_never_stood(drive: &Played, result: Result<Completion, Failure>) {
    let Err(Failure::Timeout {
        waiting_for: WaitingFor::Standstill(seen),
        ..
    }) = result
    else {
        panic!("{result:?}");
    };
    assert_eq!(seen.positions.1, drive.position, "{seen:?}");
}

/// Of an axis that was moving: after its quick stop, it is being switched off.
fn switching_off() -> (Played, CommandId) {
    let (mut drive, _) = Played::moving(Played::staying(), 100_000);
    let disabling = drive.submit(Command::Disable);
    assert_eq!(drive.word(), HALT);
    drive.velocity = 0;
    drive.cycles_until(QUICK_STOP | 0x0100, ENABLED);
    assert!(drive.cycles_until(0, QUICK_STOP_ACTIVE) < 30);
    assert_eq!(drive.outcome(disabling), None);
    (drive, disabling)
}

#[test]
fn a_halt_at_rest_is_done_when_the_drive_has_surely_seen_it() {
    let mut drive = Played::enabled(Played::config());
    let halting = drive.submit(Command::Halt);
    assert_eq!(drive.word(), HALT);
    // It counts from when it is known to be delivered.
    drive.cycles(5, Brings::Answered, REACHED);
    assert_eq!(
        drive.cycles_to_end(halting, REACHED),
        (
            3,
            Ok(Completion::Stopped {
                state: State::OperationEnabled
            })
        )
    );
}

#[test]
fn a_halt_of_an_axis_that_may_just_set_off_waits_for_the_rest_after_it() {
    let mut drive = Played::enabled(Played::config());
    drive.move_to(5_000);
    drive.shows(REACHED);
    // Acknowledged, and held by a brake.
    drive.shows_for(30, ACKNOWLEDGED);
    let halting = drive.submit(Command::Halt);
    // Sent in the first cycle, seen two later; then an eighth of the settle time.
    assert_eq!(drive.cycles_to_end(halting, ENABLED).0, 16);
}

#[test]
fn whether_a_drive_ignores_bit_8_is_measured_from_when_it_has_surely_seen_it() {
    let mut config = Played::config();
    config.deadlines.standstill = Duration::from_secs(1);
    config.loss.undelivered_cycles = 10_000;
    let (mut drive, _) = Played::moving(config, 1_000_000);
    let halting = drive.submit(Command::Halt);
    drive.cycles(350, Brings::Answered, ENABLED);
    assert_eq!(drive.outcome(halting), None);
    // Two spans of 100 ms.
    let ignored = Err(Failure::HaltIgnored);
    assert_eq!(drive.cycles_to_end(halting, ENABLED), (204, ignored));
}

#[test]
fn a_halt_that_stops_nothing_fails_at_its_deadline() {
    let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
    let halting = drive.submit(Command::Halt);
    for cycle in 0..399 {
        // It gets slower all the time.
        drive.velocity = 500 - cycle;
        drive.shows(ENABLED);
    }
    assert_eq!((drive.outcome(halting), drive.word()), (None, HALT));
    drive.shows(ENABLED);
    let result = drive.outcome(halting).expect("its time is over");
    assert_never_stood(&drive, result);
    assert_eq!(drive.word(), HALT, "it stays");
}

#[test]
fn a_halt_during_a_quick_stop_waits_for_its_end() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    drive.submit(Command::Halt);
    drive.shows(ENABLED);
    let stopping = drive.submit(Command::QuickStop);
    let halting = drive.submit(Command::Halt);
    drive.velocity = 0;
    drive.shows_for(60, QUICK_STOP_ACTIVE);
    assert_eq!(drive.outcome(halting), None);
    drive.shows(SWITCH_ON_DISABLED);
    for id in [stopping, halting] {
        assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));
    }
}

#[test]
fn a_quick_stop_takes_no_bit_8_from_a_later_halt() {
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::QuickStop);
    assert_eq!(drive.word(), QUICK_STOP);
    drive.submit(Command::Halt);
    assert_eq!(drive.word(), QUICK_STOP);
    drive.stop_lane(StopRequest::HALT);
    assert_eq!(drive.word(), QUICK_STOP);
    assert!(!drive.core.snapshot().halted);
}

#[test]
fn whoever_stops_an_axis_that_is_being_switched_off_waits_for_that() {
    for command in [
        Command::Halt,
        Command::Stop,
        Command::QuickStop,
        Command::Release,
        Command::Disable,
    ] {
        let (mut drive, disabling) = switching_off();
        let waiting = drive.submit(command);
        assert_eq!(drive.outcome(waiting), None, "{command:?}");
        assert_eq!(drive.word(), 0, "{command:?}");
        drive.shows_for(3, SWITCH_ON_DISABLED);
        for id in [disabling, waiting] {
            let end = stopped(State::SwitchOnDisabled);
            assert_eq!(drive.outcome(id), end, "{command:?}");
        }
    }
}

#[test]
fn an_axis_that_is_not_switched_off_in_time_fails_whoever_waits_for_it() {
    let (mut drive, disabling) = switching_off();
    let (cycles, result) = drive.cycles_to_end(disabling, QUICK_STOP_ACTIVE);
    assert_eq!(cycles, 200);
    let Err(Failure::Timeout { waiting_for, .. }) = result else {
        panic!("{result:?}");
    };
    assert_eq!(waiting_for, WaitingFor::State(State::SwitchOnDisabled));
    assert_eq!(drive.word(), 0);
}

/// Words that say that it was switched off may be wrong.
#[test]
fn an_axis_that_moves_while_it_is_switched_off_is_switched_off_after_its_stop() {
    let (mut drive, disabling) = switching_off();
    drive.velocity = 20;
    drive.shows_for(5, SWITCH_ON_DISABLED);
    drive.shows_for(5, QUICK_STOP_ACTIVE);
    assert_eq!(drive.word(), QUICK_STOP);
    drive.velocity = 0;
    assert!(drive.cycles_until(0, QUICK_STOP_ACTIVE) < 200);
    assert_eq!(drive.outcome(disabling), None);
    drive.shows_for(3, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(disabling), stopped(State::SwitchOnDisabled));
}

#[test]
fn a_stop_of_a_drive_that_stays_in_quick_stop_active_leaves_it_there() {
    let (mut drive, moving) = Played::moving(Played::staying(), 100_000);
    let stopping = drive.submit(Command::QuickStop);
    assert_eq!(drive.word(), QUICK_STOP);
    drive.velocity = 0;
    let (_, result) = drive.cycles_to_end(stopping, QUICK_STOP_ACTIVE);
    let state = State::QuickStopActive;
    assert_eq!(result, Ok(Completion::Stopped { state }));
    let delivery = Delivery::Accepted;
    let failure = Failure::QuickStopped { delivery };
    assert_eq!(drive.outcome(moving), Some(Err(failure)));
    drive.shows_for(300, QUICK_STOP_ACTIVE);
    assert_eq!(drive.word(), QUICK_STOP);
}

#[test]
fn whoever_waits_in_vain_for_an_undelivered_quick_stop_is_told_and_so_is_the_next() {
    let mut config = Played::config();
    config.loss.undelivered_cycles = 10_000;
    let (mut drive, _) = Played::moving(config, 1_000_000);
    for command in [Command::QuickStop, Command::Stop, Command::QuickStop] {
        let stopping = drive.submit(command);
        drive.cycles(399, Brings::Answered, ENABLED);
        assert_eq!(drive.outcome(stopping), None, "{command:?}");
        drive.cycle(Brings::Answered, ENABLED);
        let result = drive.outcome(stopping).expect("its time is over");
        assert_never_stood(&drive, result);
        assert_eq!(drive.word(), 0);
        drive.cycles(600, Brings::Answered, ENABLED);
    }
}

#[test]
fn a_fault_of_a_moving_axis_lets_whoever_stops_it_wait_for_its_rest() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    let stopping = drive.submit(Command::QuickStop);
    drive.shows(FAULT);
    drive.shows_for(20, FAULT);
    assert_eq!(drive.outcome(stopping), None);
    let late = drive.submit(Command::Stop);
    drive.velocity = 0;
    drive.shows_for(30, FAULT);
    let code = None;
    assert_eq!(
        drive.outcome(stopping),
        Some(Err(Failure::Fault {
            code,
            following_error: false
        }))
    );
    assert_eq!(drive.outcome(late), stopped(State::Fault));
}

/// Halted on its way, at rest.
fn halted() -> (Played, CommandId) {
    let (mut drive, moving) = Played::moving(Played::config(), 100_000);
    let halting = drive.submit(Command::Halt);
    // It gets slower: an axis that freezes at once may be at work unseen.
    for velocity in [20, 10, 0] {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    assert!(drive.cycles_to_end(halting, ENABLED).1.is_ok());
    (drive, moving)
}

#[test]
fn a_stop_comes_before_a_resume_that_is_not_sent() {
    for (command, failure, word) in [
        (Command::Halt, Failure::HALTED, HALT),
        (Command::Stop, Failure::QUICK_STOPPED, HALT),
        (
            Command::QuickStop,
            Failure::QUICK_STOPPED,
            QUICK_STOP | 0x100,
        ),
    ] {
        let (mut drive, _) = halted();
        let resuming = drive.submit(Command::Resume);
        assert_eq!((drive.outcome(resuming), drive.word()), (None, GO));
        assert_eq!(drive.answer(Command::Resume), Some(Err(Failure::Busy)));
        drive.submit(command);
        assert_eq!(drive.outcome(resuming), Some(Err(failure)), "{command:?}");
        assert_eq!(drive.word(), word, "{command:?}");
        drive.shows_for(20, ENABLED);
        assert_ne!(drive.word() & 0x100, 0, "{command:?}: it never fell");
    }
    // Of an axis that is not halted it takes nothing back.
    let mut drive = Played::enabled(Played::config());
    let resuming = drive.submit(Command::Resume);
    drive.submit(Command::QuickStop);
    assert_eq!(drive.outcome(resuming), Some(Err(Failure::QUICK_STOPPED)));
    assert_eq!(drive.word(), QUICK_STOP);
    assert!(!drive.core.snapshot().halted);
}

#[test]
fn a_resume_says_what_is_in_its_way() {
    let state = State::SwitchOnDisabled;
    let mut drive = Played::disabled(Played::config());
    assert_eq!(
        drive.answer(Command::Resume),
        Some(Err(Failure::NotEnabled { state }))
    );
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    assert_eq!(drive.answer(Command::Resume), Some(Err(Failure::Moving)));
    drive.submit(Command::Stop);
    let failure = Failure::QUICK_STOPPED;
    assert_eq!(drive.answer(Command::Resume), Some(Err(failure)));

    // The halt is not sent yet: what it keeps goes on by a frame with bit 8 alone.
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    drive.submit(Command::Halt);
    assert_eq!(drive.answer(Command::Resume), Some(Err(Failure::Busy)));
    drive.shows(ENABLED);
    let resuming = drive.submit(Command::Resume);
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(resuming), Some(Ok(Completion::Done)));
    // One that stands without a set-point is not stopped by it.
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::Halt);
    assert_eq!((drive.answer(Command::Resume), drive.word()), (None, GO));

    // The drive would not go on.
    let mut config = Played::config();
    config.traits.halt_keeps_set_point = false;
    let (mut drive, _) = Played::moving(config.clone(), 100_000);
    drive.submit(Command::Halt);
    drive.velocity = 0;
    drive.shows_for(30, ENABLED);
    assert_eq!(
        drive.answer(Command::Resume),
        Some(Err(Failure::Unsupported(Unsupported::Resume)))
    );
    let mut drive = Played::enabled(config);
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    assert_eq!((drive.answer(Command::Resume), drive.word()), (None, GO));
}

#[test]
fn what_may_have_begun_unseen_is_not_resumed_but_stopped() {
    // The drive never acknowledges the set-point.
    let mut drive = Played::enabled(Played::config());
    let moving = drive.move_to(5_000);
    drive.shows_for(60, REACHED);
    assert!(matches!(
        drive.outcome(moving),
        Some(Err(Failure::Unknown { .. }))
    ));
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    assert_eq!(drive.answer(Command::Resume), Some(Err(Failure::NeedsStop)));
    assert_eq!(drive.word(), HALT);

    // The drive never begins its homing.
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    let homing = drive.submit(HOME);
    drive.shows_for(120, REACHED);
    assert!(matches!(
        drive.outcome(homing),
        Some(Err(Failure::Timeout { .. }))
    ));
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    assert_eq!(drive.answer(Command::Resume), Some(Err(Failure::NeedsStop)));
    assert_eq!(drive.word(), HALT);
}

#[test]
fn eight_wait_for_one_standstill_and_each_of_them_once() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    let waiting = core::array::from_fn::<_, 8, _>(|_| drive.submit(Command::QuickStop));
    assert_eq!(drive.answer(Command::QuickStop), Some(Err(Failure::Busy)));
    drive.submit_as(waiting[3], Command::QuickStop);
    assert_eq!(drive.outcome(waiting[3]), None);
    drive.velocity = 0;
    drive.shows_for(20, QUICK_STOP_ACTIVE);
    drive.shows(SWITCH_ON_DISABLED);
    for id in waiting {
        assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));
    }
}

#[test]
fn the_stop_lane_takes_a_rise_of_bit_4_back_that_is_not_sent() {
    for stop in [
        StopRequest::HALT,
        StopRequest::STOP,
        StopRequest::QUICK_STOP,
        StopRequest::HALT | StopRequest::STOP | StopRequest::QUICK_STOP,
    ] {
        let mut drive = Played::enabled(Played::config());
        let moving = drive.move_to(5_000);
        assert_eq!(drive.word() & 0x10, 0x10);
        assert!(!drive.stop_lane(StopRequest::empty()));
        assert_eq!(drive.word() & 0x10, 0x10);
        assert!(drive.stop_lane(stop), "{stop:?}");
        assert_eq!(drive.word() & 0x10, 0, "{stop:?}");
        assert!(matches!(drive.outcome(moving), Some(Err(_))), "{stop:?}");
        assert!(!drive.stop_lane(stop), "{stop:?}: there is none any more");

        // What was sent keeps its bit 4.
        let mut drive = Played::enabled(Played::config());
        drive.move_to(5_000);
        drive.shows(REACHED);
        assert!(!drive.stop_lane(stop), "{stop:?}");
        assert_eq!(drive.word() & 0x10, 0x10, "{stop:?}");
    }
}

#[test]
fn inputs_that_are_too_short_are_none() {
    let mut drive = Played::enabled(Played::config());
    let bytes = drive.inputs(REACHED);
    for length in 0..bytes.len() {
        drive.now += Duration::from_millis(1);
        let inputs = Inputs::Fresh(&bytes[..length]);
        drive.core.step(drive.now, inputs, &mut drive.outputs);
        let snapshot = drive.core.snapshot();
        assert!(!snapshot.answered, "{length}");
        drive.shows(REACHED);
    }
    // Of an axis without the last object they are long enough.
    let fields = AxisFields {
        error_code: None,
        ..FIELDS
    };
    assert!(fields.sample(&bytes[..11], Mode::None).is_some());
}

#[test]
fn each_halt_is_measured_by_itself() {
    let mut config = Played::config();
    config.deadlines.standstill = Duration::from_secs(1);
    let (mut drive, _) = Played::moving(config, 1_000_000);
    let ignored = Err(Failure::HaltIgnored);
    for _ in 0..2 {
        let halting = drive.submit(Command::Halt);
        assert_eq!(drive.cycles_to_end(halting, ENABLED), (204, ignored));
        assert_eq!(drive.word(), HALT, "it stays");
        drive.submit(Command::Resume);
        drive.shows_for(10, ENABLED);
        assert_eq!(drive.word(), GO);
    }
    // One that nobody waits for goes on to a quick stop, a later one that somebody waits for does not.
    drive.stop_lane(StopRequest::HALT);
    assert_eq!(drive.cycles_until(QUICK_STOP | 0x100, ENABLED), 204);
}

#[test]
fn a_drive_that_is_enabled_by_somebody_while_its_rest_is_waited_for_gets_a_quick_stop() {
    let mut drive = Played::new(Played::config());
    drive.velocity = 50;
    drive.shows_for(2, SWITCH_ON_DISABLED);
    let stopping = drive.submit(Command::Stop);
    let ignored = Err(Failure::QuickStopIgnored);
    // It is commanded from the first of these words on, and seen to be ignored after two spans of 100 ms.
    assert_eq!(drive.cycles_to_end(stopping, ENABLED), (204, ignored));
    assert_eq!(drive.word(), 0);
}

#[test]
fn bits_of_the_mode_stay_as_they_were_sent_until_the_axis_stands() {
    // Its drive stops it by itself, while a second move is on its way.
    let (mut drive, first) = Played::moving(Played::config(), 100_000);
    let second = drive.move_to(50_000);
    drive.shows(ENABLED);
    assert_eq!(drive.word(), 0x003F);
    drive.shows(QUICK_STOP_ACTIVE);
    assert_eq!((drive.word(), drive.target()), (0x003B, 50_000));
    for (id, delivery) in [(first, Delivery::Accepted), (second, Delivery::Unknown)] {
        let failure = Failure::QuickStopped { delivery };
        assert_eq!(drive.outcome(id), Some(Err(failure)));
    }
    drive.velocity = 0;
    drive.shows_for(30, QUICK_STOP_ACTIVE);
    assert_eq!((drive.word(), drive.target()), (QUICK_STOP, drive.position));
    // So does bit 8.
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    drive.submit(Command::Halt);
    drive.shows(ENABLED);
    drive.shows(QUICK_STOP_ACTIVE);
    assert_eq!(drive.word(), QUICK_STOP | 0x0100);
    drive.velocity = 0;
    drive.shows_for(30, QUICK_STOP_ACTIVE);
    assert_eq!(drive.word(), QUICK_STOP);
}

/// A halted drive that leaves its fault reaction with its set-point, and is late to obey, would go on for a moment without bit 8.
#[test]
fn bit_8_stays_with_the_disabling_word_until_the_drive_is_out_of_operation_enabled() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    drive.submit(Command::Halt);
    drive.velocity = 0;
    drive.shows_for(30, REACHED);
    assert_eq!(drive.word(), HALT);
    drive.shows_for(30, FAULT_REACTION);
    assert_eq!(drive.word(), 0x0100);
    drive.shows_for(30, REACHED);
    assert_eq!(drive.word(), 0x0100);
    // Nor does it fall when somebody enables the axis meanwhile.
    drive.submit(Command::Enable);
    drive.shows_for(30, REACHED);
    assert_eq!(drive.word(), 0x0100);
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.word(), 0);
}

#[test]
fn a_stop_that_the_drive_overtakes_by_its_own_quick_stop_has_no_more_time_than_before() {
    let mut config = Played::staying();
    config.deadlines.standstill = Duration::from_secs(4);
    let (mut drive, _) = Played::moving(config, 100_000);
    // It gets slower, and never stands.
    drive.velocity = 10_000;
    drive.submit(Command::Stop);
    let mut until_off = 0;
    while drive.word() != 0 {
        drive.velocity -= 1;
        let brings = if until_off < 2_500 {
            ENABLED
        } else {
            QUICK_STOP_ACTIVE
        };
        drive.shows(brings);
        until_off += 1;
        assert!(until_off < 9_000, "it has no end");
    }
    assert!((3_990..4_010).contains(&until_off), "{until_off}");
}

#[test]
fn a_drive_that_switches_off_by_itself_ends_what_was_under_way() {
    let (mut drive, moving) = Played::moving(Played::config(), 100_000);
    drive.shows(SWITCH_ON_DISABLED);
    let state = State::SwitchOnDisabled;
    assert_eq!(
        drive.outcome(moving),
        Some(Err(Failure::Disabled { state }))
    );
    assert_eq!(drive.word(), QUICK_STOP, "it may be moving by power");
    drive.velocity = 0;
    drive.shows_for(30, SWITCH_ON_DISABLED);
    assert_eq!(drive.word(), 0);
}

#[test]
fn a_halt_that_a_disable_overtakes_is_done_when_the_axis_stands() {
    let mut drive = Played::enabled(Played::config());
    let halting = drive.submit(Command::Halt);
    let disabling = drive.submit(Command::Disable);
    drive.shows_for(3, READY);
    for id in [halting, disabling] {
        assert_eq!(drive.outcome(id), stopped(State::ReadyToSwitchOn));
    }
}

#[test]
fn a_move_is_told_once_that_it_is_halted() {
    let (mut drive, moving) = halted();
    drive.shows_for(20, ENABLED);
    let told = |drive: &Played| {
        let reports = drive.reports.iter();
        reports
            .filter(|report| **report == (moving, Event::Halted))
            .count()
    };
    assert_eq!(told(&drive), 1);
    drive.submit(Command::Resume);
    drive.velocity = 20;
    drive.shows_for(5, ENABLED);
    drive.submit(Command::Halt);
    drive.shows_for(3, ENABLED);
    drive.velocity = 0;
    drive.shows_for(30, ENABLED);
    assert_eq!(told(&drive), 2);
}

#[test]
fn an_axis_that_its_drive_does_not_bring_to_rest_loses_its_power_at_the_deadline() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    let stopping = drive.submit(Command::QuickStop);
    let (cycles, result) = drive.cycles_to_end(stopping, QUICK_STOP_ACTIVE);
    assert_eq!(cycles, 400);
    assert_never_stood(&drive, result);
    assert_eq!(drive.word(), 0);
    drive.shows_for(900, QUICK_STOP_ACTIVE);
    assert_eq!(drive.word(), 0);
}

#[test]
fn an_ignored_quick_stop_is_measured_anew_after_each_other_state() {
    let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
    drive.submit(Command::QuickStop);
    drive.shows_for(150, ENABLED);
    drive.shows(QUICK_STOP_ACTIVE);
    drive.shows_for(202, ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
    drive.shows(ENABLED);
    assert_eq!(drive.word(), 0);
    // It takes it at last: until it stands the voltage stays on.
    drive.shows(QUICK_STOP_ACTIVE);
    assert_eq!(drive.word(), QUICK_STOP);
    drive.velocity = 0;
    assert!(drive.cycles_until(0, QUICK_STOP_ACTIVE) < 20);
}

#[test]
fn a_drive_that_leaves_its_fault_reaction_for_operation_enabled_is_stopped() {
    for cycles in [1, 5] {
        let (mut drive, moving) = Played::moving(Played::config(), 100_000);
        drive.shows_for(cycles, FAULT_REACTION);
        let failure = Failure::Fault {
            code: None,
            following_error: false,
        };
        assert_eq!(drive.outcome(moving), Some(Err(failure)), "{cycles}");
        drive.shows(ENABLED);
        assert_eq!(drive.word(), QUICK_STOP, "{cycles}");
        drive.velocity = 0;
        drive.shows_for(30, ENABLED);
        assert_eq!(drive.word(), 0, "{cycles}");
    }
}

#[test]
fn whoever_stopped_an_axis_before_its_fault_is_told_when_it_stands() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    let stopping = drive.submit(Command::QuickStop);
    drive.shows_for(20, FAULT);
    assert_eq!(drive.outcome(stopping), None);
    drive.velocity = 0;
    drive.shows_for(30, FAULT);
    let code = None;
    assert_eq!(
        drive.outcome(stopping),
        Some(Err(Failure::Fault {
            code,
            following_error: false
        }))
    );
}

#[test]
fn a_stop_of_an_axis_that_never_stands_fails_when_its_brake_has_had_its_time() {
    let timed_out = |drive: &mut Played, command, statusword| {
        let stopping = drive.submit(command);
        let (cycles, result) = drive.cycles_to_end(stopping, statusword);
        assert_eq!(cycles, 400, "{command:?}");
        assert_never_stood(drive, result);
    };
    for command in [Command::Stop, Command::QuickStop, Command::Disable] {
        // Enabled by somebody else for one cycle; then its time to come to rest runs, with 1 to 50 ms less left than the stop has.
        for before in [1, 2, 10, 50] {
            for statusword in [SWITCHED_ON, SWITCH_ON_DISABLED, FAULT] {
                match (command, statusword) {
                    // It is refused.
                    (Command::QuickStop, FAULT) => continue,
                    // It leads further down, which has a deadline of its own.
                    (Command::Disable, SWITCHED_ON) => continue,
                    _ => {}
                }
                let mut drive = Played::disabled(Played::config());
                drive.velocity = 20;
                drive.shows(ENABLED);
                drive.shows_for(before, statusword);
                timed_out(&mut drive, command, statusword);
                // So does the next: it runs on from what its drive did.
                timed_out(&mut drive, command, statusword);
                drive.velocity = 0;
                let stopping = drive.submit(command);
                let (_, result) = drive.cycles_to_end(stopping, statusword);
                assert!(result.is_ok(), "{command:?}: {result:?}");
            }
        }
    }
}

#[test]
fn a_resume_does_not_overtake_a_stop_of_an_axis_that_does_not_stand() {
    let mut drive = Played::enabled(Played::config());
    drive.position += 15;
    drive.shows(REACHED);
    drive.submit(Command::Halt);
    assert_eq!(drive.answer(Command::Resume), Some(Err(Failure::Busy)));
    assert_eq!(drive.word(), HALT);
}

#[test]
fn a_jog_that_does_not_come_to_rest_says_what_was_seen() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    let jog = drive.submit(Command::Jog(JogSetPoint::new(40)));
    assert!(!drive.core.snapshot().has_set_point);
    drive.velocity = 40;
    drive.shows(ENABLED);
    assert!(drive.core.snapshot().has_set_point);
    let (now, outputs) = (drive.now, &mut drive.outputs);
    drive.core.release_jog(now, jog, outputs);
    let (_, result) = drive.cycles_to_end(jog, ENABLED);
    assert_never_stood(&drive, result);
}

#[test]
fn a_disable_comes_before_a_resume_that_is_not_sent() {
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    let resuming = drive.submit(Command::Resume);
    drive.submit(Command::Disable);
    drive.shows(REACHED);
    let state = State::OperationEnabled;
    assert_eq!(
        drive.outcome(resuming),
        Some(Err(Failure::Disabled { state }))
    );
}

/// Halted on its way at an end velocity: it goes on with that when bit 8 falls.
fn halted_at_end_velocity() -> Played {
    let mut drive = Played::at_end_velocity();
    drive.halt_to_rest();
    drive
}

#[test]
fn a_stop_just_after_a_resume_stops_what_goes_on_at_its_end_velocity() {
    let mut drive = halted_at_end_velocity();
    let resuming = drive.submit(Command::Resume);
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(resuming), Some(Ok(Completion::Done)));
    assert_eq!(drive.word(), GO);
    let stopping = drive.submit(Command::Stop);
    // The drive has begun to go on by now.
    drive.velocity = 20;
    drive.shows_for(3, ENABLED);
    assert_eq!(drive.outcome(stopping), None);
    assert_eq!(drive.word(), HALT);
}

//! Drives that do not answer, or do not take their outputs; and programs that are not alive.

use super::played::{ACKNOWLEDGED, Brings, ENABLED, Played, REACHED, SWITCH_ON_DISABLED, absolute};
use crate::{
    axis::{Command, Completion, Delivery, Event, Failure, Inputs},
    ds402::{Controlword, Mode, State},
    homing::{HomingCommand, HomingMethod},
    profile_position::Limits,
    profile_velocity::JogSetPoint,
};

const QUICK_STOP: u16 = 0x000B;

const NOT_SENT: Delivery = Delivery::NotSent;
const BUS_LOST: Failure = Failure::BusLost { delivery: NOT_SENT };
const UNDELIVERED: Failure = Failure::Undelivered {
    delivery: NOT_SENT,
    counter: None,
};

const HOME: Command = Command::Home(HomingCommand {
    method: HomingMethod::NEGATIVE_LIMIT,
    offset: None,
    until: None,
});

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

const STOPS: [Command; 4] = [
    Command::Halt,
    Command::Stop,
    Command::QuickStop,
    Command::Disable,
];

fn that_do_not() -> [Command; 5] {
    [
        Command::ResetFault,
        Command::SelectMode(Mode::Homing),
        Command::PrepareMode(Mode::Homing),
        Command::SetLimits(Limits::trust_drive()),
        Command::Release,
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
    assert!(!drive.core.withdraw(other, &mut drive.outputs));
    assert_eq!(drive.word() & 0x10, 0x10);
    assert!(drive.core.withdraw(moving, &mut drive.outputs));
    drive.drain();
    assert_eq!(drive.word() & 0x10, 0);
    assert_eq!(drive.outcome(moving), Some(Err(Failure::Withdrawn)));

    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    let jog = drive.submit(Command::Jog(JogSetPoint::new(7)));
    assert!(drive.core.withdraw(jog, &mut drive.outputs));
    assert_eq!(drive.target_velocity(), 0);

    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    let homing = drive.submit(HOME);
    assert!(drive.core.withdraw(homing, &mut drive.outputs));
    drive.shows_for(10, REACHED);
    assert_eq!(drive.word() & 0x10, 0);

    // A change of mode, before and after it is written.
    for cycles in [0, 5] {
        let mut drive = Played::enabled(Played::config());
        let selecting = drive.submit(Command::SelectMode(Mode::Homing));
        drive.shows_for(cycles, REACHED);
        assert!(!drive.core.withdraw(other, &mut drive.outputs));
        assert!(drive.core.withdraw(selecting, &mut drive.outputs));
        drive.drain();
        assert_eq!(drive.outcome(selecting), Some(Err(Failure::Withdrawn)));
        assert_eq!(drive.outputs[6], 1);
        assert!(!drive.core.withdraw(selecting, &mut drive.outputs));
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
    config.referencing = crate::axis::Referencing::ByHoming;
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

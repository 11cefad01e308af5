//! Stop and hold: the axis stays enabled where it was stopped, and what the drive kept is gone. What a drive does with a set-point while it is
//! halted decides how it ends.

use crate::common::Rig;
use servocrab::ds402::{Mode, State};
use servocrab::profile_position::PositionRange;
use servocrab::{
    BufferMode, Doubt, Failure, SetPoint,
    axis::{Command, CommandId, Completion, Event, Unsupported},
};
use servocrab_sim::ds402::{Behaviour, Outcome, WhileHalted};

const STAYS_ENABLED: Completion = Completion::Stopped {
    state: State::OperationEnabled,
};

/// An enabled axis whose drive does this with set-points while it is halted, and is said to acknowledge them.
fn rig(while_halted: WhileHalted) -> Rig {
    let behaviour = Behaviour {
        while_halted,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.traits.acknowledges_while_halted = true;
    });
    rig.enable();
    rig
}

/// The same, on its way to 50 000.
fn moving(while_halted: WhileHalted) -> (Rig, CommandId) {
    let mut rig = rig(while_halted);
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    assert!(rig.moves());
    (rig, id)
}

#[test]
fn a_moving_axis_stops_and_stays_enabled_and_nothing_is_kept() {
    let (mut rig, id) = moving(WhileHalted::Takes);
    let behind = rig.abs(-10_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.wait_accepted(behind);
    let hold = rig.send(Command::Hold);
    rig.cycle();
    assert_eq!(rig.words.last().map(|word| word & 0x100), Some(0x100));
    let held = rig.finish(hold);
    assert_eq!(held, Ok(Completion::Done));
    assert!(!rig.moves());
    for replaced in [id, behind] {
        assert_eq!(rig.outcome(replaced), Some(Err(Failure::Superseded)));
    }
    rig.assert_rests();
    assert_eq!(rig.statusword().state(), State::OperationEnabled);
    assert_eq!(rig.word() & 0x1FF, 0x000F);
    let outcomes: Vec<_> = rig.ledger().iter().map(|entry| entry.outcome).collect();
    assert_eq!(
        outcomes,
        [Outcome::Replaced, Outcome::Replaced, Outcome::Reached]
    );
    // It goes on without another enable.
    let next = rig.abs(0, SetPoint::new());
    rig.assert_reached(next, 0);
}

#[test]
fn what_a_drive_does_with_a_set_point_while_it_is_halted_decides_how_it_ends() {
    for habit in [WhileHalted::Ignores, WhileHalted::TakesAtRelease] {
        let (mut rig, id) = moving(habit);
        let hold = rig.send(Command::Hold);
        let failure = rig.finish(hold).expect_err("it was not acknowledged");
        assert!(
            matches!(
                failure,
                Failure::Unknown {
                    doubt: Doubt::Unacknowledged,
                    ..
                }
            ),
            "{habit:?}: {failure:?}"
        );
        // Bit 8 stays, and the axis needs a stop.
        rig.assert_rests();
        assert_eq!(rig.word() & 0x100, 0x100, "{habit:?}");
        for refused in [Command::Resume, Command::Hold] {
            let refused = rig.send(refused);
            assert_eq!(rig.finish(refused), Err(Failure::NeedsStop), "{habit:?}");
        }
        let stop = rig.send(Command::Stop);
        assert!(rig.finish(stop).is_ok(), "{habit:?}");
        assert!(rig.outcome(id).is_some_and(|outcome| outcome.is_err()));
        rig.enable();
        rig.assert_rests();
        let next = rig.abs(0, SetPoint::new());
        rig.assert_reached(next, 0);
    }
}

#[test]
fn what_its_drive_cannot_do_is_refused_and_the_axis_moves_on() {
    let turn = PositionRange {
        min: 0,
        max: 99_999,
    };
    type Change = fn(&mut servocrab::axis::CoreConfig);
    let cases: [(Change, &str); 2] = [
        (|_| {}, "while it is halted"),
        (
            |config| config.traits.acknowledges_while_halted = true,
            "modulo",
        ),
    ];
    for (change, reason) in cases {
        let mut rig = Rig::new(Behaviour::akd2g(), |config| {
            change(config);
            if reason == "modulo" {
                config.modulo = Some(turn);
            }
        });
        rig.enable();
        let id = rig.abs(50_000, SetPoint::new());
        rig.wait_accepted(id);
        rig.run(200);
        let sent = rig.words.len();
        let hold = rig.send(Command::Hold);
        let failure = rig.finish(hold).expect_err("it is refused");
        assert!(
            matches!(failure, Failure::Unsupported(Unsupported::Hold { .. })),
            "{failure:?}"
        );
        let text = failure.to_string();
        for part in [reason, "stop()", "605Ah = 5 or 6"] {
            assert!(text.contains(part), "{text}");
        }
        rig.assert_reached(id, 50_000);
        assert_eq!(rig.distinct_words(sent), [0x000F]);
    }
}

#[test]
fn an_axis_that_holds_no_set_point_is_released_where_it_stands() {
    let mut rig = rig(WhileHalted::Takes);
    let sent = rig.words.len();
    let hold = rig.send(Command::Hold);
    assert_eq!(rig.finish(hold), Ok(STAYS_ENABLED));
    let halt = rig.send(Command::Halt);
    assert_eq!(rig.finish(halt), Ok(STAYS_ENABLED));
    let hold = rig.send(Command::Hold);
    assert_eq!(rig.finish(hold), Ok(Completion::Done));
    rig.run(20);
    assert_eq!(rig.distinct_words(sent), [0x010F, 0x000F]);
    assert!(rig.ledger().is_empty());
}

#[test]
fn a_halted_axis_is_held_where_it_stands() {
    let (mut rig, id) = moving(WhileHalted::Takes);
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let hold = rig.send(Command::Hold);
    assert!(rig.finish(hold).is_ok());
    assert_eq!(rig.outcome(id), Some(Err(Failure::Superseded)));
    rig.assert_rests();
}

#[test]
fn a_halt_or_a_stop_that_comes_meanwhile_has_its_way() {
    for (command, delay) in [
        (Command::Halt, 0),
        (Command::Halt, 5),
        (Command::Stop, 5),
        (Command::QuickStop, 5),
        (Command::Disable, 5),
    ] {
        let (mut rig, _) = moving(WhileHalted::Takes);
        let hold = rig.send(Command::Hold);
        rig.run(delay);
        let stop = rig.send(command);
        assert!(rig.finish(stop).is_ok(), "{command:?}");
        let outcome = rig.outcome(hold).expect("it has ended");
        let failure = outcome.expect_err("it was overtaken");
        let expected = match command {
            Command::Halt => matches!(failure, Failure::Halted { .. }),
            Command::Disable => matches!(failure, Failure::Disabled { .. }),
            _ => matches!(failure, Failure::QuickStopped { .. }),
        };
        assert!(expected, "{command:?}: {failure:?}");
        rig.assert_rests();
        if command == Command::Halt {
            assert_eq!(rig.word() & 0x100, 0x100, "it stays halted");
        } else {
            assert_ne!(rig.statusword().state(), State::OperationEnabled);
        }
    }
}

#[test]
fn it_is_refused_in_another_mode_without_power_and_in_a_fault() {
    let mut rig = rig(WhileHalted::Takes);
    let select = rig.send(Command::SelectMode(Mode::ProfileVelocity));
    assert!(rig.finish(select).is_ok());
    let hold = rig.send(Command::Hold);
    assert!(matches!(rig.finish(hold), Err(Failure::WrongMode { .. })));
    let disable = rig.send(Command::Disable);
    assert!(rig.finish(disable).is_ok());
    let hold = rig.send(Command::Hold);
    assert!(matches!(rig.finish(hold), Err(Failure::NotEnabled { .. })));
    rig.drive.inject_fault(0x7305);
    rig.run(50);
    let hold = rig.send(Command::Hold);
    assert!(matches!(rig.finish(hold), Err(Failure::Fault { .. })));
}

/// The drive would have it for the set-point of a hold as well.
#[test]
fn an_end_velocity_that_goes_by_sdo_is_refused_on_an_axis_that_can_be_held() {
    let mut rig = rig(WhileHalted::Takes);
    let id = rig.abs(5_000, SetPoint::new().end_velocity(500));
    let failure = rig.finish(id).expect_err("it is refused");
    assert!(
        failure.to_string().contains("end velocity 6082h"),
        "{failure}"
    );
    let id = rig.abs(5_000, SetPoint::new().end_velocity(0));
    rig.assert_reached(id, 5_000);
}

#[test]
fn an_aborting_move_on_a_halted_axis_takes_the_place_of_what_is_kept() {
    let (mut rig, id) = moving(WhileHalted::Takes);
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let queued = rig.abs(9_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    assert!(matches!(rig.finish(queued), Err(Failure::Halted { .. })));
    let next = rig.abs(-4_000, SetPoint::new());
    rig.wait_accepted(next);
    assert_eq!(rig.outcome(id), Some(Err(Failure::Superseded)));
    rig.assert_rests();
    assert_eq!(rig.reports(next), [Event::Accepted, Event::Halted]);
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    rig.assert_reached(next, -4_000);
}

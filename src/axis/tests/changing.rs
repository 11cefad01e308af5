//! Changes of the mode, and the limits and parameters that a motion is checked against.

use core::time::Duration;

use super::played::{
    ACKNOWLEDGED, Brings, ENABLED, FAULT, FAULT_REACTION, FIELDS, HALT, HOME, Played, QUICK_STOP,
    QUICK_STOP_ACTIVE, REACHED, READY, SWITCH_ON_DISABLED, SWITCHED_ON, SlowModes, absolute,
};
use crate::{
    BufferMode, Doubt, Failure, Referencing, SetPoint,
    axis::{
        AxisFields, Command, Completion, CoreConfig, Delivery, Event, ParameterFault, Unsupported,
        WaitingFor,
    },
    ds402::{Mode, State, SupportedModes},
    profile_position::{
        Limits, MinVelocity, MoveCommand, Parameters, PositionRange, Reference, RelativeBase,
    },
    profile_velocity::JogSetPoint,
};

const DONE: Option<Result<Completion, Failure>> = Some(Ok(Completion::Done));
const TO_HOMING: Command = Command::SelectMode(Mode::Homing);

fn refused(failure: Failure) -> Option<Result<Completion, Failure>> {
    Some(Err(failure))
}

fn wrong_mode(expected: Mode, shown: Mode) -> Failure {
    Failure::WrongMode {
        expected,
        shown,
        delivery: Delivery::NotSent,
    }
}

/// 6060h is not in the process data.
fn mode_by_sdo() -> CoreConfig {
    CoreConfig {
        fields: AxisFields {
            mode: None,
            ..FIELDS
        },
        ..Played::config()
    }
}

#[test]
fn a_mode_is_written_at_rest_and_done_when_it_is_shown() {
    let mut drive = Played::enabled(Played::config());
    assert_eq!(
        drive.answer(Command::SelectMode(Mode::ProfilePosition)),
        DONE
    );
    let selecting = drive.submit(TO_HOMING);
    // No bit of the last mode was sent for long enough.
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 6));
    drive.shows(REACHED);
    assert_eq!(drive.outcome(selecting), None);
    assert_eq!(drive.answer(TO_HOMING), refused(Failure::Busy));
    drive.mode = 6;
    drive.shows(REACHED);
    assert_eq!(drive.outcome(selecting), DONE);
    assert_eq!(drive.answer(TO_HOMING), DONE);
}

#[test]
fn a_mode_that_is_not_shown_in_time_is_taken_back() {
    let mut drive = Played::enabled(Played::config());
    let selecting = drive.submit(TO_HOMING);
    drive.shows_for(59, REACHED);
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 6));
    drive.shows(REACHED);
    assert_eq!(drive.outputs[6], 1);
    let Some(Err(Failure::Timeout { waiting_for, .. })) = drive.outcome(selecting) else {
        panic!("{:?}", drive.outcome(selecting));
    };
    assert_eq!(waiting_for, WaitingFor::Mode(Mode::Homing));
    // It is shown too late: nothing is left that waits for it.
    drive.mode = 6;
    drive.shows(REACHED);
    assert_eq!(
        drive.answer(HOME),
        refused(wrong_mode(Mode::Homing, Mode::Homing))
    );
}

/// Bit 4 starts a homing in homing mode. A drive that is late to change its mode may be there when the mode before is commanded again.
#[test]
fn nothing_begins_while_the_drive_may_come_to_a_mode_that_was_taken_back() {
    let wrong = refused(wrong_mode(Mode::ProfilePosition, Mode::ProfilePosition));
    let withdrawn = || {
        let mut drive = Played::enabled(Played::config());
        let selecting = drive.submit(TO_HOMING);
        drive.shows_for(3, REACHED);
        assert_eq!(drive.outputs[6], 6);
        assert!(
            drive
                .core
                .withdraw(drive.now, selecting, &mut drive.outputs)
        );
        assert_eq!(drive.outputs[6], 1);
        drive.drain();
        assert_eq!(drive.outcome(selecting), refused(Failure::Withdrawn));
        drive
    };
    let mut drive = withdrawn();
    for _ in 0..60 {
        assert_eq!(drive.answer(Command::Move(absolute(50))), wrong);
        drive.shows(REACHED);
    }
    drive.shows(REACHED);
    assert_eq!(drive.answer(Command::Move(absolute(50))), None);
    assert_eq!(drive.word(), 0x003F);

    // Who selects the mode before waits for that, and no longer.
    let mut drive = withdrawn();
    let back = drive.submit(Command::SelectMode(Mode::ProfilePosition));
    let other = drive.answer(Command::SelectMode(Mode::ProfileVelocity));
    assert_eq!(other, refused(Failure::Busy));
    drive.shows_for(59, REACHED);
    assert_eq!(drive.outcome(back), None);
    drive.shows(REACHED);
    assert_eq!(drive.outcome(back), Some(Ok(Completion::Done)));
    // Or goes away again.
    let mut drive = withdrawn();
    let back = drive.submit(Command::SelectMode(Mode::ProfilePosition));
    assert!(drive.core.withdraw(drive.now, back, &mut drive.outputs));
    assert_eq!(drive.answer(Command::Move(absolute(50))), wrong);

    // A change that was not written yet leaves nothing to wait for.
    let mut drive = Played::enabled(Played::config());
    drive.velocity = 30;
    drive.shows_for(3, ENABLED);
    let selecting = drive.submit(TO_HOMING);
    drive.shows(ENABLED);
    drive
        .core
        .withdraw(drive.now, selecting, &mut drive.outputs);
    drive.velocity = 0;
    drive.shows_for(30, REACHED);
    assert_eq!(drive.answer(Command::Move(absolute(50))), None);

    // Nor does a change to the mode that is in the outputs already.
    let mut drive = Played::enabled(Played::config());
    drive.mode = 6;
    drive.shows(REACHED);
    let selecting = drive.submit(Command::SelectMode(Mode::ProfilePosition));
    drive.shows_for(3, REACHED);
    assert!(
        drive
            .core
            .withdraw(drive.now, selecting, &mut drive.outputs)
    );
    drive.mode = 1;
    drive.shows(REACHED);
    assert_eq!(drive.answer(Command::Move(absolute(50))), None);
}

#[test]
fn a_mode_is_not_written_while_the_axis_moves_or_bits_of_the_last_may_be_seen() {
    // It moves without a set-point.
    let mut drive = Played::enabled(Played::config());
    drive.position += 500;
    drive.velocity = 30;
    drive.shows(ENABLED);
    let selecting = drive.submit(TO_HOMING);
    drive.shows_for(59, ENABLED);
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 1));
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(selecting), refused(Failure::Moving));
    // One that is not driven may be turned by hand.
    let mut drive = Played::disabled(Played::config());
    drive.velocity = 30;
    drive.shows_for(3, SWITCH_ON_DISABLED);
    drive.submit(TO_HOMING);
    assert_eq!(drive.outputs[6], 6);

    let mut drive = Played::enabled(Played::config());
    drive.move_to(0);
    drive.shows(REACHED);
    assert_eq!(drive.answer(TO_HOMING), refused(Failure::Moving));
    drive.shows(ACKNOWLEDGED);
    assert_eq!(drive.word() & 0x10, 0);
    // The drive reaches it at once.
    drive.shows_for(20, REACHED);
    drive.submit(TO_HOMING);
    assert_eq!(drive.outputs[6], 6);
}

#[test]
fn bits_that_were_not_delivered_low_keep_the_mode() {
    let mut drive = Played::new(Played::config());
    drive.cycles(20, Brings::Answered, SWITCH_ON_DISABLED);
    let selecting = drive.submit(TO_HOMING);
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 1));
    drive.shows_for(2, SWITCH_ON_DISABLED);
    assert_eq!(drive.outputs[6], 1);
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.outputs[6], 6);
}

#[test]
fn a_change_of_mode_says_what_is_in_its_way() {
    let mut config = Played::config();
    config.supported_modes = Some(SupportedModes::PROFILE_POSITION);
    let mut drive = Played::enabled(config);
    let mode = Mode::Homing;
    assert_eq!(
        drive.answer(TO_HOMING),
        refused(Failure::Unsupported(Unsupported::Mode(mode)))
    );
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::Halt);
    assert_eq!(drive.answer(TO_HOMING), refused(Failure::HALTED));
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::QuickStop);
    assert_eq!(drive.answer(TO_HOMING), refused(Failure::Busy));
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    assert_eq!(drive.answer(TO_HOMING), refused(Failure::Moving));
    // A move that waits for its turn.
    let mut drive = Played::enabled(Played::config());
    drive.cycle(Brings::Answered, REACHED);
    drive.move_to(5_000);
    assert_eq!(drive.answer(TO_HOMING), refused(Failure::Moving));
}

#[test]
fn who_writes_6060h_by_sdo_is_told_when_and_then_waits_for_the_mode() {
    let mut drive = Played::enabled(Played::config());
    let mode = Mode::Homing;
    assert_eq!(
        drive.answer(Command::PrepareMode(mode)),
        Some(Ok(Completion::Prepared { mode }))
    );
    assert_eq!(drive.outputs[6], 1);
    drive.shows_for(100, REACHED);
    assert_eq!(
        drive.answer(HOME),
        refused(wrong_mode(Mode::Homing, Mode::ProfilePosition))
    );
    assert_eq!(
        drive.answer(Command::Move(absolute(5))),
        refused(wrong_mode(Mode::ProfilePosition, Mode::ProfilePosition))
    );
    let selecting = drive.submit(TO_HOMING);
    drive.mode = 6;
    drive.shows(REACHED);
    assert_eq!(drive.outcome(selecting), DONE);
}

#[test]
fn what_ends_everything_ends_a_change_of_mode() {
    let code = None;
    let mut drive = Played::enabled(Played::config());
    let selecting = drive.submit(TO_HOMING);
    drive.shows(FAULT);
    assert_eq!(
        drive.outcome(selecting),
        refused(Failure::Fault {
            code,
            following_error: false
        })
    );
    assert_eq!(drive.outputs[6], 1);
}

#[test]
fn a_mode_that_is_not_mapped_is_what_was_read_of_it() {
    let mut drive = Played::enabled(CoreConfig {
        fields: AxisFields {
            mode_display: None,
            ..FIELDS
        },
        ..Played::config()
    });
    assert_eq!(drive.core.snapshot().mode, Mode::None);
    drive.core.note_mode(Mode::ProfilePosition);
    assert_eq!(drive.core.snapshot().mode, Mode::ProfilePosition);
    drive.shows(REACHED);
    assert_eq!(drive.core.snapshot().mode, Mode::ProfilePosition);
    assert_eq!(drive.answer(Command::CheckMove(absolute(5))), DONE);
    // Where it is mapped that says nothing.
    let mut drive = Played::enabled(Played::config());
    drive.core.note_mode(Mode::Homing);
    assert_eq!(drive.core.snapshot().mode, Mode::ProfilePosition);
}

#[test]
fn a_motion_is_refused_for_what_is_in_its_way() {
    let state = State::SwitchOnDisabled;
    let each = |failure: Failure, prepare: &dyn Fn() -> (Played, Mode)| {
        for mode in [Mode::ProfilePosition, Mode::Homing, Mode::ProfileVelocity] {
            let commands = match mode {
                Mode::ProfilePosition => {
                    [Command::Move(absolute(5)), Command::CheckMove(absolute(5))]
                }
                Mode::Homing => [HOME, Command::CheckHome],
                _ => [Command::Jog(JogSetPoint::new(5)), Command::CheckJog(5)],
            };
            for command in commands {
                let (mut drive, of) = prepare();
                let expected = match failure {
                    Failure::WrongMode { shown, .. } if mode != of => wrong_mode(mode, shown),
                    _ if mode != of => continue,
                    failure => failure,
                };
                let outputs = drive.outputs;
                assert_eq!(drive.answer(command), refused(expected), "{command:?}");
                assert_eq!(drive.outputs, outputs, "{command:?}");
            }
        }
    };
    for mode in [Mode::ProfilePosition, Mode::Homing, Mode::ProfileVelocity] {
        let enabled = move || {
            if mode == Mode::ProfilePosition {
                Played::enabled(Played::config())
            } else {
                Played::enabled_in(mode, Played::config())
            }
        };
        let code = None;
        each(
            Failure::Fault {
                code,
                following_error: false,
            },
            &|| {
                let mut drive = enabled();
                drive.shows(FAULT);
                (drive, mode)
            },
        );
        each(Failure::QUICK_STOPPED, &|| {
            let mut drive = enabled();
            drive.submit(Command::QuickStop);
            (drive, mode)
        });
        each(Failure::NotEnabled { state }, &|| {
            let mut drive = enabled();
            drive.submit(Command::Disable);
            drive.shows_for(5, SWITCH_ON_DISABLED);
            (drive, mode)
        });
        each(Failure::HALTED, &|| {
            let mut drive = enabled();
            drive.submit(Command::Halt);
            (drive, mode)
        });
        // 6060h holds it, 6061h shows another.
        each(wrong_mode(mode, Mode::CyclicTorque), &|| {
            let mut drive = enabled();
            drive.mode = 10;
            drive.shows(REACHED);
            (drive, mode)
        });
    }
    // 6061h shows it, 6060h holds another.
    let mut drive = Played::enabled(Played::config());
    drive.mode = 6;
    drive.shows(REACHED);
    assert_eq!(
        drive.answer(HOME),
        refused(wrong_mode(Mode::Homing, Mode::Homing))
    );
    // In its own mode each is allowed.
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    assert_eq!(drive.answer(Command::CheckHome), DONE);
    assert_eq!(drive.answer(HOME), None);
    assert_eq!(drive.answer(Command::CheckHome), refused(Failure::Busy));
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    assert_eq!(drive.answer(Command::CheckJog(5)), DONE);
    assert_eq!(drive.answer(Command::Jog(JogSetPoint::new(5))), None);
    assert_eq!(drive.answer(Command::CheckJog(5)), refused(Failure::Busy));
}

#[test]
fn limits_hold_to_the_count() {
    let mut drive = Played::enabled(Played::config());
    let limits = Limits {
        position_range: Some(PositionRange { min: -100, max: 50 }),
        max_velocity: Some(700),
        ..Limits::trust_drive()
    };
    assert_eq!(drive.answer(Command::SetLimits(limits)), DONE);
    for (target, allowed) in [(-101, false), (-100, true), (50, true), (51, false)] {
        let answer = drive.answer(Command::CheckMove(absolute(target)));
        assert_eq!(answer == DONE, allowed, "{target}");
        assert!(allowed || matches!(answer, Some(Err(Failure::BeyondLimit { .. }))));
    }
    // Where a distance ends is judged when its turn comes.
    let distance = MoveCommand {
        reference: Reference::Relative,
        ..absolute(51)
    };
    assert_eq!(drive.answer(Command::CheckMove(distance)), DONE);
    for (velocity, allowed) in [(700, true), (701, false)] {
        for set_point in [
            SetPoint::new().velocity(velocity),
            SetPoint::new().velocity(1).end_velocity(velocity),
        ] {
            let mut fast = absolute(0);
            fast.set_point = set_point;
            let limit = 700;
            let answer = drive.answer(Command::CheckMove(fast));
            let too_fast = refused(Failure::BeyondLimit {
                object: crate::coe::ObjectAddress::new(0x607F, 0),
                limit,
                asked: velocity.into(),
            });
            assert_eq!(answer, if allowed { DONE } else { too_fast });
        }
    }
    // A modulo axis has its turn among them, whatever else is said.
    let mut config = Played::config();
    config.modulo = Some(PositionRange { min: 0, max: 359 });
    let mut drive = Played::enabled(config);
    for _ in 0..2 {
        for (target, allowed) in [(-1, false), (0, true), (359, true), (360, false)] {
            let answer = drive.answer(Command::CheckMove(absolute(target)));
            assert_eq!(answer == DONE, allowed, "{target}");
        }
        drive.answer(Command::SetLimits(Limits::trust_drive()));
    }
}

#[test]
fn jogs_are_held_within_the_greatest_velocity() {
    let mut config = Played::config();
    config.limits.max_velocity = Some(700);
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, config);
    for (velocity, allowed) in [(700, true), (-700, true), (701, false), (-701, false)] {
        let answer = drive.answer(Command::CheckJog(velocity));
        assert_eq!(answer == DONE, allowed, "{velocity}");
    }
    let jog = drive.submit(Command::Jog(JogSetPoint::new(5)));
    let other = crate::axis::CommandId(900);
    assert_eq!(drive.core.jog(), Some(jog));
    for (id, velocity, follows) in [
        (jog, -700, true),
        (jog, -701, false),
        (other, 20, false),
        (jog, 30, true),
    ] {
        let before = drive.target_velocity();
        let followed = drive.core.set_jog(id, velocity, &mut drive.outputs);
        assert_eq!(followed, follows, "{velocity}");
        let expected = if follows { velocity } else { before };
        assert_eq!(drive.target_velocity(), expected);
    }
    let now = drive.now;
    assert!(!drive.core.release_jog(now, other, &mut drive.outputs));
    assert_eq!(drive.target_velocity(), 30);
    assert!(drive.core.release_jog(now, jog, &mut drive.outputs));
    assert_eq!(drive.target_velocity(), 0);
    assert!(!drive.core.release_jog(now, jog, &mut drive.outputs));
    drive.shows_for(60, REACHED);
    assert_eq!(drive.core.jog(), None);
}

/// 2010h is 300, and in the unit of 6081h; the drive holds this in 6081h.
fn with_least(held: u32) -> CoreConfig {
    let mut config = Played::config();
    config.traits.limits.min_velocity = MinVelocity::AsProfileVelocity;
    config.limits.min_velocity = Some(300);
    config.defaults.velocity = Some(held);
    config
}

fn with_velocity(velocity: u32) -> Command {
    let mut command = absolute(0);
    command.set_point = SetPoint::new().velocity(velocity);
    Command::CheckMove(command)
}

fn too_slow(asked: u32) -> Option<Result<Completion, Failure>> {
    refused(Failure::TooSlow { asked, least: 300 })
}

#[test]
fn a_move_below_the_least_velocity_is_refused_and_one_that_leaves_it_out_by_what_the_drive_holds() {
    let mapped = |held| {
        let mut config = with_least(held);
        // In place of 60FFh.
        config.fields.velocity = config.fields.target_velocity.take();
        Played::enabled(config)
    };
    let mut drive = mapped(299);
    assert_eq!(drive.answer(with_velocity(299)), too_slow(299));
    assert_eq!(drive.answer(with_velocity(300)), DONE);
    let left_out = || Command::Move(absolute(0));
    assert_eq!(drive.answer(left_out()), too_slow(299));
    assert_eq!(mapped(300).answer(left_out()), None, "it is sent");
    // A velocity of 0 keeps its own text.
    let zero = Some(Err(Failure::Parameter {
        name: "profile velocity 6081h",
        fault: ParameterFault::Zero,
    }));
    assert_eq!(drive.answer(with_velocity(0)), zero);
    // Not mapped, it is checked before it is written by SDO. The move that comes after that has none.
    let mut drive = Played::enabled(with_least(299));
    assert_eq!(drive.answer(with_velocity(299)), too_slow(299));
    assert_eq!(drive.answer(with_velocity(300)), DONE);
    assert_eq!(drive.answer(left_out()), None, "it is sent");
}

#[test]
fn a_least_velocity_of_unknown_unit_refuses_nothing() {
    for what in [MinVelocity::Absent, MinVelocity::UnitUnknown] {
        let mut config = with_least(300);
        config.traits.limits.min_velocity = what;
        let mut drive = Played::enabled(config);
        assert_eq!(drive.answer(with_velocity(1)), DONE, "{what:?}");
    }
}

#[test]
fn a_jog_is_never_slower_than_the_least_velocity() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, with_least(300));
    for velocity in [299, -299, 1] {
        let answer = drive.answer(Command::CheckJog(velocity));
        assert_eq!(answer, too_slow(velocity.unsigned_abs()));
        let jog = Command::Jog(JogSetPoint::new(velocity));
        assert_eq!(drive.answer(jog), too_slow(velocity.unsigned_abs()));
    }
    let jog = drive.submit(Command::Jog(JogSetPoint::new(-300)));
    for (velocity, goes_out) in [(-300, -300), (299, 0), (-400, -400), (0, 0), (300, 300)] {
        let followed = drive.core.set_jog(jog, velocity, &mut drive.outputs);
        assert_eq!(followed, velocity == goes_out, "{velocity}");
        assert_eq!(drive.target_velocity(), goes_out, "{velocity}");
    }
}

#[test]
fn a_jog_is_let_go_when_its_holder_is_silent_for_longer_than_its_time() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    assert!(!drive.core.has_dead_man());
    let held = JogSetPoint::new(40).dead_man(core::time::Duration::from_millis(10));
    let jog = drive.submit(Command::Jog(held));
    assert!(drive.core.has_dead_man());
    let hold = |drive: &mut Played, times| {
        let held = drive
            .core
            .hold_jog(drive.now, jog, times, &mut drive.outputs);
        drive.shows(ENABLED);
        held
    };
    for times in [1, 1, 2] {
        assert!(hold(&mut drive, times));
    }
    // That was the word; ten more cycles are its time.
    for _ in 0..10 {
        assert!(hold(&mut drive, 2));
        assert_eq!(drive.target_velocity(), 40);
    }
    assert!(!hold(&mut drive, 2));
    assert_eq!(drive.target_velocity(), 0);
    assert!(!drive.core.has_dead_man());
    drive.shows_for(60, REACHED);
    assert!(matches!(drive.outcome(jog), Some(Err(Failure::NotHeld))));

    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    drive.submit(Command::Jog(JogSetPoint::new(40)));
    assert!(!drive.core.has_dead_man(), "it has no such time");
}

#[test]
fn an_absolute_target_needs_a_reference_or_leave() {
    let distance = MoveCommand {
        reference: Reference::Relative,
        ..absolute(5)
    };
    for (referencing, homed, allowed) in [
        (Referencing::ByHoming, false, false),
        (Referencing::ByHoming, true, true),
        (Referencing::AbsoluteEncoder, false, true),
        (Referencing::UnreferencedMovesAllowed, false, true),
    ] {
        let drive = Played::enabled(CoreConfig {
            referencing,
            homed,
            ..Played::config()
        });
        let referenced = homed || referencing == Referencing::AbsoluteEncoder;
        assert_eq!(drive.core.snapshot().referenced, referenced);
        let mut drive = drive;
        let answer = drive.answer(Command::CheckMove(absolute(5)));
        let not_referenced = refused(Failure::NotReferenced);
        assert_eq!(answer, if allowed { DONE } else { not_referenced });
        assert_eq!(drive.answer(Command::CheckMove(distance)), DONE);
    }
}

/// With all parameters in the outputs.
const MAPPED: AxisFields = AxisFields {
    velocity: Some(11),
    acceleration: Some(15),
    deceleration: Some(19),
    end_velocity: Some(23),
    profile_type: Some(27),
    ..FIELDS
};

#[test]
fn parameters_go_out_as_given_or_as_the_drive_held_them_where_they_are_mapped() {
    let held = Parameters {
        velocity: Some(1),
        acceleration: Some(2),
        deceleration: Some(3),
        end_velocity: Some(4),
        profile_type: Some(5),
    };
    let given = Parameters {
        velocity: Some(11),
        acceleration: Some(12),
        deceleration: Some(13),
        end_velocity: Some(14),
        profile_type: Some(15),
    };
    let none = Parameters::default();
    assert_eq!(MAPPED.complete(&none, &held), Ok(held));
    assert_eq!(MAPPED.complete(&given, &held), Ok(given));
    // What nobody has said of the end and the ramps.
    let speeds = Parameters {
        end_velocity: None,
        profile_type: None,
        ..held
    };
    let stops_with_linear_ramps = Parameters {
        end_velocity: Some(0),
        profile_type: Some(0),
        ..held
    };
    assert_eq!(MAPPED.complete(&speeds, &none), Ok(stops_with_linear_ramps));
    assert_eq!(MAPPED.mapped(&given), given);
    // The axis goes on at an end velocity, however that is written.
    let goes_on = Parameters {
        end_velocity: given.end_velocity,
        ..none
    };
    assert_eq!(FIELDS.mapped(&given), goes_on);
    // What is not mapped is the drive's own, and cannot be given.
    assert_eq!(FIELDS.complete(&none, &none), Ok(none));
    // An end velocity has been written by SDO then: the axis goes on at it.
    for end_velocity in [None, Some(0), Some(7)] {
        let by_sdo = Parameters {
            end_velocity,
            ..none
        };
        let goes_on_at = Parameters {
            end_velocity: end_velocity.or(held.end_velocity),
            profile_type: held.profile_type,
            ..none
        };
        assert_eq!(FIELDS.complete(&by_sdo, &held), Ok(goes_on_at));
    }
    for (one, name) in [
        (
            Parameters {
                velocity: Some(7),
                ..none
            },
            "profile velocity 6081h",
        ),
        (
            Parameters {
                acceleration: Some(7),
                ..none
            },
            "profile acceleration 6083h",
        ),
        (
            Parameters {
                deceleration: Some(7),
                ..none
            },
            "profile deceleration 6084h",
        ),
        (
            Parameters {
                profile_type: Some(7),
                ..none
            },
            "motion profile type 6086h",
        ),
    ] {
        let missing = Err(Failure::Parameter {
            name,
            fault: ParameterFault::NotMapped,
        });
        assert_eq!(FIELDS.complete(&one, &held), missing);
        assert_eq!(MAPPED.complete(&one, &held).map(|_| ()), Ok(()), "{name}");
        assert_eq!(MAPPED.mapped(&one), one, "{name}");
    }
    // A speed or ramp of 0 is none, and one that nobody has said is missing.
    for (zero, name) in [
        (
            Parameters {
                velocity: Some(0),
                ..given
            },
            "profile velocity 6081h",
        ),
        (
            Parameters {
                acceleration: Some(0),
                ..given
            },
            "profile acceleration 6083h",
        ),
        (
            Parameters {
                deceleration: Some(0),
                ..given
            },
            "profile deceleration 6084h",
        ),
    ] {
        assert_eq!(
            MAPPED.complete(&zero, &held),
            Err(Failure::Parameter {
                name,
                fault: ParameterFault::Zero,
            })
        );
        assert_eq!(
            MAPPED.complete(&none, &zero),
            Err(Failure::Parameter {
                name,
                fault: ParameterFault::Zero,
            })
        );
    }
    let first = "profile velocity 6081h";
    assert_eq!(
        MAPPED.complete(&none, &none),
        Err(Failure::Parameter {
            name: first,
            fault: ParameterFault::Missing,
        })
    );
}

#[test]
fn the_ramps_of_a_jog_go_out_in_its_mode_alone() {
    let config = |fields| CoreConfig {
        fields,
        defaults: Parameters {
            velocity: Some(1),
            acceleration: Some(2),
            deceleration: Some(3),
            ..Parameters::default()
        },
        ..Played::config()
    };
    let mut jog = JogSetPoint::new(5).acceleration(12);
    let held = config(MAPPED).defaults;
    assert_eq!(MAPPED.complete_jog(&mut jog, &held), Ok(()));
    assert_eq!((jog.acceleration, jog.deceleration), (Some(12), Some(3)));
    let mut without = JogSetPoint::new(5);
    assert_eq!(FIELDS.complete_jog(&mut without, &held), Ok(()));
    assert_eq!((without.acceleration, without.deceleration), (None, None));
    let no_velocity = AxisFields {
        target_velocity: None,
        ..MAPPED
    };
    assert!(matches!(
        no_velocity.complete_jog(&mut jog, &held),
        Err(Failure::Parameter {
            name: _,
            fault: ParameterFault::NotMapped,
        })
    ));

    let mut drive = Played::enabled_in(Mode::ProfileVelocity, config(FIELDS));
    let mut outputs = [0; 29];
    drive.core.known.config.0.fields = MAPPED;
    let id = crate::axis::CommandId(800);
    let jog = Command::Jog(JogSetPoint::new(-5).acceleration(12).deceleration(13));
    drive.core.submit(drive.now, id, jog, &mut outputs);
    assert_eq!(outputs[7..11], (-5_i32).to_le_bytes());
    assert_eq!(outputs[11..15], 1_u32.to_le_bytes());
    assert_eq!(outputs[15..19], 12_u32.to_le_bytes());
    assert_eq!(outputs[19..23], 13_u32.to_le_bytes());
}

#[test]
fn a_blend_with_ramps_that_are_not_known_is_refused_where_they_must_be_linear() {
    let mut blend = absolute(5);
    blend.set_point = SetPoint::new().buffer_mode(BufferMode::Blending);
    let not_mapped = refused(Failure::Parameter {
        name: "motion profile type 6086h",
        fault: ParameterFault::NotMapped,
    });
    for (buffer_mode, needs, expected) in [
        (BufferMode::Blending, true, not_mapped),
        (BufferMode::Blending, false, None),
        (BufferMode::Aborting, true, None),
    ] {
        let mut config = Played::config();
        config.traits.blend_needs_linear_ramps = needs;
        let mut drive = Played::enabled(config);
        blend.set_point.buffer_mode = buffer_mode;
        let answer = drive.answer(Command::Move(blend));
        assert_eq!(answer, expected, "{buffer_mode:?}, {needs}");
    }
}

#[test]
fn a_mode_is_written_two_cycles_of_the_drive_after_the_last_bit_of_another_has_fallen() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    let homing = drive.submit(HOME);
    drive.shows_for(4, REACHED);
    assert_eq!(drive.word(), 0x001F);
    assert!(drive.core.snapshot().has_set_point);
    drive.shows_for(20, ENABLED);
    // Homing attained, at rest.
    let (_, result) = drive.cycles_to_end(homing, 0x1637);
    assert!(matches!(result, Ok(Completion::Homed { .. })));
    drive.submit(Command::SelectMode(Mode::ProfilePosition));
    drive.shows_for(2, REACHED);
    assert_eq!(drive.outputs[6], 6);
    drive.shows(REACHED);
    assert_eq!(drive.outputs[6], 1);
}

/// The drive counts from its last target. The homing leads the axis away from there, and moves the zero to where it shows the same again.
#[test]
fn the_end_of_the_last_move_is_no_base_any_more_once_a_homing_has_moved_the_zero() {
    let distance_ends = |homes: bool| {
        let mut config = Played::config();
        config.traits.relative_base = RelativeBase::PreviousTarget;
        let (mut drive, first) = Played::moving(config, 200);
        drive.velocity = 0;
        drive.position = 200;
        assert!(drive.cycles_to_end(first, REACHED).1.is_ok());
        for (mode, shown) in [(Mode::Homing, 6), (Mode::ProfilePosition, 1)] {
            let selecting = drive.submit(Command::SelectMode(mode));
            drive.shows_for(10, REACHED);
            drive.mode = shown;
            drive.shows(REACHED);
            assert_eq!(drive.outcome(selecting), DONE);
            if homes && mode == Mode::Homing {
                let homing = drive.submit(HOME);
                drive.velocity = 20;
                drive.shows_for(20, ENABLED);
                drive.velocity = 0;
                drive.position = 200;
                assert!(drive.cycles_to_end(homing, 0x1637).1.is_ok());
            }
        }
        // A low of bit 4 that was seen in this mode.
        drive.shows_for(3, REACHED);
        let mut command = absolute(5);
        command.reference = Reference::Relative;
        let id = drive.submit(Command::Move(command));
        drive.shows(REACHED);
        drive.shows(ACKNOWLEDGED | REACHED);
        drive.cycles_to_end(id, REACHED).1
    };
    assert_eq!(
        distance_ends(false),
        Ok(Completion::Reached { position: 200 })
    );
    let ended = distance_ends(true);
    let not_begun = Doubt::NotBegun;
    assert!(
        matches!(ended, Err(Failure::Unknown { doubt, .. }) if doubt == not_begun),
        "{ended:?}"
    );
}

#[test]
fn a_mode_that_the_drive_shows_already_is_written_all_the_same() {
    let mut drive = Played::enabled(Played::config());
    drive.mode = 6;
    drive.shows(REACHED);
    let selecting = drive.submit(TO_HOMING);
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 6));
    drive.shows(REACHED);
    assert_eq!(drive.outcome(selecting), DONE);
}

#[test]
fn a_mode_that_was_written_fails_by_its_display_also_while_somebody_turns_the_axis() {
    let mut drive = Played::disabled(Played::config());
    let selecting = drive.submit(TO_HOMING);
    drive.velocity = 30;
    let (cycles, result) = drive.cycles_to_end(selecting, SWITCH_ON_DISABLED);
    assert_eq!(cycles, 60);
    assert!(matches!(result, Err(Failure::Timeout { .. })), "{result:?}");
}

#[test]
fn a_drive_whose_cycle_is_longer_than_the_deadline_of_its_acknowledge_has_its_time() {
    let cycle = Duration::from_millis(40);
    let mut config = Played::config();
    assert!(config.deadlines.acknowledge < 2 * cycle);
    config.traits.drive_cycle = cycle;
    let mut drive = Played::new(config);
    drive.shows_for(170, SWITCH_ON_DISABLED);
    let enabling = drive.submit(Command::Enable);
    for statusword in [READY, SWITCHED_ON] {
        drive.shows(statusword);
    }
    let (_, enabled) = drive.cycles_to_end(enabling, ENABLED);
    assert_eq!(enabled, Ok(Completion::Done));
    drive.shows_for(170, REACHED);

    for target in [5_000, 9_000] {
        let moving = drive.move_to(target);
        // Two of its cycles after the low before it was delivered.
        assert!(drive.cycles_until(0x003F, ENABLED) <= 81, "{target}");
        assert_eq!(drive.target(), target);
        // The acknowledge comes within two of its cycles as well.
        drive.shows_for(79, ENABLED);
        drive.shows(ACKNOWLEDGED);
        drive.shows(ENABLED);
        assert!(drive.reports.contains(&(moving, Event::Accepted)));
    }

    // But it is not waited for without end: four of its cycles.
    let late = drive.move_to(1_000);
    drive.cycles_until(0x003F, ENABLED);
    let risen = drive.now;
    let (_, result) = drive.cycles_to_end(late, ENABLED);
    assert!(matches!(result, Err(Failure::Unknown { .. })), "{result:?}");
    let sent = risen + Duration::from_millis(1);
    assert_eq!(drive.now - sent, 4 * cycle);
}

/// A drive that may come to homing: that was taken back after three cycles. This many later another mode was selected, had to wait since
/// something pushed the axis, and was given up before it was written.
fn with_a_second_change_given_up(cycles: u32) -> Played {
    let mut drive = Played::enabled(Played::config());
    let selecting = drive.submit(TO_HOMING);
    drive.shows_for(3, REACHED);
    assert_eq!(drive.outputs[6], 6);
    assert!(
        drive
            .core
            .withdraw(drive.now, selecting, &mut drive.outputs)
    );
    drive.shows_for(cycles, REACHED);
    drive.position += 15;
    drive.shows(REACHED);
    let other = drive.submit(Command::SelectMode(Mode::ProfileVelocity));
    assert_eq!((drive.outcome(other), drive.outputs[6]), (None, 1));
    assert!(drive.core.withdraw(drive.now, other, &mut drive.outputs));
    drive
}

/// A second change that waits for standstill and is given up as well does not make the first one forgotten.
#[test]
fn nothing_begins_after_a_second_change_was_given_up_before_it_was_written() {
    let mut drive = with_a_second_change_given_up(0);
    // Four cycles after 6060h was 6: the drive may come to homing at any time.
    let wrong = refused(wrong_mode(Mode::ProfilePosition, Mode::ProfilePosition));
    let answer = drive.answer(Command::Move(absolute(50)));
    assert_eq!((answer, drive.word()), (wrong, 0x000F));
}

/// The second change began later, and had longer. What is waited for is the first.
#[test]
fn a_mode_that_was_taken_back_is_waited_for_no_longer_because_of_a_second_change() {
    let mut drive = with_a_second_change_given_up(40);
    drive.shows_for(18, REACHED);
    let wrong = refused(wrong_mode(Mode::ProfilePosition, Mode::ProfilePosition));
    assert_eq!(drive.answer(Command::Move(absolute(50))), wrong);
    // 60 cycles after it was taken back.
    drive.shows(REACHED);
    assert_eq!(drive.answer(Command::Move(absolute(50))), None);
}

/// The drive may show the first at any time, after a second that was given up as well: what it shows then is no answer to a third.
#[test]
fn a_mode_that_was_taken_back_is_not_selected_at_once_behind_a_second_change() {
    let mut drive = with_a_second_change_given_up(0);
    drive.shows_for(40, REACHED);
    let again = drive.submit(TO_HOMING);
    drive.shows_for(3, REACHED);
    assert_eq!((drive.outcome(again), drive.outputs[6]), (None, 1));
    drive.shows_for(40, REACHED);
    assert_eq!((drive.outcome(again), drive.outputs[6]), (None, 6));
}

/// A mode that was written by SDO is in the drive still, whatever the axis has forgotten. One in the outputs is not.
#[cfg(feature = "std")]
#[test]
fn an_axis_that_begins_again_remembers_a_mode_that_was_written_by_sdo() {
    use crate::axis::core::Reattach;

    let begins_again = |mut drive: Played, config: CoreConfig| {
        let again = Reattach::Kept(Box::new(config));
        drive.core.restart(drive.now, again, &mut drive.outputs);
        drive.drain();
        drive.shows_for(20, SWITCH_ON_DISABLED);
        drive.enable();
        drive.shows_for(20, REACHED);
        drive
    };
    let mut drive = Played::enabled(mode_by_sdo());
    drive.answer(Command::PrepareMode(Mode::Homing));
    let wrong = refused(wrong_mode(Mode::ProfilePosition, Mode::ProfilePosition));
    let mut drive = begins_again(drive, mode_by_sdo());
    assert_eq!(drive.answer(Command::Move(absolute(50))), wrong);

    let mut drive = Played::enabled(Played::config());
    let selecting = drive.submit(TO_HOMING);
    drive.shows_for(3, REACHED);
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 6));
    let mut drive = begins_again(drive, Played::config());
    assert!(drive.outcome(selecting).is_some());
    // The drive may come to what was taken back, for as long as without a restart.
    assert_eq!(drive.answer(Command::Move(absolute(50))), wrong);
    drive.shows_for(60, REACHED);
    assert_eq!(drive.answer(Command::Move(absolute(50))), None);
}

/// 6060h was written by SDO, and the wait for 6061h is given up while it waits for standstill.
#[test]
fn nothing_begins_after_a_mode_was_written_by_sdo_and_its_selection_was_given_up() {
    for late in [false, true] {
        let mut drive = Played::enabled(mode_by_sdo());
        let mode = Mode::Homing;
        assert_eq!(
            drive.answer(Command::PrepareMode(mode)),
            Some(Ok(Completion::Prepared { mode }))
        );
        // The drive has 6060h = 6 from here on. Something pushes the axis.
        drive.velocity = 3;
        drive.shows_for(10, REACHED);
        let selecting = drive.submit(TO_HOMING);
        assert_eq!(drive.outcome(selecting), None);
        if late {
            drive.shows_for(60, REACHED);
            assert!(drive.outcome(selecting).is_some());
        } else {
            assert!(
                drive
                    .core
                    .withdraw(drive.now, selecting, &mut drive.outputs)
            );
        }
        // Nothing takes that back.
        let wrong = refused(wrong_mode(Mode::ProfilePosition, Mode::ProfilePosition));
        let answer = drive.answer(Command::Move(absolute(50)));
        assert_eq!((answer, drive.word()), (wrong, 0x000F), "{late}");
    }
}

/// The wait for 6061h is given up after 6060h was written.
#[test]
fn nothing_begins_after_a_mode_that_was_written_by_sdo_was_given_up() {
    let mut drive = Played::enabled(mode_by_sdo());
    drive.answer(Command::PrepareMode(Mode::Homing));
    let selecting = drive.submit(TO_HOMING);
    drive.shows_for(3, REACHED);
    assert_eq!(drive.outcome(selecting), None);
    assert!(
        drive
            .core
            .withdraw(drive.now, selecting, &mut drive.outputs)
    );
    // Nothing takes it back, however late the drive is.
    drive.shows_for(300, REACHED);
    let wrong = refused(wrong_mode(Mode::ProfilePosition, Mode::ProfilePosition));
    assert_eq!(drive.answer(Command::Move(absolute(50))), wrong);
}

/// A drive that is slow in its modes shows one that was taken back, before it comes to the one between, and to the same again.
#[test]
fn a_mode_that_was_taken_back_and_is_selected_again_is_not_confirmed_by_the_first_time() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.shows_for(20, REACHED);
    let mut later = SlowModes::new(Mode::Homing, 10);
    let mut shows_for = |drive: &mut Played, cycles: u32| {
        for _ in 0..cycles {
            later.shows(drive, REACHED);
        }
    };
    let to_moves = Command::SelectMode(Mode::ProfilePosition);
    let selecting = drive.submit(to_moves);
    shows_for(&mut drive, 3);
    assert!(
        drive
            .core
            .withdraw(drive.now, selecting, &mut drive.outputs)
    );
    shows_for(&mut drive, 3);
    let again = drive.submit(to_moves);
    let mut moving = None;
    for _ in 0..300 {
        if moving.is_none() && drive.outcome(again).is_some() {
            assert_eq!(drive.outcome(again), Some(Ok(Completion::Done)));
            moving = Some(drive.move_to(50));
        }
        shows_for(&mut drive, 1);
    }
    assert!(moving.is_some());
}

/// The same where it goes by SDO, and the mode before is selected.
#[test]
fn a_mode_before_one_that_was_written_by_sdo_is_not_confirmed_by_what_is_still_shown() {
    let mut drive = Played::enabled(mode_by_sdo());
    let prepared = |mode| Some(Ok(Completion::Prepared { mode }));
    let to_moves = Mode::ProfilePosition;
    let to_homing = drive.answer(Command::PrepareMode(Mode::Homing));
    assert_eq!(to_homing, prepared(Mode::Homing));
    // 6060h is 6 from here on, and the program gives it up.
    drive.shows_for(3, REACHED);
    assert_eq!(
        drive.answer(Command::PrepareMode(to_moves)),
        prepared(to_moves)
    );
    // 6060h is 1 again. The drive has not come to the mode between yet, in which bit 4 starts a homing.
    drive.shows_for(3, REACHED);
    let selecting = drive.submit(Command::SelectMode(to_moves));
    drive.shows(REACHED);
    assert_eq!(drive.outcome(selecting), None, "6061h is from before");
    // The drive comes to it, and back. By the time that it has for a mode it is in the last one.
    drive.mode = 6;
    drive.shows_for(3, REACHED);
    drive.mode = 1;
    let (cycles, result) = drive.cycles_to_end(selecting, REACHED);
    assert_eq!(result, Ok(Completion::Done));
    // Cycles of 1 ms, with those since the second was asked for.
    let waited = Duration::from_millis(u64::from(cycles) + 7);
    assert_eq!(waited, Played::config().deadlines.mode);
    drive.move_to(50);
    drive.shows_for(3, REACHED);
    assert_eq!(drive.word() & 0x0010, 0x0010);
}

/// The drive comes to homing mode 40 ms after it was commanded. Meanwhile it leaves OP and is recovered with its power kept.
#[cfg(feature = "std")]
#[test]
fn a_recovered_drive_that_may_still_come_to_a_mode_that_was_taken_back_starts_nothing() {
    use crate::axis::core::Reattach;

    let mut config = Played::config();
    config.deadlines.mode = Duration::from_millis(1_000);
    let mut drive = Played::enabled(config.clone());
    let selecting = drive.submit(Command::SelectMode(Mode::Homing));
    assert_eq!(drive.outputs[6], 6);
    drive.shows(REACHED);
    drive.shows(REACHED);
    // It leaves OP.
    drive.cycles(12, Brings::Nothing, REACHED);
    assert!(matches!(
        drive.outcome(selecting),
        Some(Err(Failure::BusLost { .. }))
    ));
    let now = drive.now;
    drive
        .core
        .restart(now, Reattach::Unknown, &mut drive.outputs);
    drive.cycles(20, Brings::Answered, SWITCH_ON_DISABLED);
    let kept = Reattach::Kept(Box::new(config));
    drive.core.restart(now, kept, &mut drive.outputs);
    drive.drain();
    drive.shows_for(40, SWITCH_ON_DISABLED);
    drive.enable();
    drive.shows_for(2, REACHED);
    // Within a tenth of the time that a drive has to show a mode.
    assert!(drive.now < now + Duration::from_millis(100));
    let moving = drive.submit(Command::Move(absolute(5_000)));
    assert!(
        matches!(drive.outcome(moving), Some(Err(Failure::WrongMode { .. }))),
        "{:?}, {:04X}h",
        drive.outcome(moving),
        drive.word()
    );
}

/// An axis that is set up slowly is not fast after its drive has come back.
#[cfg(feature = "std")]
#[test]
fn an_override_outlives_a_drive_that_comes_back() {
    use crate::{axis::core::Reattach, profile_position::VelocityOverride};

    let mut config = Played::config();
    (config.fields.velocity, config.fields.target_velocity) = (Some(7), None);
    let mut drive = Played::enabled(config.clone());
    let slow = VelocityOverride::new(0.05).expect("within its range");
    let set = drive.submit(Command::SetOverride(slow));
    assert_eq!(drive.outcome(set), Some(Ok(Completion::Done)));
    drive.cycles(12, Brings::Nothing, REACHED);
    let now = drive.now;
    drive
        .core
        .restart(now, Reattach::Unknown, &mut drive.outputs);
    drive.cycles(20, Brings::Answered, SWITCH_ON_DISABLED);
    let kept = Reattach::Kept(Box::new(config));
    drive.core.restart(now, kept, &mut drive.outputs);
    drive.drain();
    drive.shows_for(40, SWITCH_ON_DISABLED);
    drive.enable();
    drive.shows_for(2, REACHED);
    let mut fast = absolute(5_000);
    fast.set_point.parameters.velocity = Some(20_000);
    drive.submit(Command::Move(fast));
    assert_eq!(drive.word() & 0x10, 0x10);
    assert_eq!(drive.outputs[7..11], 1_000_u32.to_le_bytes());
}

/// By its own quick stop, or in its fault reaction.
#[test]
fn a_mode_is_not_written_while_the_drive_stops_an_axis_by_itself() {
    for statusword in [QUICK_STOP_ACTIVE, FAULT_REACTION] {
        let (mut drive, _) = Played::moving(Played::staying(), 100_000);
        drive.shows_for(3, statusword);
        assert_eq!((drive.word(), drive.outputs[6]), (QUICK_STOP, 1));
        drive.submit(Command::SelectMode(Mode::Homing));
        assert_eq!(drive.outputs[6], 1, "{statusword:04X}h");
        drive.shows_for(3, statusword);
        assert_eq!(drive.outputs[6], 1, "{statusword:04X}h");
    }
}

/// The change waits for standstill, and a halt comes before that.
#[test]
fn a_mode_is_not_written_on_a_halted_axis() {
    let mut drive = Played::enabled(Played::config());
    drive.position += 100;
    drive.shows(ENABLED);
    let selecting = drive.submit(Command::SelectMode(Mode::Homing));
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 1));
    drive.submit(Command::Halt);
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(selecting), Some(Err(Failure::HALTED)));
    drive.shows_for(40, ENABLED);
    assert_eq!((drive.word(), drive.outputs[6]), (HALT, 1));
}

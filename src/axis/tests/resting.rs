//! Cycles in which nothing happens: what they leave as it is, and what they follow.

use alloc::vec::Vec;

use super::played::{
    Brings, ENABLED, FAULT, HOME, Played, QUICK_STOP_ACTIVE, REACHED, READY, SWITCH_ON_DISABLED,
    SWITCHED_ON, absolute,
};
use crate::{
    StopRequest,
    axis::{Command, CommandId, CoreConfig, Inputs},
    ds402::{Controlword, Mode},
    profile_velocity::JogSetPoint,
};

/// One more cycle with this statusword, for outputs that are kept: whether something in them may have changed.
fn writes(drive: &mut Played, unchanged: bool, statusword: u16) -> bool {
    drive.now += core::time::Duration::from_millis(1);
    let bytes = drive.inputs(statusword);
    let inputs = Inputs::Fresh(&bytes);
    let cycle = drive.core.snapshot().cycle;
    let writes = drive
        .core
        .step_kept(drive.now, inputs, unchanged, &mut drive.outputs);
    let snapshot = drive.core.snapshot();
    assert_eq!(snapshot.cycle, cycle + 1);
    assert_eq!(snapshot.position, drive.position);
    assert_eq!(snapshot.velocity, drive.velocity);
    writes
}

/// Whether a stop has nothing to wait for.
fn stands(drive: &Played) -> bool {
    let (mut core, mut outputs) = (drive.core.clone(), drive.outputs);
    core.submit(drive.now, CommandId(900), Command::Stop, &mut outputs);
    core.poll_event().is_some()
}

/// What 607Ah is after the axis has dithered by a count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Target {
    Follows,
    Stays,
}

#[test]
fn an_axis_at_rest_writes_nothing_and_follows_where_no_move_is_under_way() {
    let at_rest = |mode| {
        if mode == Mode::ProfilePosition {
            Played::enabled(Played::config())
        } else {
            Played::enabled_in(mode, Played::config())
        }
    };
    let disabled_in = |mode| {
        let mut drive = at_rest(mode);
        drive.submit(Command::Disable);
        drive.shows_for(30, SWITCH_ON_DISABLED);
        drive
    };
    let in_another_mode = || {
        let mut drive = at_rest(Mode::ProfilePosition);
        drive.mode = 3;
        drive.shows_for(5, REACHED);
        drive
    };
    use Target::{Follows, Stays};
    for (name, mut drive, statusword, target) in [
        (
            "disabled",
            disabled_in(Mode::ProfilePosition),
            SWITCH_ON_DISABLED,
            Follows,
        ),
        (
            "disabled in homing mode",
            disabled_in(Mode::Homing),
            SWITCH_ON_DISABLED,
            Follows,
        ),
        ("enabled", at_rest(Mode::ProfilePosition), REACHED, Stays),
        (
            "enabled in homing mode",
            at_rest(Mode::Homing),
            REACHED,
            Follows,
        ),
        (
            "enabled in velocity mode",
            at_rest(Mode::ProfileVelocity),
            REACHED,
            Follows,
        ),
        ("in another mode", in_another_mode(), REACHED, Stays),
    ] {
        let outputs = drive.outputs;
        for _ in 0..3 {
            assert!(!writes(&mut drive, true, statusword), "{name}");
        }
        assert_eq!(drive.outputs, outputs, "{name}");
        let before = drive.target();
        drive.position += 1;
        let follows = target == Follows;
        assert_eq!(writes(&mut drive, false, statusword), follows, "{name}");
        let target = if follows { drive.position } else { before };
        assert_eq!(drive.target(), target, "{name}");
        assert!(!writes(&mut drive, true, statusword), "{name}");
    }
}

#[test]
fn an_axis_at_rest_that_never_was_in_a_mode_writes_nothing() {
    let mut drive = Played::disabled(Played::config());
    assert!(!writes(&mut drive, true, SWITCH_ON_DISABLED));
    // In homing mode from the first cycle on.
    let mut drive = Played::disabled(CoreConfig {
        mode: Mode::Homing,
        ..Played::config()
    });
    drive.mode = 6;
    drive.submit(Command::Enable);
    for statusword in [READY, SWITCHED_ON, ENABLED, ENABLED, ENABLED] {
        drive.shows(statusword);
    }
    drive.shows_for(20, REACHED);
    assert!(!writes(&mut drive, true, REACHED));
}

#[test]
fn a_cycle_of_an_axis_with_something_under_way_is_computed_as_a_whole() {
    let enabled = || Played::enabled(Played::config());
    let mut halted = enabled();
    halted.submit(Command::Halt);
    halted.shows_for(30, REACHED);
    let mut changing = enabled();
    changing.submit(Command::SelectMode(Mode::Homing));
    changing.shows_for(5, REACHED);
    let mut disabling = enabled();
    disabling.submit(Command::Disable);
    disabling.shows_for(5, REACHED);
    let mut stopping = enabled();
    stopping.submit(Command::QuickStop);
    stopping.shows_for(5, REACHED);
    let mut lost = enabled();
    lost.cycles(30, Brings::Answered, REACHED);
    let mut jogging = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    let jog = jogging.submit(Command::Jog(JogSetPoint::new(0)));
    jogging.shows_for(5, REACHED);
    jogging
        .core
        .release_jog(jogging.now, jog, &mut jogging.outputs);
    jogging.shows(REACHED);
    let mut unwatched = enabled();
    unwatched.stop_lane(StopRequest::QUICK_STOP);
    unwatched.shows_for(5, REACHED);
    let mut rising = enabled();
    rising.move_to(5_000);
    rising.shows(REACHED);
    for (name, mut drive) in [
        ("halted", halted),
        ("changing its mode", changing),
        ("disabling", disabling),
        ("stopping", stopping),
        ("lost", lost),
        ("released", jogging),
        ("rising", rising),
        ("stopping, and nobody waits", unwatched),
    ] {
        assert!(writes(&mut drive, true, REACHED), "{name}");
    }
    // After whatever is new to it, one cycle is.
    let mut drive = enabled();
    drive.cycle(Brings::Answered, REACHED);
    assert!(writes(&mut drive, true, REACHED), "not delivered before");
    let mut drive = enabled();
    assert!(!writes(&mut drive, true, REACHED));
    drive.core.set_manufacturer_bits(Controlword::MANUFACTURER);
    assert!(writes(&mut drive, true, REACHED), "other bits");
    assert_eq!(drive.word() & 0xF800, 0xF800);
    assert!(writes(&mut drive, true, REACHED), "they are sent");
    assert!(!writes(&mut drive, true, REACHED));
    let mut drive = enabled();
    drive.error_code = 0x8611;
    assert!(writes(&mut drive, false, REACHED), "another error code");
    let mut drive = enabled();
    assert!(writes(&mut drive, false, ENABLED), "another statusword");
    let mut drive = enabled();
    drive.mode = 6;
    assert!(writes(&mut drive, false, REACHED), "another mode");
    let mut drive = enabled();
    drive.cycles(3, Brings::Nothing, REACHED);
    assert!(writes(&mut drive, true, REACHED), "seen again");
    let mut drive = enabled();
    let bytes = drive.inputs(REACHED);
    let inputs = Inputs::Answered(&bytes);
    assert!(
        drive
            .core
            .step_kept(drive.now, inputs, true, &mut drive.outputs),
        "perhaps not delivered"
    );
}

#[cfg(feature = "std")]
#[test]
fn a_step_is_left_out_at_rest_once_everything_was_taken_in() {
    let mut drive = Played::enabled(Played::config());
    let same = drive.inputs(REACHED);
    assert!(
        !drive.core.rests_at(drive.now, &Inputs::Fresh(&same)),
        "not taken yet"
    );
    drive.core.take_change();
    assert!(drive.core.rests_at(drive.now, &Inputs::Fresh(&same)));
    assert!(!drive.core.rests_at(drive.now, &Inputs::Answered(&same)));
    assert!(!drive.core.rests_at(drive.now, &Inputs::Stale));
    // The next one counts those that were left out.
    let cycles = drive.core.snapshot().cycle + 200;
    drive.now += core::time::Duration::from_millis(200);
    drive.core.count_to(cycles);
    drive.shows(REACHED);
    assert_eq!(drive.core.snapshot().cycle, cycles + 1);
    // Asked for something, it does not rest.
    drive.move_to(1_000);
    drive.core.take_change();
    assert!(!drive.core.rests_at(drive.now, &Inputs::Fresh(&same)));
}

#[test]
fn an_axis_that_does_not_stand_is_looked_at_until_it_does() {
    let mut drive = Played::enabled(Played::config());
    drive.position = 500;
    // It jumped.
    writes(&mut drive, false, REACHED);
    assert!(!stands(&drive));
    for _ in 0..13 {
        writes(&mut drive, true, REACHED);
    }
    assert!(stands(&drive));
}

#[test]
fn a_fault_and_a_held_quick_stop_at_rest_stay_what_they_are() {
    let mut config = Played::config();
    config.quick_stop = crate::ds402::QuickStopOption(6);
    let mut drive = Played::enabled(config);
    drive.submit(Command::QuickStop);
    drive.shows_for(50, QUICK_STOP_ACTIVE);
    for _ in 0..20 {
        writes(&mut drive, true, QUICK_STOP_ACTIVE);
        assert_eq!(drive.word(), 0x000B);
    }
    let mut drive = Played::enabled(Played::config());
    drive.shows_for(50, FAULT);
    for _ in 0..20 {
        writes(&mut drive, true, FAULT);
        assert_eq!(drive.word(), 0);
    }
    // Whoever resets it then is not overlooked.
    drive.submit(Command::ResetFault);
    for _ in 0..3 {
        writes(&mut drive, true, FAULT);
    }
    assert_eq!(drive.word(), 0x0080);
}

#[test]
fn cycles_without_inputs_write_nothing_until_the_drive_is_lost() {
    let mut drive = Played::enabled(Played::config());
    let silent = |drive: &mut Played| {
        drive.now += core::time::Duration::from_millis(1);
        let (now, outputs) = (drive.now, &mut drive.outputs);
        drive.core.step_kept(now, Inputs::Stale, false, outputs)
    };
    for cycle in 1..10 {
        assert!(!silent(&mut drive), "{cycle}");
        assert_eq!(drive.core.snapshot().age, cycle);
    }
    assert!(silent(&mut drive));
    assert!(drive.core.snapshot().lost);
}

#[test]
fn a_stop_lane_with_nothing_in_it_and_a_stop_that_is_over_leave_an_axis_at_rest() {
    let mut drive = Played::enabled(Played::config());
    assert!(!drive.stop_lane(StopRequest::empty()));
    assert!(!writes(&mut drive, true, REACHED));
    // One that had to wait for the rest.
    drive.position += 15;
    drive.shows(REACHED);
    let stopping = drive.submit(Command::Stop);
    drive.shows_for(30, REACHED);
    assert!(drive.outcome(stopping).is_some());
    assert!(!writes(&mut drive, true, REACHED));
}

#[cfg(feature = "std")]
#[test]
fn its_port_learns_what_is_new_and_no_more() {
    use crate::axis::SnapshotChange;

    let mut drive = Played::enabled(Played::config());
    let mut change = |unchanged, moved, inputs: bool| {
        drive.now += core::time::Duration::from_millis(1);
        drive.position += moved;
        let bytes = drive.inputs(REACHED);
        let inputs = if inputs {
            Inputs::Fresh(&bytes)
        } else {
            Inputs::Stale
        };
        let (now, outputs) = (drive.now, &mut drive.outputs);
        drive.core.step_kept(now, inputs, unchanged, outputs);
        drive.core.take_change()
    };
    assert_eq!(change(true, 0, true), SnapshotChange::Anything);
    assert_eq!(change(true, 0, true), SnapshotChange::Nothing);
    assert_eq!(change(false, 1, true), SnapshotChange::Motion);
    assert_eq!(change(true, 0, false), SnapshotChange::Silence);
    assert_eq!(change(false, 0, true), SnapshotChange::Anything);
}

/// Whatever a drive shows and a program asks for: where cycles are left out, the same goes out at the same time.
#[test]
fn cycles_that_are_left_out_would_have_changed_nothing() {
    let words = [
        SWITCH_ON_DISABLED,
        READY,
        SWITCHED_ON,
        ENABLED,
        REACHED,
        0x1237,
        0x1637,
        QUICK_STOP_ACTIVE,
        FAULT,
    ];
    let mut number = 0x9E37_79B9_7F4A_7C15_u64;
    let mut random = |below: u64| {
        number ^= number << 13;
        number ^= number >> 7;
        number ^= number << 17;
        number % below
    };
    let mut left_out = 0;
    for trial in 0..1_000 {
        let mut config = Played::config();
        config.traits.start_bits_first = trial % 2 == 0;
        let mut drive = if trial % 5 == 0 {
            Played::disabled(config)
        } else {
            Played::enabled(config)
        };
        let (mut core, mut outputs) = (drive.core.clone(), drive.outputs);
        let mut word = REACHED;
        let mut before = Vec::new();
        for cycle in 0..600 {
            match random(40) {
                0..6 => word = words[random(words.len() as u64) as usize],
                6 => drive.position += random(60) as i32 - 30,
                7 => drive.mode = [1, 1, 3, 6][random(4) as usize],
                8 => {
                    let command = match random(9) {
                        0 => Command::Enable,
                        1 => Command::Disable,
                        2 => Command::Halt,
                        3 => Command::Resume,
                        4 => Command::Stop,
                        5 => Command::SelectMode(
                            [Mode::Homing, Mode::ProfilePosition][random(2) as usize],
                        ),
                        6 => Command::ResetFault,
                        7 => HOME,
                        _ => Command::Move(absolute(random(100) as i32)),
                    };
                    let id = CommandId(10_000 + cycle);
                    core.submit(drive.now, id, command, &mut outputs);
                    drive
                        .core
                        .submit(drive.now, id, command, &mut drive.outputs);
                }
                _ => {}
            }
            drive.now += core::time::Duration::from_millis(1);
            let bytes = drive.inputs(word);
            let inputs = if random(60) == 0 {
                Inputs::Stale
            } else if random(60) == 0 {
                Inputs::Answered(&bytes)
            } else {
                Inputs::Fresh(&bytes)
            };
            let unchanged = before == bytes;
            before = bytes.to_vec();
            // Its attention is called to each cycle.
            core.set_manufacturer_bits(Controlword::empty());
            core.step_kept(drive.now, inputs, false, &mut outputs);
            let steps = drive
                .core
                .step_kept(drive.now, inputs, unchanged, &mut drive.outputs);
            left_out += u32::from(!steps);
            assert_eq!(drive.outputs, outputs, "{trial}, {cycle}");
            loop {
                let event = core.poll_event();
                assert_eq!(drive.core.poll_event(), event, "{trial}, {cycle}");
                if event.is_none() {
                    break;
                }
            }
        }
    }
    assert!(left_out > 50_000, "{left_out}");
}

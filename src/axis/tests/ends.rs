//! How a move ends where a halt, a stall of the host or a turning axis hides its end.

use core::time::Duration;

use super::played::{ACKNOWLEDGED, ENABLED, GO, Played, REACHED, absolute};
use crate::{
    axis::{Command, CommandId, Completion, CoreConfig, Event, Failure},
    ds402::Controlword,
    profile_position::{BufferMode, BufferSignal, PositionRange, SetPoint, Traits},
};

/// Bit 12 shows the buffer.
fn showing_room() -> CoreConfig {
    let mut config = Played::config();
    config.traits = Traits {
        buffer_signal: BufferSignal::Acknowledge,
        ..config.traits
    };
    config
}

fn send(drive: &mut Played, target: i32, set_point: SetPoint) -> CommandId {
    let mut command = absolute(target);
    command.set_point = set_point;
    drive.submit(Command::Move(command))
}

/// It goes round at its end velocity, with bit 10.
fn turns(drive: &mut Played) {
    for _ in 0..1_000 {
        if drive.position >= 3_500 {
            drive.position -= 3_600;
        }
        drive.shows(REACHED);
    }
}

/// The drive has taken the second move, acknowledges it too late, and goes on at its end velocity, with bit 10.
#[test]
fn a_turning_axis_is_not_at_rest() {
    let mut config = Played::config();
    config.modulo = Some(PositionRange { min: 0, max: 3_599 });
    let (mut drive, first) = Played::moving(config, 3_100);
    drive.velocity = 0;
    drive.position = 100;
    let second = send(&mut drive, 3_000, SetPoint::new().end_velocity(100));
    drive.shows_for(60, ENABLED);
    assert!(matches!(
        drive.outcome(second),
        Some(Err(Failure::Timeout { .. }))
    ));
    drive.velocity = 100;
    drive.shows_for(29, ENABLED);
    assert_eq!((drive.position, drive.outcome(first)), (3_000, None));
    turns(&mut drive);
    assert_eq!(drive.outcome(first), None, "the axis turns");
}

/// The same where the drive has taken it, and takes its time to begin.
#[test]
fn a_turning_axis_has_not_reached_the_next_end_by_the_bit_10_of_before() {
    let mut config = Played::config();
    config.modulo = Some(PositionRange { min: 0, max: 3_599 });
    let mut drive = Played::enabled(config);
    let first = drive.passes(400, 100);
    drive.shows_for(3, ENABLED);
    drive.shows_for(5, REACHED);
    assert!(matches!(drive.outcome(first), Some(Ok(_))));
    let next = drive.move_to(1_300);
    drive.shows(REACHED);
    drive.shows(ACKNOWLEDGED | REACHED);
    turns(&mut drive);
    let end = drive.outcome(next);
    assert!(!matches!(end, Some(Ok(_))), "{end:?}");
}

/// A halt on the way to the first of two, and the ramp of it leads past that end: the drive goes over to the second there.
fn passed_on_the_ramp_of_a_halt(config: CoreConfig) -> Option<Result<Completion, Failure>> {
    let shows_room = config.traits.buffer_signal == BufferSignal::Acknowledge;
    let (mut drive, first) = Played::moving(config, 1_000);
    let second = send(
        &mut drive,
        3_000,
        SetPoint::new().buffer_mode(BufferMode::Blending),
    );
    drive.shows(ENABLED);
    drive.shows_for(3, ACKNOWLEDGED);
    assert!(drive.reports.contains(&(second, Event::Accepted)));
    let full = if shows_room { ACKNOWLEDGED } else { ENABLED };
    drive.shows_for(36, full);
    assert_eq!((drive.position, drive.outcome(first)), (900, None));
    let halting = drive.submit(Command::Halt);
    drive.shows_for(5, full);
    assert_eq!(drive.position, 1_000, "seen there");
    drive.shows(ENABLED);
    for velocity in (0..20).rev() {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    assert!(drive.cycles_to_end(halting, REACHED).1.is_ok());
    drive.shows_for(150, REACHED);
    let resuming = drive.submit(Command::Resume);
    drive.shows(REACHED);
    assert_eq!(drive.outcome(resuming), Some(Ok(Completion::Done)));
    drive.shows(REACHED);
    drive.velocity = 18;
    drive.shows_for(((3_000 - drive.position) / 18) as u32, ENABLED);
    drive.velocity = 0;
    let (_, end) = drive.cycles_to_end(second, REACHED);
    assert!(end.is_ok(), "{end:?}");
    drive.outcome(first)
}

#[test]
fn an_end_that_was_passed_on_the_ramp_of_a_halt_is_not_missed() {
    let end = passed_on_the_ramp_of_a_halt(showing_room());
    assert!(
        !matches!(end, Some(Err(Failure::MissedTarget { .. }))),
        "{end:?}"
    );
}

#[test]
fn nor_where_bit_12_shows_nothing() {
    let end = passed_on_the_ramp_of_a_halt(Played::config());
    assert!(
        !matches!(end, Some(Err(Failure::MissedTarget { .. }))),
        "{end:?}"
    );
}

/// The ramp of a halt leads past the end of a move that ends in motion: when bit 8 falls the drive goes on at its end velocity.
#[test]
fn an_end_in_motion_that_was_passed_on_the_ramp_of_a_halt_is_told() {
    let mut drive = Played::enabled(Played::passing());
    let first = drive.passes(1_000, 20);
    drive.shows_for(45, ENABLED);
    assert_eq!((drive.position, drive.outcome(first)), (900, None));
    let halting = drive.submit(Command::Halt);
    drive.shows_for(5, ENABLED);
    assert_eq!(drive.position, 1_000, "seen there");
    for velocity in (0..20).rev() {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    assert!(drive.cycles_to_end(halting, REACHED).1.is_ok());
    let resuming = drive.submit(Command::Resume);
    drive.shows(REACHED);
    assert_eq!(drive.outcome(resuming), Some(Ok(Completion::Done)));
    drive.velocity = 20;
    drive.shows_for(5_000, REACHED);
    assert!(drive.outcome(first).is_some(), "it never ends");
}

/// Bit 12 has shown that the drive has gone on to the second, and the axis lags behind the end of the first.
#[test]
fn a_halt_is_told_to_one_whose_end_is_still_looked_for() {
    let (mut drive, first) = Played::moving(showing_room(), 1_000);
    let second = send(
        &mut drive,
        3_000,
        SetPoint::new().buffer_mode(BufferMode::Blending),
    );
    drive.shows(ENABLED);
    drive.shows_for(3, ACKNOWLEDGED);
    drive.shows_for(36, ACKNOWLEDGED);
    drive.shows_for(3, ENABLED);
    assert_eq!((drive.position, drive.outcome(first)), (960, None));
    drive.halt_to_rest();
    drive.shows_for(2_000, REACHED);
    assert!(drive.reports.contains(&(second, Event::Halted)));
    let told = drive.reports.contains(&(first, Event::Halted));
    assert!(
        told || drive.outcome(first).is_some(),
        "who waits for it waits on"
    );
}

/// The host stands still after it has sent the second move, for so long. Where the axis was on its way on the idle path before, or not. How the
/// first one ends, at whose end the axis was meanwhile.
fn stands_still_after_the_second(idle: bool) -> Option<Result<Completion, Failure>> {
    let (mut drive, first) = Played::moving(showing_room(), 1_000);
    drive.shows_for(38, ENABLED);
    if !idle {
        // Computed as a whole.
        for _ in 0..2 {
            drive.core.set_manufacturer_bits(Controlword::empty());
            drive.shows(ENABLED);
        }
    } else {
        drive.shows_for(2, ENABLED);
    }
    let second = send(
        &mut drive,
        0,
        SetPoint::new().buffer_mode(BufferMode::Buffered),
    );
    assert_eq!(drive.word(), GO | 0x0010);
    drive.shows(ENABLED);
    assert_eq!((drive.position, drive.outcome(first)), (920, None));
    drive.now += Duration::from_millis(100);
    drive.velocity = -20;
    drive.position = 600;
    drive.shows(ACKNOWLEDGED);
    assert!(drive.reports.contains(&(second, Event::Accepted)));
    drive.shows_for(29, ENABLED);
    drive.velocity = 0;
    let (_, end) = drive.cycles_to_end(second, REACHED);
    assert!(end.is_ok(), "{end:?}");
    drive.outcome(first)
}

#[test]
fn a_host_that_stood_still_has_not_seen_the_end_whichever_way_it_went_before() {
    for idle in [false, true] {
        let end = stands_still_after_the_second(idle);
        let unseen = matches!(end, Some(Err(Failure::Unseen { .. })));
        assert!(unseen, "{idle}: {end:?}");
    }
}

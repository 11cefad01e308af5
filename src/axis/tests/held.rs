//! What the drive may have done with a set-point, where bits 10 and 12 and the position leave that open.

use core::time::Duration;

use super::played::{ACKNOWLEDGED, Brings, ENABLED, GO, Played, REACHED, absolute};
use crate::{
    axis::{Command, CommandId, Completion, CoreConfig, Event, Failure},
    ds402::Controlword,
    profile_position::{
        BufferMode, BufferSignal, MoveCommand, PositionRange, Reference, RelativeBase, SetPoint,
        Traits, WaitingFor,
    },
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

fn queue(drive: &mut Played, reference: Reference, target: i32) -> CommandId {
    drive.submit(Command::Move(MoveCommand {
        reference,
        target,
        set_point: SetPoint::new().buffer_mode(BufferMode::Buffered),
        gated: false,
    }))
}

/// The axis waits where it stood, and shows this before and while a second move to the same end is sent. How the first ends.
fn to_the_same_end(word: u16) -> Option<Result<Completion, Failure>> {
    let mut drive = Played::enabled(showing_room());
    let first = drive.move_to(1_000);
    drive.shows(REACHED);
    drive.shows(ACKNOWLEDGED);
    drive.shows_for(10, ENABLED);
    drive.cycles(3, Brings::Nothing, word);
    drive.shows_for(5, word);
    let second = queue(&mut drive, Reference::Absolute, 1_000);
    drive.shows(word);
    drive.shows(ACKNOWLEDGED);
    drive.velocity = 20;
    drive.shows_for(50, ENABLED);
    drive.velocity = 0;
    let (_, end) = drive.cycles_to_end(second, REACHED);
    assert!(matches!(end, Ok(Completion::Reached { .. })), "{end:?}");
    drive.outcome(first)
}

#[test]
fn a_move_that_seems_over_where_it_began_has_not_ended_by_the_motion_of_the_next() {
    // The drive may have dropped it while no inputs came.
    let end = to_the_same_end(REACHED);
    let unseen = matches!(end, Some(Err(Failure::Unseen { target: 1_000, .. })));
    assert!(unseen, "{end:?}");
    // Without bit 10 it is the active one until the next takes over.
    let end = to_the_same_end(ENABLED);
    let reached = matches!(end, Some(Ok(Completion::Reached { .. })));
    assert!(reached, "{end:?}");
}

/// The axis lags behind the end of the first move when the drive takes the second, and passes the end of that before the acknowledge.
/// Bit 12 then stays high for so many cycles. How the second ends, with a third behind it.
fn passed_before_its_acknowledge(full: u32) -> Option<Result<Completion, Failure>> {
    let (mut drive, _) = Played::moving(showing_room(), 1_000);
    drive.shows_for(34, ENABLED);
    let second = queue(&mut drive, Reference::Absolute, 850);
    drive.velocity = 10;
    drive.shows_for(9, ENABLED);
    assert_eq!(drive.position, 870);
    drive.shows_for(1 + full, ACKNOWLEDGED);
    drive.shows_for(5, ENABLED);
    queue(&mut drive, Reference::Absolute, 20_000);
    drive.shows_for(3, ENABLED);
    drive.shows(ACKNOWLEDGED);
    drive.shows_for(250, ENABLED);
    drive.outcome(second)
}

#[test]
fn an_end_that_the_axis_was_at_before_the_acknowledge_is_not_missed() {
    let end = passed_before_its_acknowledge(0);
    assert!(
        matches!(end, Some(Err(Failure::Unseen { target: 850, .. }))),
        "{end:?}"
    );
    // Bit 12 has shown that the drive was at the one before it meanwhile.
    let end = passed_before_its_acknowledge(30);
    assert!(
        matches!(end, Some(Err(Failure::MissedTarget { target: 850, .. }))),
        "{end:?}"
    );
}

/// The drive counts a distance from its demand, beside which the axis swings, and begins it late, with bit 10 high. The axis comes to rest where a
/// distance from its place would have ended.
#[test]
fn a_distance_from_a_swing_has_not_ended_where_one_from_its_place_would_have() {
    let mut config = Played::config();
    config.traits.relative_base = RelativeBase::Demand;
    config.deadlines.begin = core::time::Duration::from_millis(300);
    let mut drive = Played::enabled(config);
    drive.position = -38;
    drive.velocity = 2;
    drive.shows_for(2, REACHED);
    let distance = queue(&mut drive, Reference::Relative, 40);
    drive.shows_for(9, REACHED);
    drive.shows(0x1637);
    drive.shows_for(7, REACHED);
    assert_eq!(drive.position, 0);
    drive.velocity = 0;
    let (_, end) = drive.cycles_to_end(distance, REACHED);
    assert_eq!(end, Err(Failure::NotBegun { actual: 0 }));
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

/// The drive has taken the second move and acknowledges it too late. It goes on at its end velocity, with bit 10.
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

/// Acknowledged behind the active one.
fn blends_to_3000(drive: &mut Played) -> CommandId {
    let blend = SetPoint::new().buffer_mode(BufferMode::Blending);
    let id = send(drive, 3_000, blend);
    drive.shows(ENABLED);
    drive.shows_for(3, ACKNOWLEDGED);
    assert!(drive.reports.contains(&(id, Event::Accepted)));
    id
}

/// The ramp of a halt leads past 1000, where the axis is seen. The drive shows this word until then.
fn halts_beyond_1000(drive: &mut Played, word: u16, at_the_end: Brings) {
    let halting = drive.submit(Command::Halt);
    drive.shows_for(3, word);
    drive.cycles(2, at_the_end, word);
    assert_eq!(drive.position, 1_000);
    drive.cycles(2, at_the_end, ENABLED);
    for velocity in (0..20).rev() {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    assert!(drive.cycles_to_end(halting, REACHED).1.is_ok());
}

fn resumes(drive: &mut Played) {
    let resuming = drive.submit(Command::Resume);
    drive.shows(REACHED);
    assert_eq!(drive.outcome(resuming), Some(Ok(Completion::Done)));
}

/// A halt on the way to the first of two, and the ramp of it leads past that end: the drive goes over to the second there.
fn passed_on_the_ramp_of_a_halt(
    config: CoreConfig,
    at_the_end: Brings,
) -> Option<Result<Completion, Failure>> {
    let shows_room = config.traits.buffer_signal == BufferSignal::Acknowledge;
    let (mut drive, first) = Played::moving(config, 1_000);
    let second = blends_to_3000(&mut drive);
    let full = if shows_room { ACKNOWLEDGED } else { ENABLED };
    drive.shows_for(36, full);
    assert_eq!((drive.position, drive.outcome(first)), (900, None));
    halts_beyond_1000(&mut drive, full, at_the_end);
    drive.shows_for(150, REACHED);
    resumes(&mut drive);
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
    let end = passed_on_the_ramp_of_a_halt(showing_room(), Brings::Fresh);
    assert!(
        !matches!(end, Some(Err(Failure::MissedTarget { .. }))),
        "{end:?}"
    );
}

#[test]
fn nor_where_bit_12_shows_nothing() {
    let end = passed_on_the_ramp_of_a_halt(Played::config(), Brings::Fresh);
    assert!(
        !matches!(end, Some(Err(Failure::MissedTarget { .. }))),
        "{end:?}"
    );
}

/// Frames are lost while the ramp leads past that end.
#[test]
fn an_end_that_was_passed_unseen_on_the_ramp_of_a_halt_is_not_missed() {
    for config in [showing_room(), Played::config()] {
        let end = passed_on_the_ramp_of_a_halt(config, Brings::Nothing);
        assert!(
            !matches!(end, Some(Err(Failure::MissedTarget { .. }))),
            "{end:?}"
        );
    }
}

/// The ramp of a halt leads past the end of a move that ends in motion: when bit 8 falls the drive goes on at its end velocity.
#[test]
fn an_end_in_motion_that_was_passed_on_the_ramp_of_a_halt_is_told() {
    let mut drive = Played::enabled(Played::passing());
    let first = drive.passes(1_000, 20);
    drive.shows_for(45, ENABLED);
    assert_eq!((drive.position, drive.outcome(first)), (900, None));
    halts_beyond_1000(&mut drive, ENABLED, Brings::Fresh);
    resumes(&mut drive);
    drive.velocity = 20;
    drive.shows_for(5_000, REACHED);
    let end = drive.outcome(first);
    assert!(
        matches!(end, Some(Ok(Completion::Reached { .. }))),
        "{end:?}"
    );
}

/// Bit 12 has shown that the drive has gone on to the second, and the axis lags behind the end of the first.
#[test]
fn a_halt_is_told_to_one_whose_end_is_still_looked_for() {
    let (mut drive, first) = Played::moving(showing_room(), 1_000);
    let second = blends_to_3000(&mut drive);
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

/// The host stands still after it has sent the second move. The axis was on the idle path before, or not. How the first one ends: the axis was at
/// its end meanwhile.
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

/// Bit 10 stays high: the drive has taken it, and waits, for a brake for example.
fn taken(drive: &mut Played, target: i32, buffer_mode: BufferMode) -> CommandId {
    let id = send(drive, target, SetPoint::new().buffer_mode(buffer_mode));
    drive.shows(REACHED);
    drive.shows(REACHED | ACKNOWLEDGED);
    drive.shows_for(4, REACHED);
    assert!(drive.reports.contains(&(id, Event::Accepted)));
    id
}

#[test]
fn one_that_has_replaced_another_at_rest_may_not_have_begun() {
    for first in [None, Some(1)] {
        let mut drive = Played::enabled(Played::config());
        if let Some(target) = first {
            taken(&mut drive, target, BufferMode::Aborting);
        }
        let replacing = taken(&mut drive, 1, BufferMode::Aborting);
        let (_, end) = drive.cycles_to_end(replacing, REACHED);
        assert_eq!(end, Ok(Completion::Reached { position: 0 }));
        // The drive may be at that one still: then this one is queued behind it.
        taken(&mut drive, 500, BufferMode::Buffered);
        queue(&mut drive, Reference::Absolute, 900);
        for _ in 0..50 {
            drive.shows(REACHED);
            assert_eq!(drive.word(), GO, "{first:?}");
        }
    }
}

/// The drive goes through both ends at its end velocity, with bit 10 from the second on.
fn both_end(first: i32, second: i32, buffer_mode: BufferMode) {
    let mut config = Played::passing();
    config.traits.buffer_signal = BufferSignal::None;
    let (mut drive, one) = Played::moving(config, first);
    let set_point = SetPoint::new().end_velocity(20).buffer_mode(buffer_mode);
    let two = send(&mut drive, second, set_point);
    drive.shows_for(5, ENABLED);
    drive.shows(ACKNOWLEDGED);
    assert!(drive.reports.contains(&(two, Event::Accepted)));
    while drive.position < first {
        drive.shows(ENABLED);
    }
    if buffer_mode == BufferMode::Buffered {
        drive.velocity = 0;
        drive.shows_for(5, ENABLED);
        drive.velocity = 20;
    }
    while drive.position < second {
        drive.shows(ENABLED);
    }
    // For six seconds, on and on.
    drive.shows_for(6_000, REACHED);
    assert!(
        drive.outcome(one).is_some(),
        "{first} {second} {buffer_mode:?}"
    );
    assert!(
        drive.outcome(two).is_some(),
        "{first} {second} {buffer_mode:?}"
    );
}

#[test]
fn a_move_that_ends_in_motion_close_behind_another_ends() {
    for buffer_mode in [BufferMode::Blending, BufferMode::Buffered] {
        for second in [600, 520, 505, 500] {
            both_end(500, second, buffer_mode);
        }
    }
}

/// An input of the drive holds the axis just before its target, with bit 10 low.
#[test]
fn no_third_move_goes_to_a_drive_that_may_hold_two() {
    let mut drive = Played::enabled(Played::config());
    let first = drive.move_to(100);
    drive.shows(REACHED);
    drive.shows(ACKNOWLEDGED);
    drive.velocity = 10;
    while drive.position < 90 {
        drive.shows(ENABLED);
    }
    drive.velocity = 0;
    drive.position = 95;
    let waits = |end| {
        matches!(
            end,
            Err(Failure::Timeout {
                waiting_for: WaitingFor::TargetReached,
                ..
            })
        )
    };
    assert!(waits(drive.cycles_to_end(first, ENABLED).1));

    // This one is queued behind it.
    let second = queue(&mut drive, Reference::Absolute, 103);
    drive.shows(ENABLED);
    drive.shows(ACKNOWLEDGED);
    drive.shows_for(3, ENABLED);
    assert!(drive.reports.contains(&(second, Event::Accepted)));
    assert!(waits(drive.cycles_to_end(second, ENABLED).1));

    // For this one it has no place.
    let third = queue(&mut drive, Reference::Absolute, 500);
    drive.shows(ENABLED);
    assert_eq!(drive.word(), GO);
    drive.shows_for(20, ENABLED);
    assert_eq!(drive.word(), GO);
    assert_eq!(drive.outcome(third), Some(Err(Failure::NeedsStop)));
}

#[test]
fn a_distance_that_ends_in_motion_behind_a_doubtful_end_ends() {
    // The drive has limited the first.
    let (mut drive, first) = Played::moving(Played::passing(), 500);
    while drive.position < 300 {
        drive.shows(ENABLED);
    }
    drive.velocity = 0;
    let missed = drive.cycles_to_end(first, REACHED).1;
    assert!(
        matches!(missed, Err(Failure::MissedTarget { .. })),
        "{missed:?}"
    );

    // From wherever this one counts: the drive shows its end, and goes on.
    let mut command = absolute(100);
    command.reference = Reference::Relative;
    command.set_point = SetPoint::new()
        .end_velocity(20)
        .buffer_mode(BufferMode::Buffered);
    let second = drive.submit(Command::Move(command));
    drive.shows(REACHED);
    drive.shows(ACKNOWLEDGED);
    assert!(drive.reports.contains(&(second, Event::Accepted)));
    drive.velocity = 20;
    drive.shows_for(5, ENABLED);
    drive.shows_for(6_000, REACHED);
    assert!(drive.outcome(second).is_some());
}

/// A brake holds the axis, with bit 10 of the rest before.
#[test]
fn two_moves_of_no_way_are_not_over_while_bit_12_shows_a_full_buffer() {
    let mut drive = Played::enabled(showing_room());
    let first = drive.move_to(2);
    drive.shows(REACHED);
    drive.shows(REACHED | ACKNOWLEDGED);
    drive.shows_for(4, REACHED);
    let second = queue(&mut drive, Reference::Absolute, 4);
    drive.shows(REACHED);
    drive.shows_for(150, REACHED | ACKNOWLEDGED);
    assert!(drive.reports.contains(&(second, Event::Accepted)));
    assert_eq!((drive.outcome(first), drive.outcome(second)), (None, None));
    drive.position = 4;
    drive.shows_for(250, REACHED);
    assert!(matches!(drive.outcome(first), Some(Ok(_))));
    assert!(matches!(drive.outcome(second), Some(Ok(_))));
}

fn ask(
    drive: &mut Played,
    reference: Reference,
    target: i32,
    buffer_mode: BufferMode,
) -> CommandId {
    drive.submit(Command::Move(MoveCommand {
        reference,
        target,
        set_point: SetPoint::new().buffer_mode(buffer_mode),
        gated: false,
    }))
}

/// Bit 10 low, bit 11 (internal limit active) high.
const LIMITED: u16 = ENABLED | 0x0800;

/// The drive limits the distance (bit 11) at this place, and rests there with bit 10.
#[track_caller]
fn is_limited_at(drive: &mut Played, position: i32, distance: CommandId) {
    while drive.position < position {
        drive.shows(ENABLED);
    }
    drive.velocity = 0;
    drive.shows_for(200, LIMITED | 0x0400);
    let outcome = drive.outcome(distance);
    assert!(!matches!(outcome, Some(Ok(_))), "{outcome:?}");
}

/// A distance that replaces a move under way, another move behind it. The drive limits the distance (bit 11) after less than a third, and goes
/// on to the next.
#[test]
fn a_distance_that_the_drive_has_limited_to_a_third_is_not_reached_where_another_follows() {
    let mut outcomes = alloc::vec::Vec::new();
    for (next, base) in [
        (BufferMode::Buffered, RelativeBase::Undocumented),
        (BufferMode::Buffered, RelativeBase::Actual),
        (BufferMode::Blending, RelativeBase::Actual),
    ] {
        let mut config = Played::config();
        config.traits.buffer_signal = BufferSignal::Acknowledge;
        config.traits.relative_base = base;
        let (mut drive, first) = Played::moving(config, 100_000);
        drive.shows_for(30, ENABLED);
        let distance = ask(
            &mut drive,
            Reference::Relative,
            10_000,
            BufferMode::Aborting,
        );
        drive.shows(ENABLED);
        drive.shows(ACKNOWLEDGED);
        drive.shows_for(5, ENABLED);
        assert_eq!(drive.outcome(first), Some(Err(Failure::Superseded)));
        assert!(drive.reports.contains(&(distance, Event::Accepted)));
        // Its end is near 10_800, wherever the drive counts from.
        assert!(drive.position < 900, "{}", drive.position);
        let behind = ask(&mut drive, Reference::Absolute, 0, next);
        drive.shows(ENABLED);
        // The buffer is full.
        drive.shows_for(20, ACKNOWLEDGED);
        assert!(drive.reports.contains(&(behind, Event::Accepted)));
        while drive.position < 3_000 {
            drive.shows(ACKNOWLEDGED);
        }
        // Limited there.
        drive.velocity = 0;
        drive.shows_for(30, ACKNOWLEDGED | 0x0800);
        drive.velocity = -20;
        drive.shows_for(40, LIMITED);
        outcomes.push((next, base, drive.outcome(distance)));
    }
    let good = |(_, _, outcome): &_| matches!(outcome, Some(Ok(_)));
    assert!(!outcomes.iter().any(good), "{outcomes:#?}");
}

/// A distance that is blended behind a move, as the last. The drive limits it (bit 11) to four fifths, and rests there.
#[test]
fn a_blended_distance_that_the_drive_has_limited_is_not_reached() {
    let mut config = Played::config();
    config.traits.buffer_signal = BufferSignal::Acknowledge;
    config.traits.relative_base = RelativeBase::Actual;
    let (mut drive, first) = Played::moving(config, 1_000);
    let distance = ask(
        &mut drive,
        Reference::Relative,
        100_000,
        BufferMode::Blending,
    );
    drive.shows(ENABLED);
    drive.shows_for(5, ACKNOWLEDGED);
    assert!(drive.reports.contains(&(distance, Event::Accepted)));
    while drive.position < 1_040 {
        drive.shows(ACKNOWLEDGED);
    }
    drive.shows_for(50, ENABLED);
    assert!(matches!(
        drive.outcome(first),
        Some(Ok(Completion::Passed { .. }))
    ));
    is_limited_at(&mut drive, 80_000, distance);
}

/// A distance that replaces a move under way is acknowledged 40 ms after bit 4. The drive limits it (bit 11) to less than four tenths.
#[test]
fn a_distance_that_was_acknowledged_late_and_limited_is_not_reached() {
    let (mut drive, first) = Played::moving(Played::config(), 100_000);
    drive.shows_for(30, ENABLED);
    let distance = ask(
        &mut drive,
        Reference::Relative,
        10_000,
        BufferMode::Aborting,
    );
    drive.shows_for(40, ENABLED);
    drive.shows(ACKNOWLEDGED);
    drive.shows_for(5, ENABLED);
    assert_eq!(drive.outcome(first), Some(Err(Failure::Superseded)));
    assert!(drive.reports.contains(&(distance, Event::Accepted)));
    // It counts from between 700 and 1_700, and ends beyond 10_700.
    assert!(drive.position < 1_700, "{}", drive.position);
    is_limited_at(&mut drive, 4_600, distance);
}

//! What the drive may have done with a set-point, where bits 10 and 12 and the position leave that open.

use super::played::{ACKNOWLEDGED, Brings, ENABLED, Played, REACHED};
use crate::{
    axis::{Command, CommandId, Completion, CoreConfig, Failure},
    profile_position::{
        BufferMode, BufferSignal, MoveCommand, Reference, RelativeBase, SetPoint, Traits,
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

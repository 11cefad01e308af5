//! Moves that start together with those of other axes.

use super::played::{ACKNOWLEDGED, ENABLED, Played, REACHED, absolute};
use crate::{
    BufferMode, Failure, SetPoint,
    axis::{Command, CommandId, Event},
};

fn ask(drive: &mut Played, target: i32, buffer_mode: BufferMode, gated: bool) -> CommandId {
    let mut command = absolute(target);
    command.set_point = SetPoint::new().buffer_mode(buffer_mode);
    command.gated = gated;
    drive.submit(Command::Move(command))
}

/// As `start_together` asks for them, on the same two axes. Of each group one move replaces the others and one queues.
#[test]
fn two_groups_do_not_wait_for_each_other_for_ever() {
    let gated = |drive: &mut Played, target, mode| ask(drive, target, mode, true);
    let mut axes = [0, 1].map(|_| Played::moving(Played::config(), 1_000).0);
    let [x, y] = &mut axes;
    // The buffer of the first axis is full: the first group waits for that.
    let queued = ask(x, 1_500, BufferMode::Buffered, false);
    x.shows(ENABLED);
    x.shows(ACKNOWLEDGED);
    x.shows(ACKNOWLEDGED);
    x.shows_for(5, ENABLED);
    assert!(x.reports.contains(&(queued, Event::Accepted)));
    let first = [
        gated(x, 2_000, BufferMode::Buffered),
        gated(y, 2_000, BufferMode::Aborting),
    ];
    for _ in 0..3 {
        x.shows(ENABLED);
        y.shows(ENABLED);
        assert_eq!(
            [x.core.is_armed(first[0]), y.core.is_armed(first[1])],
            [false, true]
        );
    }
    let second = [
        gated(x, 3_000, BufferMode::Aborting),
        gated(y, 3_000, BufferMode::Buffered),
    ];
    // The first group has failed: `Groups::advance` withdraws its other move, and the second group starts.
    assert_eq!(x.outcome(first[0]), Some(Err(Failure::Superseded)));
    assert!(y.core.withdraw(y.now, first[1], &mut y.outputs));
    x.shows_for(5, ENABLED);
    y.velocity = 0;
    y.position = 1_000;
    y.shows_for(5, REACHED);
    assert_eq!(
        [x.core.is_armed(second[0]), y.core.is_armed(second[1])],
        [true, true]
    );
}

/// What starts alone waits for nobody: it goes on waiting behind one that starts together with others.
#[test]
fn a_move_of_no_group_waits_behind_one_of_a_group_that_overtakes_it() {
    let mut drive = Played::moving(Played::config(), 1_000).0;
    ask(&mut drive, 1_500, BufferMode::Buffered, false);
    drive.shows(ENABLED);
    drive.shows_for(2, ACKNOWLEDGED);
    drive.shows_for(5, ENABLED);
    let waits = ask(&mut drive, 2_000, BufferMode::Buffered, false);
    let replaces = [3_000, 4_000].map(|to| ask(&mut drive, to, BufferMode::Aborting, true));
    drive.shows_for(5, ENABLED);
    assert!(drive.core.is_armed(replaces[0]));
    assert!(
        drive
            .core
            .withdraw(drive.now, replaces[0], &mut drive.outputs)
    );
    drive.shows_for(5, ENABLED);
    assert!(drive.core.is_armed(replaces[1]));
    assert_eq!(drive.outcome(waits), None);
}

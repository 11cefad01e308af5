//! What reading the axis core found, as short stories: each once broke a promise.

use core::time::Duration;

use servocrab::axis::{
    Command, CommandId, Completion, CoreConfig, Delivery, Failure, Referencing, StopRequest,
    WaitingFor,
};
use servocrab::ds402::QuickStopOption;
use servocrab::profile_position::{
    BufferMode, BufferSignal, MoveCommand, Parameters, Reference, SetPoint,
};
use servocrab_sim::ds402::{AckFault, Axis, Behaviour, Outcome, Plant, State};

use super::world::World;
use crate::frames::Link;

fn world(behaviour: Behaviour) -> World {
    let mut config = CoreConfig::new(World::fields(true));
    config.referencing = Referencing::UnreferencedMovesAllowed;
    config.quick_stop = QuickStopOption(behaviour.quick_stop_option);
    config.defaults = Parameters {
        velocity: Some(50_000),
        acceleration: Some(500_000),
        deceleration: Some(500_000),
        ..Parameters::default()
    };
    let mut world = World::new(
        Axis::new(behaviour.with_plant(Plant::ideal())),
        config,
        Duration::from_millis(1),
        0,
    );
    let id = world.submit(Command::Enable);
    assert_eq!(finish(&mut world, id), Ok(Completion::Done));
    world
}

fn run(world: &mut World, cycles: usize) {
    for _ in 0..cycles {
        world.cycle(StopRequest::empty(), false, Link::Good);
    }
}

fn finish(world: &mut World, id: CommandId) -> Result<Completion, Failure> {
    for _ in 0..30_000 {
        if let Some((_, result)) = world.done(id) {
            return result;
        }
        run(world, 1);
    }
    panic!("{id:?} does not end: {:?}", world.core.snapshot());
}

fn to(target: i32, buffer_mode: BufferMode) -> Command {
    Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target,
        set_point: SetPoint::new().buffer_mode(buffer_mode),
        gated: false,
    })
}

fn until_accepted(world: &mut World, id: CommandId) {
    for _ in 0..1_000 {
        if world.accepted(id).is_some() {
            return;
        }
        run(world, 1);
    }
    panic!("{id:?} is not accepted");
}

#[test]
fn a_stop_that_the_drive_ignores_ends_in_time_and_so_does_the_next_one() {
    let mut world = world(Behaviour::akd2g());
    let id = world.submit(to(1_000_000, BufferMode::Aborting));
    until_accepted(&mut world, id);
    world.drive.set_remote(false);
    for command in [
        Command::QuickStop,
        Command::QuickStop,
        Command::Stop,
        Command::Disable,
        Command::Halt,
        Command::Release,
    ] {
        let id = world.submit(command);
        assert!(
            matches!(
                finish(&mut world, id),
                Err(Failure::QuickStopIgnored
                    | Failure::Timeout {
                        waiting_for: WaitingFor::State(_),
                        ..
                    })
            ),
            "{command:?}"
        );
    }
    world.drive.set_remote(true);
    run(&mut world, 500);
    assert_eq!(world.drive.state(), State::SwitchOnDisabled);
}

#[test]
fn moves_that_wait_behind_an_unknown_one_are_not_sent() {
    let mut world = world(Behaviour::akd2g());
    world.drive.disturbances().ack = AckFault::Never;
    let first = world.submit(to(1_000, BufferMode::Aborting));
    let second = world.submit(to(2_000, BufferMode::Buffered));
    assert!(matches!(
        finish(&mut world, first),
        Err(Failure::Timeout {
            delivery: Delivery::Unknown,
            ..
        })
    ));
    world.drive.disturbances().ack = AckFault::None;
    assert_eq!(finish(&mut world, second), Err(Failure::NeedsStop));
    run(&mut world, 1_000);
    assert_eq!(world.ledger().len(), 1);
}

#[test]
fn a_clamped_move_with_another_behind_it_has_missed_its_target() {
    for start in [BufferMode::Buffered, BufferMode::Blending] {
        let mut world = world(Behaviour::akd2g());
        for (subindex, limit) in [(1, -5_000), (2, 5_000)] {
            world.drive.set(0x607D, subindex, limit).expect("a limit");
        }
        let first = world.submit(to(8_000, BufferMode::Aborting));
        let second = world.submit(to(1_000, start));
        let end = finish(&mut world, first);
        assert!(
            matches!(end, Err(Failure::MissedTarget { target: 8_000, .. })),
            "{start:?}: {end:?}"
        );
        assert_eq!(
            finish(&mut world, second),
            Ok(Completion::Reached { position: 1_000 })
        );
    }
}

#[test]
fn a_target_that_is_overshot_before_it_is_reached_is_not_done_at_the_first_crossing() {
    let mut world = world(Behaviour::akd2g());
    let fast = world.submit(to(1_000_000, BufferMode::Aborting));
    until_accepted(&mut world, fast);
    run(&mut world, 400);
    let near = world.drive.position() as i32 + 300;
    let first = world.submit(to(near, BufferMode::Aborting));
    let second = world.submit(to(near + 20_000, BufferMode::Buffered));
    let end = finish(&mut world, first);
    let (report, _) = world.done(first).expect("it has just ended");
    assert!(matches!(end, Ok(Completion::Reached { .. })), "{end:?}");
    let line = &world.ledger()[1];
    assert_eq!(line.outcome, Outcome::Reached);
    assert!(
        line.ended_at.is_some_and(|ended| ended <= report.now),
        "reported at {:?}: {line:?}",
        report.now
    );
    assert!(matches!(
        finish(&mut world, second),
        Ok(Completion::Reached { .. })
    ));
}

#[test]
fn a_gated_move_is_not_started_on_inputs_that_did_not_arrive() {
    let mut world = world(Behaviour::akd2g());
    let id = world.submit(Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target: 100,
        set_point: SetPoint::new(),
        gated: true,
    }));
    run(&mut world, 10);
    assert!(world.core.is_armed(id));
    world.cycle(StopRequest::empty(), false, Link::ReplyLost);
    assert!(!world.core.is_armed(id));
    run(&mut world, 1);
    assert!(world.core.is_armed(id));
}

/// On its ramp of a fault reaction, with this deceleration.
fn in_a_fault_reaction(deceleration: u32) -> World {
    let mut world = world(Behaviour::akd2g());
    world.drive.set(0x605E, 0, 1).expect("slow down");
    let id = world.submit(Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target: i32::MAX,
        set_point: SetPoint::new()
            .velocity(1_000_000)
            .acceleration(100_000_000)
            .deceleration(deceleration),
        gated: false,
    }));
    until_accepted(&mut world, id);
    run(&mut world, 50);
    world.drive.inject_fault(0x7305);
    run(&mut world, 20);
    assert_eq!(world.drive.state(), State::FaultReactionActive);
    world
}

#[test]
fn a_reset_during_a_fault_reaction_that_never_ends_is_given_up() {
    let mut world = in_a_fault_reaction(1);
    let reset = world.submit(Command::ResetFault);
    assert!(finish(&mut world, reset).is_err());
}

#[test]
fn a_drive_that_is_lost_in_its_fault_reaction_is_not_left_to_coast() {
    let mut world = in_a_fault_reaction(1_000_000);
    let from = world.frames.len();
    for _ in 0..100 {
        world.cycle(StopRequest::empty(), false, Link::ReplyLost);
    }
    let frames = &world.frames[from..];
    let cut = frames.iter().find(|frame| !frame.sent.bit(1));
    assert!(cut.is_none(), "voltage disabled: {cut:?}");
    let last = frames.last().expect("many");
    assert!(
        last.velocity != 0.0 && !last.sent.bit(2),
        "no quick stop: {last:?}"
    );
}

#[test]
fn a_drives_own_quick_stop_is_not_turned_into_coasting() {
    for command in [Command::Enable, Command::Disable] {
        let mut world = world(Behaviour {
            abort_connection_option: 3,
            ..Behaviour::akd2g()
        });
        world.drive.set(0x6085, 0, 50_000).expect("a slow ramp");
        let id = world.submit(to(1_000_000, BufferMode::Aborting));
        until_accepted(&mut world, id);
        run(&mut world, 300);
        world.drive.connection_lost();
        world.drive.connection_restored();
        run(&mut world, 5);
        assert_eq!(world.drive.state(), State::QuickStopActive);
        let from = world.frames.len();
        world.submit(command);
        run(&mut world, 2_000);
        let cut = world.frames[from..]
            .iter()
            .find(|frame| frame.velocity != 0.0 && !frame.sent.bit(1));
        assert!(cut.is_none(), "{command:?}: {cut:?}");
    }
}

#[test]
fn a_slow_axis_is_not_taken_for_one_that_stands() {
    let mut world = world(Behaviour {
        quick_stop_option: 6,
        ..Behaviour::akd2g()
    });
    world.drive.set(0x6085, 0, 200).expect("a very slow ramp");
    let id = world.submit(Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target: 100_000,
        set_point: SetPoint::new().velocity(400),
        gated: false,
    }));
    until_accepted(&mut world, id);
    run(&mut world, 500);
    let stop = world.submit(Command::QuickStop);
    assert_eq!(
        finish(&mut world, stop),
        Ok(Completion::Stopped {
            state: servocrab::ds402::State::QuickStopActive
        })
    );
    // Its window is 10 counts, its settle time 100 ms.
    let velocity = world.drive.velocity();
    assert!(velocity.abs() < 100.0, "it moves: {velocity} counts/s");
}

#[test]
fn bit_10_of_a_halt_is_not_an_arrival() {
    let mut world = world(Behaviour::akd2g());
    let id = world.submit(Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target: 1_000,
        set_point: SetPoint::new().velocity(1_000),
        gated: false,
    }));
    until_accepted(&mut world, id);
    while world.drive.position() < 991 {
        run(&mut world, 1);
    }
    let halt = world.submit(Command::Halt);
    assert!(finish(&mut world, halt).is_ok());
    let stood = world.drive.position();
    assert!((990..1_000).contains(&stood), "{stood}");
    world.submit(Command::Resume);
    assert!(matches!(
        finish(&mut world, id),
        Ok(Completion::Reached { .. })
    ));
    assert_eq!(world.drive.position(), 1_000);
}

#[test]
fn of_two_clamped_moves_the_second_has_shown_nothing() {
    for start in [BufferMode::Buffered, BufferMode::Blending] {
        let mut world = world(Behaviour::akd2g());
        for (subindex, limit) in [(1, -5_000), (2, 5_000)] {
            world.drive.set(0x607D, subindex, limit).expect("a limit");
        }
        let first = world.submit(to(8_000, BufferMode::Aborting));
        let second = world.submit(to(9_000, start));
        let missed = Failure::MissedTarget {
            target: 8_000,
            actual: 5_000,
        };
        let not_begun = Failure::NotBegun { actual: 5_000 };
        for (id, failure) in [(first, missed), (second, not_begun)] {
            assert_eq!(finish(&mut world, id), Err(failure), "{start:?}");
        }
    }
}

#[test]
fn a_halt_beyond_the_end_of_a_blend_is_not_its_passing() {
    let mut world = world(Behaviour::akd2g());
    // Accelerates fast and slows down slowly, as the halt does then.
    let mut soft = |target, start| {
        let set_point = SetPoint::new()
            .acceleration(1_000_000)
            .deceleration(300_000)
            .buffer_mode(start);
        world.submit(Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target,
            set_point,
            gated: false,
        }))
    };
    let first = soft(10_000, BufferMode::Aborting);
    soft(30_000, BufferMode::Blending);
    while world.drive.position() < 8_000 {
        run(&mut world, 1);
    }
    let halt = world.submit(Command::Halt);
    assert!(finish(&mut world, halt).is_ok());
    assert!(world.drive.position() > 10_100);
    assert_eq!(world.ledger()[0].outcome, Outcome::Active);
    world.submit(Command::Resume);
    run(&mut world, 3);
    assert!(world.done(first).is_none(), "the drive goes back to it");
    assert!(finish(&mut world, first).is_ok());
    assert_eq!(world.ledger()[0].outcome, Outcome::Passed);
}

#[test]
fn a_resume_beside_a_stop_in_the_same_cycle_says_that_bit_8_did_not_fall() {
    for (lane, failure) in [
        (
            StopRequest::HALT,
            Failure::Halted {
                delivery: Delivery::NotSent,
            },
        ),
        (
            StopRequest::STOP,
            Failure::QuickStopped {
                delivery: Delivery::NotSent,
            },
        ),
        (
            StopRequest::QUICK_STOP,
            Failure::QuickStopped {
                delivery: Delivery::NotSent,
            },
        ),
    ] {
        for moves in [true, false] {
            let mut world = world(Behaviour::akd2g());
            if moves {
                let id = world.submit(to(1_000_000, BufferMode::Aborting));
                until_accepted(&mut world, id);
                run(&mut world, 100);
            }
            let halt = world.submit(Command::Halt);
            assert!(finish(&mut world, halt).is_ok());
            let resume = world.submit(Command::Resume);
            assert!(world.done(resume).is_none(), "nothing is sent yet");
            world.cycle(lane, false, Link::Good);
            let sent = world.frames.last().expect("a frame").sent;
            let falls = !sent.bit(8) && sent.bit(2);
            let expected = if falls {
                Ok(Completion::Done)
            } else {
                Err(failure)
            };
            assert_eq!(finish(&mut world, resume), expected, "{lane:?}, {moves}");
            // A stop of an axis that stands without a set-point is nothing that bit 8 would have to stay for.
            assert_eq!(falls, lane == StopRequest::STOP && !moves);
        }
    }
}

#[test]
fn a_resume_of_an_axis_that_the_stop_lane_halts_in_that_cycle_is_refused() {
    let mut world = world(Behaviour::akd2g());
    let resume = world.submit(Command::Resume);
    let another = world.submit(Command::Resume);
    assert_eq!(finish(&mut world, another), Err(Failure::Busy));
    world.cycle(StopRequest::HALT, false, Link::Good);
    assert_eq!(
        finish(&mut world, resume),
        Err(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    let resume = world.submit(Command::Resume);
    world.cycle(StopRequest::empty(), false, Link::ReplyLost);
    assert_eq!(
        world.done(resume).map(|(_, result)| result),
        Some(Ok(Completion::Done)),
        "it was sent"
    );
}

/// A move with a blend behind it, and one that replaces both, which the drive does not acknowledge, and takes or not.
fn perhaps_replaced(taken: bool) -> (World, [CommandId; 2], i32) {
    let mut world = world(Behaviour::akd2g());
    let first = world.submit(to(30_000, BufferMode::Aborting));
    let second = world.submit(to(60_000, BufferMode::Blending));
    until_accepted(&mut world, second);
    world.drive.disturbances().ack = AckFault::Never;
    world.drive.disturbances().deaf_to_bit_4 = !taken;
    let third = world.submit(to(100_000, BufferMode::Aborting));
    assert!(matches!(
        finish(&mut world, third),
        Err(Failure::Timeout {
            delivery: Delivery::Unknown,
            ..
        })
    ));
    assert!(
        world.drive.position() < 30_000,
        "the end of the first is still ahead"
    );
    (world, [first, second], 100_000)
}

#[test]
fn a_move_that_an_unacknowledged_one_may_have_replaced_has_not_passed_its_end() {
    let (mut world, held, actual) = perhaps_replaced(true);
    assert_eq!(world.ledger()[0].outcome, Outcome::Replaced);
    for id in held {
        let end = finish(&mut world, id);
        assert_eq!(end, Err(Failure::PerhapsSuperseded { actual }));
    }
    let (mut world, [first, second], _) = perhaps_replaced(false);
    // It has, but nothing tells it from the other scenario before the axis stands.
    let actual = 60_000;
    assert_eq!(
        finish(&mut world, first),
        Err(Failure::PerhapsSuperseded { actual })
    );
    assert_eq!(
        finish(&mut world, second),
        Ok(Completion::Reached { position: 60_000 })
    );
}

#[test]
fn a_move_that_an_unacknowledged_one_may_have_replaced_ends_also_by_a_stop() {
    let (mut world, held, _) = perhaps_replaced(true);
    let stop = world.submit(Command::Stop);
    assert!(finish(&mut world, stop).is_ok());
    for id in held {
        assert_eq!(
            finish(&mut world, id),
            Err(Failure::QuickStopped {
                delivery: Delivery::Accepted
            })
        );
    }
}

/// On a drive whose inputs are three frames late, a place becomes free by itself while a replacement is on
/// its way: that fall of bit 12 does not show that the replacement was taken.
#[test]
fn a_place_that_became_free_by_itself_is_no_sign_that_the_replacement_was_taken() {
    for moment in 0..60 {
        let behaviour = Behaviour {
            without: &[],
            ..Behaviour::pp2010()
        };
        let mut config = CoreConfig::new(World::fields(true));
        config.referencing = Referencing::UnreferencedMovesAllowed;
        config.traits.buffer_signal = BufferSignal::Acknowledge;
        config.defaults = Parameters {
            velocity: Some(50_000),
            acceleration: Some(60_000),
            deceleration: Some(120_000),
            ..Parameters::default()
        };
        let (period, late) = (Duration::from_millis(2), 3);
        let mut world = World::new(
            Axis::new(behaviour.with_plant(Plant::ideal())),
            config,
            period,
            late,
        );
        let id = world.submit(Command::Enable);
        assert_eq!(finish(&mut world, id), Ok(Completion::Done));
        let first = world.submit(to(20, BufferMode::Aborting));
        let second = world.submit(to(20, BufferMode::Blending));
        until_accepted(&mut world, first);
        run(&mut world, moment);
        let third = world.submit(to(47, BufferMode::Aborting));
        let fourth = world.submit(to(4_000, BufferMode::Buffered));
        for id in [first, second, third, fourth] {
            let end = finish(&mut world, id);
            let (report, _) = world.done(id).expect("it has just ended");
            if let Ok(Completion::Reached { position }) = end {
                let ended = world.ledger().iter().any(|line| {
                    line.target
                        .is_some_and(|target| (target - i64::from(position)).abs() <= 10)
                        && line.ended_at.is_some_and(|ended| ended <= report.now)
                });
                assert!(
                    ended,
                    "at {moment}: {id:?} at {position}: {:#?}",
                    world.ledger()
                );
            }
        }
    }
}

/// Its frames do not reach the drive until the move before has ended. Where the axis was when bit 4 rose does not say on which side of its
/// end it begins.
#[test]
fn a_move_that_is_taken_after_the_one_before_has_ended_is_not_passed_on_its_way() {
    let mut world = world(Behaviour::akd2g());
    let first = world.submit(to(3_200, BufferMode::Aborting));
    until_accepted(&mut world, first);
    while world.drive.position() < 3_075 {
        run(&mut world, 1);
    }
    let second = world.submit(to(3_130, BufferMode::Buffered));
    while world.done(first).is_none() {
        world.cycle(StopRequest::empty(), false, Link::Undelivered);
    }
    until_accepted(&mut world, second);
    let third = world.submit(to(1_000, BufferMode::Blending));
    assert!(matches!(
        finish(&mut world, second),
        Ok(Completion::Passed { .. })
    ));
    let (report, _) = world.done(second).expect("it has just ended");
    let line = &world.ledger()[1];
    assert!(
        line.ended_at.is_some_and(|ended| ended <= report.now),
        "told at {:?}: {line:?}",
        report.now
    );
    assert!(finish(&mut world, third).is_ok());
}

//! Moves until a torque: the axis is halted in the frame after the sample that shows it long enough, and held. What the drive does while it is
//! halted decides how that ends.

use core::time::Duration;

use crate::common::Rig;
use servocrab::coe::obj;
use servocrab::drives;
use servocrab::ds402::State;
use servocrab::{
    BufferMode, Doubt, Failure, SetPoint,
    axis::{
        Command, CommandId, Completion, CoreConfig, Delivery, Event, ParameterFault, Unsupported,
    },
};
use servocrab_sim::ds402::{Behaviour, Outcome, Plant, WhileHalted};

const LASTS: Duration = Duration::from_millis(20);

/// With 6077h in its inputs, on a shaft with this friction.
fn rig(friction: u16, while_halted: WhileHalted, change: impl FnOnce(&mut CoreConfig)) -> Rig {
    let plant = Plant {
        friction,
        ..Plant::default()
    };
    let behaviour = Behaviour {
        while_halted,
        plant,
        ..Behaviour::akd2g()
    };
    let mut description = drives::akd2g();
    description.axes[0].inputs.push(obj::TORQUE_ACTUAL.into());
    let mut rig = Rig::of(description, behaviour, |config| {
        config.traits.acknowledges_while_halted = true;
        change(config);
    });
    rig.enable();
    rig
}

fn press(torque: u16) -> SetPoint {
    SetPoint::new().until_torque(torque, LASTS)
}

/// Where the torque was seen, and how much it was.
fn contact(rig: &Rig, id: CommandId) -> Option<(i32, i16)> {
    rig.reports(id).into_iter().find_map(|event| match event {
        Event::Contact { position, torque } => Some((position, torque)),
        _ => None,
    })
}

#[test]
fn the_torque_ends_the_move_and_the_axis_is_held() {
    for target in [100_000, -100_000] {
        let mut rig = rig(80, WhileHalted::Takes, |_| {});
        let id = rig.abs(target, press(60));
        rig.wait_accepted(id);
        rig.run_until(500, |rig| contact(rig, id).is_some());
        let (position, torque) = contact(&rig, id).unwrap();
        assert!(torque.unsigned_abs() >= 60 && i32::from(torque.signum()) == target.signum());
        assert!((rig.drive.position() - i64::from(position)).abs() < 500);
        rig.cycle();
        assert_eq!(rig.words.last().map(|word| word & 0x100), Some(0x100));
        let held = rig.finish(id);
        assert_eq!(held, Ok(Completion::Done));
        rig.assert_rests();
        assert_eq!(rig.statusword().state(), State::OperationEnabled);
        assert_eq!(rig.word() & 0x1FF, 0x000F);
        let outcomes: Vec<_> = rig.ledger().iter().map(|entry| entry.outcome).collect();
        assert_eq!(outcomes, [Outcome::Replaced, Outcome::Reached]);
        let back = rig.abs(0, SetPoint::new());
        rig.assert_reached(back, 0);
    }
}

/// 0.5 ‰ a count: 300 ‰ press it in by 600 counts.
#[test]
fn an_axis_that_presses_against_a_wall_stops_there() {
    for (limit, ends) in [(3_000, true), (250, false)] {
        let mut rig = rig(30, WhileHalted::Takes, |_| {});
        rig.drive.set(0x6072, 0, limit).unwrap();
        rig.drive.put_wall(20_000, 0.5);
        let id = rig.abs(30_000, press(300).velocity(10_000));
        if !ends {
            // The drive presses with less, and the move goes on until it is stopped.
            rig.run(2_300);
            assert_eq!((contact(&rig, id), rig.outcome(id)), (None, None));
            assert!(
                rig.drive
                    .get(0x6077, 0)
                    .is_some_and(|torque| torque <= limit)
            );
            continue;
        }
        let held = rig.finish(id);
        assert_eq!(held, Ok(Completion::Done));
        let (position, torque) = contact(&rig, id).unwrap();
        assert!((300..450).contains(&torque), "{torque} ‰");
        assert!((20_500..21_000).contains(&position), "{position}");
        // Held where it stood, it gives way to the wall as far as its loop is soft.
        rig.run(500);
        assert!((20_000..21_000).contains(&rig.drive.position()));
        rig.assert_rests();
        let back = rig.abs(0, SetPoint::new());
        rig.assert_reached(back, 0);
    }
}

#[test]
fn friction_that_grips_ends_the_move_where_it_lasts() {
    for (peak, ends) in [(15, false), (40, true)] {
        let mut rig = rig(30, WhileHalted::Takes, |_| {});
        let id = rig.abs(60_000, press(300));
        rig.wait_accepted(id);
        rig.run(300);
        rig.drive
            .inject_torque_peak(500, Duration::from_millis(peak));
        let done = rig.finish(id);
        assert!(done.is_ok(), "{done:?}");
        assert_eq!(contact(&rig, id).is_some(), ends, "{peak} ms");
    }
}

#[test]
fn without_the_torque_the_move_arrives() {
    let mut rig = rig(30, WhileHalted::Takes, |_| {});
    let id = rig.abs(20_000, press(500));
    rig.assert_reached(id, 20_000);
    assert_eq!(contact(&rig, id), None);
}

/// The ramp takes 100 ‰ for 10 ms.
#[test]
fn a_peak_that_is_shorter_does_not_end_it() {
    let fast = SetPoint::new().acceleration(5_000_000);
    for (lasts, ends) in [(50, false), (3, true)] {
        let mut rig = rig(0, WhileHalted::Takes, |_| {});
        let id = rig.abs(20_000, fast.until_torque(80, Duration::from_millis(lasts)));
        let done = rig.finish(id);
        assert!(done.is_ok(), "{done:?}");
        assert_eq!(contact(&rig, id).is_some(), ends, "{lasts} ms");
    }
}

#[test]
fn where_the_axis_cannot_be_held_it_is_refused_before_it_starts() {
    type Change = fn(&mut CoreConfig);
    type Expected = fn(Failure) -> bool;
    let nothing: Change = |_| {};
    let cases: [(Change, SetPoint, Expected); 4] = [
        (
            |config| config.traits.acknowledges_while_halted = false,
            press(100),
            |failure| matches!(failure, Failure::Unsupported(Unsupported::Hold { .. })),
        ),
        (
            |config| config.fields.torque = None,
            press(100),
            |failure| {
                let Failure::Parameter { name, fault } = failure else {
                    return false;
                };
                name.contains("6077h") && fault == ParameterFault::NotMapped
            },
        ),
        (
            nothing,
            press(100).buffer_mode(BufferMode::Buffered),
            |failure| matches!(failure, Failure::Unsupported(Unsupported::Start { .. })),
        ),
        (nothing, press(0), |failure| {
            matches!(
                failure,
                Failure::Parameter {
                    fault: ParameterFault::Zero,
                    ..
                }
            )
        }),
    ];
    for (change, set_point, expected) in cases {
        let mut rig = rig(30, WhileHalted::Takes, change);
        let sent = rig.words.len();
        let id = rig.abs(20_000, set_point);
        let failure = rig.finish(id).expect_err("it is refused");
        assert!(expected(failure), "{failure:?}");
        rig.run(10);
        assert_eq!(rig.distinct_words(sent), [0x000F]);
    }
}

#[test]
fn a_drive_that_takes_no_set_point_while_it_is_halted_stays_halted() {
    for habit in [WhileHalted::Ignores, WhileHalted::TakesAtRelease] {
        let mut rig = rig(80, habit, |_| {});
        let id = rig.abs(100_000, press(60));
        let failure = rig.finish(id).expect_err("it was not acknowledged");
        assert!(
            matches!(
                failure,
                Failure::Unknown {
                    doubt: Doubt::Unacknowledged,
                    ..
                }
            ),
            "{failure:?}"
        );
        assert!(contact(&rig, id).is_some());
        rig.assert_rests();
        assert_eq!(rig.word() & 0x100, 0x100);
    }
}

#[test]
fn a_stop_beside_the_contact_ends_the_move_once() {
    for (command, delay) in [
        (Command::Halt, 1),
        (Command::Stop, 1),
        (Command::QuickStop, 1),
        (Command::Disable, 30),
    ] {
        let mut rig = rig(80, WhileHalted::Takes, |_| {});
        let id = rig.abs(100_000, press(60));
        rig.run_until(500, |rig| contact(rig, id).is_some());
        rig.run(delay);
        let stop = rig.send(command);
        assert!(rig.finish(stop).is_ok(), "{command:?}");
        rig.run(500);
        let ends = rig.reports(id).into_iter();
        let ends = ends.filter(|event| matches!(event, Event::Done(_))).count();
        assert_eq!(ends, 1, "{command:?}");
        assert!(rig.outcome(id).is_some_and(|outcome| outcome.is_err()));
        rig.assert_rests();
    }
}

/// What the drive keeps of it leads into what it pressed on, without a limit.
#[test]
fn a_move_that_has_pressed_is_not_resumed() {
    let mut rig = rig(80, WhileHalted::Takes, |_| {});
    let id = rig.abs(100_000, press(60));
    rig.run_until(500, |rig| contact(rig, id).is_some());
    rig.run(1);
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let ended = rig.outcome(id).expect("it has ended");
    let halted = Failure::Halted {
        delivery: Delivery::Accepted,
    };
    assert_eq!(ended, Err(halted));
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Err(Failure::NeedsStop));
    rig.assert_rests();
    let hold = rig.send(Command::Hold);
    assert_eq!(rig.finish(hold), Ok(Completion::Done));
    let back = rig.abs(0, SetPoint::new());
    rig.assert_reached(back, 0);
}

/// What is missing is no torque.
#[test]
fn a_torque_counts_from_samples_that_have_arrived() {
    let mut rig = rig(80, WhileHalted::Takes, |_| {});
    let id = rig.abs(100_000, press(60));
    rig.wait_accepted(id);
    rig.run(10);
    assert_eq!(contact(&rig, id), None);
    for _ in 0..4 {
        rig.cycle_over(crate::common::Link::ReplyLost);
    }
    assert_eq!(contact(&rig, id), None);
    rig.run_until(100, |rig| contact(rig, id).is_some());
}

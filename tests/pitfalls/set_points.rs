//! Pitfalls 7 to 13: what a set-point carries, and what is said about it.

use servocrab::{BufferMode, SetPoint};
use servocrab::{
    Failure,
    axis::{Command, Completion, Event, ParameterFault},
};
use servocrab_sim::ds402::{Behaviour, Outcome};

use crate::common::{Link, Rig};
use crate::{BIT_4, enabled, rises, target};

#[test]
fn pitfall_07_bit_10_left_from_the_move_before_ends_no_move() {
    for stale in [1, 20, 150] {
        let mut rig = Rig::enabled();
        rig.drive.disturbances().stale_reached_cycles = stale;
        for position in [20_000, -20_000] {
            let id = rig.abs(position, SetPoint::new());
            rig.assert_reached(id, position);
        }
    }
}

#[test]
fn pitfall_07_bit_10_left_from_before_ends_no_move_whose_end_is_not_known() {
    let mut rig = Rig::enabled();
    rig.drive.disturbances().stale_reached_cycles = 20;
    // The first relative move of all: what it counts from, nobody knows.
    let id = rig.rel(20_000, SetPoint::new());
    assert!(matches!(rig.finish(id), Ok(Completion::Reached { .. })));
    assert_eq!(rig.ledger()[0].outcome, Outcome::Reached);
    rig.assert_at(20_000);
}

#[test]
fn pitfall_08_the_target_stays_in_the_outputs_until_the_acknowledge() {
    let mut rig = enabled(|drive| drive.bit_4_filter_cycles = 5);
    let id = rig.abs(10_000, SetPoint::new());
    while !rig.accepted(id) {
        rig.cycle();
        if rig.word() & BIT_4 != 0 {
            assert_eq!(target(&rig), 10_000);
        }
    }
    assert_eq!(rig.ledger()[0].value, 10_000);
    rig.assert_reached(id, 10_000);
}

#[test]
fn pitfall_09_an_absolute_move_after_a_relative_one_is_absolute() {
    let mut rig = Rig::enabled();
    let relative = rig.rel(3_000, SetPoint::new());
    assert!(rig.finish(relative).is_ok());
    let absolute = rig.abs(1_000, SetPoint::new());
    rig.assert_reached(absolute, 1_000);
    let flags: Vec<_> = rig.ledger().iter().map(|line| line.relative).collect();
    assert_eq!(flags, [true, false]);
    rig.assert_at(1_000);
}

#[test]
fn pitfall_10_two_moves_to_the_same_target_are_two_moves() {
    let mut rig = Rig::enabled();
    for sent in 1..=3 {
        let id = rig.abs(10_000, SetPoint::new());
        rig.assert_reached(id, 10_000);
        assert_eq!(rig.ledger().len(), sent);
    }
    assert_eq!(rises(&rig.words, BIT_4), 3);
}

#[test]
fn pitfall_10_a_target_can_be_sent_again_after_a_stop() {
    let mut rig = Rig::enabled();
    let first = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(first);
    rig.run(200);
    let stop = rig.send(Command::Stop);
    assert!(rig.finish(stop).is_ok());
    assert_ne!(rig.drive.position(), 50_000);
    rig.enable();
    let again = rig.abs(50_000, SetPoint::new());
    rig.assert_reached(again, 50_000);
    assert_eq!(rig.ledger().len(), 2);
}

#[test]
fn pitfall_11_a_move_that_shall_replace_says_so_with_bit_5() {
    let mut rig = Rig::enabled();
    let first = rig.abs(1_000_000, SetPoint::new());
    rig.wait_accepted(first);
    rig.run(300);
    let second = rig.abs(0, SetPoint::new());
    rig.wait_accepted(second);
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
    assert_eq!(rig.ledger()[0].outcome, Outcome::Replaced);
    assert!(rig.ledger()[1].bit_5);
    rig.assert_reached(second, 0);
}

#[test]
fn pitfall_11_a_move_that_shall_wait_leaves_the_active_one_alone() {
    let mut rig = Rig::enabled();
    let first = rig.abs(20_000, SetPoint::new());
    let second = rig.abs(0, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.assert_reached(second, 0);
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Reached { .. }))
    ));
    assert_eq!(rig.ledger()[0].outcome, Outcome::Reached);
}

#[test]
fn pitfall_12_the_parameters_reach_the_drive_with_the_edge_that_they_belong_to() {
    let mut rig = enabled(|drive| drive.bit_4_filter_cycles = 3);
    for n in 1..=3 {
        let id = rig.abs(
            i32::try_from(n * 5_000).expect("small"),
            SetPoint::new()
                .velocity(10_000 * n)
                .acceleration(100_000 * n)
                .deceleration(200_000 * n),
        );
        // The first frame with bit 4 does not arrive.
        rig.run_until(20, |rig| rig.word() & BIT_4 != 0);
        rig.cycle_over(Link::RequestLost);
        assert!(rig.finish(id).is_ok());
        let line = rig.ledger().last().expect("it was executed");
        assert_eq!(
            (line.velocity, line.acceleration, line.deceleration),
            (10_000 * n, 100_000 * n, 200_000 * n)
        );
    }
}

#[test]
fn pitfall_12_a_parameter_that_has_no_way_to_the_drive_refuses_the_move() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| config.fields.velocity = None);
    rig.enable();
    let refused = rig.abs(10_000, SetPoint::new().velocity(1));
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::Parameter {
            fault: ParameterFault::NotMapped,
            ..
        }))
    ));
    rig.run(100);
    assert_eq!(rises(&rig.words, BIT_4), 0);
    assert!(rig.ledger().is_empty());
}

#[test]
fn pitfall_13_a_move_is_not_accepted_before_the_drive_has_taken_it() {
    let mut rig = Rig::enabled();
    rig.drive.disturbances().ack_delay_cycles = 50;
    let id = rig.abs(10_000, SetPoint::new());
    assert_eq!(rig.reports(id), [], "nothing has been sent");
    for _ in 0..5 {
        rig.cycle_over(Link::RequestLost);
    }
    assert!(rig.ledger().is_empty());
    assert_eq!(rig.reports(id), [], "nothing has arrived");
    rig.run(40);
    assert_eq!(rig.ledger().len(), 1);
    assert_eq!(rig.reports(id), [], "nothing has been acknowledged");
    rig.wait_accepted(id);
    assert_eq!(rig.reports(id), [Event::Accepted]);
}

#[test]
fn pitfall_13_no_command_succeeds_while_no_frame_arrives() {
    let mut rig = Rig::akd2g();
    rig.run(5);
    let enable = rig.send(Command::Enable);
    for _ in 0..5 {
        rig.cycle_over(Link::RequestLost);
    }
    assert_eq!(rig.outcome(enable), None);
    assert_eq!(rig.finish(enable), Ok(Completion::Done));
    let id = rig.abs(1_000_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    for command in [Command::Halt, Command::Stop, Command::QuickStop] {
        let stop = rig.send(command);
        for _ in 0..3 {
            rig.cycle_over(Link::RequestLost);
        }
        assert_eq!(rig.outcome(stop), None, "{command:?}");
    }
}

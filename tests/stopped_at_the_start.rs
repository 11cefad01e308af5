//! A quick stop of an axis that has just set off, where its position alone tells whether it stands.
#![allow(missing_docs)]

mod common;

use common::Rig;
use servocrab::axis::{Command, CommandId, Completion, StopRequest, Tolerances};
use servocrab::ds402::{Mode, QuickStopOption, State};
use servocrab::profile_position::SetPoint;
use servocrab_sim::ds402::{self, Behaviour};

/// Enabled, and at rest for longer than its settle time.
fn at_rest() -> Rig {
    let behaviour = Behaviour {
        quick_stop_option: 6,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.quick_stop = QuickStopOption(6);
        config.fields.actual_velocity = None;
        config.tolerances = Tolerances {
            position: 1_000,
            ..Tolerances::default()
        };
    });
    // A quick stop of a fortieth of a second.
    rig.drive.set(0x6085, 0, 200_000).unwrap();
    rig.enable();
    rig.run(200);
    rig
}

/// On its way at 5000 counts/s, for longer than its settle time, and nearer to where it stood than its position window.
fn just_set_off() -> Rig {
    let mut rig = at_rest();
    let id = rig.abs(1_000_000, SetPoint::new().acceleration(40_000));
    rig.wait_accepted(id);
    rig.run_until(200, |rig| rig.drive.velocity() > 5_000.0);
    assert!(rig.drive.position() < 500);
    rig
}

/// Runs to the end of this command, by which the axis must stand, with its power on until then.
fn ends_at_rest(rig: &mut Rig, id: CommandId, state: State) {
    while rig.outcome(id).is_none() {
        rig.cycle();
        let powered = matches!(
            rig.drive.state(),
            ds402::State::OperationEnabled | ds402::State::QuickStopActive
        );
        assert!(powered || !rig.moves(), "it coasts");
    }
    assert_eq!(rig.outcome(id), Some(Ok(Completion::Stopped { state })));
    assert_eq!(rig.drive.velocity(), 0.0);
}

#[test]
fn it_is_done_when_the_axis_stands_and_not_while_it_is_near_where_it_stood() {
    let mut rig = just_set_off();
    let id = rig.send(Command::QuickStop);
    ends_at_rest(&mut rig, id, State::QuickStopActive);
}

#[test]
fn whoever_disables_the_axis_meanwhile_lets_it_not_coast() {
    let mut rig = just_set_off();
    rig.stop = StopRequest::QUICK_STOP;
    rig.cycle();
    let id = rig.send(Command::Disable);
    ends_at_rest(&mut rig, id, State::SwitchOnDisabled);
}

/// The drive itself goes into Quick stop active.
#[test]
fn a_drive_that_stops_by_itself_keeps_its_power_until_the_axis_stands() {
    for command in [Command::Disable, Command::Enable, Command::Stop] {
        let mut rig = just_set_off();
        rig.drive.set(0x6007, 0, 3).unwrap();
        rig.drive.connection_lost();
        rig.drive.connection_restored();
        rig.run_until(10, |rig| {
            rig.core.snapshot().state == State::QuickStopActive
        });
        let id = rig.send(command);
        while rig.outcome(id).is_none() {
            rig.cycle();
            let powered = rig.drive.state() == ds402::State::QuickStopActive;
            assert!(powered || !rig.moves(), "{command:?}: it coasts");
        }
        assert_eq!(rig.drive.velocity(), 0.0, "{command:?}");
    }
}

/// The drive shows the bit 10 of the move before for some cycles more.
#[test]
fn a_halt_is_done_when_the_axis_stands() {
    let mut rig = at_rest();
    let first = rig.abs(100_000, SetPoint::new());
    assert!(rig.finish(first).is_ok());
    rig.run(200);
    rig.drive.disturbances().stale_reached_cycles = 40;
    let second = rig.abs(0, SetPoint::new());
    rig.wait_accepted(second);
    rig.run_until(100, |rig| rig.drive.velocity() < -10_000.0);
    let halt = rig.send(Command::Halt);
    while rig.outcome(halt).is_none() {
        rig.cycle();
    }
    assert_eq!(rig.drive.velocity(), 0.0);
}

/// Bit 8 falls on an axis without a set-point: nothing sets off by it.
#[test]
fn an_axis_that_rests_through_halt_and_resume_is_still_at_rest() {
    let mut rig = at_rest();
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    rig.run(1);
    let stop = rig.send(Command::Stop);
    let state = State::OperationEnabled;
    assert_eq!(rig.outcome(stop), Some(Ok(Completion::Stopped { state })));
    let mode = rig.send(Command::SelectMode(Mode::ProfileVelocity));
    assert_eq!(rig.finish(mode), Ok(Completion::Done));
}

//! A drive that does otherwise than its traits say: the outcome that shows it names the trait.

use servocrab::axis::{Command, CommandId};
use servocrab::profile_position::{BufferSignal, Limits, RelativeBase, Traits};
use servocrab::{BufferMode, Doubt, Failure, SetPoint};
use servocrab_sim::ds402::{AckPolicy, Behaviour, Bit5, RelativeBase as Base, WhileHalted};

use crate::common::Rig;

/// What the drive does, what its traits say, and the move whose outcome shows it.
struct Row {
    named: &'static str,
    does: fn(&mut Behaviour),
    says: fn(&mut Traits),
    doing: fn(&mut Rig) -> CommandId,
    shows: fn(Failure) -> bool,
}

fn is_doubt(failure: Failure, why: Doubt) -> bool {
    matches!(failure, Failure::Unknown { doubt, .. } if doubt == why)
}

/// A move under way to 20 000, and a second one behind it.
fn queued(rig: &mut Rig, next: i32, start: BufferMode) -> CommandId {
    let first = rig.abs(20_000, SetPoint::new());
    rig.wait_accepted(first);
    // Faster than a sample in each window.
    let set_point = SetPoint::new().velocity(500_000);
    rig.abs(next, set_point.buffer_mode(start));
    first
}

/// A drive that replaces the active set-point whatever bits 5 and 9 say.
fn ignoring_start_bits(named: &'static str, doing: fn(&mut Rig) -> CommandId) -> Row {
    Row {
        named,
        does: |drive| drive.bit_5 = Bit5::Ignored,
        says: |traits| traits.buffer_signal = BufferSignal::None,
        doing,
        shows: |failure| is_doubt(failure, Doubt::Unseen),
    }
}

fn halted(rig: &mut Rig) -> CommandId {
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    id
}

#[test]
fn a_drive_that_does_otherwise_than_its_traits_say_is_told_with_the_trait() {
    let rows = [
        ignoring_start_bits("`Traits::after_current`", |rig| {
            queued(rig, -5_000, BufferMode::Buffered)
        }),
        ignoring_start_bits("`Traits::after_current`", |rig| {
            queued(rig, 40_000, BufferMode::Buffered)
        }),
        ignoring_start_bits("`Traits::blend`", |rig| {
            queued(rig, -5_000, BufferMode::Blending)
        }),
        Row {
            named: "`Traits::buffer_signal`",
            does: |_| {},
            says: |traits| traits.buffer_signal = BufferSignal::Acknowledge,
            doing: |rig| queued(rig, 40_000, BufferMode::Buffered),
            shows: |failure| is_doubt(failure, Doubt::Unseen),
        },
        Row {
            named: "`Traits::relative_base`",
            does: |drive| drive.relative_base = Base::Actual,
            says: |traits| traits.relative_base = RelativeBase::PreviousTarget,
            doing: |rig| {
                let first = rig.abs(20_000, SetPoint::new());
                rig.wait_accepted(first);
                rig.run(100);
                rig.rel(5_000, SetPoint::new())
            },
            shows: |failure| matches!(failure, Failure::MissedTarget { target: 25_000, .. }),
        },
        Row {
            named: "`Traits::halt_keeps_set_point`",
            does: |drive| drive.halt_keeps = false,
            says: |_| {},
            doing: |rig| {
                let id = halted(rig);
                rig.send(Command::Resume);
                id
            },
            shows: |failure| is_doubt(failure, Doubt::NotBegun),
        },
        Row {
            named: "`Traits::acknowledges_while_halted`",
            does: |drive| drive.while_halted = WhileHalted::Ignores,
            says: |traits| traits.acknowledges_while_halted = true,
            doing: |rig| {
                halted(rig);
                rig.abs(0, SetPoint::new())
            },
            shows: |failure| is_doubt(failure, Doubt::Unacknowledged),
        },
    ];
    for row in rows {
        let mut behaviour = Behaviour {
            ack: AckPolicy::FollowsBit4,
            ..Behaviour::generic()
        };
        (row.does)(&mut behaviour);
        let mut rig = Rig::new(behaviour, |config| {
            config.limits = Limits::trust_drive();
            config.traits = Traits::cia402();
            (row.says)(&mut config.traits);
        })
        .ideal();
        rig.enable();
        let id = (row.doing)(&mut rig);
        let end = rig.finish(id);
        let what = format!("{}: {end:?}, {:?}", row.named, rig.ledger());
        let failure = end.expect_err(&what);
        assert!((row.shows)(failure), "{what}");
        assert!(failure.to_string().contains(row.named), "{failure}");
        // Whatever it holds, a stop ends it, and the next move is executed.
        let stop = rig.send(Command::Stop);
        assert!(rig.finish(stop).is_ok(), "{}", row.named);
        rig.enable();
        let next = rig.abs(1_000, SetPoint::new());
        rig.assert_reached(next, 1_000);
    }
}

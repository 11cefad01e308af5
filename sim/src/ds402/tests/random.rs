//! Anything a master may write, in any order: what always holds, whatever that is.

use core::time::Duration;

use proptest::prelude::*;

use super::super::{
    AckPolicy, Axis, Behaviour, Bit5, Executed, FullBuffer, HomeOffset, Homing, HomingOutcome,
    LimitSwitches, LimitViolation, Machine, Outcome, Plant, State, VelocityEnd, VelocityPhase,
    WhileMoving,
};

#[derive(Debug, Clone)]
enum Action {
    Word(u16),
    Object(u16, i64),
    Fault(u16),
    Voltage(bool),
    Remote(bool),
    Inhibit(bool),
    Connection(bool),
    Run(u32),
    /// Everything that a master does to get to Operation enabled in a mode, with bit 4 low.
    Enable(i64),
}

/// Mostly words of an axis in operation, so that it gets somewhere; now and then any other.
fn words() -> impl Strategy<Value = u16> {
    let usual = prop::sample::select(vec![0x000F, 0x000F, 0x001F, 0x001F, 0x003F, 0x021F]);
    prop_oneof![
        20 => (usual, any::<u16>()).prop_map(|(word, noise)| word | (noise & noise >> 3 & 0x0370)),
        1 => prop::sample::select(vec![0x0006, 0x0007, 0x000B, 0x001B, 0x0000]),
        1 => any::<u16>(),
    ]
}

fn values() -> impl Strategy<Value = i64> {
    prop_oneof![
        4 => -5000..5000_i64,
        3 => 1..1_000_000_i64,
        1 => prop::sample::select(vec![0, 1, i64::from(i32::MAX), i64::from(i32::MIN), 0xFFFF_FFFF]),
    ]
}

fn actions() -> impl Strategy<Value = Action> {
    let objects = vec![
        0x607A, 0x607A, 0x607A, 0x6081, 0x6082, 0x6083, 0x6084, 0x6085, 0x607F, 0x60C5, 0x60C6,
        0x60F2, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6007, 0x6067, 0x6068, 0x607C, 0x60FF,
        0x60FF, 0x609A, 0x606D, 0x6070, 0x2010, 0x607E, 0x6080,
    ];
    prop_oneof![
        60 => words().prop_map(Action::Word),
        30 => (prop::sample::select(objects), values())
            .prop_map(|(index, value)| Action::Object(index, value)),
        4 => (-4..12_i64).prop_map(|code| Action::Object(0x605A, code)),
        2 => prop::sample::select(vec![0, 1, 1, 1, 3, 3, 6, 6, 8])
            .prop_map(|mode| Action::Object(0x6060, mode)),
        3 => (0..38_i64).prop_map(|method| Action::Object(0x6098, method)),
        1 => any::<u16>().prop_map(Action::Fault),
        1 => any::<bool>().prop_map(Action::Voltage),
        1 => any::<bool>().prop_map(Action::Remote),
        1 => any::<bool>().prop_map(Action::Inhibit),
        1 => any::<bool>().prop_map(Action::Connection),
        6 => prop::sample::select(vec![1, 1, 3, 6]).prop_map(Action::Enable),
        50 => (1..300_u32).prop_map(Action::Run),
    ]
}

fn behaviours() -> impl Strategy<Value = Behaviour> {
    let presets: Vec<fn() -> Behaviour> = vec![
        Behaviour::akd2g,
        Behaviour::generic,
        Behaviour::pp2010,
        Behaviour::ax2000,
        Behaviour::sigma7,
    ];
    let preset = prop::sample::select(presets);
    let ranges = vec![(i32::MIN, i32::MAX), (i32::MIN, i32::MAX), (-3000, 2999)];
    let range = prop::sample::select(ranges);
    let numbers = (0..3_u32, 0..4_usize, range);
    (any::<[bool; 8]>(), numbers, preset).prop_map(|(flag, (cycles, waiting, range), preset)| {
        Behaviour {
            waiting_set_points: waiting,
            position_range: range,
            while_moving: if flag[5] {
                WhileMoving::Queues
            } else {
                WhileMoving::TakenAfterArrival
            },
            limit_switches: if flag[6] {
                LimitSwitches::Shown
            } else {
                LimitSwitches::Stop
            },
            motion_blocks_mode_change: flag[7],
            machine: Machine {
                negative_limit: Some(-4000),
                positive_limit: Some(6000),
                home_switch: Some((100, 300)),
                index_period: 1000,
                ..Machine::default()
            },
            ack: if flag[0] {
                AckPolicy::FollowsBit4
            } else {
                AckPolicy::BufferFree
            },
            bit_5: if flag[1] {
                Bit5::Replaces
            } else {
                Bit5::Blends
            },
            full_buffer: if flag[2] {
                FullBuffer::Ignore
            } else {
                FullBuffer::OverwritePending
            },
            limit_violation: if flag[3] {
                LimitViolation::Clamp
            } else {
                LimitViolation::Refuse
            },
            halt_keeps: flag[4],
            power_on_cycles: cycles,
            ..preset()
        }
    })
}

/// Half of the shafts are where their demand is.
fn plants() -> impl Strategy<Value = Plant> {
    prop_oneof![Just(Plant::ideal()), any::<u64>().prop_map(Plant::seeded)]
}

fn is_open(line: &Executed) -> bool {
    matches!(line.outcome, Outcome::Queued | Outcome::Active)
}

/// The state that a statusword shows, by the masks of DSP 402.
fn shown(statusword: u16) -> State {
    match (statusword & 0x004F, statusword & 0x006F) {
        (0x00, _) => State::NotReadyToSwitchOn,
        (0x40, _) => State::SwitchOnDisabled,
        (0x0F, _) => State::FaultReactionActive,
        (0x08, _) => State::Fault,
        (_, 0x21) => State::ReadyToSwitchOn,
        (_, 0x23) => State::SwitchedOn,
        (_, 0x27) => State::OperationEnabled,
        (_, 0x07) => State::QuickStopActive,
        _ => panic!("{statusword:04X} is no state"),
    }
}

fn is_homing(line: &Homing) -> bool {
    line.outcome == HomingOutcome::Active
}

fn is_driven(line: &VelocityPhase) -> bool {
    line.end == VelocityEnd::Active
}

/// Homing and profile velocity: they run in their mode alone, and only a homing shifts what is reported.
fn check_modes(before: &Axis, after: &Axis) {
    let mode = after.get(0x6061, 0).expect("exists");
    let enabled = after.state() == State::OperationEnabled;
    let homes = after
        .homings()
        .iter()
        .filter(|line| is_homing(line))
        .count();
    assert!(homes <= usize::from(enabled && mode == 6));
    let phases = after.velocity_phases();
    let driven = phases.iter().filter(|line| is_driven(line)).count();
    assert!(driven <= usize::from(enabled && mode == 3));
    assert!(phases.iter().all(|line| line.target != 0));
    let started = after.homings().len() - before.homings().len();
    assert!(started == 0 || before.controlword() & 0x0010 != 0);

    let shift = |axis: &Axis| axis.mechanical_position() - axis.position();
    let attained = |axis: &Axis| {
        let outcomes = axis.homings().iter().map(|line| line.outcome);
        outcomes
            .filter(|outcome| *outcome == HomingOutcome::Attained)
            .count()
    };
    assert!(
        shift(before) == shift(after) || attained(after) > attained(before),
        "shifted without homing"
    );
    if let (true, Some(line)) = (attained(after) > attained(before), after.homings().last()) {
        let home = line.home.expect("attained") - shift(after);
        // The other sign by the drive's reading of 607Ch, and by bit 7 of 607Eh.
        let beyond = after.behaviour.home_offset == HomeOffset::ZeroBeyondHome;
        let turned = after
            .get(0x607E, 0)
            .is_some_and(|polarity| polarity & 0x80 != 0);
        let reads = if beyond == turned { home } else { -home };
        assert_eq!(Some(reads as i32), line.offset, "home reads the offset");
        assert!(after.is_referenced());
    }
}

fn check(before: &Axis, after: &Axis) {
    if after.behaviour.plant.word_cycle.is_zero() {
        assert_eq!(shown(after.statusword()), after.state());
    }
    assert!(after.velocity().is_finite());
    let (old, new) = (before.ledger(), after.ledger());
    assert!(new.len() - old.len() <= 1, "one set-point per edge");
    let most = 1 + after.behaviour.waiting_set_points;
    assert!(new.iter().filter(|line| is_open(line)).count() <= most);
    assert!(
        new.iter()
            .filter(|line| line.outcome == Outcome::Active)
            .count()
            <= 1
    );
    for (old, new) in old.iter().zip(new) {
        assert!(is_open(old) || old == new, "a final outcome changed");
    }
    for line in new {
        if line.outcome == Outcome::Reached || line.outcome == Outcome::Passed {
            assert_eq!(line.end_position, line.target);
        }
    }
    check_modes(before, after);
    let is_pp = |axis: &Axis| axis.get(0x6061, 0) == Some(1);
    let rose = after.behaviour.plant.word_cycle.is_zero()
        && is_pp(before)
        && is_pp(after)
        && after.statusword() & !before.statusword() & 0x1000 != 0;
    assert!(
        !rose || new.len() > old.len(),
        "bit 12 rose without a set-point"
    );
    // The word that the cycle has seen; the drive itself may reset bit 4 (60F2h).
    let edge = before.controlword() & 0x0010 != 0;
    assert!(new.len() == old.len() || edge, "a set-point without bit 4");
    let turns = |axis: &Axis| axis.demand().1 != 0.0;
    if !turns(before)
        && turns(after)
        && after.state() != State::SwitchedOn
        && after.state().is_powered()
    {
        let active = |line: &Executed| line.outcome == Outcome::Active;
        let asked = old.iter().any(active)
            || before.homings().iter().any(is_homing)
            || after.velocity_phases().iter().any(is_driven)
            || before.velocity_phases().iter().any(is_driven);
        assert!(asked, "the axis moves and nobody asked for it");
        assert_eq!(before.state(), State::OperationEnabled);
    }
    let is_rigid = after.behaviour.plant.is_rigid();
    if is_rigid && before.state() != State::OperationEnabled {
        assert!(
            after.velocity().abs() <= before.velocity().abs(),
            "faster without operation"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn whatever_is_written_the_ledger_the_words_and_the_motion_agree(
        behaviour in behaviours(), plant in plants(), actions in prop::collection::vec(actions(), 1..150),
    ) {
        let mut axis = Axis::new(behaviour.with_plant(plant));
        axis.set(0x6098, 0, 23).expect("any method");
        for (subindex, speed) in [(1, 40_000), (2, 5_000)] {
            axis.set(0x6099, subindex, speed).expect("any speed");
        }
        let mut now = Duration::ZERO;
        for action in [Action::Run(3), Action::Enable(1)].into_iter().chain(actions) {
            let mut steps = vec![(axis.controlword(), 1)];
            match action {
                Action::Word(word) => steps = vec![(word, 1)],
                Action::Run(count) => steps = vec![(axis.controlword(), count)],
                Action::Enable(mode) => {
                    axis.set(0x6060, 0, mode).expect("takes any mode");
                    axis.set_voltage(true);
                    axis.set_remote(true);
                    axis.set_inhibited(false);
                    axis.connection_restored();
                    steps = vec![(0x0000, 2), (0x0080, 1), (0x0006, 1), (0x0007, 1), (0x000F, 4)];
                }
                Action::Object(index, value) => {
                    // A value that the object refuses changes nothing.
                    let kept = axis.get(index, 0);
                    if axis.set(index, 0, value).is_err() {
                        prop_assert_eq!(axis.get(index, 0), kept);
                    }
                }
                Action::Fault(code) => axis.inject_fault(code),
                Action::Voltage(on) => axis.set_voltage(on),
                Action::Remote(remote) => axis.set_remote(remote),
                Action::Inhibit(inhibited) => axis.set_inhibited(inhibited),
                Action::Connection(true) => axis.connection_restored(),
                Action::Connection(false) => axis.connection_lost(),
            }
            for (word, cycles) in steps {
                axis.set(0x6040, 0, word.into()).expect("any word");
                for _ in 0..cycles {
                    let before = axis.clone();
                    now += Duration::from_millis(1);
                    axis.cycle(now);
                    check(&before, &axis);
                }
            }
        }
    }
}

//! A simulated axis without a master: objects in, statusword and ledger out, a millisecond for each cycle.
#![allow(dead_code, reason = "each document uses its own part of the bench")]

use core::time::Duration;

use servocrab_sim::ds402::{
    Access, Axis, Behaviour, DataType, Entry, Mapping, Outcome, Plant, State,
};

/// What the profile objects hold unless a test says otherwise.
pub(crate) const VELOCITY: i64 = 10_000;
pub(crate) const ACCELERATION: i64 = 100_000;
pub(crate) const DECELERATION: i64 = 50_000;
pub(crate) const QUICK_STOP_DECELERATION: i64 = 200_000;

pub(crate) struct Drive {
    pub(crate) axis: Axis,
    now: Duration,
}

impl Drive {
    /// Just powered up and in Switch on disabled; nothing has been written.
    pub(crate) fn powered_up(behaviour: Behaviour) -> Self {
        let mut drive = Self {
            axis: Axis::new(behaviour.with_plant(Plant::ideal())),
            now: Duration::ZERO,
        };
        drive.run(5);
        drive
    }

    /// In Switch on disabled, in profile position mode.
    pub(crate) fn new(behaviour: Behaviour) -> Self {
        let mut drive = Self::powered_up(behaviour);
        drive.set(0x6060, 1);
        drive.set(0x6081, VELOCITY);
        drive.set(0x6083, ACCELERATION);
        drive.set(0x6084, DECELERATION);
        drive.set(0x6085, QUICK_STOP_DECELERATION);
        drive.run(10);
        assert_eq!(drive.state(), State::SwitchOnDisabled);
        drive
    }

    pub(crate) fn enabled(behaviour: Behaviour) -> Self {
        let mut drive = Self::new(behaviour);
        drive.enable();
        drive
    }

    pub(crate) fn enable(&mut self) {
        for word in [0x00, 0x06, 0x07, 0x0F] {
            self.word(word);
        }
        assert_eq!(self.state(), State::OperationEnabled);
    }

    pub(crate) fn set(&mut self, index: u16, value: i64) {
        self.axis.set(index, 0, value).expect("the object takes it");
    }

    pub(crate) fn set_sub(&mut self, index: u16, subindex: u8, value: i64) {
        let set = self.axis.set(index, subindex, value);
        set.expect("the object takes it");
    }

    pub(crate) fn get(&self, index: u16) -> i64 {
        self.axis.get(index, 0).expect("the object exists")
    }

    pub(crate) fn run(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.now += Duration::from_millis(1);
            self.axis.cycle(self.now);
        }
    }

    /// A value of 6040h and one cycle; the statusword after it.
    pub(crate) fn word(&mut self, controlword: u16) -> u16 {
        self.set(0x6040, controlword.into());
        self.run(1);
        self.axis.statusword()
    }

    pub(crate) fn state(&self) -> State {
        self.axis.state()
    }

    /// A bit of the statusword.
    pub(crate) fn bit(&self, bit: u16) -> bool {
        self.axis.statusword() & (1 << bit) != 0
    }

    /// A rising edge of bit 4 with the other bits of `base`, whose bit 4 is low.
    pub(crate) fn start(&mut self, base: u16, target: i64) -> u16 {
        self.set(0x607A, target);
        self.word(base);
        self.word(base | 0x10)
    }

    /// Bit 4 low, with the other bits of an enabled axis.
    pub(crate) fn lower(&mut self) {
        self.word(0x0F);
    }

    /// Whether the axis moves within the next cycles.
    pub(crate) fn moves(&mut self) -> bool {
        let before = self.axis.position();
        self.run(20);
        self.axis.position() != before
    }

    /// Runs until nothing moves and no set-point is left; fails after a minute.
    pub(crate) fn settle(&mut self) {
        for _ in 0..60_000 {
            let open = |outcome| matches!(outcome, Outcome::Queued | Outcome::Active);
            if self.axis.velocity() == 0.0 && !self.outcomes().into_iter().any(open) {
                return;
            }
            self.run(1);
        }
        panic!("no rest: {:?}", self.axis.ledger());
    }

    /// Runs until the condition holds; fails after `cycles`.
    pub(crate) fn run_until(&mut self, cycles: u32, mut condition: impl FnMut(&Self) -> bool) {
        for _ in 0..cycles {
            if condition(self) {
                return;
            }
            self.run(1);
        }
        panic!("not within {cycles} cycles: {:?}", self.axis.ledger());
    }

    pub(crate) fn outcomes(&self) -> Vec<Outcome> {
        let lines = self.axis.ledger().iter();
        lines.map(|line| line.outcome).collect()
    }

    /// The fastest and the slowest that the axis is while the condition holds, cycle by cycle, in counts/s.
    pub(crate) fn speeds_while(&mut self, mut condition: impl FnMut(&Self) -> bool) -> (f64, f64) {
        let (mut slowest, mut fastest) = (f64::INFINITY, 0.0_f64);
        while condition(self) {
            let speed = self.axis.velocity().abs();
            slowest = slowest.min(speed);
            fastest = fastest.max(speed);
            self.run(1);
        }
        (slowest, fastest)
    }

    /// Type, access and mapping of an object.
    pub(crate) fn attributes(&self, index: u16, subindex: u8) -> (DataType, Access, Mapping) {
        let entry = self.entry(index, subindex).expect("the object exists");
        (entry.kind, entry.access, entry.mapping)
    }

    pub(crate) fn entry(&self, index: u16, subindex: u8) -> Option<Entry> {
        let mut entries = self.axis.entries().iter();
        entries
            .find(|entry| (entry.index, entry.subindex) == (index, subindex))
            .copied()
    }
}

/// Nearly the same speed: a cycle's ramp is the tolerance.
pub(crate) fn assert_near(speed: f64, expected: f64) {
    assert!((speed - expected).abs() <= 200.0, "{speed}, not {expected}");
}

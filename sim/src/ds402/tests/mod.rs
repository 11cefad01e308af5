//! Tests of the axis model, and the bench on which they run it in virtual time.

mod faults;
mod handshake;
mod hanging;
mod homing;
mod motion;
mod options;
mod personalities;
mod plant;
mod ramps;
mod random;
mod sequence;
mod states;
mod touch_probe;
mod trajectory;
mod velocity;
mod wall;

use core::time::Duration;

use super::{Axis, Behaviour, Executed, Outcome, Plant, State};

/// An axis with its own time; 1 ms per cycle.
#[derive(Clone)]
struct Bench {
    axis: Axis,
    now: Duration,
}

impl Bench {
    /// An axis in Switch on disabled, in profile position mode, with small numbers in the profile objects.
    fn new(behaviour: Behaviour) -> Bench {
        let mut bench = Bench {
            axis: Axis::new(behaviour.with_plant(Plant::ideal())),
            now: Duration::ZERO,
        };
        bench.set(0x6060, 1);
        bench.set(0x6081, 10_000);
        bench.set(0x6083, 100_000);
        bench.set(0x6084, 50_000);
        bench.set(0x6085, 200_000);
        bench.run(10);
        assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
        bench
    }

    fn enabled(behaviour: Behaviour) -> Bench {
        let mut bench = Bench::new(behaviour);
        bench.enable();
        bench
    }

    fn enable(&mut self) {
        for word in [0x0000, 0x0006, 0x0007, 0x000F] {
            self.word(word);
        }
        self.run(2);
        assert_eq!(self.axis.state(), State::OperationEnabled);
    }

    fn set(&mut self, index: u16, value: i64) {
        self.axis
            .set(index, 0, value)
            .expect("object takes the value");
    }

    fn run(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.now += Duration::from_millis(1);
            self.axis.cycle(self.now);
        }
        // A test that waits for what never comes is to end.
        assert!(self.now < Duration::from_secs(2000), "it takes for ever");
    }

    /// Writes the controlword, runs one cycle, and gives the statusword.
    fn word(&mut self, controlword: u16) -> u16 {
        self.set(0x6040, controlword.into());
        self.run(1);
        self.axis.statusword()
    }

    /// One rising edge of bit 4 on `base`, from a low bit 4.
    fn start(&mut self, base: u16, target: i64) -> u16 {
        self.set(0x607A, target);
        self.word(base & !0x0010);
        self.word(base | 0x0010)
    }

    /// Runs until the axis stands with an empty buffer, and gives the cycles that took.
    fn settle(&mut self) -> u32 {
        for cycles in 0..200_000 {
            let open = |line: &Executed| matches!(line.outcome, Outcome::Queued | Outcome::Active);
            if self.axis.velocity() == 0.0 && !self.axis.ledger().iter().any(open) {
                return cycles;
            }
            self.run(1);
        }
        panic!("the axis does not come to rest");
    }

    fn outcomes(&self) -> Vec<Outcome> {
        self.axis.ledger().iter().map(|line| line.outcome).collect()
    }

    fn bit(&self, bit: u16) -> bool {
        self.axis.statusword() & (1 << bit) != 0
    }
}

//! Pitfall 38: the simulated drives themselves. One that never acknowledges, or that follows the target's level, would
//! hide every mistake with bits 4 and 12; and then it would be of no use that all other tests are green.

use core::time::Duration;

use servocrab_sim::ds402::{Axis, Behaviour, Outcome, Plant, State};

/// Each drive that there is, by its name.
fn drives() -> [(&'static str, Behaviour); 5] {
    [
        ("akd2g", Behaviour::akd2g()),
        ("pp2010", Behaviour::pp2010()),
        ("ax2000", Behaviour::ax2000()),
        ("sigma7", Behaviour::sigma7()),
        ("generic", Behaviour::generic()),
    ]
}

struct Drive {
    axis: Axis,
    now: Duration,
}

impl Drive {
    /// In Operation enabled, at 0.
    fn enabled(behaviour: Behaviour) -> Self {
        let mut drive = Self {
            axis: Axis::new(behaviour.with_plant(Plant::ideal())),
            now: Duration::ZERO,
        };
        for (object, value) in [
            (0x6060, 1),
            (0x6081, 10_000),
            (0x6083, 100_000),
            (0x6084, 100_000),
        ] {
            drive.set(object, value);
        }
        for word in [0x00, 0x00, 0x06, 0x07, 0x0F] {
            drive.word(word);
        }
        assert_eq!(drive.axis.state(), State::OperationEnabled);
        drive
    }

    fn set(&mut self, object: u16, value: i64) {
        self.axis.set(object, 0, value).expect("it takes it");
    }

    fn run(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.now += Duration::from_millis(1);
            self.axis.cycle(self.now);
        }
    }

    fn word(&mut self, controlword: u16) {
        self.set(0x6040, controlword.into());
        self.run(1);
    }

    fn acknowledges(&self) -> bool {
        self.axis.statusword() & 1 << 12 != 0
    }
}

#[test]
fn pitfall_38_a_simulated_drive_acknowledges_each_set_point_and_takes_it_back() {
    for (name, behaviour) in drives() {
        let mut drive = Drive::enabled(behaviour);
        for target in [1_000, 2_000, 500] {
            assert!(!drive.acknowledges(), "{name}: before");
            drive.set(0x607A, target);
            drive.word(0x1F);
            assert!(drive.acknowledges(), "{name}: with the edge");
            drive.run(400);
            assert!(drive.acknowledges(), "{name}: as long as bit 4");
            drive.word(0x0F);
            assert!(!drive.acknowledges(), "{name}: bit 4 is low");
            assert_eq!(drive.axis.position(), target, "{name}");
        }
    }
}

#[test]
fn pitfall_38_a_simulated_drive_moves_by_edges_and_not_by_the_targets_level() {
    for (name, behaviour) in drives() {
        let mut drive = Drive::enabled(behaviour);
        drive.set(0x607A, 1_000);
        drive.run(100);
        assert_eq!(drive.axis.position(), 0, "{name}: no bit 4, no move");
        drive.word(0x1F);
        drive.run(400);
        assert_eq!(drive.axis.position(), 1_000, "{name}");
        drive.set(0x607A, 5_000);
        drive.run(400);
        assert_eq!(drive.axis.position(), 1_000, "{name}: still high");
        drive.word(0x0F);
        drive.run(400);
        assert_eq!(drive.axis.position(), 1_000, "{name}: falling");
        let outcomes: Vec<_> = drive
            .axis
            .ledger()
            .iter()
            .map(|line| line.outcome)
            .collect();
        assert_eq!(outcomes, [Outcome::Reached], "{name}");
    }
}

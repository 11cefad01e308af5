//! The plant: where the shaft is beside its demand, and what is measured of it.

use core::time::Duration;

use proptest::prelude::*;

use super::super::{Axis, Behaviour, Outcome, Plant, State};

const MS: Duration = Duration::from_millis(1);
const TURN: i64 = 1 << 20;

/// Nothing random, and a loop whose figures are easy to compute: ω = 100/s.
fn quiet() -> Plant {
    Plant {
        cycle: Duration::ZERO,
        bandwidth_hz: 100.0 / core::f64::consts::TAU,
        damping: 1.0,
        feed_forward: 1.0,
        dither: 0,
        load_step: 0,
        start_delay: Duration::ZERO,
        ..Plant::default()
    }
}

struct Bench {
    axis: Axis,
    now: Duration,
}

impl Bench {
    fn enabled(plant: Plant) -> Bench {
        Self::of(Behaviour::akd2g().with_plant(plant))
    }

    fn of(behaviour: Behaviour) -> Bench {
        let mut bench = Bench {
            axis: Axis::new(behaviour),
            now: Duration::ZERO,
        };
        bench.axis.set(0x6060, 0, 1).unwrap();
        bench.axis.set(0x6081, 0, 100_000).unwrap();
        bench.axis.set(0x6083, 0, 1_000_000).unwrap();
        bench.axis.set(0x6084, 0, 1_000_000).unwrap();
        for word in [0, 0, 0x06, 0x07, 0x0F, 0x0F] {
            bench.word(word);
        }
        assert_eq!(bench.axis.state(), State::OperationEnabled);
        bench
    }

    fn cycle(&mut self) {
        self.now += MS;
        self.axis.cycle(self.now);
    }

    fn word(&mut self, controlword: i64) {
        self.axis.set(0x6040, 0, controlword).unwrap();
        self.cycle();
    }

    fn start(&mut self, target: i64) {
        self.axis.set(0x607A, 0, target).unwrap();
        self.word(0x0F);
        self.word(0x1F);
    }

    fn get(&self, index: u16) -> i64 {
        self.axis.get(index, 0).unwrap()
    }

    fn bit_10(&self) -> bool {
        self.axis.statusword() & 0x0400 != 0
    }
}

#[test]
fn the_shaft_runs_past_its_end_by_what_the_ramp_makes_and_settles() {
    let mut bench = Bench::enabled(quiet());
    bench.start(20_000);
    let mut furthest = 0;
    for _ in 0..500 {
        bench.cycle();
        furthest = furthest.max(bench.axis.position());
    }
    // a/ω² = 1 000 000 / 100² = 100 counts ahead at the end of the ramp; a critically damped loop only comes back.
    assert!((95..=101).contains(&(furthest - 20_000)), "{furthest}");
    assert_eq!(bench.axis.position(), 20_000);
    assert_eq!(bench.axis.velocity(), 0.0, "it comes to rest");
    let line = &bench.axis.ledger()[0];
    assert_eq!(
        (line.outcome, line.end_position),
        (Outcome::Reached, Some(20_000))
    );
    let ahead = line.shaft_position.unwrap() - 20_000;
    assert!((90..=101).contains(&ahead), "{line:?}");
}

#[test]
fn at_a_constant_velocity_the_following_error_is_what_is_not_fed_forward() {
    let mut bench = Bench::enabled(Plant {
        feed_forward: 0.75,
        ..quiet()
    });
    bench.start(60_000);
    for _ in 0..300 {
        bench.cycle();
    }
    assert_eq!(bench.axis.demand().1, 100_000.0);
    // 2ζ(1 − f)v/ω = 2 · 0.25 · 100 000 / 100.
    assert_eq!(bench.get(0x60F4), 500);
    assert_eq!(bench.axis.demand().0 - bench.axis.position(), 500);
    assert!((bench.axis.velocity() - 100_000.0).abs() < 1.0);
}

#[test]
fn torque_accelerates_and_brakes_and_overcomes_friction() {
    let mut bench = Bench::enabled(Plant {
        rated_acceleration: 10_000_000,
        friction: 20,
        ..quiet()
    });
    let mut seen = Vec::new();
    bench.start(20_000);
    for _ in 0..500 {
        bench.cycle();
        seen.push(bench.get(0x6077));
    }
    // Up with a tenth of the rated torque for 100 ms, on for 100 ms, down for 100 ms.
    assert_eq!(
        [seen[90], seen[180], seen[280], seen[490]],
        [120, 20, -80, 0]
    );
}

#[test]
fn at_rest_the_encoder_dithers_and_606c_is_seldom_zero() {
    let mut bench = Bench::enabled(Plant {
        load_step: 0,
        ..Plant::default()
    });
    let (mut positions, mut zeros) = (Vec::new(), 0);
    for _ in 0..1000 {
        bench.cycle();
        positions.push(bench.get(0x6064));
        let velocity = bench.get(0x606C);
        assert_eq!(velocity % 10, 0, "in steps of velocity_step");
        zeros += i32::from(velocity == 0);
    }
    for count in -1..=1 {
        assert!(positions.contains(&count));
    }
    assert!(positions.iter().all(|at| (-1..=1).contains(at)));
    assert!(zeros < 200, "{zeros} of 1000");
    assert_eq!(bench.axis.velocity(), 0.0, "the shaft itself stands");
    assert!(!bench.axis.moved_since(Duration::ZERO));
}

#[test]
fn load_steps_push_the_shaft_and_the_loop_takes_them_up() {
    let mut bench = Bench::enabled(Plant {
        load_step: 8,
        load_every: 100 * MS,
        ..Plant::default()
    });
    let (mut furthest, mut at_home) = (0, 0);
    for _ in 0..5_000 {
        bench.cycle();
        let off = bench.axis.position().abs();
        furthest = furthest.max(off);
        at_home += i32::from(off == 0);
    }
    assert!((2..=8).contains(&furthest), "{furthest}");
    assert!(at_home > 1_000, "{at_home}");
    assert!(
        !bench.axis.moved_since(Duration::ZERO),
        "that is no motion of the axis"
    );
}

#[test]
fn bit_10_comes_while_the_axis_swings_through_its_window_and_falls_again() {
    let mut bench = Bench::enabled(Plant {
        damping: 0.3,
        ..quiet()
    });
    bench.start(20_000);
    let (mut edges, mut last) = (Vec::new(), bench.bit_10());
    for _ in 0..800 {
        bench.cycle();
        if bench.bit_10() != last {
            last = !last;
            edges.push((last, bench.axis.velocity().abs() > 100.0));
        }
    }
    assert!(edges.len() >= 3, "{edges:?}");
    assert_eq!(edges[0], (true, true), "it comes in motion");
    assert!(!edges[1].0, "and falls again");
    assert!(last, "and comes to stay");
}

#[test]
fn a_servo_cycle_of_its_own_leaves_the_position_older_than_the_word() {
    let mut bench = Bench::enabled(Plant {
        cycle: 4 * MS,
        ..quiet()
    });
    bench.start(40_000);
    let mut positions = Vec::new();
    for _ in 0..200 {
        bench.cycle();
        positions.push(bench.get(0x6064));
    }
    for four in positions[100..].windows(5) {
        let news = four.windows(2).filter(|two| two[0] != two[1]).count();
        assert_eq!(news, 1, "a new position in each fourth cycle");
    }
    // With the seed lies also where the servo's cycles are: up to one of them behind.
    let behind = |seed: u64| {
        let mut bench = Bench::enabled(Plant {
            cycle: MS,
            seed,
            ..quiet()
        });
        bench.start(40_000);
        for _ in 0..200 {
            bench.cycle();
        }
        bench.axis.demand().0 - bench.axis.position()
    };
    // 100 counts a cycle.
    let all: Vec<i64> = (0..20).map(behind).collect();
    assert!(
        all.iter().all(|behind| (-1..=101).contains(behind)),
        "{all:?}"
    );
    assert!(all.iter().max() > all.iter().min(), "{all:?}");
}

#[test]
fn the_statusword_can_be_older_than_the_mode_and_the_position() {
    let mut bench = Bench::enabled(Plant {
        word_cycle: 5 * MS,
        ..quiet()
    });
    let mut late = 0;
    for target in 1..20 {
        bench.start(target * 10);
        let mut cycles = 0;
        while bench.axis.statusword() & 0x1000 == 0 {
            bench.cycle();
            cycles += 1;
            assert!(cycles < 10, "bit 12 comes");
        }
        late = late.max(cycles);
        while bench.axis.statusword() & 0x1000 != 0 {
            bench.word(0x0F);
        }
        for _ in 0..40 + target % 5 {
            bench.cycle();
        }
    }
    assert_eq!(late, 4);
}

#[test]
fn an_axis_sets_off_after_its_start_delay_and_bit_10_is_low_meanwhile() {
    let mut bench = Bench::enabled(Plant {
        start_delay: 150 * MS,
        ..quiet()
    });
    bench.start(20_000);
    let taken = bench.now;
    assert_eq!(bench.axis.ledger()[0].outcome, Outcome::Queued);
    for _ in 0..149 {
        bench.cycle();
        assert!(!bench.bit_10());
    }
    assert!(!bench.axis.moved_since(taken));
    bench.cycle();
    assert_eq!(bench.axis.ledger()[0].started_at, Some(taken + 150 * MS));
    // One that follows in motion does not wait.
    bench.axis.set(0x607A, 0, 40_000).unwrap();
    for _ in 0..50 {
        bench.cycle();
    }
    bench.word(0x0F);
    bench.word(0x3F);
    assert_eq!(bench.axis.ledger()[1].started_at, Some(bench.now));
}

#[test]
fn without_power_the_shaft_coasts_from_where_it_is() {
    let mut bench = Bench::enabled(Plant {
        feed_forward: 0.75,
        ..quiet()
    });
    bench.start(60_000);
    for _ in 0..300 {
        bench.cycle();
    }
    assert_eq!(bench.get(0x60F4), 500);
    let before = bench.axis.position();
    bench.word(0x00);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
    assert!(
        bench.axis.position() - before <= 100,
        "no jump to the demand"
    );
    bench.cycle();
    assert_eq!(bench.get(0x60F4), 0);
    let speed = bench.axis.velocity();
    assert!(speed > 95_000.0 && speed < 100_000.0, "{speed}");
    for _ in 0..200 {
        bench.cycle();
    }
    assert!(bench.axis.stands());
}

#[test]
fn the_axis_stands_when_its_shaft_does() {
    let mut bench = Bench::enabled(Plant {
        standstill_velocity: 100,
        ..quiet()
    });
    bench.start(20_000);
    bench.cycle();
    while bench.axis.demand().1 != 0.0 || bench.axis.ledger()[0].ended_at.is_none() {
        assert_eq!(bench.axis.stands_since(), None);
        bench.cycle();
    }
    let ended = bench.axis.ledger()[0].ended_at.unwrap();
    for _ in 0..500 {
        bench.cycle();
    }
    let stood = bench.axis.stands_since().unwrap();
    assert!(
        stood > ended + 20 * MS && stood < ended + 150 * MS,
        "{stood:?}"
    );
}

/// What a move shows of a plant, cycle by cycle.
fn shown(plant: Plant) -> Vec<[i64; 4]> {
    let mut bench = Bench::enabled(plant);
    bench.start(TURN / 16);
    let mut shown = Vec::new();
    for _ in 0..1_500 {
        bench.cycle();
        shown.push([0x6041, 0x6064, 0x606C, 0x6077].map(|index| bench.get(index)));
    }
    shown
}

#[test]
fn the_same_seed_gives_the_same_counts_and_another_one_others() {
    for seed in 0..20 {
        assert_eq!(shown(Plant::seeded(seed)), shown(Plant::seeded(seed)));
        assert_ne!(shown(Plant::seeded(seed)), shown(Plant::seeded(seed + 1)));
    }
}

#[test]
fn every_seeded_plant_gets_every_drive_to_its_target() {
    let drives: [fn() -> Behaviour; 5] = [
        Behaviour::generic,
        Behaviour::akd2g,
        Behaviour::pp2010,
        Behaviour::ax2000,
        Behaviour::sigma7,
    ];
    for seed in 0..200 {
        let plant = Plant::seeded(seed);
        let behaviour = drives[seed as usize % drives.len()]();
        let mut bench = Bench::of(behaviour.with_plant(plant));
        bench.start(30_000);
        for _ in 0..1_200 {
            bench.cycle();
        }
        let off = (bench.axis.position() - 30_000).abs();
        assert!(off <= i64::from(plant.load_step), "{seed}: {off}");
        assert!(bench.axis.stands(), "{seed}");
        assert_eq!(bench.axis.ledger()[0].outcome, Outcome::Reached);
        let most = plant.load_step + plant.dither;
        let reached = bench.bit_10() || most > 10;
        assert!(reached, "{seed}: {:04X}", bench.axis.statusword());
    }
}

fn any_float() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        prop::sample::select(vec![0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e300]),
        0.0..100.0,
    ]
}

proptest! {
    #[test]
    fn no_setting_breaks_the_plant(
        (bandwidth_hz, damping, feed_forward) in (any_float(), any_float(), any_float()),
        times in prop::array::uniform6(prop_oneof![any::<u64>(), 0..10_000_000_u64]),
        numbers in prop::array::uniform5(any::<u32>()),
        target in any::<i32>(),
    ) {
        let [cycle, word_cycle, load_every, load_recovery, velocity_filter, start_delay] =
            times.map(Duration::from_nanos);
        let plant = Plant {
            seed: times[0],
            cycle,
            word_cycle,
            bandwidth_hz,
            damping,
            feed_forward,
            dither: numbers[0],
            load_step: numbers[1],
            load_every,
            load_recovery,
            velocity_filter,
            velocity_step: numbers[2],
            rated_acceleration: numbers[3],
            friction: numbers[4] as u16,
            start_delay,
            standstill_velocity: numbers[4],
        };
        let mut axis = Axis::new(Behaviour::generic().with_plant(plant));
        axis.set(0x6060, 0, 1).unwrap();
        axis.set(0x607A, 0, target.into()).unwrap();
        axis.set(0x6065, 0, 0xFFFF_FFFF).unwrap();
        let mut now = Duration::ZERO;
        for word in [0, 0x06, 0x07, 0x0F, 0x1F, 0x11F, 0x0B, 0x00] {
            axis.set(0x6040, 0, word).unwrap();
            for _ in 0..40 {
                now += MS;
                axis.cycle(now);
                prop_assert!(axis.velocity().is_finite());
            }
        }
    }
}

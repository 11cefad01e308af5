//! Touch probes: which edges are held, where, and what 60B9h says.

use core::time::Duration;

use super::super::{Behaviour, Machine, Mark};
use super::Bench;

const FUNCTION: u16 = 0x60B8;
const STATUS: u16 = 0x60B9;

fn on(probes: [Option<Mark>; 2]) -> Bench {
    let machine = Machine {
        probes,
        ..Machine::default()
    };
    Bench::enabled(Behaviour {
        machine,
        ..Behaviour::generic()
    })
}

impl Bench {
    fn is(&self, index: u16) -> i64 {
        self.axis.get(index, 0).expect("it is there")
    }

    /// Moves, without waiting for the end.
    fn starts_to(&mut self, target: i64) {
        self.set(0x607A, target);
        self.word(0x000F);
        self.word(0x003F);
    }
}

#[test]
fn an_edge_of_a_mark_is_held_to_the_count_in_both_directions() {
    let mut bench = on([Some(Mark::new(1_005, 2_000)), None]);
    bench.set(FUNCTION, 0x0031);
    bench.run(1);
    assert_eq!(bench.is(STATUS), 0x0001);
    bench.starts_to(3_000);
    bench.run(1_000);
    assert_eq!(bench.is(STATUS), 0x0007);
    // Active from 1005 on; inactive again at the first count behind.
    assert_eq!((bench.is(0x60BA), bench.is(0x60BB)), (1_005, 2_001));
    assert_eq!((bench.is(0x60D5), bench.is(0x60D6)), (1, 1));
    bench.set(FUNCTION, 0);
    bench.run(1);
    assert_eq!((bench.is(STATUS), bench.is(0x60BA)), (0, 1_005));
    bench.set(FUNCTION, 0x0031);
    bench.starts_to(0);
    bench.run(1_000);
    assert_eq!((bench.is(0x60BA), bench.is(0x60BB)), (2_000, 1_004));
}

#[test]
fn an_edge_between_two_cycles_is_held_where_the_shaft_was_then() {
    let mut bench = on([None, None]);
    bench.set(FUNCTION, 0x1100);
    bench.starts_to(10_000);
    bench.run(300);
    let (before, at) = (
        bench.axis.position(),
        bench.now + Duration::from_micros(250),
    );
    bench.axis.set_probe_input(2, true, at);
    bench.run(1);
    let way = bench.axis.position() - before;
    assert_eq!(way, 10, "counts in a cycle");
    assert_eq!(bench.is(STATUS), 0x0300);
    assert!((2..=3).contains(&(bench.is(0x60BC) - before)));
    assert_eq!(bench.is(0x60D3), at.as_nanos() as i64);
}

#[test]
fn of_an_input_that_bounces_the_first_edge_is_held_or_the_last_as_bit_1_says() {
    for (function, held, counted) in [(0x0011, 2, 1), (0x0013, 8, 3)] {
        let mut bench = on([None, None]);
        bench.set(FUNCTION, function);
        bench.starts_to(10_000);
        bench.run(300);
        let before = bench.axis.position();
        // Ten counts a cycle.
        let levels = [true, false, true, false, true];
        for (micros, active) in [200, 400, 500, 700, 800].into_iter().zip(levels) {
            let at = bench.now + Duration::from_micros(micros);
            bench.axis.set_probe_input(1, active, at);
        }
        bench.run(10);
        assert_eq!(bench.is(0x60BA) - before, held, "{function:04X}h");
        assert_eq!(bench.is(0x60D5), counted, "{function:04X}h");
    }
}

#[test]
fn a_probe_that_is_off_or_looks_at_another_edge_or_source_holds_nothing() {
    for function in [0x0000, 0x0010, 0x0021, 0x0015, 0x1100] {
        let mut bench = on([Some(Mark::new(1_000, i64::MAX)), None]);
        bench.set(FUNCTION, function);
        bench.starts_to(2_000);
        bench.run(1_000);
        assert_eq!(bench.is(STATUS) & 0x0606, 0, "{function:04X}h");
        assert_eq!(bench.is(0x60BA), 0, "{function:04X}h");
    }
}

#[test]
fn an_input_that_is_active_when_its_probe_is_enabled_has_had_its_edge() {
    let mut bench = on([Some(Mark::new(-5, 5)), None]);
    bench.set(FUNCTION, 0x0011);
    bench.run(5);
    assert_eq!(bench.is(STATUS), 0x0001);
}

#[test]
fn the_position_of_an_edge_lies_in_the_turn() {
    let mut bench = on([Some(Mark::new(100, 149).every(3_600)), None]);
    bench.axis.set(0x607B, 1, 0).unwrap();
    bench.axis.set(0x607B, 2, 3_599).unwrap();
    bench.set(FUNCTION, 0x0033);
    bench.run(1);
    bench.set(0x607A, 2 * 3_600 + 1_000);
    bench.word(0x000F);
    // Relative: two turns and a bit.
    bench.word(0x007F);
    bench.run(3_000);
    assert_eq!((bench.is(0x60BA), bench.is(0x60BB)), (100, 150));
    assert_eq!((bench.is(0x60D5), bench.is(0x60D6)), (3, 3));
}

//! The AKD2G's example sequence, options 1 to 4, word by word, with the reactions that its page names.

use super::super::{Behaviour, Cause, Outcome, State};
use super::Bench;

/// One option of the example: what is set before the move, and the words start, halt and quick stop.
struct Option {
    base: u16,
    start: u16,
    halt: u16,
    quick_stop: u16,
    relative: bool,
    immediately: bool,
}

const OPTIONS: [Option; 4] = [
    Option {
        base: 0x0F,
        start: 0x1F,
        halt: 0x11F,
        quick_stop: 0x1B,
        relative: false,
        immediately: false,
    },
    Option {
        base: 0x4F,
        start: 0x5F,
        halt: 0x15F,
        quick_stop: 0x5B,
        relative: true,
        immediately: false,
    },
    Option {
        base: 0x2F,
        start: 0x3F,
        halt: 0x13F,
        quick_stop: 0x3B,
        relative: false,
        immediately: true,
    },
    Option {
        base: 0x6F,
        start: 0x7F,
        halt: 0x17F,
        quick_stop: 0x7B,
        relative: true,
        immediately: true,
    },
];

/// Mode, parameters, 06h, 0Fh, and the option's own word before the move. The axis stands at 1000.
fn prepared(option: &Option) -> Bench {
    let mut bench = Bench::new(Behaviour::akd2g());
    bench.axis.place(1000);
    bench.set(0x607A, 5000);
    assert_eq!(bench.word(0x06) & 0x6F, 0x21);
    bench.word(0x0F);
    assert_eq!(bench.word(0x0F) & 0x6F, 0x27);
    bench.word(option.base);
    let before = bench.now;
    bench.run(50);
    assert!(
        !bench.axis.moved_since(before),
        "nothing moves before bit 4 rises"
    );
    assert!(!bench.bit(12));
    bench
}

fn target(option: &Option) -> i64 {
    if option.relative { 6000 } else { 5000 }
}

#[test]
fn start_raises_the_acknowledge_and_arrives() {
    for option in &OPTIONS {
        let mut bench = prepared(option);
        bench.word(option.start);
        assert!(bench.bit(12), "acknowledged in the cycle of the edge");
        assert!(!bench.bit(10));
        bench.settle();
        assert_eq!(bench.axis.position(), target(option));
        assert!(bench.bit(10));
        assert!(
            bench.bit(12),
            "stays high after the move as long as bit 4 is high"
        );
        bench.word(option.base);
        assert!(!bench.bit(12), "turns off with bit 4");
        let [line] = bench.axis.ledger() else {
            panic!("one set-point")
        };
        assert_eq!(line.outcome, Outcome::Reached);
        assert_eq!(
            (line.relative, line.bit_5),
            (option.relative, option.immediately)
        );
        assert_eq!(
            (line.start_position, line.target),
            (Some(1000), Some(target(option)))
        );
    }
}

#[test]
fn bit_4_can_fall_during_the_move() {
    for option in &OPTIONS {
        let mut bench = prepared(option);
        bench.word(option.start);
        bench.run(20);
        bench.word(option.base);
        assert!(!bench.bit(12));
        bench.settle();
        assert_eq!(bench.axis.position(), target(option));
    }
}

#[test]
fn halt_slows_down_by_6084h_and_remembers() {
    for option in &OPTIONS {
        for resume in [option.start, option.base] {
            let mut bench = prepared(option);
            bench.word(option.start);
            bench.run(200);
            let speed = bench.axis.velocity();
            assert_eq!(speed, 10_000.0);
            bench.word(option.halt);
            let mut cycles = 0;
            while bench.axis.velocity() > 0.0 {
                assert!(!bench.bit(10), "bit 10 is 0 while the axis decelerates");
                bench.run(1);
                cycles += 1;
            }
            assert_eq!(cycles, 200, "10000 counts/s at 50000 counts/s²");
            assert!(bench.bit(10), "bit 10 with velocity 0");
            assert_eq!(bench.axis.state(), State::OperationEnabled);
            let paused = bench.now;
            bench.run(100);
            assert!(!bench.axis.moved_since(paused));
            assert_eq!(bench.outcomes(), [Outcome::Active]);

            bench.word(resume);
            bench.run(5);
            assert!(
                bench.axis.moved_since(paused),
                "continues regardless of bit 4"
            );
            assert!(!bench.bit(10));
            bench.settle();
            assert_eq!(bench.axis.position(), target(option));
            assert_eq!(bench.outcomes(), [Outcome::Reached]);
        }
    }
}

#[test]
fn quick_stop_forgets_and_enabling_with_bit_4_high_moves_nothing() {
    for option in &OPTIONS {
        let mut bench = prepared(option);
        bench.word(option.start);
        bench.run(200);
        bench.word(option.quick_stop);
        assert_eq!(bench.axis.statusword() & 0x6F, 0x07);
        assert_eq!(bench.outcomes(), [Outcome::Discarded(Cause::QuickStop)]);
        let mut cycles = 0;
        while bench.axis.state() == State::QuickStopActive {
            bench.run(1);
            cycles += 1;
        }
        assert_eq!(cycles, 50, "10000 counts/s at 200000 counts/s² of 6085h");
        assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
        assert_eq!(bench.axis.velocity(), 0.0);

        let stopped = bench.now;
        bench.word(option.start);
        assert_eq!(
            bench.axis.state(),
            State::SwitchOnDisabled,
            "has to step through the states"
        );
        for word in [0x16, 0x1F, 0x1F, 0x1F] {
            bench.word(word);
        }
        assert_eq!(bench.axis.state(), State::OperationEnabled);
        bench.run(100);
        assert!(!bench.axis.moved_since(stopped));
        assert_eq!(bench.axis.ledger().len(), 1);

        bench.word(option.base);
        bench.word(option.start);
        assert_eq!(bench.axis.ledger().len(), 2);
        bench.settle();
        assert!(bench.axis.moved_since(stopped));
    }
}

#[test]
fn parameters_are_those_of_the_edge() {
    for option in &OPTIONS {
        let mut bench = prepared(option);
        bench.word(option.start);
        for (index, value) in [(0x607A, -9), (0x6081, 1), (0x6083, 1), (0x6084, 1)] {
            bench.set(index, value);
        }
        bench.settle();
        assert_eq!(bench.axis.position(), target(option));
        let line = &bench.axis.ledger()[0];
        assert_eq!((line.value, line.velocity), (5000, 10_000));
        assert_eq!((line.acceleration, line.deceleration), (100_000, 50_000));
    }
}

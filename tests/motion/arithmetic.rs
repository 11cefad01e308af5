//! The arithmetic of positions, turns and times: every case at 8 bits, the boundaries at 32 bits and at the ends of time.

// The very code of the axis core, at another width.
#[path = "../../src/profile_position/circle.rs"]
mod circle;

use core::time::Duration;

use circle::{Circle, Turn};
use servocrab::ds402::Mode;
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{MoveCommand, PositionRange, Reference},
};
use servocrab::{
    Referencing,
    axis::{
        AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Deadlines, Event, Inputs,
        Tolerances,
    },
};

type Small = Circle<8>;

const LEAST: i64 = i8::MIN as i64;
const MOST: i64 = i8::MAX as i64;

/// Where one comes to who counts: one position after the other, and from the last of a turn to the first.
fn count(turn: Option<Turn>, from: i64, steps: i64) -> i64 {
    let (min, max) = match turn {
        Some(turn) if turn.min < turn.max => (turn.min, turn.max),
        _ => (LEAST, MOST),
    };
    let mut at = from;
    for _ in 0..steps.abs() {
        at = match steps > 0 {
            true if at == max => min,
            true => at + 1,
            false if at == min => max,
            false => at - 1,
        };
    }
    at
}

#[test]
fn on_the_circle_of_8_bits_each_way_leads_to_its_end_and_no_shorter_one_does() {
    for from in LEAST..=MOST {
        for to in LEAST..=MOST {
            let way = Small::way(None, from, to);
            assert_eq!(count(None, from, way), to, "{from} to {to}");
            assert_eq!(way, i64::from((to as i8).wrapping_sub(from as i8)));
            assert_eq!(Small::after(None, from, way), to);
            assert!((LEAST..=MOST).contains(&way));
        }
    }
}

#[test]
fn in_each_turn_of_8_bits_each_way_is_the_shorter_one_and_leads_to_its_end() {
    let mut cases = 0_u64;
    for min in LEAST..=MOST {
        for max in min + 1..=MOST {
            let turn = Turn { min, max };
            let length = max - min + 1;
            let around = Some(turn);
            for from in min..=max {
                for to in min..=max {
                    let way = Small::way(around, from, to);
                    // Either `to - from` or that with a turn more or less: there is no other way, and none is shorter than half.
                    let off = from + way - to;
                    let half = 2 * way.abs() <= length;
                    let lands = off == 0 || off == length || off == -length;
                    assert!(half && lands, "{from} to {to} in {turn:?}: {way}");
                    cases += 1;
                }
            }
        }
    }
    println!("{cases} cases");
}

/// Distances of more than a turn, one way and the other, from its ends and its middle.
#[test]
fn each_turn_of_8_bits_is_gone_around_as_often_as_a_distance_says() {
    for min in LEAST..=MOST {
        for max in min + 1..=MOST {
            let around = Some(Turn { min, max });
            for from in [min, i64::midpoint(min, max), max] {
                for step in [1, -1] {
                    let mut expected = from;
                    for steps in 1..=300 {
                        expected = count(around, expected, step);
                        let distance = steps * step;
                        let at = Small::after(around, from, distance);
                        assert_eq!(at, expected, "{from} by {distance} in {min}..={max}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_turn_of_8_bits_has_as_many_positions_as_can_be_counted() {
    for min in LEAST..=MOST {
        for max in LEAST..=MOST {
            let counted = (min..=max).count() as i64;
            // One position is no turn, and all of them are the circle.
            let expected = (counted > 1 && counted < 256).then_some(counted);
            assert_eq!(Small::length(Turn { min, max }), expected, "{min}..={max}");
        }
    }
}

/// The numbers at which something may go over.
fn boundaries() -> Vec<i64> {
    let ends = [
        i64::from(i32::MIN),
        -(1 << 30),
        -65_536,
        -3_600,
        0,
        3_600,
        65_535,
        1 << 30,
        i64::from(i32::MAX),
    ];
    let mut all: Vec<i64> = ends
        .iter()
        .flat_map(|end| (-2..=2).map(move |off| end + off))
        .filter(|number| i32::try_from(*number).is_ok())
        .collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// What programs may call with any number.
#[test]
fn a_range_wraps_every_number() {
    let mut numbers = boundaries();
    numbers.extend([i64::MIN, i64::MIN + 1, i64::MAX - 1, i64::MAX]);
    for &min in &numbers {
        for &max in &numbers {
            let (Ok(min), Ok(max)) = (i32::try_from(min), i32::try_from(max)) else {
                continue;
            };
            let range = PositionRange { min, max };
            for &position in &numbers {
                let wrapped = range.wrap(position);
                if let Some(length) = range.length() {
                    assert!((min..=max).contains(&wrapped), "{position} in {range:?}");
                    let off = i128::from(wrapped) - i128::from(position);
                    assert_eq!(off.rem_euclid(length.into()), 0, "{position} in {range:?}");
                }
            }
        }
    }
}

/// Which of an axis' times are as long, or as short, as they can be; the others are usual ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Extreme {
    All,
    Deadlines,
    Settle,
    DriveCycle,
    Acknowledge,
    Begin,
}

/// Nothing that a program sets, no time and no position makes the core fail.
#[test]
fn no_time_and_no_setting_is_too_long_for_the_core() {
    let times = [
        Duration::ZERO,
        Duration::from_nanos(1),
        Duration::from_secs(1),
        Duration::from_secs(u64::MAX / 2),
        Duration::MAX - Duration::from_secs(20),
        Duration::MAX - Duration::from_nanos(1),
        Duration::MAX,
    ];
    let turns = [
        None,
        Some(PositionRange { min: 0, max: 3_599 }),
        Some(PositionRange {
            min: i32::MIN,
            max: i32::MAX,
        }),
        Some(PositionRange { min: 5, max: 5 }),
    ];
    use Extreme::{Acknowledge, All, Begin, Deadlines, DriveCycle, Settle};
    let (mut accepted, mut arrived) = (0, 0);
    for extreme in [All, Deadlines, Settle, DriveCycle, Acknowledge, Begin] {
        for &span in &times {
            for &start in &times {
                for window in [0, 10, u32::MAX] {
                    for modulo in turns {
                        let case =
                            format!("{extreme:?}, {window}, {modulo:?}, {start:?}, {span:?}");
                        let lived =
                            std::panic::catch_unwind(|| live(extreme, start, span, window, modulo));
                        let events = lived.expect(&case);
                        accepted += events.iter().filter(|e| **e == Event::Accepted).count();
                        let has_arrived = |event: &Event| {
                            use Completion::{Passed, Reached};
                            matches!(event, Event::Done(Ok(Reached { .. } | Passed { .. })))
                        };
                        arrived += events.iter().filter(|e| has_arrived(e)).count();
                    }
                }
            }
        }
    }
    assert!(accepted > 0 && arrived > 0, "{accepted}, {arrived}");
}

/// What a drive shows that does at once what the controlword says: bit 12 follows bit 4.
const fn answer(word: u16, reached: bool) -> u16 {
    let state = if word & 0x8F == 0x0F {
        0x0237
    } else if word & 0x8F == 0x07 {
        0x0233
    } else if word & 0x87 == 0x06 {
        0x0231
    } else {
        0x0250
    };
    state | (word & 0x10) << 8 | (reached as u16) << 10
}

/// What a drive shows that answers nothing.
const WORDS: [u16; 9] = [
    0x250, 0x231, 0x233, 0x237, 0x637, 0x1237, 0x217, 0x21F, 0x218,
];

/// Where the axis shows itself, from one end of the numbers to the other; in some places for longer.
const POSITIONS: [i32; 8] = [0, 0, i32::MAX, i32::MIN, i32::MIN, -1, -1, 3_600];

fn settings(
    extreme: Extreme,
    span: Duration,
    window: u32,
    modulo: Option<PositionRange>,
) -> CoreConfig {
    let mut config = CoreConfig::new(AxisFields::at(0, 0));
    config.referencing = Referencing::UnreferencedMovesAllowed;
    config.modulo = modulo;
    let is = |this: &[Extreme]| extreme == Extreme::All || this.contains(&extreme);
    let or = |this, usual| if is(&[this]) { span } else { usual };
    config.traits.drive_cycle = or(Extreme::DriveCycle, Duration::from_millis(1));
    config.tolerances = Tolerances {
        position: window,
        settle: or(Extreme::Settle, Duration::from_millis(5)),
    };
    if is(&[Extreme::Deadlines]) {
        config.deadlines = Deadlines {
            enable: span,
            disable: span,
            acknowledge: span,
            begin: span,
            standstill: span,
            mode: span,
            fault_reset: span,
        };
    }
    let deadlines = &mut config.deadlines;
    deadlines.acknowledge = or(Extreme::Acknowledge, deadlines.acknowledge);
    deadlines.begin = or(Extreme::Begin, deadlines.begin);
    config
}

fn live(
    extreme: Extreme,
    start: Duration,
    span: Duration,
    window: u32,
    modulo: Option<PositionRange>,
) -> Vec<Event> {
    let mut core = AxisCore::new(settings(extreme, span, window, modulo));
    core.note_mode(Mode::ProfilePosition);
    let mut outputs = [0; 6];
    let mut now = start;
    let mut id = 0;
    let mut lived = Vec::new();
    let mut had = 0;
    for round in 0..8_usize {
        // The drive does what it is told, or shows anything. Time goes on slowly, or as far as there is any.
        let sound = round % 4 < 2;
        let far = if round % 2 == 0 {
            Duration::ZERO
        } else {
            span / 3
        };
        let pause = far.saturating_add(Duration::from_millis(1));
        for place in 0..WORDS.len() {
            let a_move = |target, buffer_mode| {
                Command::Move(MoveCommand {
                    reference: if round % 3 == 2 {
                        Reference::Relative
                    } else {
                        Reference::Absolute
                    },
                    target,
                    set_point: SetPoint::new().buffer_mode(buffer_mode),
                    gated: false,
                })
            };
            let turned = if sound { place } else { place + 4 * round };
            let command = match turned % WORDS.len() {
                0 => Command::Enable,
                1 => a_move(i32::MAX, BufferMode::Aborting),
                2 => a_move(i32::MIN, BufferMode::Buffered),
                3 => a_move(3_599, BufferMode::Blending),
                4 => Command::Halt,
                5 => Command::Resume,
                6 => [Command::Stop, Command::QuickStop][round % 2],
                7 => Command::Disable,
                _ => Command::ResetFault,
            };
            id += 1;
            core.submit(now, CommandId(id), command, &mut outputs);
            // An axis stands while it is enabled, and then jumps.
            let enables = command == Command::Enable;
            for seen in 0..if enables { 24 } else { 8 } {
                let jumps = if enables { 0 } else { seen / 3 };
                let position = POSITIONS[(place + round + jumps) % POSITIONS.len()];
                let sent = u16::from_le_bytes([outputs[0], outputs[1]]);
                // What a frame brings is answered in the next.
                let had = core::mem::replace(&mut had, sent);
                let word = if sound {
                    answer(had, seen == 7)
                } else {
                    WORDS[place]
                };
                let mut inputs = [0; 6];
                inputs[..2].copy_from_slice(&word.to_le_bytes());
                inputs[2..].copy_from_slice(&position.to_le_bytes());
                let inputs = match seen {
                    4 if !enables => Inputs::Stale,
                    6 if !enables => Inputs::Answered(&inputs),
                    _ => Inputs::Fresh(&inputs),
                };
                core.step(now, inputs, &mut outputs);
                while let Some((_, event)) = core.poll_event() {
                    lived.push(event);
                }
                now = now.saturating_add(pause);
            }
        }
    }
    lived
}

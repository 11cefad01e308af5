//! Whether a move has been at its end, judged by samples that are far apart: a drive that clamps a set-point, or goes on from its end, while
//! it holds the next one. The drive here is written from CiA 402 alone.

use core::time::Duration;

use servocrab::ds402::Mode;
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{BufferSignal, MoveCommand, Reference},
};
use servocrab::{
    Failure, Referencing,
    axis::{
        AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Event, Inputs, Tolerances,
    },
};

use {BufferSignal::Acknowledge, Start::AtRest, Start::InMotion};
/// Bit 12 follows bit 4.
const FOLLOWS: BufferSignal = BufferSignal::None;

/// The drive's own cycle, and how many of them a millisecond has.
const DRIVE_CYCLE: f64 = 0.000_25;
const DRIVE_CYCLES: u32 = 4;
/// Profile velocity, counts/s.
const VELOCITY: f64 = 50_000.0;
/// Where the drive clamps, and where the moves end that it does not clamp.
const LIMIT: i32 = 6_000;

const BIT_4: u16 = 1 << 4;
const BIT_5: u16 = 1 << 5;
const BIT_9: u16 = 1 << 9;

#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    target: f64,
    end: f64,
    blends: bool,
}

/// A drive with two set-points and trapezoidal ramps, exactly where its demand is. 606Ch is not mapped.
struct Drive {
    /// Bit 12 stays high while both places are taken; else it follows bit 4.
    shows_room: bool,
    ramp: f64,
    /// The first so many set-points are cut off at the limit.
    clamped: usize,
    /// Drive cycles from a set-point at rest to its beginning.
    start_delay: u32,
    /// And from the end of one that stops to the next one, with bit 10 high.
    dwell: u32,
    word: u16,
    state: u16,
    acknowledge: bool,
    taken: usize,
    active: Option<Held>,
    queued: Option<Held>,
    wait: u32,
    position: f64,
    velocity: f64,
    /// How near the axis has come to the target of each set-point while that was active.
    nearest: Vec<f64>,
    /// Whether there was another one behind each of them at its end.
    had_next: Vec<bool>,
}

impl Drive {
    fn statusword(&self) -> u16 {
        let reached = self.state == 0x0237 && self.velocity == 0.0 && self.is_waiting();
        self.state | u16::from(reached) << 10 | u16::from(self.acknowledge) << 12
    }

    /// Between set-points, or before the first has begun.
    fn is_waiting(&self) -> bool {
        self.active.is_none() || self.wait > 0
    }

    fn take(&mut self, word: u16, target: i32) {
        let rises = word & !self.word & BIT_4 != 0;
        self.word = word;
        self.state = match (self.state, word & 0x8F) {
            (_, word) if word & 0x06 != 0x06 => 0x0250,
            (0x0250, 0x06) => 0x0231,
            (0x0231, 0x07) => 0x0233,
            (0x0233, 0x0F) => 0x0237,
            (state, _) => state,
        };
        if rises && self.state == 0x0237 {
            self.edge(word, target.into());
        }
        let is_full = self.shows_room && self.queued.is_some();
        if word & BIT_4 == 0 && !is_full {
            self.acknowledge = false;
        }
    }

    fn edge(&mut self, word: u16, target: f64) {
        let limit = if self.taken < self.clamped {
            LIMIT.into()
        } else {
            f64::INFINITY
        };
        let held = Held {
            target,
            end: target.min(limit),
            blends: word & BIT_9 != 0,
        };
        let replaces = word & BIT_5 != 0 && self.active.is_some();
        if replaces {
            self.active = Some(held);
            self.queued = None;
            self.nearest.push(f64::INFINITY);
            self.had_next.push(false);
        } else if self.active.is_none() {
            self.active = Some(held);
            self.wait = self.start_delay;
            self.nearest.push(f64::INFINITY);
        } else if self.queued.is_none() {
            self.queued = Some(held);
        } else {
            return;
        }
        self.taken += 1;
        self.acknowledge = true;
    }

    /// One drive cycle.
    fn cycle(&mut self) {
        if self.wait > 0 {
            self.wait -= 1;
            return;
        }
        let Some(active) = self.active else { return };
        let passes = active.end == active.target && self.queued.is_some_and(|next| next.blends);
        let left = active.end - self.position;
        let direction = if left < 0.0 { -1.0 } else { 1.0 };
        let change = self.ramp * DRIVE_CYCLE;
        let slow_enough = if passes {
            VELOCITY
        } else {
            // What a cycle goes further before it can slow down is in it.
            (2.0 * self.ramp * left.abs() + change * change / 4.0).sqrt() - change / 2.0
        };
        let wanted = direction * VELOCITY.min(slow_enough);
        self.velocity += (wanted - self.velocity).clamp(-change, change);
        let step = self.velocity * DRIVE_CYCLE;
        let is_there = left.abs() < 0.5 || (step * direction >= left.abs() && step != 0.0);
        if is_there && (passes || self.velocity.abs() <= 2.0 * change) {
            if passes {
                self.position += step;
            } else {
                self.position = active.end;
                self.velocity = 0.0;
            }
            let nearest = if active.end == active.target {
                0.0
            } else {
                f64::INFINITY
            };
            self.note(active.target, nearest);
            self.had_next.push(self.queued.is_some());
            self.active = self.queued.take();
            if self.active.is_some() {
                self.nearest.push(f64::INFINITY);
                self.wait = if passes { 0 } else { self.dwell };
            }
        } else {
            self.position += step;
            self.note(active.target, f64::INFINITY);
        }
    }

    fn note(&mut self, target: f64, at_its_end: f64) {
        let distance = (target - self.position).abs().min(at_its_end);
        if let Some(nearest) = self.nearest.last_mut() {
            *nearest = nearest.min(distance);
        }
    }
}

/// Whether the judged move begins at rest or replaces one under way.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Start {
    AtRest,
    InMotion,
}

/// Where the one behind it leads.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Behind {
    Onward,
    Back,
}

#[derive(Debug, Clone, Copy)]
struct Case {
    /// Bus cycle, ms.
    cycle: u32,
    window: u32,
    ramp: f64,
    signal: BufferSignal,
    start: Start,
    behind: Behind,
    buffer_mode: BufferMode,
    /// Where the axis is at the beginning, where the judged move leads, and whether the drive clamps that.
    begin: i32,
    target: i32,
    clamps: bool,
    /// Bus cycles for which the drive stands, with bit 10 high, before the one behind begins.
    dwell: u32,
}

struct Bench {
    core: AxisCore,
    drive: Drive,
    cycle: u32,
    now: Duration,
    outputs: [u8; 6],
    events: Vec<(CommandId, Event)>,
    next: u32,
}

impl Bench {
    fn new(case: &Case) -> Self {
        let mut config = CoreConfig::new(AxisFields::at(0, 0));
        config.referencing = Referencing::AbsoluteEncoder;
        config.tolerances = Tolerances {
            position: case.window,
            ..Tolerances::default()
        };
        config.traits.buffer_signal = case.signal;
        let start_delay = match case.start {
            // Time for the one behind to be taken.
            Start::AtRest => 12 * case.cycle * DRIVE_CYCLES,
            Start::InMotion => 0,
        };
        let mut bench = Self {
            core: AxisCore::new(config),
            drive: Drive {
                shows_room: case.signal == BufferSignal::Acknowledge,
                ramp: case.ramp,
                clamped: 0,
                start_delay,
                dwell: case.dwell * case.cycle * DRIVE_CYCLES,
                word: 0,
                state: 0x0250,
                acknowledge: false,
                taken: 0,
                active: None,
                queued: None,
                wait: 0,
                position: case.begin.into(),
                velocity: 0.0,
                nearest: Vec::new(),
                had_next: Vec::new(),
            },
            cycle: case.cycle,
            now: Duration::ZERO,
            outputs: [0; 6],
            events: Vec::new(),
            next: 0,
        };
        bench.core.note_mode(Mode::ProfilePosition);
        bench.run(Duration::from_millis(400));
        let enable = bench.send(Command::Enable);
        while bench.outcome(enable).is_none() {
            bench.step();
        }
        bench
    }

    fn send(&mut self, command: Command) -> CommandId {
        self.next += 1;
        let id = CommandId(self.next);
        self.core.submit(self.now, id, command, &mut self.outputs);
        self.drain();
        id
    }

    fn moves(&mut self, target: i32, buffer_mode: BufferMode) -> CommandId {
        self.send(Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target,
            set_point: SetPoint::new().buffer_mode(buffer_mode),
            gated: false,
        }))
    }

    /// One bus cycle: the frame brings what the drive showed last and takes the outputs to it.
    fn step(&mut self) {
        self.now += Duration::from_millis(self.cycle.into());
        let mut inputs = [0; 6];
        inputs[..2].copy_from_slice(&self.drive.statusword().to_le_bytes());
        inputs[2..].copy_from_slice(&(self.drive.position.round() as i32).to_le_bytes());
        let [w0, w1, target @ ..] = self.outputs;
        let word = u16::from_le_bytes([w0, w1]);
        self.drive.take(word, i32::from_le_bytes(target));
        self.core
            .step(self.now, Inputs::Fresh(&inputs), &mut self.outputs);
        self.drain();
        for _ in 0..self.cycle * DRIVE_CYCLES {
            self.drive.cycle();
        }
    }

    fn drain(&mut self) {
        while let Some(event) = self.core.poll_event() {
            self.events.push(event);
        }
    }

    fn run(&mut self, time: Duration) {
        let until = self.now + time;
        while self.now < until {
            self.step();
        }
    }

    fn outcome(&self, id: CommandId) -> Option<Result<Completion, Failure>> {
        self.events.iter().find_map(|&(of, event)| match event {
            Event::Done(result) if of == id => Some(result),
            _ => None,
        })
    }
}

/// What a move ended as, and how near to its target the axis came.
struct Judged {
    outcome: Result<Completion, Failure>,
    nearest: f64,
}

/// Two moves, of which the first is judged; none where the drive did not hold the second when the first came to its end.
fn judge(case: &Case) -> Option<Judged> {
    let mut bench = Bench::new(case);
    let mut before = 0;
    if case.start == Start::InMotion {
        let id = bench.moves(1_000_000, BufferMode::Aborting);
        while bench.drive.velocity < VELOCITY * 0.99 {
            bench.step();
        }
        assert!(bench.events.contains(&(id, Event::Accepted)));
        before = 1;
    }
    bench.drive.clamped = if case.clamps { before + 1 } else { 0 };
    let judged = bench.moves(case.target, BufferMode::Aborting);
    let behind = match case.behind {
        Behind::Onward => case.target + 6_000,
        Behind::Back => case.target - 6_000,
    };
    let last = bench.moves(behind, case.buffer_mode);
    while bench.outcome(last).is_none() {
        assert!(
            bench.now < Duration::from_secs(20),
            "{case:?}: it has no end"
        );
        bench.step();
    }
    assert_eq!(bench.drive.taken, before + 2, "{case:?}");
    let outcome = bench.outcome(judged);
    bench.drive.had_next[before].then_some(Judged {
        outcome: outcome.unwrap_or_else(|| panic!("{case:?}: it has no end")),
        nearest: bench.drive.nearest[before],
    })
}

/// The way to the end of a judged move that is no short one: as long as a handshake of the slowest cycle needs. One in motion has to
/// come to its velocity before.
const fn way(start: Start) -> i32 {
    match start {
        Start::AtRest => 30_000,
        Start::InMotion => 60_000,
    }
}

/// All cases of one start on a drive of one kind, by cycle, window, ramp, what is behind, and how that begins.
fn cases(signal: BufferSignal, start: Start) -> Vec<Case> {
    let mut cases = Vec::new();
    for cycle in [1, 2, 4, 10, 20] {
        for window in [10, 100] {
            for ramp in [60_000.0, 500_000.0, 2_000_000.0] {
                for behind in [Behind::Onward, Behind::Back] {
                    for buffer_mode in [BufferMode::Buffered, BufferMode::Blending] {
                        cases.push(Case {
                            cycle,
                            window,
                            ramp,
                            signal,
                            start,
                            behind,
                            buffer_mode,
                            begin: LIMIT - way(start),
                            target: LIMIT,
                            clamps: false,
                            dwell: 0,
                        });
                    }
                }
            }
        }
    }
    cases
}

/// Moves that the drive cuts off, just more than a window or further before their targets. It stands there for two samples at least.
fn clamped(signal: BufferSignal, start: Start) -> Vec<Case> {
    let mut clamped = Vec::new();
    for case in cases(signal, start) {
        let window = case.window as i32;
        for miss in [window + 1, 20, 40, 130, 200, 300, 400] {
            for dwell in [2, 3, 8] {
                clamped.push(Case {
                    target: LIMIT + miss,
                    clamps: true,
                    dwell,
                    ..case
                });
            }
        }
    }
    clamped.retain(|case| case.target - LIMIT > case.window as i32);
    clamped
}

/// Moves that come to their ends. Where the drive can take the next one before they begin, short ones are among them.
fn reached(signal: BufferSignal, start: Start) -> Vec<Case> {
    let mut reached = Vec::new();
    for case in cases(signal, start) {
        for way in [15, 30, 120, 400, way(start)] {
            for dwell in [0, 3] {
                reached.push(Case {
                    begin: LIMIT - way,
                    dwell,
                    ..case
                });
            }
        }
    }
    let is_long = |case: &Case| LIMIT - case.begin == way(start);
    let takes_short_ones = signal == Acknowledge && start == AtRest;
    // One that ends where the axis is within its window from the beginning is another matter.
    reached.retain(|case| {
        is_long(case) || (takes_short_ones && LIMIT - case.begin > case.window as i32)
    });
    reached
}

/// Judges each of these cases, and says which ones are wrong.
fn assert_none(cases: &[Case], is_wrong: impl Fn(&Judged) -> bool) {
    let (mut judged_ones, mut wrong) = (0, Vec::new());
    for case in cases {
        let Some(judged) = judge(case) else { continue };
        let clamps = judged.nearest > f64::from(case.window);
        assert_eq!(clamps, case.clamps, "{case:?}: {}", judged.nearest);
        judged_ones += 1;
        if is_wrong(&judged) {
            wrong.push(format!("{case:?}: {:?}", judged.outcome));
        }
    }
    assert!(
        judged_ones * 5 > cases.len() * 2,
        "{judged_ones} of {}",
        cases.len()
    );
    assert!(
        wrong.is_empty(),
        "{} of {judged_ones} are wrong, the first of them:\n{}",
        wrong.len(),
        wrong[..wrong.len().min(10)].join("\n")
    );
}

const KINDS: [(BufferSignal, Start); 4] = [
    (Acknowledge, AtRest),
    (FOLLOWS, AtRest),
    (Acknowledge, InMotion),
    (FOLLOWS, InMotion),
];

#[test]
fn a_move_that_the_drive_clamps_is_not_reached() {
    for (signal, start) in KINDS {
        assert_none(&clamped(signal, start), |judged| judged.outcome.is_ok());
    }
}

#[test]
fn a_move_that_comes_to_its_end_is_not_missed() {
    for (signal, start) in KINDS {
        assert_none(&reached(signal, start), |judged| {
            matches!(judged.outcome, Err(Failure::MissedTarget { .. }))
        });
    }
}

fn assert_reached_by_close_samples(signal: BufferSignal, start: Start) {
    let mut close = reached(signal, start);
    close.retain(|case| case.cycle <= 2);
    assert_none(&close, |judged| judged.outcome.is_err());
}

#[test]
fn a_move_that_comes_to_its_end_is_reached_by_close_samples() {
    for (signal, start) in [
        (Acknowledge, AtRest),
        (Acknowledge, InMotion),
        (FOLLOWS, InMotion),
    ] {
        assert_reached_by_close_samples(signal, start);
    }
}

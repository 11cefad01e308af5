//! A drive in Profile Position mode whose axis has a position loop behind its profile: it lags, overshoots and dithers. Written
//! from CiA 402 alone; it shares nothing with the library or with `servocrab-sim`. One call of [`Drive::cycle`] is 1 ms.
#![allow(missing_docs)]
#![allow(dead_code, reason = "each test file uses its own part of it")]

use core::time::Duration;

use servocrab::{
    Failure, Referencing,
    axis::{AxisFields, Command, CommandId, Completion, CoreConfig, Event},
};
use servocrab::{
    SetPoint,
    profile_position::{MoveCommand, Parameters, Reference},
};

use super::differential::CorePair;
use super::frames::{Late, Link, Random};

/// How a drive and its axis behave.
#[derive(Debug, Clone, Copy)]
pub struct Habits {
    /// Natural frequency of the position loop, rad/s; 0: the axis is where its demand is. With its velocity feed-forward the
    /// axis goes past its end by about deceleration / frequency².
    pub frequency: f64,
    /// Damping of the position loop; 1 is critical.
    pub damping: f64,
    /// How much of the demanded velocity is fed forward; with less than 1 the axis creeps to its end.
    pub feed_forward: f64,
    /// Milliseconds from taking a set-point at rest to setting off, with bit 10 as it was.
    pub start_delay: u32,
    /// Milliseconds of rest between a set-point that stops and the next one, with bit 10 high.
    pub dwell: u32,
    /// The encoder shows up to so many counts more or less than there are.
    pub dither: i32,
    /// The axis comes to rest so far from its end (a load that the loop does not take up), with bit 10 high all the same.
    pub droop: i32,
    /// Position window 6067h, counts, and its time 6068h, ms.
    pub window: i32,
    pub window_time: u32,
    /// Whether a set-point that stops is over only when the axis has settled in the window, not when its demand is there.
    pub ends_settled: bool,
    /// Whether bit 12 stays high while there is no room; else it follows bit 4.
    pub shows_room: bool,
    /// Ends beyond are cut off silently, with bit 11 high.
    pub limits: Option<(i32, i32)>,
    /// What distances count from: the end before, or where the axis is.
    pub from_actual: bool,
    /// Milliseconds from an edge of bit 4 to bit 12.
    pub acknowledge_delay: u32,
    /// Bit 10 is low while the axis is halted.
    pub halt_hides_bit_10: bool,
    /// In this millisecond alone bit 10 is high, whatever the axis does.
    pub wrong_bit_10: Option<u64>,
    /// Bit 10 is never high.
    pub never_reached: bool,
}

impl Default for Habits {
    fn default() -> Self {
        Self {
            frequency: 0.0,
            damping: 1.0,
            feed_forward: 1.0,
            start_delay: 0,
            dwell: 0,
            dither: 0,
            droop: 0,
            window: 10,
            window_time: 5,
            ends_settled: false,
            shows_room: false,
            limits: None,
            from_actual: false,
            acknowledge_delay: 0,
            halt_hides_bit_10: false,
            wrong_bit_10: None,
            never_reached: false,
        }
    }
}

/// How a set-point ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The demand stopped there.
    Stopped,
    /// The demand went through.
    Passed,
    /// A later one took its place.
    Replaced,
    /// A stop of the drive.
    Dropped,
}

/// One edge of bit 4.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// 6081h names the move.
    pub velocity: u32,
    pub taken: bool,
    /// Where it leads; none before it is started.
    pub end: Option<f64>,
    pub ended: Option<(u64, End)>,
    /// How near the axis has come to it, until 100 ms after its demand went on.
    pub nearest: f64,
}

#[derive(Debug, Clone, Copy)]
struct Held {
    entry: usize,
    word: u16,
    target: i32,
    velocity: f64,
    acceleration: f64,
    deceleration: f64,
    end: f64,
}

/// The outputs as the drive has them.
#[derive(Debug, Clone, Copy, Default)]
pub struct Outputs {
    pub word: u16,
    mode: i8,
    target: i32,
    velocity: u32,
    acceleration: u32,
    deceleration: u32,
}

/// Below Operation enabled, in it, or in Quick stop active.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Power {
    Disabled,
    Ready,
    SwitchedOn,
    Enabled,
    QuickStop,
}

#[derive(Debug)]
pub struct Drive {
    pub habits: Habits,
    pub now: u64,
    power: Power,
    last: Outputs,
    active: Option<Held>,
    queued: Option<Held>,
    /// Of the demand, counts and counts a millisecond.
    pub demand: f64,
    pub speed: f64,
    /// Of the axis.
    pub actual: f64,
    pub rate: f64,
    /// The end of the last set-point.
    last_end: f64,
    wait: u32,
    dwells: bool,
    in_window: u32,
    reached: bool,
    acknowledge: bool,
    acknowledge_in: Option<u32>,
    limited: bool,
    noise: Random,
    pub ledger: Vec<Entry>,
}

const BIT_4: u16 = 1 << 4;
const BIT_5: u16 = 1 << 5;
const BIT_6: u16 = 1 << 6;
const BIT_8: u16 = 1 << 8;
const BIT_9: u16 = 1 << 9;

impl Drive {
    pub fn new(habits: Habits) -> Self {
        Self {
            habits,
            now: 0,
            power: Power::Disabled,
            last: Outputs::default(),
            active: None,
            queued: None,
            demand: 0.0,
            speed: 0.0,
            actual: 0.0,
            rate: 0.0,
            last_end: 0.0,
            wait: 0,
            dwells: false,
            in_window: 1_000,
            reached: true,
            acknowledge: false,
            acknowledge_in: None,
            limited: false,
            noise: Random::new(7),
            ledger: Vec::new(),
        }
    }

    pub fn holds_any(&self) -> bool {
        self.active.is_some() || self.queued.is_some()
    }

    pub fn statusword(&self) -> u16 {
        let state = match self.power {
            Power::Disabled => 0x0040,
            Power::Ready => 0x0021,
            Power::SwitchedOn => 0x0023,
            Power::Enabled => 0x0027,
            Power::QuickStop => 0x0007,
        };
        let bit = |on: bool, bit: u16| u16::from(on) << bit;
        let hidden = self.habits.halt_hides_bit_10 && self.last.word & BIT_8 != 0;
        let wrong = self.habits.wrong_bit_10 == Some(self.now);
        let reached = self.reached && !self.habits.never_reached;
        state
            | 1 << 9
            | 1 << 4
            | bit(reached && !hidden || wrong, 10)
            | bit(self.limited, 11)
            | bit(self.acknowledge, 12)
    }

    pub fn position(&mut self) -> i32 {
        let dither = i64::from(self.habits.dither);
        let noise = if dither == 0 {
            0
        } else {
            self.noise.below(2 * dither as u64 + 1) as i64 - dither
        };
        (self.actual.round() as i64 + noise) as i32
    }

    /// Takes outputs in.
    pub fn take(&mut self, outputs: Outputs) {
        let rises = outputs.word & !self.last.word & BIT_4 != 0;
        self.last = outputs;
        let word = outputs.word;
        let to = match (self.power, word & 0x8F) {
            (Power::Enabled, w) if w & 0x06 == 0x02 => Power::QuickStop,
            (Power::QuickStop, w) if w & 0x02 != 0 => Power::QuickStop,
            (_, w) if w & 0x02 == 0 => Power::Disabled,
            (_, w) if w & 0x06 == 0x02 => Power::Disabled,
            (Power::Disabled, w) if w & 0x07 == 0x06 => Power::Ready,
            (Power::Ready, w) if w & 0x07 == 0x07 => Power::SwitchedOn,
            (Power::SwitchedOn, w) if w & 0x0F == 0x0F => Power::Enabled,
            (Power::Enabled, w) if w & 0x0F == 0x07 => Power::SwitchedOn,
            (_, w) if w & 0x07 == 0x06 => Power::Ready,
            (power, _) => power,
        };
        if self.power == Power::Enabled && to != Power::Enabled {
            self.drop_all(End::Dropped);
        }
        self.power = to;
        if rises && self.power == Power::Enabled {
            self.edge(outputs);
        }
        let full = self.habits.shows_room && self.queued.is_some();
        if word & BIT_4 == 0 && !full {
            self.acknowledge = false;
            self.acknowledge_in = None;
        }
    }

    fn edge(&mut self, outputs: Outputs) {
        let replaces = outputs.word & BIT_5 != 0;
        let taken = replaces || self.queued.is_none();
        let entry = self.ledger.len();
        self.ledger.push(Entry {
            velocity: outputs.velocity,
            taken,
            end: None,
            ended: None,
            nearest: f64::INFINITY,
        });
        if !taken {
            return;
        }
        let held = Held {
            entry,
            word: outputs.word,
            target: outputs.target,
            velocity: f64::from(outputs.velocity) / 1e3,
            acceleration: f64::from(outputs.acceleration) / 1e6,
            deceleration: f64::from(outputs.deceleration) / 1e6,
            end: 0.0,
        };
        self.acknowledge_in = Some(self.habits.acknowledge_delay);
        if replaces {
            self.drop_all(End::Replaced);
        }
        if self.active.is_none() {
            let at_rest = self.speed == 0.0;
            self.start(held);
            self.wait = if at_rest { self.habits.start_delay } else { 0 };
        } else {
            self.queued = Some(held);
        }
    }

    /// All that it holds is over.
    pub fn drop_all(&mut self, how: End) {
        for held in [self.active.take(), self.queued.take()]
            .into_iter()
            .flatten()
        {
            self.ledger[held.entry].ended = Some((self.now, how));
        }
    }

    fn start(&mut self, mut held: Held) {
        let base = if self.habits.from_actual {
            self.actual.round()
        } else {
            self.last_end
        };
        let asked = if held.word & BIT_6 == 0 {
            f64::from(held.target)
        } else {
            base + f64::from(held.target)
        };
        held.end = asked;
        if let Some((min, max)) = self.habits.limits {
            held.end = asked.clamp(f64::from(min), f64::from(max));
            self.limited = held.end != asked;
        }
        self.ledger[held.entry].end = Some(held.end);
        self.last_end = held.end;
        self.active = Some(held);
    }

    /// One millisecond.
    pub fn cycle(&mut self) {
        self.now += 1;
        self.acknowledge_in = self.acknowledge_in.and_then(|left| {
            self.acknowledge |= left == 0;
            left.checked_sub(1)
        });
        match self.power {
            Power::Enabled if self.last.word & BIT_8 == 0 => self.follow_profile(),
            Power::Disabled | Power::Ready | Power::SwitchedOn => {
                self.speed = 0.0;
                self.demand = self.actual.round();
                self.last_end = self.demand;
            }
            Power::Enabled | Power::QuickStop => {
                let ramp = 2.0;
                self.speed -= self.speed.clamp(-ramp, ramp);
                self.demand += self.speed;
                if self.power == Power::QuickStop && self.speed == 0.0 && self.rate.abs() < 0.01 {
                    self.power = Power::Disabled;
                }
            }
        }
        self.follow_demand();
        for entry in &mut self.ledger {
            let over = entry.ended.is_some_and(|(when, _)| self.now > when + 100);
            if let Some(end) = entry.end.filter(|_| !over) {
                entry.nearest = entry.nearest.min((self.actual - end).abs());
            }
        }
        let waits = self.wait > 0 && self.reached;
        let waits = waits || self.dwells;
        let idle = self.active.is_none() || waits;
        let end = self.last_end;
        let near = (self.actual - self.demand).abs()
            <= f64::from(self.habits.window + self.habits.droop.abs())
            && (waits || (self.demand - end).abs() < 0.5 || self.last.word & BIT_8 != 0);
        self.in_window = if near { self.in_window + 1 } else { 0 };
        self.reached = (waits && !self.dwells)
            || (idle && self.queued.is_none() && self.in_window > self.habits.window_time)
            || (self.wait > 0 && self.in_window > self.habits.window_time);
    }

    fn follow_profile(&mut self) {
        if self.wait > 0 {
            self.wait -= 1;
            self.dwells &= self.wait > 0;
            return;
        }
        let Some(active) = self.active else { return };
        let left = active.end - self.demand;
        let blends = self.queued.is_some_and(|next| {
            let end = f64::from(next.target);
            next.word & BIT_9 != 0 && next.word & BIT_6 == 0 && (end - active.end) * left > 0.0
        });
        let stop = if blends {
            f64::INFINITY
        } else {
            (2.0 * active.deceleration * left.abs()).sqrt()
        };
        let goal = left.signum() * active.velocity.min(stop);
        let speeds_up = goal.abs() > self.speed.abs() && goal * self.speed >= 0.0;
        let step = if speeds_up {
            active.acceleration
        } else {
            active.deceleration
        };
        let before = self.speed;
        self.speed += (goal - self.speed).clamp(-step, step);
        let arrives = left.abs() <= self.speed.abs().max(0.5)
            && self.speed * left >= 0.0
            && (blends || before.abs() <= 2.0 * active.deceleration + 0.5);
        if !arrives {
            self.demand += self.speed;
            return;
        }
        if blends {
            self.demand += self.speed;
            self.end_active(End::Passed);
        } else {
            self.demand = active.end;
            self.speed = 0.0;
            let settled = (self.actual - self.demand).abs()
                <= f64::from(self.habits.window + self.habits.droop.abs())
                && self.rate.abs() < 0.2;
            if self.habits.ends_settled && !settled {
                return;
            }
            self.end_active(End::Stopped);
        }
    }

    fn end_active(&mut self, how: End) {
        if let Some(active) = self.active.take() {
            self.ledger[active.entry].ended = Some((self.now, how));
        }
        if let Some(next) = self.queued.take() {
            self.start(next);
            if how == End::Stopped {
                self.wait = self.habits.dwell;
                self.dwells = self.wait > 0;
            }
            // There is room again.
            if self.last.word & BIT_4 == 0 {
                self.acknowledge = false;
            }
        }
    }

    fn follow_demand(&mut self) {
        let goal = self.demand + f64::from(self.habits.droop);
        if self.habits.frequency == 0.0 {
            self.rate = goal - self.actual;
            self.actual = goal;
            return;
        }
        // Per millisecond; small steps keep it stable.
        const STEPS: u32 = 8;
        let (w, d, dt) = (
            self.habits.frequency / 1e3,
            self.habits.damping,
            1.0 / f64::from(STEPS),
        );
        for _ in 0..STEPS {
            let fed = self.habits.feed_forward * self.speed;
            let pull = w * w * (goal - self.actual) + 2.0 * d * w * (fed - self.rate);
            self.rate += pull * dt;
            self.actual += self.rate * dt;
        }
    }
}

const FIELDS: AxisFields = AxisFields {
    controlword: 0,
    mode: Some(2),
    target: 3,
    velocity: Some(7),
    end_velocity: None,
    acceleration: Some(11),
    deceleration: Some(15),
    profile_type: None,
    target_velocity: None,
    statusword: 0,
    mode_display: Some(2),
    position: 3,
    actual_velocity: None,
    error_code: None,
    torque: None,
    digital_outputs: None,
    digital_inputs: None,
};

/// The axis core and that drive on a bus.
pub struct Bus {
    pub core: CorePair,
    pub drive: Drive,
    /// From one frame to the next, ms.
    pub period: u32,
    /// Frames by which inputs are late.
    pub latency: usize,
    pub now: Duration,
    pub outputs: [u8; 19],
    pub events: Vec<(u64, CommandId, Event)>,
    pub words: Vec<u16>,
    late: Late,
    next_id: u32,
}

impl Bus {
    pub fn new(habits: Habits, change: impl FnOnce(&mut CoreConfig)) -> Self {
        let mut config = CoreConfig::new(FIELDS);
        config.referencing = Referencing::AbsoluteEncoder;
        config.defaults = Parameters {
            velocity: Some(50_000),
            acceleration: Some(500_000),
            deceleration: Some(500_000),
            ..Parameters::default()
        };
        change(&mut config);
        Self {
            core: CorePair::new(config),
            drive: Drive::new(habits),
            period: 1,
            latency: 0,
            now: Duration::ZERO,
            outputs: [0; 19],
            events: Vec::new(),
            words: Vec::new(),
            late: Late::default(),
            next_id: 0,
        }
    }

    pub fn enabled(habits: Habits, change: impl FnOnce(&mut CoreConfig)) -> Self {
        let mut bus = Self::new(habits, change);
        bus.enable();
        bus
    }

    pub fn enable(&mut self) {
        let id = self.send(Command::Enable);
        assert_eq!(self.finish(id), Ok(Completion::Done));
    }

    pub fn send(&mut self, command: Command) -> CommandId {
        self.next_id += 1;
        let id = CommandId(self.next_id);
        self.core.submit(self.now, id, command, &mut self.outputs);
        self.drain();
        id
    }

    /// A move named by its velocity: 40 000 + 7 for each command before it.
    pub fn go(&mut self, reference: Reference, target: i32, set_point: SetPoint) -> CommandId {
        let name = self.next_id + 1;
        let set_point = match set_point.parameters.velocity {
            None => set_point.velocity(Self::name(CommandId(name))),
            Some(_) => set_point,
        };
        self.send(Command::Move(MoveCommand {
            reference,
            target,
            set_point,
            gated: false,
        }))
    }

    pub fn name(id: CommandId) -> u32 {
        40_000 + 7 * id.0
    }

    pub fn abs(&mut self, target: i32, set_point: SetPoint) -> CommandId {
        self.go(Reference::Absolute, target, set_point)
    }

    pub fn rel(&mut self, distance: i32, set_point: SetPoint) -> CommandId {
        self.go(Reference::Relative, distance, set_point)
    }

    /// What became of the move in the drive.
    pub fn entry(&self, id: CommandId) -> Option<Entry> {
        let name = Self::name(id);
        self.drive
            .ledger
            .iter()
            .find(|entry| entry.velocity == name)
            .copied()
    }

    pub fn cycle(&mut self) {
        self.cycle_over(Link::Good);
    }

    pub fn cycle_over(&mut self, link: Link) {
        self.cycle_after(link, self.period);
    }

    /// One frame, so many milliseconds after the one before.
    pub fn cycle_after(&mut self, link: Link, period: u32) {
        for _ in 0..period {
            self.drive.cycle();
            self.now += Duration::from_millis(1);
        }
        self.words
            .push(u16::from_le_bytes([self.outputs[0], self.outputs[1]]));
        let mut inputs = [0; 7];
        inputs[..2].copy_from_slice(&self.drive.statusword().to_le_bytes());
        inputs[2] = 1;
        inputs[3..].copy_from_slice(&self.drive.position().to_le_bytes());
        if link.delivers() {
            self.deliver();
        }
        let arrived = self.late.pass(inputs.to_vec(), self.latency);
        let inputs = link.tells(arrived.as_deref());
        self.core.step(self.now, inputs, &mut self.outputs);
        self.drain();
    }

    pub fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.cycle();
        }
    }

    pub fn run_until(&mut self, cycles: usize, mut condition: impl FnMut(&Self) -> bool) {
        for _ in 0..cycles {
            if condition(self) {
                return;
            }
            self.cycle();
        }
        panic!("not within {cycles} cycles; {:?}", self.core.snapshot());
    }

    /// For at most a minute.
    pub fn finish(&mut self, id: CommandId) -> Result<Completion, Failure> {
        self.run_until(60_000, |bus| bus.outcome(id).is_some());
        self.outcome(id).expect("it has just been seen")
    }

    pub fn wait_accepted(&mut self, id: CommandId) {
        self.run_until(2_000, |bus| bus.accepted(id));
    }

    pub fn outcome(&self, id: CommandId) -> Option<Result<Completion, Failure>> {
        self.told(id).map(|(_, result)| result)
    }

    /// The command's last report, and when it came, ms.
    pub fn told(&self, id: CommandId) -> Option<(u64, Result<Completion, Failure>)> {
        self.events.iter().find_map(|&(at, of, event)| match event {
            Event::Done(result) if of == id => Some((at, result)),
            _ => None,
        })
    }

    pub fn accepted(&self, id: CommandId) -> bool {
        self.events
            .iter()
            .any(|&(_, of, event)| of == id && event == Event::Accepted)
    }

    /// The word in the outputs, sent with the next frame.
    pub fn word(&self) -> u16 {
        u16::from_le_bytes([self.outputs[0], self.outputs[1]])
    }

    fn drain(&mut self) {
        while let Some((id, event)) = self.core.poll_event() {
            self.events.push((self.drive.now, id, event));
        }
    }

    fn deliver(&mut self) {
        let at = |from: usize| {
            let mut raw = [0; 4];
            raw.copy_from_slice(&self.outputs[from..from + 4]);
            u32::from_le_bytes(raw)
        };
        self.drive.take(Outputs {
            word: u16::from_le_bytes([self.outputs[0], self.outputs[1]]),
            mode: self.outputs[2].cast_signed(),
            target: at(3).cast_signed(),
            velocity: at(7),
            acceleration: at(11),
            deceleration: at(15),
        });
    }
}

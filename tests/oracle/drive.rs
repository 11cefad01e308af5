//! A drive axis after CiA 402 that does, cycle by cycle, anything that the standard permits. Written from the standard (CiA DSP
//! 402 v2.0, and the words of v3 for bits 5 and 9); it shares nothing with the simulator or the library.
//!
//! It takes outputs in, moves a plant of its own, and shows inputs. What it really did is in its ledger.

use crate::habits::{Habit, Habits, Hits};
use crate::random::Random;

/// What came with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outputs {
    pub word: u16,
    pub mode: i8,
    pub target: i32,
    pub velocity: u32,
    pub acceleration: u32,
    pub deceleration: u32,
    pub target_velocity: i32,
    pub end_velocity: u32,
}

pub const OUTPUT_BYTES: usize = 27;
pub const INPUT_BYTES: usize = 13;

impl Outputs {
    pub fn read(bytes: &[u8; OUTPUT_BYTES]) -> Self {
        let long = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        Self {
            word: u16::from_le_bytes([bytes[0], bytes[1]]),
            mode: bytes[2].cast_signed(),
            target: long(3).cast_signed(),
            velocity: long(7),
            acceleration: long(11),
            deceleration: long(15),
            target_velocity: long(19).cast_signed(),
            end_velocity: long(23),
        }
    }

    pub const fn bit(&self, bit: u16) -> bool {
        self.word >> bit & 1 != 0
    }

    const fn is_disable_voltage(&self) -> bool {
        self.word & 0x82 == 0
    }

    const fn is_quick_stop(&self) -> bool {
        self.word & 0x86 == 0x02
    }

    const fn is_shutdown(&self) -> bool {
        self.word & 0x87 == 0x06
    }

    const fn is_disable_operation(&self) -> bool {
        self.word & 0x8F == 0x07
    }

    const fn is_enable_operation(&self) -> bool {
        self.word & 0x8F == 0x0F
    }
}

/// The states of the standard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    NotReady,
    SwitchOnDisabled,
    Ready,
    SwitchedOn,
    Enabled,
    QuickStop,
    FaultReaction,
    Fault,
}

impl State {
    /// Bits 0 to 3, 5 and 6.
    const fn bits(self) -> u16 {
        match self {
            Self::NotReady => 0x00,
            Self::SwitchOnDisabled => 0x40,
            Self::Ready => 0x21,
            Self::SwitchedOn => 0x23,
            Self::Enabled => 0x27,
            Self::QuickStop => 0x07,
            Self::FaultReaction => 0x0F,
            Self::Fault => 0x08,
        }
    }

    /// Whether the power stage is on.
    pub const fn is_powered(self) -> bool {
        matches!(self, Self::Enabled | Self::QuickStop | Self::FaultReaction)
    }
}

/// What bit 12 shows of the buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ack {
    /// It stays high while the buffer is full.
    Buffer,
    /// It follows bit 4, after an edge that was taken.
    Handshake,
}

/// What a distance counts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Base {
    PreviousTarget,
    Demand,
    Actual,
}

/// How one scenario's drive is made.
#[derive(Debug, Clone)]
pub struct Making {
    pub ack: Ack,
    pub base: Base,
    /// 605Ah: 1, 2, or 5 to 8.
    pub quick_stop: u8,
    /// One turn of a modulo axis: its least position, and how many it has.
    pub turn: Option<(i64, i64)>,
    /// Whether an absolute target is approached in the positive direction, and not by the shorter way.
    pub one_way: bool,
    /// It takes bits 5, 6 and 9 from the word before the edge.
    pub bits_first: bool,
    /// Its bit 5 goes through the active target, and nothing replaces that (AX2000).
    pub passes_by_bit_5: bool,
    /// Seconds of one of its cycles.
    pub tick: f64,
    /// 6067h, counts; 6068h, ticks.
    pub window: f64,
    pub window_ticks: u32,
    /// 6085h.
    pub quick_ramp: f64,
    /// Of the plant: natural frequency (rad/s), damping, and how much of the demanded velocity is fed forward.
    pub frequency: f64,
    pub damping: f64,
    pub feed_forward: f64,
    /// 6064h and 606Ch are this restless.
    pub dither: i32,
    pub velocity_noise: i32,
    /// One disturbance in so many ticks, on average.
    pub cycles_between_incidents: u64,
}

/// How a set-point that was taken ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The demand came to rest at its end.
    Reached,
    /// The next took over in motion.
    Passed,
    /// Another took its place.
    Replaced,
    /// It was dropped.
    Dropped,
}

/// Ticks by which its outputs are late at most, however often that comes over it.
const LATE: u32 = 3;

/// A set-point that was taken.
#[derive(Debug, Clone, Copy)]
pub struct Latch {
    /// 6081h: the move's name.
    pub velocity: u32,
    pub target: i32,
    pub relative: bool,
    pub goal: f64,
    /// When the demand set off for it.
    pub began: Option<u64>,
    pub end: Option<(u64, End)>,
    /// From where it begins to its end.
    pub way: f64,
    /// From where the axis is when it is taken.
    pub axis_way: f64,
    /// Whether the drive passes its end with an end velocity.
    pub passes: bool,
    /// How near the demand came to its end.
    pub nearest: f64,
    /// How near the axis came to it since it became the active one, as it shows itself.
    pub axis_nearest: f64,
    /// The same from its third tick on: before that nothing shows yet that it is the active one, and that the axis is near may be of
    /// the one before.
    pub axis_came: f64,
    /// Its move was `Reached`, or `Passed`, while the axis stood within the window of its end, with bit 10: that it may begin yet
    /// shows in nothing. Or it was to be dropped, by a drive that does not, and that showed another state meanwhile.
    pub over: bool,
    /// Of a distance that was taken while the axis was not where its demand was: how far apart that is what it may count from, within
    /// the window. Which of it the drive takes shows only when the axis goes.
    pub vague: f64,
}

#[derive(Debug, Clone, Copy)]
struct SetPoint {
    index: usize,
    goal: f64,
    velocity: f64,
    acceleration: f64,
    deceleration: f64,
    /// 6082h: how fast it passes its end.
    end_velocity: f64,
    blend: bool,
}

pub struct Drive {
    pub making: Making,
    pub habits: Habits,
    pub hits: Hits,
    random: Random,
    pub now: u64,
    pub state: State,
    /// Ticks before the next transition.
    power_wait: u32,
    cause_until: u64,
    fault_since: u64,
    reaction_until: u64,
    pub mode: i8,
    mode_wait: u32,
    out: Outputs,
    mailbox: Outputs,
    hold_outputs: u32,
    /// For how many ticks it has not looked at them.
    outputs_late: u32,
    hold_inputs: u32,
    before: u16,
    active: Option<SetPoint>,
    pending: Option<SetPoint>,
    /// It has passed its end, and goes on at this velocity.
    runs_on: Option<f64>,
    last_target: f64,
    /// The demand.
    pub demand: f64,
    pub demand_velocity: f64,
    /// Whence the demand has just come to an end: its sign.
    arrives: Option<f64>,
    /// The axis.
    pub position: f64,
    pub velocity: f64,
    /// Where 6064h counts from.
    zero: f64,
    wait: u32,
    reached: bool,
    reached_since: u32,
    stale_reached: u32,
    show_reached_while_waiting: bool,
    glitch: bool,
    right_bits_for: u32,
    ack: bool,
    ack_due: Option<u32>,
    ack_hold: u32,
    ack_pulse: bool,
    wrong: Option<(u16, u32)>,
    /// Whether it shows Operation enabled and is not.
    shows_enabled: bool,
    flap: Option<(i8, u32)>,
    stop_requested: bool,
    homing: Option<u32>,
    /// How many homings have begun, and how many have come to their end.
    pub homings: (u64, u64),
    homed: bool,
    homing_failed: bool,
    push: f64,
    /// For so many ticks an input holds the axis.
    held: u32,
    next_hold: u64,
    /// The set-point that ended last.
    recent: Option<usize>,
    next_incident: u64,
    image: [u8; INPUT_BYTES],
    pub ledger: Vec<Latch>,
    /// An edge with bit 5 low came onto a full buffer, of none of which the end was where the axis stood.
    pub overrun: Option<u32>,
    /// Habits end with the disturbed part of a scenario.
    pub healed: bool,
}

const MS_100: f64 = 0.1;

impl Drive {
    pub fn new(making: Making, habits: Habits, mut random: Random) -> Self {
        let next_incident = random.below(making.cycles_between_incidents * 2) + 1;
        let mut drive = Self {
            making,
            habits,
            hits: Hits::default(),
            random,
            now: 0,
            state: State::NotReady,
            power_wait: 0,
            cause_until: 0,
            fault_since: 0,
            reaction_until: 0,
            mode: 0,
            mode_wait: 0,
            out: Outputs::default(),
            mailbox: Outputs::default(),
            hold_outputs: 0,
            outputs_late: 0,
            hold_inputs: 0,
            before: 0,
            active: None,
            pending: None,
            runs_on: None,
            last_target: 0.0,
            demand: 0.0,
            demand_velocity: 0.0,
            arrives: None,
            position: 0.0,
            velocity: 0.0,
            zero: 0.0,
            wait: 0,
            reached: true,
            reached_since: 0,
            stale_reached: 0,
            show_reached_while_waiting: false,
            glitch: false,
            right_bits_for: 0,
            ack: false,
            ack_due: None,
            ack_hold: 0,
            ack_pulse: false,
            wrong: None,
            shows_enabled: false,
            flap: None,
            stop_requested: false,
            homing: None,
            homings: (0, 0),
            homed: false,
            homing_failed: false,
            push: 0.0,
            held: 0,
            next_hold: 0,
            recent: None,
            next_incident,
            image: [0; INPUT_BYTES],
            ledger: Vec::new(),
            overrun: None,
            healed: false,
        };
        drive.show();
        drive
    }

    /// A frame has passed with these outputs.
    pub const fn take(&mut self, outputs: Outputs) {
        self.mailbox = outputs;
    }

    /// What the frame that passes now fetches.
    pub const fn image(&self) -> &[u8; INPUT_BYTES] {
        &self.image
    }

    /// Whether it holds a set-point whose end neither the demand nor the axis has come to, in any mode; and how far the longest way is that
    /// one of them has still to go. One with no way to go is over for all that shows, and so are two of them one behind the other, however far both lead.
    pub fn holds(&self) -> Option<f64> {
        if self.state != State::Enabled {
            return None;
        }
        match self.mode {
            1 if self.runs_on.is_some() => Some(f64::INFINITY),
            1 => self.active.map(|active| {
                let latch = &self.ledger[active.index];
                let way = (active.goal - self.demand).abs();
                let way = way.min((active.goal - self.position).abs()) - latch.vague;
                let way = if latch.over { 0.0 } else { way };
                let behind = self.pending.map(|next| {
                    let way = (next.goal - active.goal).abs();
                    let way = way.min((next.goal - self.demand).abs());
                    if self.ledger[next.index].over {
                        0.0
                    } else {
                        way
                    }
                });
                way.max(behind.unwrap_or(0.0))
            }),
            3 if self.out.target_velocity != 0 => Some(f64::INFINITY),
            6 if self.homing.is_some() => Some(f64::INFINITY),
            _ => None,
        }
    }

    /// Whether it waits before it sets off, or stands between two.
    pub const fn waits(&self) -> bool {
        self.wait > 0
    }

    /// A set-point has ended for all that shows, where the drive stands within this of its end, with bit 10.
    pub fn note_over(&mut self, index: usize, within: f64) {
        let shows_reached = self.image[1] & 0x04 != 0;
        let away = self.apart(self.ledger[index].goal, self.position);
        let latch = &mut self.ledger[index];
        let away = away - latch.vague;
        if shows_reached && self.demand_velocity == 0.0 && away <= within {
            latch.over = true;
        }
    }

    /// Whether the active set-point counts as over, as far as it shows itself.
    fn is_over(&self) -> bool {
        self.active
            .is_some_and(|active| self.ledger[active.index].over)
    }

    pub const fn word_in_effect(&self) -> u16 {
        self.out.word
    }

    /// Nothing unusual happens from now on.
    pub fn heal(&mut self) {
        self.healed = true;
        self.habits = Habits::default();
        self.wrong = None;
        self.flap = None;
        self.cause_until = 0;
        self.hold_outputs = 0;
        self.hold_inputs = 0;
        self.wait = 0;
        self.power_wait = 0;
        self.mode_wait = 0;
        self.push = 0.0;
        self.held = 0;
        if self.state == State::FaultReaction {
            self.reaction_until = self.now;
        }
    }

    fn has(&mut self, habit: Habit) -> bool {
        let has = self.habits.has(habit);
        if has {
            self.hits.hit(habit);
        }
        has
    }

    fn ticks(&self, seconds: f64) -> u32 {
        (seconds / self.making.tick).ceil() as u32
    }

    /// One of its own cycles.
    pub fn cycle(&mut self) {
        self.now += 1;
        if self.now >= self.next_incident && !self.healed {
            self.next_incident =
                self.now + 1 + self.random.below(self.making.cycles_between_incidents * 2);
            self.trouble();
        }
        self.step_hold();
        if self.hold_outputs > 0 && self.outputs_late < LATE {
            self.hold_outputs -= 1;
            self.outputs_late += 1;
        } else {
            self.out = self.mailbox;
            self.outputs_late = 0;
        }
        let out = self.out;
        self.step_power(&out);
        self.step_mode(&out);
        self.step_set_points(&out);
        self.step_demand(&out);
        self.step_plant();
        self.step_bits(&out);
        self.before = out.word;
        if self.hold_inputs > 0 {
            self.hold_inputs -= 1;
        } else {
            self.show();
        }
    }

    fn trouble(&mut self) {
        const EVENTS: [Habit; 14] = [
            Habit::WrongWord,
            Habit::WrongWords,
            Habit::FaultReactionLeft,
            Habit::FaultReactionLeftMoving,
            Habit::FaultResetsItself,
            Habit::Fault,
            Habit::FaultCoasts,
            Habit::ModeFlaps,
            Habit::OutputsLate,
            Habit::InputsLate,
            Habit::OwnQuickStop,
            Habit::OwnSwitchOff,
            Habit::OwnDisable,
            Habit::LoadStep,
        ];
        let from = self.random.below(EVENTS.len() as u64 + 1) as usize;
        let mut events = EVENTS.iter().cycle().skip(from).take(EVENTS.len());
        let habit = if from == EVENTS.len() {
            None
        } else {
            events.find(|habit| self.habits.has(**habit)).copied()
        };
        let Some(habit) = habit else {
            // Of a distance from nobody knows where bit 10 is the only word.
            let absolute = self
                .active
                .is_some_and(|active| !self.ledger[active.index].relative);
            // On a slow one the axis is where it was, for all that shows, and within the window of its end it has arrived.
            let fast = self.demand_velocity.abs() * 0.02 > 20.0 * self.making.window;
            let away = self.active.is_some_and(|active| {
                (active.goal - self.position).abs() > 3.0 * self.making.window
            });
            // But one that goes through the window in a tick only passes it.
            let passes = self.velocity.abs() * self.making.tick > 3.0 * self.making.window;
            let shown = self.hold_inputs == 0;
            if absolute && fast && (away || passes) && shown && self.has(Habit::Bit10Glitch) {
                self.glitch = true;
            }
            return;
        };
        let powered = self.state.is_powered();
        match habit {
            Habit::WrongWord | Habit::WrongWords => {
                let bits = self.random.pick(&[
                    0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08, 0x31, 0x33, 0x37, 0x17, 0x1F,
                    0x18, 0x50, 0x60, 0x6F, 0x7F,
                ]);
                let more = if habit == Habit::WrongWords {
                    1 + self.random.below(4) as u32
                } else {
                    0
                };
                self.wrong = Some((bits, more));
            }
            Habit::FaultReactionLeft | Habit::FaultReactionLeftMoving => {
                if !powered {
                    return;
                }
                if habit == Habit::FaultReactionLeft {
                    self.drop_all();
                }
                let ticks = self.random.pick(&[1, 1, 1, 3, 20]);
                self.state = State::FaultReaction;
                self.reaction_until = self.now + ticks;
            }
            Habit::Fault | Habit::FaultResetsItself | Habit::FaultCoasts => {
                if matches!(
                    self.state,
                    State::FaultReaction | State::Fault | State::NotReady
                ) {
                    return;
                }
                self.drop_all();
                let lasting = self.random.pick(&[0.0, 0.0, 0.0, 0.3]);
                self.cause_until = self.now + u64::from(self.ticks(lasting));
                self.fault_since = self.now;
                if habit == Habit::FaultCoasts || !powered {
                    self.state = State::Fault;
                } else {
                    self.state = State::FaultReaction;
                    self.reaction_until = u64::MAX;
                }
            }
            Habit::ModeFlaps => {
                let mode = self.random.pick(&[0, 0, 3, 6, 8, -1]);
                let more = self.random.pick(&[0, 0, 1, 4]);
                self.flap = Some((mode, more));
            }
            Habit::OutputsLate => {
                self.hold_outputs = 1 + self.random.below(u64::from(LATE)) as u32;
            }
            Habit::InputsLate => self.hold_inputs = 1 + self.random.below(3) as u32,
            Habit::OwnQuickStop => {
                if self.state != State::Enabled {
                    return;
                }
                self.drop_all();
                self.state = State::QuickStop;
                self.power_wait = self.shown_for();
            }
            Habit::OwnSwitchOff => {
                if !powered || self.state == State::FaultReaction {
                    return;
                }
                self.drop_all();
                self.state = self.random.pick(&[State::SwitchOnDisabled, State::Ready]);
                self.power_wait = self.shown_for();
            }
            Habit::OwnDisable => {
                if self.state != State::Enabled {
                    return;
                }
                self.drop_all();
                self.state = State::SwitchedOn;
                self.power_wait = self.shown_for();
            }
            Habit::LoadStep => self.push = f64::from(self.random.between(-40_000, 40_000)),
            _ => return,
        }
        self.hits.hit(habit);
    }

    /// Its input holds what it has begun, and lets it go on.
    fn step_hold(&mut self) {
        self.held = self.held.saturating_sub(1);
        if self.held > 0 || !self.habits.has(Habit::Held) {
            return;
        }
        let goes = match self.mode {
            1 => self.active.is_some() || self.runs_on.is_some(),
            3 => self.out.target_velocity != 0,
            6 => self.homing.is_some(),
            _ => false,
        };
        if self.state != State::Enabled || !goes {
            self.next_hold = 0;
            return;
        }
        if self.next_hold == 0 {
            self.next_hold = self.now + 1 + self.random.below(u64::from(self.ticks(0.15)));
        } else if self.now >= self.next_hold {
            self.next_hold = 0;
            let seconds = self.random.pick(&[0.005, 0.05, 0.2, 0.6]);
            self.held = self.ticks(seconds);
            // What bit 10 shows afterwards is of the motion.
            self.show_reached_while_waiting = false;
            self.hits.hit(Habit::Held);
        }
    }

    /// What it does by itself lasts so long that somebody who looks sees it.
    fn shown_for(&mut self) -> u32 {
        self.random.pick(&[3, 10, 60])
    }

    fn step_power(&mut self, out: &Outputs) {
        if self.power_wait > 0 {
            self.power_wait -= 1;
            return;
        }
        let before = self.state;
        match self.state {
            State::NotReady => self.state = State::SwitchOnDisabled,
            State::SwitchOnDisabled => {
                if out.is_shutdown() {
                    self.state = State::Ready;
                }
            }
            State::Ready => {
                if out.is_disable_voltage() || out.is_quick_stop() {
                    self.state = State::SwitchOnDisabled;
                } else if out.is_disable_operation() || out.is_enable_operation() {
                    self.state = State::SwitchedOn;
                }
            }
            State::SwitchedOn => {
                if out.is_disable_voltage() || out.is_quick_stop() {
                    self.state = State::SwitchOnDisabled;
                } else if out.is_shutdown() {
                    self.state = State::Ready;
                } else if out.is_enable_operation() {
                    self.enable();
                }
            }
            State::Enabled => {
                if out.is_disable_voltage() {
                    self.state = State::SwitchOnDisabled;
                } else if out.is_quick_stop() {
                    if !self.has(Habit::QuickStopIgnored) {
                        self.state = State::QuickStop;
                    } else if self.wrong.is_some() {
                        let held = self.active.iter().chain(&self.pending);
                        for set_point in held {
                            self.ledger[set_point.index].over = true;
                        }
                    }
                } else if out.is_shutdown() {
                    self.state = State::Ready;
                } else if out.is_disable_operation() {
                    self.state = State::SwitchedOn;
                }
                if self.state != State::Enabled {
                    self.drop_all();
                }
            }
            State::QuickStop => {
                if out.is_disable_voltage() {
                    self.state = State::SwitchOnDisabled;
                } else if self.demand_velocity == 0.0 && self.velocity.abs() < 1_000.0 {
                    if self.making.quick_stop < 5 {
                        self.state = State::SwitchOnDisabled;
                    } else if out.is_enable_operation() {
                        self.enable();
                    }
                }
            }
            State::FaultReaction => {
                if self.reaction_until != u64::MAX {
                    if self.now >= self.reaction_until {
                        // Its set-points are dropped already, or not.
                        self.state = State::Enabled;
                    }
                } else if self.demand_velocity == 0.0 {
                    self.state = State::Fault;
                }
            }
            State::Fault => {
                let edge = out.bit(7) && self.before & 0x80 == 0;
                let gone = self.now >= self.cause_until;
                let late = self.now.saturating_sub(self.fault_since) > u64::from(self.ticks(0.2));
                if (edge && gone) || (late && self.habits.has(Habit::FaultResetsItself)) {
                    self.state = State::SwitchOnDisabled;
                }
            }
        }
        if before != self.state && self.has(Habit::PowerLate) {
            self.power_wait = self.random.below(12) as u32;
        }
    }

    fn enable(&mut self) {
        self.state = State::Enabled;
        self.demand = self.position;
        self.demand_velocity = 0.0;
        self.last_target = self.demand;
        self.ack = false;
        self.ack_due = None;
        self.wait = 0;
        self.homing = None;
        // Where bit 4 is high, or a wrong word said Operation enabled before, that would be the answer to a set-point, for all that
        // shows.
        let answers = self.out.bit(4) || self.shows_enabled;
        let edge = !answers && self.has(Habit::AckAtEnable);
        if edge {
            self.ack = true;
            self.ack_hold = self.random.below(40) as u32;
        }
    }

    /// All set-points are gone.
    fn drop_all(&mut self) {
        for set_point in self.active.take().into_iter().chain(self.pending.take()) {
            self.end(set_point.index, End::Dropped);
        }
        self.runs_on = None;
        self.wait = 0;
        self.homing = None;
        self.ack_due = None;
        self.stop_requested = false;
    }

    fn end(&mut self, index: usize, end: End) {
        let now = self.now;
        if let Some(latch) = self.ledger.get_mut(index) {
            latch.end.get_or_insert((now, end));
            self.recent = Some(index);
        }
    }

    fn step_mode(&mut self, out: &Outputs) {
        if out.mode == self.mode || !matches!(out.mode, 1 | 3 | 6 | 8) {
            return;
        }
        if self.mode_wait == 0 && self.has(Habit::ModeLate) {
            self.mode_wait = 1 + self.random.below(20) as u32;
        }
        if self.mode_wait > 1 {
            self.mode_wait -= 1;
            return;
        }
        self.mode_wait = 0;
        self.mode = out.mode;
        self.drop_all();
        self.ack = false;
        self.homed = false;
        self.homing_failed = false;
    }

    fn step_set_points(&mut self, out: &Outputs) {
        let edge = out.bit(4) && self.before & 0x10 == 0;
        if self.state != State::Enabled || !edge {
            return;
        }
        match self.mode {
            1 => self.latch(out),
            6 => {
                self.homing = Some(self.random.pick(&[2, 30, 100, 300]));
                self.homings.0 += 1;
                self.homed = false;
                self.homing_failed = false;
            }
            _ => {}
        }
    }

    fn latch(&mut self, out: &Outputs) {
        let bits = if self.making.bits_first {
            self.before
        } else {
            out.word
        };
        let bit = |number: u16| bits >> number & 1 != 0;
        let (immediate, blend) = if self.making.passes_by_bit_5 {
            (false, bit(5))
        } else {
            (bit(5), bit(9) && !bit(5))
        };
        let relative = bit(6);
        if self.pending.is_some() && !immediate {
            // Full: no document says that it is taken. One that is at its end before it begins may be over for all that shows.
            let mut held = self.active.iter().chain(&self.pending);
            let no_way = self.making.window + 2.0 + 2.0 * f64::from(self.making.dither);
            if !held.any(|held| self.apart(held.goal, self.demand) <= no_way) {
                self.overrun = Some(out.velocity);
            }
            return;
        }
        let behind = self.active.filter(|_| !immediate);
        let goal = if relative {
            let base = match (behind, self.making.base) {
                (Some(active), _) => active.goal,
                (None, Base::PreviousTarget) => self.last_target,
                (None, Base::Demand) => self.demand,
                (None, Base::Actual) => self.position.round(),
            };
            base + f64::from(out.target)
        } else {
            let goal = f64::from(out.target) + self.zero;
            self.around(behind.map_or(self.demand, |active| active.goal), goal)
        };
        let vague = if relative && behind.is_none() {
            let (demand, axis) = (self.demand, self.position);
            let least = demand.min(axis).min(self.last_target);
            let most = demand.max(axis).max(self.last_target);
            (most - least).min(self.making.window)
        } else {
            0.0
        };
        let index = self.ledger.len();
        self.ledger.push(Latch {
            velocity: out.velocity,
            target: out.target,
            relative,
            goal,
            began: None,
            end: None,
            way: (goal - behind.map_or(self.demand, |behind| behind.goal)).abs(),
            axis_way: (goal - self.position).abs(),
            passes: out.end_velocity != 0,
            nearest: (goal - self.demand).abs(),
            axis_nearest: f64::INFINITY,
            axis_came: f64::INFINITY,
            over: false,
            vague,
        });
        let set_point = SetPoint {
            index,
            goal,
            velocity: f64::from(out.velocity.max(1)),
            acceleration: f64::from(out.acceleration.max(1)),
            deceleration: f64::from(out.deceleration.max(1)),
            end_velocity: f64::from(out.end_velocity),
            blend,
        };
        self.last_target = goal;
        if immediate {
            for old in self.active.take().into_iter().chain(self.pending.take()) {
                self.end(old.index, End::Replaced);
            }
        }
        if self.active.is_none() {
            self.begin(set_point);
        } else {
            self.pending = Some(set_point);
        }
        let full = self.ack;
        if !(full && self.making.ack == Ack::Buffer) {
            self.ack_due = Some(if self.has(Habit::AckLate) {
                self.random.below(25) as u32
            } else {
                0
            });
        }
        if self.reached && self.has(Habit::Bit10Stale) {
            self.stale_reached = self.random.below(6) as u32;
        }
    }

    /// Where on a modulo axis a drive goes that is sent to a position of its turn.
    fn around(&self, from: f64, to: f64) -> f64 {
        let Some((_, length)) = self.making.turn else {
            return to;
        };
        let length = length as f64;
        let forward = (to - from).rem_euclid(length);
        // What is just behind it is no turn ahead: 6064h shows the same of both.
        let behind = if self.making.one_way {
            length - 3.0 * self.making.window
        } else {
            length / 2.0
        };
        let way = if forward > behind {
            forward - length
        } else {
            forward
        };
        from + way
    }

    /// How far two positions are apart, of a modulo axis around its turn: that is what 6064h shows.
    pub fn apart(&self, a: f64, b: f64) -> f64 {
        let way = (a - b).abs();
        match self.making.turn {
            Some((_, length)) => {
                let rest = way.rem_euclid(length as f64);
                rest.min(length as f64 - rest)
            }
            None => way,
        }
    }

    /// Whether it has nothing to do, and takes set-points.
    pub fn is_free(&self) -> bool {
        self.state == State::Enabled
            && self.mode == 1
            && self.active.is_none()
            && self.demand_velocity == 0.0
    }

    fn begin(&mut self, set_point: SetPoint) {
        self.active = Some(set_point);
        self.runs_on = None;
        self.reached_since = 0;
        if self.demand_velocity == 0.0 {
            self.show_reached_while_waiting = false;
            // One that is held does not set off, and bit 10 is low.
            if self.held == 0 && self.has(Habit::StartDelayShownReached) {
                self.wait = self.random.below(u64::from(self.ticks(0.3))) as u32;
                self.show_reached_while_waiting = true;
            } else if self.has(Habit::StartDelay) {
                self.wait = self.random.below(u64::from(self.ticks(0.3))) as u32;
            }
        }
    }

    fn step_demand(&mut self, out: &Outputs) {
        let dt = self.making.tick;
        match self.state {
            State::QuickStop | State::FaultReaction => {
                if self.state == State::FaultReaction && self.reaction_until != u64::MAX {
                    // What has set off waits no more.
                    if self.active.is_some() {
                        self.wait = 0;
                        self.follow(dt);
                        return;
                    }
                    if let Some(velocity) = self.runs_on {
                        self.approach_velocity(velocity, self.making.quick_ramp, dt);
                        return;
                    }
                }
                let ramp = self.making.quick_ramp;
                self.approach_velocity(0.0, ramp, dt);
            }
            State::Enabled => {
                let halted = out.bit(8) && !(self.has_halt_ignored(out));
                match self.mode {
                    1 => self.position_mode(halted, dt),
                    3 => {
                        let wanted = if halted || self.held > 0 {
                            0.0
                        } else {
                            f64::from(out.target_velocity)
                        };
                        self.approach_velocity(wanted, f64::from(out.acceleration.max(1)), dt);
                    }
                    6 => self.homing_mode(out, halted, dt),
                    _ => self.approach_velocity(0.0, self.making.quick_ramp, dt),
                }
            }
            _ => {
                self.demand = self.position;
                self.demand_velocity = 0.0;
            }
        }
    }

    fn has_halt_ignored(&mut self, out: &Outputs) -> bool {
        let new = self.before & 0x100 == 0;
        if out.bit(8) && new {
            return self.has(Habit::HaltIgnored);
        }
        self.habits.has(Habit::HaltIgnored)
    }

    fn approach_velocity(&mut self, wanted: f64, ramp: f64, dt: f64) {
        let change = wanted - self.demand_velocity;
        let most = ramp * dt;
        self.demand_velocity = if change.abs() <= most {
            wanted
        } else {
            self.demand_velocity + most.copysign(change)
        };
        self.demand += self.demand_velocity * dt;
    }

    fn position_mode(&mut self, halted: bool, dt: f64) {
        if halted {
            // What bit 10 shows afterwards is of the halt.
            self.show_reached_while_waiting = false;
            let ramp = self
                .active
                .map_or(self.making.quick_ramp, |active| active.deceleration);
            self.approach_velocity(0.0, ramp, dt);
            let goes = self.active.is_some() || self.runs_on.is_some();
            if self.demand_velocity == 0.0 && goes && self.has(Habit::HaltForgets) {
                self.drop_all();
            }
            return;
        }
        if self.held > 0 {
            let ramp = self.making.quick_ramp;
            let Some(active) = self.active else {
                self.approach_velocity(0.0, ramp, dt);
                return;
            };
            let way = active.goal - self.demand;
            self.approach_velocity(0.0, active.deceleration, dt);
            // What was to pass its end has passed it, on the ramp.
            let blends = self.blends(active, way);
            self.pass(active, way, blends);
            return;
        }
        if self.wait > 0 {
            self.wait -= 1;
            return;
        }
        if self.active.is_some() {
            self.follow(dt);
        } else {
            let velocity = self.runs_on.unwrap_or(0.0);
            self.approach_velocity(velocity, self.making.quick_ramp, dt);
        }
    }

    fn follow(&mut self, dt: f64) {
        let Some(active) = self.active else { return };
        let now = self.now;
        let way = active.goal - self.demand;
        let latch = &mut self.ledger[active.index];
        latch.began.get_or_insert(now);
        latch.nearest = latch.nearest.min(way.abs());
        let blends = self.blends(active, way);
        // One behind it begins at rest.
        let least = self.passing_velocity(active);
        let stop = (2.0 * active.deceleration * way.abs() + least * least).sqrt();
        let wanted = if blends {
            active.velocity
        } else {
            active.velocity.min(stop)
        }
        .copysign(way);
        let near = way.abs() <= (2.0 * active.deceleration * dt * dt).max(0.5);
        let slow = self.demand_velocity.abs() <= 4.0 * active.deceleration * dt;
        if near && slow {
            self.arrives = Some(way.signum());
            self.demand = active.goal;
            self.demand_velocity = 0.0;
            self.ledger[active.index].nearest = 0.0;
            self.end(active.index, End::Reached);
            self.active = None;
            self.reached_since = 0;
            if let Some(next) = self.pending.take() {
                self.active = Some(next);
                self.show_reached_while_waiting = false;
                if self.held == 0 && self.has(Habit::Dwell) {
                    self.wait = self.random.below(u64::from(self.ticks(0.3))) as u32;
                    self.show_reached_while_waiting = true;
                }
            }
            return;
        }
        let faster =
            wanted.abs() > self.demand_velocity.abs() && wanted * self.demand_velocity >= 0.0;
        let ramp = if faster {
            active.acceleration
        } else {
            active.deceleration * 1.5
        };
        self.approach_velocity(wanted, ramp, dt);
        self.pass(active, way, blends);
    }

    /// Whether the one behind it takes over at its end, in motion.
    fn blends(&self, active: SetPoint, way: f64) -> bool {
        self.pending
            .is_some_and(|next| next.blend && (next.goal - active.goal) * way > 0.0)
    }

    /// How fast it passes its end, with none behind it.
    fn passing_velocity(&self, active: SetPoint) -> f64 {
        self.pending.map_or(active.end_velocity, |_| 0.0)
    }

    /// Where the demand has passed the end, from where it had this way to go, and goes on there.
    fn pass(&mut self, active: SetPoint, way: f64, blends: bool) {
        if (active.goal - self.demand) * way > 0.0 {
            return;
        }
        let velocity = self.passing_velocity(active);
        if velocity > 0.0 {
            self.ledger[active.index].nearest = 0.0;
            self.end(active.index, End::Reached);
            self.active = None;
            self.runs_on = Some(velocity.copysign(way));
        } else if blends {
            self.ledger[active.index].nearest = 0.0;
            self.end(active.index, End::Passed);
            self.active = self.pending.take();
            if self.has(Habit::Bit10Glitch) {
                self.glitch = true;
            }
        }
    }

    /// Whether an axis whose demand has come to its end is beyond that, or still on its way: seen once for each end.
    fn note_arrival(&mut self) {
        let Some(direction) = self.arrives else {
            return;
        };
        if self.demand_velocity != 0.0 || !self.state.is_powered() {
            self.arrives = None;
            return;
        }
        let beyond = (self.position - self.demand) * direction;
        if beyond.abs() > self.making.window {
            let habit = if beyond > 0.0 {
                Habit::Overshoot
            } else {
                Habit::Creeps
            };
            if self.has(habit) {
                self.arrives = None;
            }
        }
    }

    fn homing_mode(&mut self, out: &Outputs, halted: bool, dt: f64) {
        let Some(left) = self.homing else {
            self.approach_velocity(0.0, self.making.quick_ramp, dt);
            return;
        };
        if halted || !out.bit(4) {
            // Interrupted.
            self.approach_velocity(0.0, self.making.quick_ramp, dt);
            if !out.bit(4) && self.demand_velocity == 0.0 {
                self.homing = None;
            }
            return;
        }
        if self.held > 0 {
            self.approach_velocity(0.0, 300_000.0, dt);
            return;
        }
        if left > 0 {
            self.homing = Some(left - 1);
            self.approach_velocity(3_000.0, 300_000.0, dt);
            return;
        }
        self.approach_velocity(0.0, 300_000.0, dt);
        if self.demand_velocity == 0.0 {
            self.homing = None;
            if self.has(Habit::HomingFails) {
                self.homing_failed = true;
            } else {
                self.homed = true;
                self.homings.1 += 1;
                self.zero = self.demand;
            }
        }
    }

    fn step_plant(&mut self) {
        let dt = self.making.tick;
        let steps = (self.making.frequency * dt / 0.25).ceil().max(1.0);
        let part = dt / steps;
        if self.state.is_powered() {
            let (w, z) = (self.making.frequency, self.making.damping);
            // The demand of the cycle is followed from where it was.
            let mut demand = self.demand - self.demand_velocity * dt;
            for _ in 0..steps as u32 {
                demand += self.demand_velocity * part;
                let pull = w * w * (demand - self.position)
                    + 2.0
                        * z
                        * w
                        * (self.making.feed_forward * self.demand_velocity - self.velocity)
                    + self.push;
                self.velocity += pull * part;
                self.position += self.velocity * part;
            }
        } else {
            // Friction.
            let loss = 200_000.0 * dt;
            self.velocity = if self.velocity.abs() <= loss {
                0.0
            } else {
                self.velocity - loss.copysign(self.velocity)
            };
            self.position += self.velocity * dt;
        }
        self.push *= 0.9;
        self.note_arrival();
        let active = self.active.map(|active| active.index);
        for index in active.into_iter().chain(self.recent) {
            if let Some(latch) = self.ledger.get_mut(index) {
                let away = (latch.goal - self.position).abs();
                latch.axis_nearest = latch.axis_nearest.min(away);
                if latch.began.is_some_and(|began| self.now >= began + 2) {
                    latch.axis_came = latch.axis_came.min(away);
                }
                if Some(index) == active {
                    latch.nearest = latch.nearest.min((latch.goal - self.demand).abs());
                }
            }
        }
    }

    fn step_bits(&mut self, out: &Outputs) {
        // Bit 12 in mode 1.
        if let Some(left) = self.ack_due {
            if left == 0 {
                self.ack = true;
                self.ack_due = None;
                if self.making.ack == Ack::Handshake && self.has(Habit::AckOfOneCycle) {
                    self.ack_pulse = true;
                }
                if self.has(Habit::AckOf100Ms) {
                    self.ack_hold = self.ticks(MS_100);
                }
            } else {
                self.ack_due = Some(left - 1);
            }
        } else if self.ack {
            if self.ack_pulse {
                self.ack = false;
                self.ack_pulse = false;
            } else if !out.bit(4) {
                if self.ack_hold > 0 {
                    self.ack_hold -= 1;
                } else if self.making.ack == Ack::Handshake || self.pending.is_none() {
                    self.ack = false;
                }
            }
        }
        // Bit 10.
        let goes = self.active.is_some();
        let halted = out.bit(8);
        let at_rest = self.demand_velocity == 0.0;
        // And with no way to go it stays.
        let short = self
            .active
            .is_some_and(|active| (active.goal - self.demand).abs() <= self.making.window);
        let waits = goes && (self.wait > 0 || short) && self.show_reached_while_waiting && at_rest;
        let now = if halted && self.state == State::Enabled {
            at_rest && !(self.habits.has(Habit::HaltWithoutBit10) && self.mode == 1)
        } else if goes && self.held > 0 {
            false
        } else if waits || self.runs_on.is_some() {
            true
        } else if self.habits.has(Habit::Bit10ByWindow) {
            !goes && (self.position - self.demand).abs() <= self.making.window
        } else {
            !goes && at_rest
        };
        if self.habits.has(Habit::HaltWithoutBit10) && halted && at_rest && self.before & 0x100 == 0
        {
            self.hits.hit(Habit::HaltWithoutBit10);
        }
        self.reached_since = if now {
            self.reached_since.saturating_add(1)
        } else {
            0
        };
        let needed = if self.habits.has(Habit::Bit10ByWindow) && !waits {
            self.making.window_ticks
        } else {
            0
        };
        let was = self.reached;
        self.reached = now && self.reached_since > needed;
        if was != self.reached && self.habits.has(Habit::Bit10ByWindow) {
            self.hits.hit(Habit::Bit10ByWindow);
        }
        if self.stale_reached > 0 {
            self.stale_reached -= 1;
            self.reached = true;
        }
    }

    fn show(&mut self) {
        let mut bits = self.state.bits();
        if let Some((wrong, more)) = self.wrong {
            bits = wrong;
            self.wrong = more.checked_sub(1).map(|left| (wrong, left));
        }
        self.shows_enabled = bits & 0x6F == 0x27 && self.state != State::Enabled;
        let mut word = bits | 0x0210;
        let enabled = self.state == State::Enabled;
        if enabled && self.mode == 6 {
            let at_rest = self.demand_velocity == 0.0;
            if self.homing.is_some() {
                // In progress.
            } else if self.homing_failed {
                word |= 0x2000 | if at_rest { 0x0400 } else { 0 };
            } else if self.homed {
                let quiet = self.has(Habit::HomingWithoutBit10);
                word |= 0x1000 | if at_rest && !quiet { 0x0400 } else { 0 };
            } else if !self.has(Habit::HomingShowsProgress) {
                word |= 0x0400;
            }
        } else {
            if self.reached || self.glitch {
                word |= 0x0400;
            }
            if self.ack && self.mode == 1 {
                word |= 0x1000;
            }
        }
        self.glitch = false;
        if self.habits.has(Habit::WrongBits) {
            self.right_bits_for = self.right_bits_for.saturating_add(1);
            // One at a time.
            if self.right_bits_for > 20 && self.random.one_in(40) {
                self.right_bits_for = 0;
                self.hits.hit(Habit::WrongBits);
                if enabled && self.mode == 6 && self.homing.is_some() {
                    word |= self
                        .random
                        .pick(&[0x0400, 0x1000, 0x1400, 0x2000, 0x2400, 0x3400]);
                } else if self.pending.is_some() && self.out.word & 0x10 == 0 && !self.is_over() {
                    // With bit 4 high it would be the end of an acknowledge.
                    word &= !0x1000;
                }
            }
        }
        let mode = match self.flap {
            Some((mode, more)) => {
                self.flap = more.checked_sub(1).map(|left| (mode, left));
                mode
            }
            None => self.mode,
        };
        let noise = if self.making.dither > 0 && self.has(Habit::Dither) {
            self.random.between(-self.making.dither, self.making.dither)
        } else {
            0
        };
        let position = (self.position - self.zero).round() as i32 + noise;
        let position = match self.making.turn {
            Some((least, length)) => {
                (least + (i64::from(position) - least).rem_euclid(length)) as i32
            }
            None => position,
        };
        let velocity = self.velocity.round() as i32
            + if self.making.velocity_noise > 0 && self.has(Habit::VelocityNoise) {
                self.random
                    .between(-self.making.velocity_noise, self.making.velocity_noise)
            } else {
                0
            };
        let error: u16 = if self.state == State::Fault {
            0x8611
        } else {
            0
        };
        self.image[0..2].copy_from_slice(&word.to_le_bytes());
        self.image[2] = mode.cast_unsigned();
        self.image[3..7].copy_from_slice(&position.to_le_bytes());
        self.image[7..11].copy_from_slice(&velocity.to_le_bytes());
        self.image[11..13].copy_from_slice(&error.to_le_bytes());
    }
}

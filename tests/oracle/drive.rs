//! A drive axis after CiA 402 that does, cycle by cycle, what docs/fault-model.md lets it do, and beyond that model whatever else its
//! habits name. Written from the standard (CiA DSP 402 v2.0, and the words of v3 for bits 5 and 9); it shares nothing with the simulator
//! or the library.
//!
//! It takes outputs in, moves a plant of its own, and shows inputs. What it really did is in its ledger.

use crate::habits::{Habit, Habits, Hits};
use crate::random::Random;
use crate::words::{ACKNOWLEDGE, HALT, LIMIT, NEW_SET_POINT, Outputs, REACHED, State};

/// What bit 12 shows of the buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Ack {
    #[default]
    /// It stays high while the buffer is full.
    Buffer,
    /// It follows bit 4, after an edge that was taken.
    Handshake,
}

/// What a distance counts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Base {
    #[default]
    PreviousTarget,
    Demand,
    Actual,
}

/// How one scenario's drive is made. Positions are those of 6064h before any homing.
#[derive(Debug, Clone, Default)]
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
    /// Seconds of one of its cycles; how many of them `Traits::drive_cycle` has, and `Deadlines::begin`.
    pub tick: f64,
    pub drive_cycle: u32,
    pub begin: u32,
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
    /// By how many ticks the statusword, 6061h, 6064h and 606Ch are old.
    pub ages: [u8; 4],
    /// The range that it limits set-points to, and whether bit 11 shows that.
    pub limits: (f64, f64),
    pub shows_limit: bool,
    /// Whether bit 10 rises where it stops between two set-points.
    pub rises_between: bool,
    /// Whether a set-point with no way to go is over in the tick in which it is taken.
    pub at_once: bool,
    /// One incident in so many ticks, on average.
    pub incidents: u64,
}

/// How a set-point that was taken ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// At its end.
    Reached,
    /// At its end, in motion: the next took over, or it goes on at its end velocity.
    Passed,
    /// At a limit of the drive.
    Limited,
    /// Another took its place.
    Replaced,
    /// It was dropped.
    Dropped,
}

/// A set-point that was taken.
#[derive(Debug, Clone, Copy)]
pub struct Latch {
    /// What was taken. 6081h is the move's name.
    pub out: Outputs,
    pub relative: bool,
    pub blend: bool,
    /// Where it leads, and where the drive ends it in place of that.
    pub goal: f64,
    pub limit: Option<f64>,
    /// From where it begins to where it leads.
    pub way: f64,
    /// How far the shaft is behind the demand there.
    pub lag: f64,
    /// Whether the core can know where it leads, to a window.
    pub known: bool,
    /// It waits for another one to end.
    pub behind: bool,
    /// It began, or was taken, while the axis was on its way.
    pub in_motion: bool,
    /// When the drive set off for it, and when its demand came to its end or to the limit.
    pub began: Option<u64>,
    pub arrived: Option<u64>,
    pub end: Option<(u64, End)>,
    pub taken: u64,
    /// When its turn came the axis rested where it leads: nothing need show that it is over.
    pub still: bool,
    /// How near the axis came to where it leads, from its beginning to that of the next.
    pub nearest: f64,
}

#[derive(Debug, Clone, Copy)]
struct SetPoint {
    index: usize,
    /// Where its demand goes.
    to: f64,
    limited: bool,
    velocity: f64,
    acceleration: f64,
    deceleration: f64,
    /// 6082h: how fast it passes its end.
    end_velocity: f64,
    blend: bool,
}

/// Where the active one is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// It sets off in so many ticks; until then bit 10 is high, or low.
    Waits {
        ticks: u32,
        reached: bool,
    },
    Runs,
    /// The demand rests at its end, until the axis is seen there for so many ticks.
    Stands {
        ticks: u32,
        reached: bool,
    },
}

/// What it shows in one tick.
#[derive(Debug, Clone, Copy, Default)]
struct Shown {
    word: u16,
    mode: i8,
    position: f64,
    counts: i32,
    velocity: i32,
    error: u16,
}

/// Ticks of the past that it can still show.
const PAST: usize = 8;

/// A wrong bit of a right word.
#[derive(Debug, Clone, Copy)]
struct WrongBit {
    bit: u16,
    high: bool,
    ticks: u32,
}

#[derive(Default)]
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
    /// Whether somebody has seen it out of Operation enabled since it left that.
    out_seen: bool,
    pub mode: i8,
    mode_wait: u32,
    pub out: Outputs,
    mailbox: Outputs,
    /// The host holds bit 4 high in mode 1, whether that has come here or not.
    host_starts: bool,
    hold_outputs: u32,
    outputs_late: u32,
    hold_inputs: u32,
    before: u16,
    active: Option<(SetPoint, Phase)>,
    pending: Option<SetPoint>,
    /// It has passed its end, and goes on at this velocity.
    runs_on: Option<f64>,
    last_target: f64,
    /// After a homing, a jog or a limit nobody else knows what a distance counts from, nor what the previous target is after enabling.
    base_lost: bool,
    pub demand: f64,
    pub demand_velocity: f64,
    /// The axis.
    pub position: f64,
    pub velocity: f64,
    /// Where 6064h counts from.
    zero: f64,
    reached: bool,
    reached_since: u32,
    stale_reached: u32,
    at_limit: bool,
    ack: bool,
    ack_due: Option<u32>,
    ack_hold: u32,
    ack_pulse: bool,
    wrong_state: Option<(u16, u32)>,
    wrong_bit: Option<WrongBit>,
    /// For how many ticks whose image arrived all bits were right, and how many there are to be before the next is wrong.
    right_for: u32,
    wrong_after: u32,
    arrived_in_tick: bool,
    flap: Option<(i8, u32)>,
    homing: Option<u32>,
    /// How many homings have begun, and how many have come to their end.
    pub homings: (u64, u64),
    homed: bool,
    homing_failed: bool,
    push: f64,
    blocked: u32,
    /// For so many ticks it is under local control.
    deaf: u32,
    /// For so many ticks an input holds the axis.
    held: u32,
    next_hold: u64,
    /// The set-point that ended last.
    recent: Option<usize>,
    /// When bit 8 was high last.
    halted_at: u64,
    next_incident: u64,
    past: [Shown; PAST],
    visible: Shown,
    pub ledger: Vec<Latch>,
    /// An edge with bit 5 low came onto a full buffer.
    pub overrun: Option<u32>,
}

/// Ticks by which its outputs are late at most, however often that comes over it.
const LATE: u32 = 3;

/// Samples may be missing for three eighths of a settle time of 100 ms.
const MISSING: f64 = 0.0375;

/// No axis is further from its demand, in counts, when bit 10 rises.
const FURTHEST_SWING: f64 = 600.0;

impl Drive {
    pub fn new(making: Making, habits: Habits, mut random: Random) -> Self {
        let mut drive = Self {
            next_incident: random.below(making.incidents * 2) + 1,
            reached: true,
            making,
            habits,
            random,
            ..Self::default()
        };
        drive.show();
        drive.past = [drive.visible; PAST];
        drive
    }

    /// The host sends bit 4 in mode 1, high or low. What rises in bit 12 from then on is the answer to that (S1): no wrong bit may be.
    pub fn expect(&mut self, starts: bool) {
        self.host_starts = starts;
        if starts && self.wrong_bit.is_some_and(|wrong| wrong.bit == ACKNOWLEDGE) {
            self.wrong_bit = None;
            self.right_for = 0;
        }
    }

    /// A frame has passed with these outputs.
    pub const fn take(&mut self, outputs: Outputs) {
        self.mailbox = outputs;
    }

    /// What the frame that passes now fetches.
    pub fn image(&self) -> [u8; crate::words::INPUT_BYTES] {
        let shown = &self.visible;
        let mut image = [0; crate::words::INPUT_BYTES];
        image[0..2].copy_from_slice(&self.word().to_le_bytes());
        image[2] = shown.mode.cast_unsigned();
        image[3..7].copy_from_slice(&shown.counts.to_le_bytes());
        image[7..11].copy_from_slice(&shown.velocity.to_le_bytes());
        image[11..13].copy_from_slice(&shown.error.to_le_bytes());
        image
    }

    const fn word(&self) -> u16 {
        match self.wrong_bit {
            Some(WrongBit {
                bit, high: true, ..
            }) => self.visible.word | bit,
            Some(WrongBit { bit, .. }) => self.visible.word & !bit,
            None => self.visible.word,
        }
    }

    /// What it shows now has arrived.
    pub const fn note_arrival(&mut self) {
        self.arrived_in_tick = true;
        if self.visible.word & 0x6F != State::Enabled.bits() {
            self.out_seen = true;
        }
    }

    /// Whether it holds a set-point whose end neither the demand nor the axis has come to, in any mode; and how far the longest way is
    /// that one of them has still to go.
    pub fn holds(&self) -> Option<f64> {
        if self.state != State::Enabled {
            return None;
        }
        match self.mode {
            1 if self.runs_on.is_some() => Some(f64::INFINITY),
            1 => self.active.map(|(active, _)| {
                let ahead = |to: f64, from: f64| (to - from).abs().min((to - self.demand).abs());
                let behind = |next: SetPoint| ahead(next.to, active.to);
                // Further than its way was long it has overshot.
                let way = ahead(active.to, self.position).min(self.ledger[active.index].way);
                // Of a distance nobody else knows the end to less than a window.
                let vague = self.ledger[active.index].relative;
                let vague = if vague { self.making.window } else { 0.0 };
                way.max(self.pending.map_or(0.0, behind)) - vague
            }),
            3 if self.out.target_velocity != 0 => Some(f64::INFINITY),
            6 if self.homing.is_some() => Some(f64::INFINITY),
            _ => None,
        }
    }

    /// Whether it has nothing to do, and takes set-points.
    pub fn is_free(&self) -> bool {
        self.state == State::Enabled
            && self.mode == 1
            && self.active.is_none()
            && self.demand_velocity == 0.0
    }

    /// Whether the demand of this set-point is at its end in two ticks: only the last of its ramp is left, or the next takes over there.
    pub fn is_there_soon(&self, index: usize) -> bool {
        let Some((active, Phase::Runs)) = self.active.filter(|(active, _)| active.index == index)
        else {
            return false;
        };
        let (dt, way) = (self.making.tick, active.to - self.demand);
        let speed = self.demand_velocity.abs();
        let stops = self.stops_at(active, way);
        way * self.demand_velocity >= 0.0
            && way.abs() <= 2.0 * speed.max(active.deceleration * dt) * dt + 1.0
            && (!stops || speed <= 8.0 * active.deceleration * dt)
    }

    /// Where its set-points are, for a reader.
    pub fn phase(&self) -> String {
        let active = self.active.map(|(active, phase)| (active.index, phase));
        format!("{active:?} held {} runs on {:?}", self.held, self.runs_on)
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

    /// A way of this length is none, for all that 6064h shows.
    pub fn no_way(&self) -> f64 {
        self.making.window + 2.0 + 2.0 * f64::from(self.making.dither)
    }

    /// Where 6064h shows this target.
    pub const fn zero(&self) -> f64 {
        self.zero
    }

    /// Nothing unusual happens from now on.
    pub fn heal(&mut self) {
        self.habits = Habits::default();
        self.wrong_state = None;
        self.wrong_bit = None;
        self.flap = None;
        self.cause_until = 0;
        self.hold_outputs = 0;
        self.hold_inputs = 0;
        self.power_wait = 0;
        self.mode_wait = 0;
        self.push = 0.0;
        self.blocked = 0;
        self.deaf = 0;
        self.held = 0;
        self.stale_reached = 0;
        self.next_incident = u64::MAX;
        if let Some((_, Phase::Waits { ticks, .. })) = &mut self.active {
            *ticks = 0;
        }
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
        if self.now >= self.next_incident {
            self.next_incident = self.now + 1 + self.random.below(self.making.incidents * 2);
            self.incident();
        }
        self.step_hold();
        self.deaf = self.deaf.saturating_sub(1);
        if self.deaf > 0 {
            // It goes on with what it was told before.
        } else if self.hold_outputs > 0 && self.outputs_late < LATE {
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
        self.step_acknowledge(&out);
        self.step_reached(&out);
        self.before = out.word;
        self.show();
        self.step_wrong_bit();
    }

    fn incident(&mut self) {
        const EVENTS: [Habit; 19] = [
            Habit::FaultReactionLeft,
            Habit::FaultResetsItself,
            Habit::Fault,
            Habit::FaultCoasts,
            Habit::OutputsLate,
            Habit::InputsLate,
            Habit::OwnQuickStop,
            Habit::OwnSwitchOff,
            Habit::OwnDisable,
            Habit::OwnEnable,
            Habit::Inhibited,
            Habit::WrongWord,
            Habit::WrongWords,
            Habit::FaultReactionLeftMoving,
            Habit::ModeFlaps,
            Habit::Forgets,
            Habit::Push,
            Habit::Blocked,
            Habit::LocalControl,
        ];
        if !self.habits.any(Habits::of(&EVENTS)) {
            self.next_incident = u64::MAX;
            return;
        }
        let from = self.random.below(EVENTS.len() as u64) as usize;
        let mut events = EVENTS.iter().cycle().skip(from).take(EVENTS.len());
        let Some(&habit) = events.find(|habit| self.habits.has(**habit)) else {
            return;
        };
        if self.undergoes(habit) {
            self.hits.hit(habit);
        }
    }

    /// Whether this can come over it now.
    fn undergoes(&mut self, habit: Habit) -> bool {
        let powered = self.state.is_powered();
        let enabled = self.state == State::Enabled;
        let may = match habit {
            Habit::FaultReactionLeft | Habit::FaultReactionLeftMoving => powered,
            Habit::Fault | Habit::FaultResetsItself | Habit::FaultCoasts => !matches!(
                self.state,
                State::FaultReaction | State::Fault | State::NotReady
            ),
            Habit::OwnQuickStop | Habit::OwnDisable => enabled,
            Habit::OwnSwitchOff => powered && self.state != State::FaultReaction,
            Habit::OwnEnable => {
                let off = [State::SwitchOnDisabled, State::Ready, State::SwitchedOn];
                off.contains(&self.state) && self.out_seen
            }
            Habit::Inhibited => matches!(self.state, State::Ready | State::SwitchedOn),
            Habit::Forgets => self.active.is_some() && enabled && self.random.one_in(16),
            // What is held longer would be older than three ticks.
            Habit::InputsLate => self.hold_inputs == 0,
            _ => true,
        };
        if !may {
            return false;
        }
        match habit {
            Habit::WrongWord | Habit::WrongWords => {
                let bits = self.random.pick(&[
                    0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08, 0x31, 0x33, 0x37, 0x17, 0x1F,
                    0x18, 0x50, 0x60, 0x6F, 0x7F,
                ]);
                let more = match habit {
                    Habit::WrongWords => 1 + self.random.below(4) as u32,
                    _ => 0,
                };
                self.wrong_state = Some((bits, more));
            }
            Habit::FaultReactionLeft | Habit::FaultReactionLeftMoving => {
                if habit == Habit::FaultReactionLeft {
                    self.drop_all();
                }
                let ticks = self.random.pick(&[1, 1, 1, 3, 20]);
                self.leave_to(State::FaultReaction);
                self.reaction_until = self.now + ticks;
            }
            Habit::Fault | Habit::FaultResetsItself | Habit::FaultCoasts => {
                self.drop_all();
                let lasting = self.random.pick(&[0.0, 0.0, 0.0, 0.3]);
                self.cause_until = self.now + u64::from(self.ticks(lasting));
                self.fault_since = self.now;
                if habit == Habit::FaultCoasts || !powered {
                    self.leave_to(State::Fault);
                } else {
                    self.leave_to(State::FaultReaction);
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
            Habit::InputsLate => self.hold_inputs = 1 + self.random.below(2) as u32,
            Habit::OwnQuickStop | Habit::OwnDisable | Habit::OwnSwitchOff => {
                self.drop_all();
                let state = match habit {
                    Habit::OwnQuickStop => State::QuickStop,
                    Habit::OwnDisable => State::SwitchedOn,
                    _ => {
                        let off = [State::SwitchOnDisabled, State::Ready, State::NotReady];
                        self.random.pick(&off)
                    }
                };
                self.leave_to(state);
                self.power_wait = self.random.pick(&[3, 10, 60]);
            }
            Habit::OwnEnable => {
                self.enable();
                // It is seen, and the word that leads it down is obeyed.
                self.power_wait = self.random.below(u64::from(2 * self.making.drive_cycle)) as u32;
            }
            Habit::Inhibited => {
                let seconds = self.random.pick(&[0.02, 0.1, 0.6]);
                self.power_wait = self.ticks(seconds);
            }
            Habit::Forgets => self.drop_all(),
            Habit::Push => self.push = f64::from(self.random.between(-40_000, 40_000)),
            Habit::Blocked | Habit::LocalControl => {
                let seconds = self.random.pick(&[0.005, 0.05, 0.3]);
                let ticks = self.ticks(seconds);
                if habit == Habit::Blocked {
                    self.blocked = ticks;
                } else {
                    self.deaf = ticks;
                }
            }
            _ => return false,
        }
        true
    }

    /// Its input holds what it has begun, and lets it go on.
    fn step_hold(&mut self) {
        self.held = self.held.saturating_sub(1);
        if self.held > 0 || !self.habits.has(Habit::Held) {
            return;
        }
        let goes = match self.mode {
            1 => match self.active {
                Some((_, phase)) => !matches!(phase, Phase::Stands { .. }),
                None => self.runs_on.is_some(),
            },
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
            // Its bit 10 is low from now on: it has begun, and is held there.
            self.set_off();
            self.hits.hit(Habit::Held);
        }
    }

    fn set_off(&mut self) {
        if let Some((active, phase @ Phase::Waits { .. })) = &mut self.active {
            *phase = Phase::Runs;
            self.ledger[active.index].began.get_or_insert(self.now);
        }
    }

    fn step_power(&mut self, out: &Outputs) {
        if self.power_wait > 0 {
            self.power_wait -= 1;
            return;
        }
        let before = self.state;
        let off = out.is_disable_voltage();
        match self.state {
            State::NotReady => self.state = State::SwitchOnDisabled,
            State::SwitchOnDisabled => {
                if out.is_shutdown() {
                    self.state = State::Ready;
                }
            }
            State::Ready => {
                if off || out.is_quick_stop() {
                    self.state = State::SwitchOnDisabled;
                } else if out.is_disable_operation() || out.is_enable_operation() {
                    self.state = State::SwitchedOn;
                }
            }
            State::SwitchedOn => {
                if off || out.is_quick_stop() {
                    self.state = State::SwitchOnDisabled;
                } else if out.is_shutdown() {
                    self.state = State::Ready;
                } else if out.is_enable_operation() && self.may_come_back() {
                    self.enable();
                }
            }
            State::Enabled => {
                if off {
                    self.leave_to(State::SwitchOnDisabled);
                } else if out.is_quick_stop() {
                    if !self.has(Habit::QuickStopIgnored) {
                        self.leave_to(State::QuickStop);
                    }
                } else if out.is_shutdown() {
                    self.leave_to(State::Ready);
                } else if out.is_disable_operation() {
                    self.leave_to(State::SwitchedOn);
                }
                if self.state != State::Enabled {
                    self.drop_all();
                }
            }
            State::QuickStop => {
                if off {
                    self.state = State::SwitchOnDisabled;
                } else if self.demand_velocity == 0.0 && self.velocity.abs() < 1_000.0 {
                    if self.making.quick_stop < 5 {
                        self.state = State::SwitchOnDisabled;
                    } else if out.is_enable_operation() && self.may_come_back() {
                        self.enable();
                    }
                }
            }
            State::FaultReaction => {
                if self.reaction_until != u64::MAX {
                    if self.now >= self.reaction_until && self.may_come_back() {
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
        if before != self.state {
            let late = !self.state.is_powered() && self.has(Habit::PowerLate);
            if late || self.has(Habit::ObeysLate) {
                self.power_wait = self.random.below(12) as u32;
            }
        }
    }

    fn leave_to(&mut self, state: State) {
        if self.state == State::Enabled {
            self.out_seen = false;
        }
        self.state = state;
    }

    /// Another state was seen, whatever frames were lost meanwhile (D4).
    fn may_come_back(&mut self) -> bool {
        self.out_seen || self.has(Habit::LeavesUnseen)
    }

    fn enable(&mut self) {
        self.state = State::Enabled;
        self.demand = self.position.round();
        self.demand_velocity = 0.0;
        self.last_target = self.demand;
        self.base_lost = self.making.base == Base::PreviousTarget;
        self.ack = false;
        self.ack_due = None;
        self.homing = None;
        // Where bit 4 is high, that would be the answer to a set-point.
        let answers = self.out.bit(4) || self.host_starts;
        if !answers && self.has(Habit::AckAtEnable) {
            self.ack = true;
            self.ack_hold = self.random.below(40) as u32;
        }
    }

    /// All set-points are gone.
    fn drop_all(&mut self) {
        if let Some((active, _)) = self.active.take() {
            self.end(active.index, End::Dropped);
        }
        if let Some(next) = self.pending.take() {
            self.end(next.index, End::Dropped);
        }
        self.runs_on = None;
        self.at_limit = false;
        self.stale_reached = 0;
        self.homing = None;
        self.ack_due = None;
    }

    fn end(&mut self, index: usize, end: End) {
        let now = self.now;
        if let Some(latch) = self.ledger.get_mut(index) {
            latch.end.get_or_insert((now, end));
            self.recent = Some(index);
        }
        self.base_lost |= end == End::Limited;
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
        let edge = out.bit(4) && self.before & NEW_SET_POINT == 0;
        if self.state != State::Enabled || !edge {
            return;
        }
        match self.mode {
            1 => self.latch(out),
            6 => {
                self.homing = Some(self.random.pick(&[2, 30, 100, 300]));
                self.homings.0 += 1;
                self.base_lost = true;
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
            self.overrun = Some(out.velocity);
            return;
        }
        // Onto a full buffer the fall of bit 12 is the acknowledge: it is taken there.
        if !self.ack && self.random.one_in(30) && self.has(Habit::EdgeIgnored) {
            return;
        }
        let behind = self.active.map(|(active, _)| active).filter(|_| !immediate);
        let moves = self.demand_velocity != 0.0
            || (self.position - self.demand).abs() > self.making.window / 2.0;
        let goal = if relative {
            let base = match (behind, self.making.base) {
                (Some(active), _) => self.ledger[active.index].goal,
                (None, Base::PreviousTarget) => self.last_target,
                (None, Base::Demand) => self.demand,
                (None, Base::Actual) => self.position,
            };
            base.round() + f64::from(out.target)
        } else {
            let goal = f64::from(out.target) + self.zero;
            let from = behind.map_or(self.demand, |active| self.ledger[active.index].goal);
            self.around(from, goal)
        };
        let from = behind.map_or(self.demand, |active| active.to);
        // One that goes on at its end is not limited (S5).
        let stops = out.end_velocity == 0;
        let limit = if stops {
            self.limit_of(from, goal)
        } else {
            None
        };
        let known = !relative
            || (!self.base_lost
                && behind.is_none_or(|before| {
                    self.ledger[before.index].known && before.end_velocity == 0.0
                })
                && (!moves || self.making.base == Base::PreviousTarget));
        let now = self.now;
        let index = self.ledger.len();
        self.base_lost &= relative;
        self.ledger.push(Latch {
            out: Outputs {
                word: out.word & !0x260 | bits & 0x260,
                ..*out
            },
            relative,
            blend,
            goal,
            limit,
            way: (goal - from).abs(),
            lag: (self.demand - self.position).abs(),
            known,
            behind: behind.is_some(),
            in_motion: moves,
            began: None,
            arrived: None,
            end: None,
            taken: now,
            still: false,
            nearest: f64::INFINITY,
        });
        let set_point = SetPoint {
            index,
            to: limit.unwrap_or(goal),
            limited: limit.is_some(),
            velocity: f64::from(out.velocity.max(1)),
            acceleration: f64::from(out.acceleration.max(1)),
            deceleration: f64::from(out.deceleration.max(1)),
            end_velocity: f64::from(out.end_velocity),
            blend,
        };
        self.last_target = goal;
        if immediate {
            let active = self.active.take().map(|(active, _)| active);
            for old in active.into_iter().chain(self.pending.take()) {
                self.end(old.index, End::Replaced);
            }
        }
        if self.active.is_none() {
            self.take_up(set_point);
        } else {
            self.pending = Some(set_point);
            self.ledger[index].still = self.is_still(index);
        }
        let full = self.ack && self.making.ack == Ack::Buffer;
        // A buffer that is full shows that for as long as it is.
        let shows = self.making.ack == Ack::Buffer && self.pending.is_some();
        let silent = !shows && self.random.one_in(30) && self.has(Habit::AckMissing);
        if !full && !silent {
            self.ack_due = Some(if self.has(Habit::AckLate) {
                self.random.below(25) as u32
            } else {
                0
            });
        }
    }

    /// Where it ends a set-point that leads to `goal` from there, if it limits it.
    fn limit_of(&mut self, from: f64, goal: f64) -> Option<f64> {
        const CLAMPS: Habits = Habits::of(&[Habit::Clamps, Habit::ClampOfOneSample]);
        const SWINGS: Habits = Habits::of(&[Habit::Overshoot, Habit::Creeps]);
        let (least, most) = self.making.limits;
        // One that stands beyond its range already goes no further.
        let within = goal.clamp(least.min(from), most.max(from));
        // S5: no axis overshoots, or lags, as far as its target is away.
        let swings = self.habits.any(SWINGS);
        let swings_there = |short: f64| swings && short < FURTHEST_SWING;
        if within != goal && !swings_there((within - goal).abs()) && self.has(Habit::Limits) {
            return Some(within);
        }
        let clamps = self.habits.any(CLAMPS);
        if !clamps || !self.random.one_in(2) {
            return None;
        }
        let (way, window) = ((goal - from).abs(), self.making.window);
        let short = self
            .random
            .pick(&[2.0 * window, 5.0 * window, 300.0, way * 0.3, way * 0.9]);
        if short < 2.0 * window || way - short <= 2.0 * window {
            return None;
        }
        if swings_there(short) {
            return None;
        }
        if self.habits.has(Habit::Clamps) {
            self.hits.hit(Habit::Clamps);
        }
        Some((goal - short.copysign(goal - from)).round())
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
        from + if forward > behind {
            forward - length
        } else {
            forward
        }
    }

    /// Whether the axis rests where this one leads, and those before it are over: nothing need show that it is over, too.
    pub fn is_still(&self, index: usize) -> bool {
        let latch = &self.ledger[index];
        let over = |before: &Latch| before.still || before.arrived.is_some();
        let is_next = self
            .active
            .is_none_or(|(active, _)| active.index == index || over(&self.ledger[active.index]));
        let near = self.apart(latch.goal, self.position) <= self.no_way();
        let short = latch.way <= 2.0 * self.no_way();
        latch.still || (self.demand_velocity == 0.0 && near && short && is_next)
    }

    /// Its turn has come, with nothing before it.
    fn take_up(&mut self, set_point: SetPoint) {
        self.runs_on = None;
        let longest = self
            .making
            .begin
            .saturating_sub(4 * self.making.drive_cycle + 4);
        let longest = u64::from(longest.max(1));
        let mut phase = Phase::Runs;
        if self.demand_velocity == 0.0 && self.held == 0 {
            // It may stay high, and does not rise.
            let late = if self.has(Habit::StartDelayShownReached) {
                Some(self.reached)
            } else if self.has(Habit::StartDelay) {
                Some(false)
            } else {
                None
            };
            if let Some(reached) = late {
                let part = self.random.pick(&[longest, longest.div_ceil(4), 8]);
                let ticks = self.random.below(part) as u32;
                phase = Phase::Waits { ticks, reached };
            }
            if self.random.one_in(4) && self.has(Habit::BeginsTooLate) {
                let ticks = self.making.begin + self.random.below(longest) as u32;
                let reached = self.reached && self.random.one_in(2);
                phase = Phase::Waits { ticks, reached };
            }
        }
        if phase == Phase::Runs && self.stands_at_a_limit() {
            // In two samples that arrive (S5).
            let ticks = self.ticks(MISSING);
            let reached = self.reached;
            phase = Phase::Waits { ticks, reached };
        }
        self.active = Some((set_point, phase));
        self.ledger[set_point.index].still = self.is_still(set_point.index);
        if phase == Phase::Runs {
            self.begin(set_point.index);
        }
    }

    /// Whether a set-point that it has limited may not have been seen there, since samples are missing.
    fn stands_at_a_limit(&self) -> bool {
        const LOSES: Habits = Habits::of(&[
            Habit::FramesLost,
            Habit::FramesLate,
            Habit::FramesDoubled,
            Habit::HostStands,
        ]);
        let end = self.recent.and_then(|index| self.ledger[index].end);
        self.habits.any(LOSES)
            && !self.habits.has(Habit::ClampOfOneSample)
            && matches!(end, Some((_, End::Limited)))
            && self.demand_velocity == 0.0
    }

    fn begin(&mut self, index: usize) {
        let latch = &mut self.ledger[index];
        latch.began.get_or_insert(self.now);
        latch.in_motion = self.demand_velocity != 0.0;
        self.at_limit = false;
        if self.reached && self.demand_velocity == 0.0 && self.has(Habit::Bit10Stale) {
            let most = 2 * self.making.drive_cycle - u32::from(self.making.ages[0]);
            self.stale_reached = self.random.below(u64::from(most) + 1) as u32;
        }
    }

    fn step_demand(&mut self, out: &Outputs) {
        let dt = self.making.tick;
        match self.state {
            State::QuickStop | State::FaultReaction => {
                if self.state == State::FaultReaction && self.reaction_until != u64::MAX {
                    // What it has kept goes on, and waits no more.
                    if self.active.is_some() {
                        self.set_off();
                        self.follow(dt);
                        return;
                    }
                    if let Some(velocity) = self.runs_on {
                        self.approach_velocity(velocity, self.making.quick_ramp, dt);
                        return;
                    }
                }
                self.approach_velocity(0.0, self.making.quick_ramp, dt);
            }
            State::Enabled => {
                let halted = out.bit(8) && !self.ignores_halt();
                match self.mode {
                    1 => self.position_mode(halted, dt),
                    3 => {
                        self.base_lost = true;
                        let stops = halted || self.held > 0;
                        let wanted = if stops { 0 } else { out.target_velocity };
                        let ramp = f64::from(out.acceleration.max(1));
                        self.approach_velocity(f64::from(wanted), ramp, dt);
                    }
                    6 => self.homing_mode(out, halted, dt),
                    // It goes at once to where 607Ah leads.
                    8 => {
                        self.demand = self.around(self.demand, f64::from(out.target) + self.zero);
                        self.demand_velocity = 0.0;
                    }
                    _ => self.approach_velocity(0.0, self.making.quick_ramp, dt),
                }
            }
            _ => {
                self.demand = self.position;
                self.demand_velocity = 0.0;
            }
        }
    }

    fn ignores_halt(&mut self) -> bool {
        if self.before & HALT == 0 {
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
        let quick = self.making.quick_ramp;
        if halted {
            self.halted_at = self.now;
            let ramp = self.active.map_or(quick, |(active, _)| active.deceleration);
            self.approach_velocity(0.0, ramp, dt);
            let new = self.before & HALT == 0 && self.random.one_in(4);
            let goes = self.active.is_some() || self.runs_on.is_some();
            let rests = goes && self.demand_velocity == 0.0;
            if (rests && self.has(Habit::HaltForgets))
                || (goes && new && self.has(Habit::HaltForgetsUntold))
            {
                self.drop_all();
            }
            return;
        }
        let Some((active, phase)) = self.active else {
            let velocity = match self.runs_on {
                Some(velocity) if self.held == 0 => velocity,
                _ => 0.0,
            };
            self.approach_velocity(velocity, quick, dt);
            return;
        };
        match phase {
            Phase::Waits { ticks, reached } if ticks > 0 => {
                let ticks = ticks - 1;
                self.active = Some((active, Phase::Waits { ticks, reached }));
            }
            Phase::Waits { .. } => {
                self.set_off();
                self.begin(active.index);
                self.follow(dt);
            }
            Phase::Runs if self.held > 0 => {
                let way = active.to - self.demand;
                self.approach_velocity(0.0, active.deceleration, dt);
                // What was to pass its end has passed it, on the ramp.
                self.pass(active, way);
            }
            Phase::Runs => self.follow(dt),
            Phase::Stands { ticks, reached } => self.stand(active, ticks, reached, dt),
        }
    }

    fn follow(&mut self, dt: f64) {
        let Some((active, _)) = self.active else {
            return;
        };
        let way = active.to - self.demand;
        // One behind it begins at rest.
        let least = self.passing_velocity(active);
        let stop = (2.0 * active.deceleration * way.abs() + least * least).sqrt();
        let wanted = if self.blends(active, way) {
            active.velocity
        } else {
            active.velocity.min(stop)
        }
        .copysign(way);
        let near = way.abs() <= (2.0 * active.deceleration * dt * dt).max(0.5);
        let slow = self.demand_velocity.abs() <= 4.0 * active.deceleration * dt;
        let began = self.ledger[active.index].began;
        let early = began == Some(self.now) && !self.making.at_once;
        if near && slow && !early && (way == 0.0 || self.stops_at(active, way)) {
            self.demand = active.to;
            self.demand_velocity = 0.0;
            self.ledger[active.index].arrived.get_or_insert(self.now);
            self.at_limit = active.limited;
            let reached = active.limited || self.pending.is_none() || self.making.rises_between;
            let ticks = if active.limited {
                self.stand_of_a_limit()
            } else {
                0
            };
            self.active = Some((active, Phase::Stands { ticks, reached }));
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
        self.pass(active, way);
    }

    /// For how many ticks it stands where it has limited a set-point, with bit 10.
    fn stand_of_a_limit(&mut self) -> u32 {
        if self.has(Habit::ClampOfOneSample) {
            1
        } else {
            // S5: it shows that when bit 10 is of set-points again.
            let since = (self.now - self.halted_at).min(1_000) as u32;
            let shows_nothing = 2 * self.making.drive_cycle + 6;
            2 * self.making.drive_cycle + shows_nothing.saturating_sub(since)
        }
    }

    /// It goes on when the axis was seen at its end (S5).
    fn stand(&mut self, active: SetPoint, ticks: u32, reached: bool, dt: f64) {
        // As counts show it.
        let near = (self.visible.position - active.to).abs() < self.making.window + 0.5;
        if !near {
            self.has(Habit::Overshoot);
            self.has(Habit::Creeps);
        }
        if active.limited {
            let ticks = if near && self.word() & REACHED != 0 {
                ticks - 1
            } else {
                self.stand_of_a_limit()
            };
            if ticks > 0 {
                self.active = Some((active, Phase::Stands { ticks, reached }));
                return;
            }
            self.end(active.index, End::Limited);
            if let Some(next) = self.pending {
                let next = &mut self.ledger[next.index];
                next.known &= !next.relative;
            }
        } else {
            if !near && !self.has(Habit::GoesOnEarly) {
                return;
            }
            self.end(active.index, End::Reached);
        }
        self.active = None;
        let Some(next) = self.pending.take() else {
            return;
        };
        self.take_up(next);
        if self.held == 0 && self.has(Habit::Dwell) {
            let longest = self
                .making
                .begin
                .saturating_sub(4 * self.making.drive_cycle + 4);
            let longest = longest.clamp(1, self.ticks(0.3));
            let ticks = self.random.below(u64::from(longest)) as u32;
            let reached = self.reached && self.random.one_in(2);
            self.ledger[next.index].began = None;
            self.active = Some((next, Phase::Waits { ticks, reached }));
            self.stale_reached = 0;
        }
        if let Some((_, Phase::Runs)) = self.active {
            self.follow(dt);
        }
    }

    /// Whether it stops at its end.
    fn stops_at(&self, active: SetPoint, way: f64) -> bool {
        self.passing_velocity(active) == 0.0 && !self.blends(active, way)
    }

    /// Whether the one behind it takes over at its end, in motion.
    fn blends(&self, active: SetPoint, way: f64) -> bool {
        !active.limited
            && self
                .pending
                .is_some_and(|next| next.blend && (next.to - active.to) * way > 0.0)
    }

    /// How fast it passes its end, with none behind it.
    fn passing_velocity(&self, active: SetPoint) -> f64 {
        if active.limited || self.pending.is_some() {
            0.0
        } else {
            active.end_velocity
        }
    }

    /// Where the demand has passed the end, from where it had this way to go, and goes on there.
    fn pass(&mut self, active: SetPoint, way: f64) {
        if (active.to - self.demand) * way > 0.0 || self.stops_at(active, way) {
            return;
        }
        let velocity = self.passing_velocity(active);
        self.ledger[active.index].arrived.get_or_insert(self.now);
        self.end(active.index, End::Passed);
        if velocity > 0.0 {
            self.active = None;
            self.runs_on = Some(velocity.copysign(way));
        } else {
            self.active = self.pending.take().map(|next| (next, Phase::Runs));
            if let Some((next, _)) = self.active {
                self.ledger[next.index].began = Some(self.now);
                self.ledger[next.index].in_motion = true;
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
        let before = self.position;
        if self.blocked > 0 {
            self.blocked -= 1;
            self.velocity = 0.0;
            if (self.demand - self.position).abs() > 500.0 && self.state == State::Enabled {
                // A following error.
                self.blocked = 0;
                self.demand = self.position;
                self.demand_velocity = 0.0;
                self.undergoes(Habit::Fault);
            }
        } else {
            self.step_shaft();
        }
        let active = self.active.map(|(active, _)| active.index);
        let (low, high) = (before.min(self.position), before.max(self.position));
        // The axis follows the demand, which may have passed two ends meanwhile.
        let before_that = self.recent.and_then(|recent| recent.checked_sub(1));
        let passed = |index: &usize| {
            self.ledger[*index]
                .end
                .is_some_and(|(_, end)| end == End::Passed)
        };
        let before_that = before_that.filter(passed);
        for index in active.into_iter().chain(self.recent).chain(before_that) {
            let latch = &mut self.ledger[index];
            let over = latch.limit.is_some() && active.is_some_and(|active| active != index);
            if !over && (latch.began.is_some() || latch.still) {
                let away = (low - latch.goal).max(latch.goal - high).max(0.0);
                latch.nearest = latch.nearest.min(away);
            }
        }
    }

    fn step_shaft(&mut self) {
        let dt = self.making.tick;
        if !self.state.is_powered() {
            // Friction.
            let loss = 200_000.0 * dt;
            self.velocity = if self.velocity.abs() <= loss {
                0.0
            } else {
                self.velocity - loss.copysign(self.velocity)
            };
            self.position += self.velocity * dt;
            return;
        }
        let away = self.demand - self.position;
        if self.demand_velocity == 0.0
            && self.push == 0.0
            && away.abs() < 1e-3
            && self.velocity.abs() < 1e-1
        {
            self.position = self.demand;
            self.velocity = 0.0;
            return;
        }
        let steps = (self.making.frequency * dt / 0.25).ceil().max(1.0);
        let part = dt / steps;
        let (w, z) = (self.making.frequency, self.making.damping);
        // The demand of the cycle is followed from where it was.
        let mut demand = self.demand - self.demand_velocity * dt;
        for _ in 0..steps as u32 {
            demand += self.demand_velocity * part;
            let slip = self.making.feed_forward * self.demand_velocity - self.velocity;
            let pull = w * w * (demand - self.position) + 2.0 * z * w * slip + self.push;
            self.velocity += pull * part;
            self.position += self.velocity * part;
        }
        self.push = if self.push.abs() < 1.0 {
            0.0
        } else {
            self.push * 0.9
        };
    }

    /// Bit 12 in mode 1.
    fn step_acknowledge(&mut self, out: &Outputs) {
        if let Some(left) = self.ack_due {
            if left > 0 {
                self.ack_due = Some(left - 1);
                return;
            }
            self.ack = true;
            self.ack_due = None;
            if self.making.ack == Ack::Handshake && self.has(Habit::AckOfOneCycle) {
                self.ack_pulse = true;
            }
            if self.making.ack == Ack::Handshake && self.has(Habit::AckOf100Ms) {
                self.ack_hold = self.ticks(0.1);
            }
        } else if self.ack_pulse {
            self.ack = false;
            self.ack_pulse = false;
        } else if self.ack && !out.bit(4) {
            if self.ack_hold > 0 {
                self.ack_hold -= 1;
            } else if self.making.ack == Ack::Handshake || self.pending.is_none() {
                self.ack = false;
            }
        }
    }

    /// Bit 10 in mode 1.
    fn step_reached(&mut self, out: &Outputs) {
        let at_rest = self.demand_velocity == 0.0;
        let by_window = self.habits.has(Habit::Bit10ByWindow);
        let of_a_rest = if by_window {
            (self.position - self.demand).abs() <= self.making.window
        } else {
            at_rest
        };
        let now = if out.bit(8) && self.state == State::Enabled {
            let quiet = self.habits.has(Habit::HaltWithoutBit10) && self.mode == 1;
            if quiet && at_rest && self.before & HALT == 0 {
                self.hits.hit(Habit::HaltWithoutBit10);
            }
            at_rest && !quiet
        } else {
            match self.active {
                Some((_, Phase::Runs)) => false,
                Some((_, Phase::Waits { reached, .. })) => reached,
                Some((_, Phase::Stands { reached, .. })) => reached && of_a_rest,
                None => self.runs_on.is_some() || of_a_rest,
            }
        };
        self.reached_since = if now {
            self.reached_since.saturating_add(1)
        } else {
            0
        };
        let waits = matches!(self.active, Some((_, Phase::Waits { .. })));
        let needed = if by_window && !waits {
            self.making.window_ticks
        } else {
            0
        };
        let was = self.reached;
        self.reached = now && self.reached_since > needed;
        if was != self.reached && by_window {
            self.hits.hit(Habit::Bit10ByWindow);
        }
        if self.stale_reached > 0 {
            self.stale_reached -= 1;
            self.reached = true;
        }
    }

    /// One bit is wrong now and then, for one drive cycle at most. Before that all have been right for two, in frames that arrived.
    fn step_wrong_bit(&mut self) {
        const BITS: [(Habit, u16); 3] = [
            (Habit::Bit10Wrong, REACHED),
            (Habit::Bit11Wrong, LIMIT),
            (Habit::Bit12Wrong, ACKNOWLEDGE),
        ];
        const WRONG: Habits = Habits::of(&[
            Habit::Bit10Wrong,
            Habit::Bit11Wrong,
            Habit::Bit12Wrong,
            Habit::WrongBits,
        ]);
        if let Some(wrong) = &mut self.wrong_bit {
            wrong.ticks -= 1;
            if wrong.ticks == 0 {
                self.wrong_bit = None;
                self.right_for = 0;
            }
            self.arrived_in_tick = false;
            return;
        }
        self.right_for += u32::from(core::mem::take(&mut self.arrived_in_tick));
        if self.right_for <= self.wrong_after || !self.habits.any(WRONG) {
            return;
        }
        let drive_cycle = u64::from(self.making.drive_cycle);
        self.wrong_after = (2 * drive_cycle + self.random.below(80)) as u32;
        self.right_for = 0;
        let (habit, bit) = self.random.pick(&BITS);
        let longer = self.random.one_in(16) && self.habits.has(Habit::WrongBits);
        if !longer && !self.habits.has(habit) {
            return;
        }
        let answers = self.host_starts && bit == ACKNOWLEDGE;
        if answers && !longer {
            return;
        }
        self.hits.hit(if longer { Habit::WrongBits } else { habit });
        let ticks = if longer {
            2 * drive_cycle + self.random.below(3 * drive_cycle)
        } else {
            1 + self.random.below(drive_cycle)
        } as u32;
        let high = self.visible.word & bit == 0;
        self.wrong_bit = Some(WrongBit { bit, high, ticks });
    }

    fn show(&mut self) {
        let now = self.shown();
        self.past[self.now as usize % PAST] = now;
        if self.hold_inputs > 0 {
            self.hold_inputs -= 1;
            return;
        }
        if self.making.ages == [0; 4] {
            self.visible = now;
            return;
        }
        self.hits.hit(Habit::Skew);
        let [word, mode, position, velocity] = self
            .making
            .ages
            .map(|age| self.past[(self.now + PAST as u64 - u64::from(age)) as usize % PAST]);
        self.visible = Shown {
            word: word.word,
            mode: mode.mode,
            position: position.position,
            counts: position.counts,
            velocity: velocity.velocity,
            error: word.error,
        };
    }

    fn shown(&mut self) -> Shown {
        let mut bits = self.state.bits();
        if let Some((wrong, more)) = self.wrong_state {
            bits = wrong;
            self.wrong_state = more.checked_sub(1).map(|left| (wrong, left));
        }
        let remote = if self.deaf > 0 { 0 } else { 0x0200 };
        let mut word = bits | 0x0010 | remote;
        if self.state == State::Enabled && self.mode == 6 {
            let at_rest = self.demand_velocity == 0.0;
            if self.homing.is_some() {
                // In progress.
            } else if self.homing_failed {
                word |= 0x2000 | if at_rest { REACHED } else { 0 };
            } else if self.homed {
                let quiet = self.has(Habit::HomingWithoutBit10);
                word |= ACKNOWLEDGE | if at_rest && !quiet { REACHED } else { 0 };
            } else if !self.has(Habit::HomingShowsProgress) {
                word |= REACHED;
            }
        } else {
            if self.reached {
                word |= REACHED;
            }
            if self.at_limit && self.making.shows_limit {
                word |= LIMIT;
            }
            if self.ack && self.mode == 1 {
                word |= ACKNOWLEDGE;
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
        let counts = self.position - self.zero;
        let counts = (counts + 0.5_f64.copysign(counts)) as i32 + noise;
        let counts = match self.making.turn {
            Some((least, length)) => {
                (least + (i64::from(counts) - least).rem_euclid(length)) as i32
            }
            None => counts,
        };
        let noise_of_velocity = if self.making.velocity_noise > 0 && self.has(Habit::VelocityNoise)
        {
            let noise = self.making.velocity_noise;
            self.random.between(-noise, noise)
        } else {
            0
        };
        Shown {
            word,
            mode,
            position: self.position + f64::from(noise),
            counts,
            velocity: self.velocity as i32 + noise_of_velocity,
            error: if self.state == State::Fault {
                0x8611
            } else {
                0
            },
        }
    }
}

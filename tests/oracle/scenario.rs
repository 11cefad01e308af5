//! One scenario: a core, a cable, a drive of some habits and a program, all from one seed, judged in every cycle.

use core::time::Duration;
use std::collections::VecDeque;

use servocrab::axis::{
    AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Delivery, Event, Failure,
    Inputs, Referencing, StopRequest,
};
use servocrab::ds402::{self, Mode, QuickStopOption};
use servocrab::homing::{HomingCommand, HomingMethod};
use servocrab::profile_position::{
    BufferMode, BufferSignal, MoveCommand, Parameters, PositionRange, Reference, RelativeBase,
    SetPoint, StartBits, Traits,
};
use servocrab::profile_velocity::JogSetPoint;

use crate::drive::{
    Ack, Base, Drive, End, INPUT_BYTES, Latch, Making, OUTPUT_BYTES, Outputs, State,
};
use crate::habits::{ALL, FIRST, Habit, Habits, Hits, SECOND};
use crate::random::Random;

/// What is left out of a scenario, to find what matters in it.
#[derive(Debug, Clone, Default)]
pub struct Cut {
    pub habits: Habits,
    pub commands: Vec<u32>,
}

/// A law that did not hold.
#[derive(Debug, Clone)]
pub struct Violation {
    pub law: &'static str,
    pub what: String,
    pub cycle: u64,
}

/// What came of a scenario.
#[derive(Debug, Default)]
pub struct Told {
    pub cycles: u64,
    pub set_points: u64,
    pub commands: u32,
    pub habits: Habits,
    pub hits: Hits,
    pub ends: Ends,
    pub violation: Option<Violation>,
    pub transcript: VecDeque<String>,
    /// How the scenario is made, for a reader.
    pub making: String,
}

/// What was said of set-points that drives had taken.
#[derive(Debug, Default, Clone, Copy)]
pub struct Ends {
    /// Reached, or passed.
    pub arrived: u64,
    /// Ended by the program, or by the drive.
    pub ended: u64,
    /// Nobody knows.
    pub doubtful: u64,
}

impl Ends {
    pub const fn add(&mut self, other: Self) {
        self.arrived += other.arrived;
        self.ended += other.ended;
        self.doubtful += other.doubtful;
    }
}

/// Failures that leave open what has become of a set-point, or that a drive without habits gives no reason for.
const DOUBTS: [&str; 3] = ["Unknown", "MissedTarget", "Timeout"];

/// Scenarios from this seed on are of more kinds: modulo axes, liveness, drives whose bits have other meanings, and drives without habits. Those
/// below are as they were when a seed of them was kept.
pub const WIDER: u64 = 1_000_000_000_000_000;

/// From this seed on there are drives that are held on their way, and moves that end in motion.
pub const HELD: u64 = 2 * WIDER;

/// From this seed on there are drives with all habits, below it with the first ones.
pub const ALL_HABITS: u64 = 4 * WIDER;

/// The habits of the scenarios from this seed on.
pub const fn habits_of(seed: u64) -> &'static [Habit] {
    match seed {
        ..HELD => FIRST,
        HELD..ALL_HABITS => SECOND,
        ALL_HABITS.. => ALL,
    }
}

/// What a scenario of a wider kind has, apart from habits.
#[derive(Debug, Clone, Copy, Default)]
struct Wider {
    /// No habits at all.
    sound: bool,
    /// Before its end everything that was asked for comes to its own.
    patient: bool,
    /// A sound drive homes twice at the end.
    homes: bool,
    turn: Option<PositionRange>,
    one_way: bool,
    /// Liveness expires at times.
    expires: bool,
    /// 605Dh = 0.
    halt_coasts: bool,
    bits_first: bool,
    passes_by_bit_5: bool,
    /// 605Ah of 7 or 8.
    quick_stop: Option<u8>,
    begin: Option<Duration>,
    /// Some moves pass their ends at this velocity.
    end_velocity: Option<u32>,
}

impl Wider {
    fn of(seed: u64) -> Self {
        if seed < WIDER {
            return Self::default();
        }
        let mut random = Random::new(!seed);
        let turn = |min, max| Some(PositionRange { min, max });
        let turns = [turn(0, 3_599), turn(-1_800, 1_799), turn(-9_000, 10_999)];
        Self {
            sound: random.one_in(16),
            patient: random.one_in(4),
            turn: random.pick(&turns).filter(|_| random.one_in(4)),
            one_way: random.one_in(2),
            expires: random.one_in(6),
            halt_coasts: random.one_in(8),
            bits_first: random.one_in(6),
            passes_by_bit_5: random.one_in(8),
            quick_stop: Some(random.pick(&[7, 8])).filter(|_| random.one_in(4)),
            begin: Some(Duration::from_millis(random.pick(&[400, 1000]))),
            homes: random.one_in(4),
            // No slower than what is surely no standstill.
            end_velocity: Some(random.pick(&[20_000, 40_000]))
                .filter(|_| random.one_in(6) && seed >= HELD),
        }
    }
}

/// Lines of a transcript that are kept.
const LINES: usize = 120;
const DISTURBED: u64 = 2_500;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Enable,
    Disable,
    Reset,
    Mode,
    Home,
    Jog,
    Move,
    Halt,
    Resume,
    Stop,
    QuickStop,
    Release,
}

impl Kind {
    const fn stops(self) -> bool {
        matches!(
            self,
            Self::Halt | Self::Stop | Self::QuickStop | Self::Disable | Self::Release
        )
    }
}

#[derive(Debug, Clone, Copy)]
struct Issued {
    kind: Kind,
    target: i32,
    since: u64,
    /// The drive had the power to move the axis when it was asked for.
    powered: bool,
    /// How many homings the drive had begun and ended by then.
    homings: (u64, u64),
    /// The axis was halted while it was under way.
    halted: bool,
    /// Its bit 4 went out with its name.
    sent: bool,
    accepted: bool,
    done: bool,
    /// Index in the drive's ledger.
    latch: Option<usize>,
    /// It was under way, or behind one that was, when the drive left Operation enabled and came back with its set-points gone, and nothing
    /// of that was in any inputs that came.
    unseen: bool,
}

/// The drive is out of Operation enabled.
#[derive(Debug, Clone, Copy)]
struct Out {
    /// Its cycle in which it left.
    since: u64,
    /// Whether inputs have come that show another state.
    shown: bool,
}

struct Scenario {
    core: AxisCore,
    kept: bool,
    drive: Drive,
    habits: Habits,
    program: Random,
    cable: Random,
    outputs: [u8; OUTPUT_BYTES],
    last_inputs: [u8; INPUT_BYTES],
    period: Duration,
    now: Duration,
    cycle: u64,
    /// Cycles of the bus for one of the drive.
    slow: u64,
    slow_left: u64,
    window: f64,
    settle: usize,
    /// And where 606Ch may shorten that.
    shorter: usize,
    shows_velocity: bool,
    limit: u64,
    stop_limit: u64,
    issued: Vec<Issued>,
    pending: Vec<u32>,
    gated: Vec<u32>,
    /// The last positions of the axis, newest last, and whether inputs came in that cycle.
    trail: VecDeque<(f64, bool)>,
    trail_length: usize,
    sent_before: Outputs,
    sent: Outputs,
    /// Since which cycle the words lead down or stop.
    stopping_since: Option<u64>,
    /// Since when the axis moves although a word that leads down has gone out.
    setting_off_since: Option<u64>,
    resume_asked: bool,
    next_command: u64,
    busy: u64,
    burst: u32,
    burst_kind: u8,
    jog: Option<u32>,
    ledger_seen: usize,
    at_rest_since: u64,
    cut: Cut,
    told: Told,
    verbose: bool,
    shown: (u16, u16),
    homes: bool,
    speed: i32,
    ramp: u32,
    blind: bool,
    out: Option<Out>,
    wider: Wider,
    expired: bool,
    /// How many cycles a set-point that nothing is in the way of may take to go out, and one to show that it has begun.
    send_limit: u64,
    begin_limit: u64,
    /// When something was in the way of the next set-point last, and when that or a bit 12 that is high.
    hindered: u64,
    blocked: u64,
    acknowledge: u64,
    /// After so many cycles the drive has surely seen a word.
    seen: u64,
}

/// Runs the scenario of this seed.
pub fn live(seed: u64, cut: &Cut, verbose: bool) -> Told {
    let mut scenario = Scenario::new(seed, cut.clone(), verbose);
    if scenario.run().is_err() {
        scenario.told.transcript.push_back(format!(
            "VIOLATION {:?}",
            scenario
                .told
                .violation
                .as_ref()
                .map(|violation| &violation.what)
        ));
    }
    scenario.told.cycles = scenario.cycle;
    scenario.told.set_points = scenario.drive.ledger.len() as u64;
    scenario.told.commands = scenario.issued.len() as u32;
    scenario.told.hits.add(&scenario.drive.hits);
    scenario.told.habits = scenario.habits;
    scenario.told
}

impl Scenario {
    fn new(seed: u64, cut: Cut, verbose: bool) -> Self {
        let mut random = Random::new(seed);
        let mut habits = Habits::default();
        let of = habits_of(seed);
        let single = random.one_in(4);
        if single {
            habits = habits.with(random.pick(of));
        }
        let density = random.pick(&[4, 8, 16]);
        for &habit in of {
            let has = random.one_in(density);
            // Those with which little else can be judged come seldom.
            let rare = matches!(habit, Habit::QuickStopIgnored | Habit::HaltIgnored);
            if has && !single && (!rare || random.one_in(4)) {
                habits = habits.with(habit);
            }
        }
        let mut random_making = random.fork();
        let (random_drive, program, cable) = (random.fork(), random.fork(), random.fork());
        let wider = Wider::of(seed);
        if wider.sound {
            habits = Habits::default();
        }
        // What follows must draw the same whatever is cut.
        habits = Habits(habits.0 & !cut.habits.0);
        let random = &mut random_making;
        let period_us: u64 = random.pick(&[250, 500, 1000, 1000, 1000, 2000]);
        let slow_by = random.pick(&[2, 3, 4]);
        let slow = if habits.has(Habit::SlowCycle) {
            slow_by
        } else {
            1
        };
        let tick = period_us as f64 * slow as f64 * 1e-6;
        let window = random.pick(&[10_u32, 10, 100]);
        let overshoot = (
            random.pick(&[60.0, 150.0]),
            random.pick(&[0.25, 0.5]),
            random.pick(&[0.9, 1.0]),
        );
        let creep = (random.pick(&[40.0, 80.0]), 1.0, random.pick(&[0.5, 0.9]));
        let stiff = (400.0, 1.0, 1.0);
        let (frequency, damping, feed_forward) = if habits.has(Habit::Overshoot) {
            overshoot
        } else if habits.has(Habit::Creeps) {
            creep
        } else {
            stiff
        };
        let dither = random.pick(&[1, 2, 3]);
        let noise = random.pick(&[1, 5, 40]);
        let ack = random.pick(&[Ack::Buffer, Ack::Handshake, Ack::Handshake]);
        let base = random.pick(&[Base::PreviousTarget, Base::Demand, Base::Actual]);
        // After a homing the previous target is nowhere that the core knows.
        let base = match base {
            Base::PreviousTarget if wider.sound => Base::Demand,
            base => base,
        };
        let quick_stop = random.pick(&[1, 2, 5, 6]);
        // That bit 12 of such a drive shows a full buffer is documented.
        let ack = if wider.passes_by_bit_5 {
            Ack::Buffer
        } else {
            ack
        };
        let making = Making {
            ack,
            base,
            quick_stop: wider.quick_stop.unwrap_or(quick_stop),
            turn: wider.turn.map(|turn| {
                let (min, max) = (i64::from(turn.min), i64::from(turn.max));
                (min, max - min + 1)
            }),
            one_way: wider.one_way,
            bits_first: wider.bits_first,
            passes_by_bit_5: wider.passes_by_bit_5,
            tick,
            window: f64::from(window),
            window_ticks: random.pick(&[0, 0, 5]),
            quick_ramp: random.pick(&[300_000.0, 2_000_000.0]),
            frequency,
            damping,
            feed_forward,
            dither: if habits.has(Habit::Dither) { dither } else { 0 },
            velocity_noise: if habits.has(Habit::VelocityNoise) {
                noise
            } else {
                0
            },
            cycles_between_incidents: random.pick(&[60, 250, 900]),
        };
        let shows_velocity = random.one_in(2);
        let passes = wider.end_velocity.is_some();
        let mut config = CoreConfig::new(fields(shows_velocity, passes));
        config.referencing = Referencing::UnreferencedMovesAllowed;
        let described = random.pick(&[true, true, false]);
        let known_base = random.one_in(2);
        config.traits = Traits {
            buffer_signal: match (described, ack) {
                (false, _) => BufferSignal::Unknown,
                (true, Ack::Buffer) => BufferSignal::Acknowledge,
                (true, Ack::Handshake) => BufferSignal::None,
            },
            relative_base: match (known_base, base) {
                (false, _) => RelativeBase::Undocumented,
                (true, Base::PreviousTarget) => RelativeBase::PreviousTarget,
                (true, Base::Demand) => RelativeBase::Demand,
                (true, Base::Actual) => RelativeBase::Actual,
            },
            halt_keeps_set_point: !habits.has(Habit::HaltForgets),
            drive_cycle: Duration::from_micros(period_us * slow)
                * if habits.has(Habit::OutputsLate) || habits.has(Habit::InputsLate) {
                    3
                } else {
                    1
                },
            ..Traits::cia402()
        };
        config.traits.start_bits_first = wider.bits_first;
        if wider.passes_by_bit_5 {
            config.traits.immediately = StartBits::Unsupported("it ends the active one first");
            config.traits.after_current = StartBits::Sequenced;
            config.traits.blend = StartBits::Bits {
                change_set_immediately: true,
                change_on_set_point: false,
            };
        }
        config.modulo = wider.turn;
        if wider.halt_coasts {
            config.stop_options.halt = Some(0);
        }
        config.quick_stop = QuickStopOption(making.quick_stop.into());
        config.defaults = Parameters {
            velocity: Some(50_000),
            acceleration: Some(500_000),
            deceleration: Some(500_000),
            ..Parameters::default()
        };
        config.tolerances.position = window;
        // An axis that swings or creeps stays within the window for a while on its way: the settle time is longer than that.
        let settle_ms = random.pick(&[20, 20, 100]);
        let swings = habits.has(Habit::Overshoot) || habits.has(Habit::Creeps);
        config.tolerances.settle = Duration::from_millis(if swings { 100 } else { settle_ms });
        config.deadlines.enable = Duration::from_millis(400);
        config.deadlines.disable = Duration::from_millis(400);
        config.deadlines.acknowledge = Duration::from_millis(random.pick(&[40, 150, 500]));
        config.deadlines.standstill = Duration::from_millis(800);
        config.deadlines.mode = Duration::from_millis(100);
        config.deadlines.fault_reset = Duration::from_millis(40);
        config.deadlines.begin = wider.begin.unwrap_or(config.deadlines.begin);
        let tolerances = config.tolerances;
        let period = Duration::from_micros(period_us);
        let settle = tolerances.settle.as_micros().div_ceil(period_us.into()) as usize;
        let cycles = |time: Duration| time.as_micros() as u64 / period_us;
        let deadlines = &config.deadlines;
        let longest = deadlines.enable
            + deadlines.disable
            + 2 * deadlines.acknowledge
            + 3 * deadlines.standstill
            + deadlines.mode
            + 3 * (deadlines.fault_reset + Duration::from_millis(100))
            + 2 * tolerances.settle;
        let told = Told {
            making: format!(
                "{making:?}, {wider:?}, period {period:?}, slow {slow}, window {window}, settle {:?}, 606Ch {shows_velocity}, {:?}, {:?}, acknowledge {:?}",
                tolerances.settle,
                config.traits.buffer_signal,
                config.traits.relative_base,
                config.deadlines.acknowledge
            ),
            ..Told::default()
        };
        let acknowledge = cycles(deadlines.acknowledge);
        let seen = cycles(config.traits.surely_seen());
        let send_limit =
            cycles(deadlines.acknowledge + deadlines.begin + 2 * tolerances.settle) + 20;
        let begin_limit =
            cycles(deadlines.begin + deadlines.acknowledge + 4 * tolerances.settle) + 200;
        let stop_limit = cycles(deadlines.standstill + 2 * tolerances.settle) + 20;
        Self {
            kept: random.one_in(2),
            core: AxisCore::new(config),
            drive: Drive::new(making, habits, random_drive),
            habits,
            program,
            cable,
            outputs: [0; OUTPUT_BYTES],
            last_inputs: [0; INPUT_BYTES],
            period,
            now: Duration::ZERO,
            cycle: 0,
            slow,
            slow_left: 0,
            window: f64::from(window),
            settle,
            shorter: (settle / 8).max(4 * slow as usize),
            shows_velocity,
            limit: cycles(longest + Duration::from_secs(1)),
            stop_limit,
            issued: Vec::new(),
            pending: Vec::new(),
            gated: Vec::new(),
            trail: VecDeque::new(),
            trail_length: settle + 32,
            sent_before: Outputs::default(),
            sent: Outputs::default(),
            stopping_since: None,
            setting_off_since: None,
            resume_asked: false,
            next_command: 5,
            busy: random.pick(&[10, 30, 100, 300]),
            burst: 0,
            burst_kind: 0,
            jog: None,
            ledger_seen: 0,
            at_rest_since: 0,
            cut,
            told,
            verbose,
            shown: (0, 0),
            homes: random.one_in(3),
            speed: random.pick(&[10_000, 40_000, 80_000]),
            ramp: random.pick(&[60_000, 500_000, 2_000_000]),
            blind: false,
            out: None,
            wider,
            expired: false,
            send_limit,
            begin_limit,
            hindered: 0,
            blocked: 0,
            acknowledge,
            seen,
        }
    }

    fn run(&mut self) -> Result<(), ()> {
        while self.cycle < DISTURBED {
            if self.cycle >= self.next_command {
                self.next_command = self.cycle + 1 + self.program.below(self.busy * 2);
                self.act()?;
            }
            let lane = self.lane();
            self.step(lane)?;
        }
        self.end()
    }

    /// Everything in order: whatever is under way comes to its end, and the axis can be used and switched off.
    fn end(&mut self) -> Result<(), ()> {
        self.say(|_| "healed".into());
        self.drive.heal();
        self.habits = self
            .habits
            .without(Habit::FramesLost)
            .without(Habit::FramesMiscounted);
        let cycles = |scenario: &Self, ms: u64| ms * 1000 / scenario.period.as_micros() as u64;
        self.wider.expires = false;
        self.expired = false;
        self.core.set_expired(false);
        for _ in 0..60 {
            self.step(StopRequest::empty())?;
        }
        if self.wider.patient {
            // The laws of what waits for nothing see to it that this ends.
            let until = self.cycle + cycles(self, 12_000);
            while self.cycle < until && self.waits_for_itself() {
                self.step(StopRequest::empty())?;
            }
        }
        let (command, kind) = if self.program.one_in(2) {
            (Command::Disable, Kind::Disable)
        } else {
            (Command::Stop, Kind::Stop)
        };
        let id = self.submit(command, kind, 0)?;
        let until = self.cycle + cycles(self, 4_000);
        while self.cycle < until && !self.pending.is_empty() {
            self.step(StopRequest::empty())?;
        }
        if let Some(&left) = self.pending.first() {
            return self.broken(
                "every future ends",
                format!(
                    "{left} {:?} has not, at the end",
                    self.issued[left as usize]
                ),
            );
        }
        let _ = id;
        // The second one finds in bit 12 what the first has left there.
        let home = Command::Home(HomingCommand {
            method: HomingMethod(17),
            offset: None,
            until: None,
        });
        for (command, kind) in [
            (Command::Disable, Kind::Disable),
            (Command::ResetFault, Kind::Reset),
            (Command::Enable, Kind::Enable),
            (Command::SelectMode(Mode::Homing), Kind::Mode),
            (home, Kind::Home),
            (home, Kind::Home),
            (Command::SelectMode(Mode::ProfilePosition), Kind::Mode),
            (Command::Enable, Kind::Move),
            (Command::Disable, Kind::Disable),
        ] {
            if kind == Kind::Reset && self.drive.state != State::Fault {
                continue;
            }
            let homes = kind == Kind::Home || command == Command::SelectMode(Mode::Homing);
            if homes && !self.wider.homes {
                continue;
            }
            let command = if kind == Kind::Move {
                let target = self.in_turn(self.core.snapshot().position + 500);
                let start = if self.wider.passes_by_bit_5 {
                    BufferMode::Buffered
                } else {
                    BufferMode::Aborting
                };
                self.a_move(Reference::Absolute, target, start, false, None)
            } else {
                command
            };
            let target = match command {
                Command::Move(command) => command.target,
                _ => 0,
            };
            // It coasts first, where its drive has no power.
            let wait = self.cycle + cycles(self, 3_000);
            let mut rests = 0;
            while rests < 2 * self.settle && self.cycle < wait {
                rests = if self.is_moving() { 0 } else { rests + 1 };
                self.step(StopRequest::empty())?;
            }
            let id = self.submit(command, kind, target)?;
            let until = self.cycle + cycles(self, 6_000);
            let mut result = None;
            while self.cycle < until && result.is_none() {
                self.step(StopRequest::empty())?;
                result = self.last_result(id);
            }
            match result {
                Some(true) => {}
                Some(false) => {
                    return self.broken(
                        "a sound drive can be used",
                        format!("{kind:?} failed on a drive in order"),
                    );
                }
                None => {
                    return self.broken(
                        "a sound drive can be used",
                        format!("{kind:?} has no end on a drive in order"),
                    );
                }
            }
        }
        Ok(())
    }

    fn last_result(&self, id: u32) -> Option<bool> {
        let issued = &self.issued[id as usize];
        issued.done.then_some(issued.since == u64::MAX)
    }

    fn broken(&mut self, law: &'static str, what: String) -> Result<(), ()> {
        self.say(|scenario| {
            let word = u16::from_le_bytes([scenario.outputs[0], scenario.outputs[1]]);
            format!(
                "next word {word:04X}, sent {:?}, drive {:?}, at {:.0} v {:.0}, {:?}",
                scenario.sent,
                scenario.drive.state,
                scenario.drive.position,
                scenario.drive.velocity,
                scenario.core.snapshot()
            )
        });
        self.told.violation = Some(Violation {
            law,
            what,
            cycle: self.cycle,
        });
        Err(())
    }

    fn say(&mut self, line: impl FnOnce(&Self) -> String) {
        if self.verbose {
            let line = format!("{:6} {}", self.cycle, line(self));
            self.told.transcript.push_back(line);
            if self.told.transcript.len() > LINES {
                self.told.transcript.pop_front();
            }
        }
    }

    fn lane(&mut self) -> StopRequest {
        if !self.program.one_in(400) {
            return StopRequest::empty();
        }
        self.program.pick(&[
            StopRequest::HALT,
            StopRequest::STOP,
            StopRequest::QUICK_STOP,
            StopRequest::HALT.union(StopRequest::QUICK_STOP),
        ])
    }

    /// What the program does now.
    fn act(&mut self) -> Result<(), ()> {
        let mut random = self.program.fork();
        let volley = if random.one_in(8) { 3 } else { 1 };
        for _ in 0..volley {
            let mut random = random.fork();
            let number = self.issued.len() as u32;
            if self.cut.commands.binary_search(&number).is_ok() {
                // A place in the numbering, so that the names of the others stay.
                self.issued.push(Issued {
                    kind: Kind::Release,
                    target: 0,
                    since: 0,
                    powered: false,
                    homings: (0, 0),
                    halted: false,
                    sent: false,
                    accepted: false,
                    done: true,
                    latch: None,
                    unseen: false,
                });
                continue;
            }
            self.choose(&mut random)?;
        }
        if random.one_in(12)
            && let Some(&id) = self.pending.last()
        {
            self.say(|_| format!("withdraw {id}"));
            self.core.withdraw(CommandId(id), &mut self.outputs);
            self.drain()?;
        }
        if let Some(id) = self.jog
            && random.one_in(3)
        {
            if random.one_in(2) {
                self.core
                    .release_jog(self.now, CommandId(id), &mut self.outputs);
            } else {
                let velocity = random.between(-9_000, 9_000);
                self.core
                    .set_jog(CommandId(id), velocity, &mut self.outputs);
            }
            self.drain()?;
        }
        Ok(())
    }

    fn choose(&mut self, random: &mut Random) -> Result<(), ()> {
        let snapshot = self.core.snapshot();
        let enabled = snapshot.controlword.bits() & 0xF == 0xF;
        let roll = random.below(100);
        if !enabled {
            let (command, kind) = if snapshot.state.is_fault() && roll < 60 {
                (Command::ResetFault, Kind::Reset)
            } else if roll < 80 {
                (Command::Enable, Kind::Enable)
            } else {
                random.pick(&[
                    (Command::Disable, Kind::Disable),
                    (Command::Stop, Kind::Stop),
                    (Command::QuickStop, Kind::QuickStop),
                    (Command::Halt, Kind::Halt),
                    (Command::Resume, Kind::Resume),
                    (Command::ResetFault, Kind::Reset),
                ])
            };
            self.submit(command, kind, 0)?;
            return Ok(());
        }
        if roll < 60 && snapshot.halted && random.one_in(2) {
            self.submit(Command::Resume, Kind::Resume, 0)?;
            return Ok(());
        }
        if roll < 60 {
            match snapshot.mode {
                Mode::Homing => {
                    let method =
                        random.pick(&[HomingMethod(1), HomingMethod(17), HomingMethod(35)]);
                    let command = HomingCommand {
                        method,
                        offset: None,
                        until: None,
                    };
                    self.submit(Command::Home(command), Kind::Home, 0)?;
                }
                Mode::ProfileVelocity => {
                    let velocity = random.between(-9_000, 9_000);
                    self.submit(Command::Jog(JogSetPoint::new(velocity)), Kind::Jog, 0)?;
                }
                _ => {
                    let relative = random.one_in(3);
                    let target = if relative {
                        random.pick(&[0, 5, -5, 40, 1000, -700, 3000])
                    } else {
                        match random.below(5) {
                            0 => snapshot.position,
                            1 => snapshot.position + random.between(-40, 40),
                            2 => 1000,
                            _ => random.between(-4_000, 4_000),
                        }
                    };
                    let target = if relative {
                        target
                    } else {
                        self.in_turn(target)
                    };
                    let start = random.pick(&[
                        BufferMode::Aborting,
                        BufferMode::Buffered,
                        BufferMode::Buffered,
                        BufferMode::Blending,
                    ]);
                    let reference = if relative {
                        Reference::Relative
                    } else {
                        Reference::Absolute
                    };
                    let gated = random.one_in(10);
                    let passes = self.wider.end_velocity.filter(|_| random.one_in(3));
                    let command = self.a_move(reference, target, start, gated, passes);
                    self.submit(command, Kind::Move, target)?;
                }
            }
            return Ok(());
        }
        let modes: &[Mode] = if self.homes {
            &[Mode::ProfilePosition, Mode::Homing, Mode::ProfileVelocity]
        } else {
            &[Mode::ProfilePosition]
        };
        let mode = random.pick(modes);
        let (command, kind) = random.pick(&[
            (Command::Halt, Kind::Halt),
            (Command::Halt, Kind::Halt),
            (Command::Resume, Kind::Resume),
            (Command::Resume, Kind::Resume),
            (Command::Stop, Kind::Stop),
            (Command::QuickStop, Kind::QuickStop),
            (Command::Disable, Kind::Disable),
            (Command::Release, Kind::Release),
            (Command::Enable, Kind::Enable),
            (Command::SelectMode(mode), Kind::Mode),
            (Command::SelectMode(mode), Kind::Mode),
            (Command::SelectMode(Mode::ProfilePosition), Kind::Mode),
            (Command::ResetFault, Kind::Reset),
        ]);
        self.submit(command, kind, 0)?;
        Ok(())
    }

    /// Of a modulo axis where in its turn that is.
    fn in_turn(&self, position: i32) -> i32 {
        match self.drive.making.turn {
            Some((least, length)) => {
                (least + (i64::from(position) - least).rem_euclid(length)) as i32
            }
            None => position,
        }
    }

    /// Whether a move is under way that nothing holds up.
    fn waits_for_itself(&self) -> bool {
        let snapshot = self.core.snapshot();
        let mut pending = self.pending.iter().map(|id| self.issued[*id as usize]);
        pending.any(|issued| issued.kind == Kind::Move) && !snapshot.halted
    }

    /// A move whose velocity is its name.
    fn a_move(
        &self,
        reference: Reference,
        target: i32,
        buffer_mode: BufferMode,
        gated: bool,
        passes: Option<u32>,
    ) -> Command {
        let velocity = self.speed as u32 + self.issued.len() as u32;
        let mut set_point = SetPoint::new()
            .velocity(velocity)
            .acceleration(self.ramp)
            .deceleration(self.ramp)
            .buffer_mode(buffer_mode);
        if let Some(velocity) = passes {
            set_point = set_point.end_velocity(velocity);
        }
        Command::Move(MoveCommand {
            reference,
            target,
            set_point,
            gated,
        })
    }

    fn submit(&mut self, command: Command, kind: Kind, target: i32) -> Result<u32, ()> {
        let id = self.issued.len() as u32;
        self.say(|_| format!("{id} {command:?}"));
        self.issued.push(Issued {
            kind,
            target,
            since: self.cycle,
            powered: self.drive.state.is_powered(),
            homings: self.drive.homings,
            halted: false,
            sent: false,
            accepted: false,
            done: false,
            latch: None,
            unseen: self.is_mistaken(),
        });
        self.pending.push(id);
        if let Command::Move(MoveCommand { gated: true, .. }) = command {
            self.gated.push(id);
        }
        match kind {
            Kind::Resume => self.resume_asked = true,
            Kind::Jog => self.jog = Some(id),
            _ => {}
        }
        let held = self.must_stop();
        self.core
            .submit(self.now, CommandId(id), command, &mut self.outputs);
        let refused = kind == Kind::Halt && self.wider.halt_coasts;
        if kind.stops() && held && !refused {
            self.has_stopped(kind)?;
        }
        self.drain()?;
        Ok(id)
    }

    /// Whether a stop that is asked for now has something to stop: all that the core can know of.
    fn must_stop(&self) -> bool {
        let snapshot = self.core.snapshot();
        self.sent.word & 0x8F == 0x0F
            && snapshot.controlword.bits() & 0xF == 0xF
            && snapshot.state == ds402::State::OperationEnabled
            && self.drive.state == State::Enabled
            && (snapshot.has_set_point
                || (self.drive.mode == 1 && self.drive.demand_velocity != 0.0 && self.is_moving()))
    }

    fn has_stopped(&mut self, kind: Kind) -> Result<(), ()> {
        let word = u16::from_le_bytes([self.outputs[0], self.outputs[1]]);
        if word & 0x100 != 0 || word & 0x04 == 0 {
            return Ok(());
        }
        self.broken(
            "a stop is in the next frame",
            format!("{kind:?} was asked for, and the next word is {word:04X}h"),
        )
    }

    /// Whether the axis truly moves: faster than what standstill permits, and by more than that.
    fn is_moving(&self) -> bool {
        let fast = self.drive.velocity.abs() * self.settle as f64 * self.period.as_secs_f64();
        fast >= self.window / 2.0 && !self.stood(0)
    }

    /// Whether the axis, `ago` cycles before now, had stayed where it was for the settle time. Where 606Ch is mapped an eighth of that
    /// time within an eighth of the window shows it as well, by the definition of standstill; before that it may have moved.
    fn stood(&self, ago: usize) -> bool {
        self.stayed(self.settle, 2.5 * self.window, ago)
            || (self.shows_velocity && self.stayed(self.shorter, 2.5 * self.window / 8.0, ago))
    }

    /// Whether in so many cycles up to `ago` cycles before now it has stayed within this, and what 6064h adds to that.
    fn stayed(&self, cycles: usize, within: f64, ago: usize) -> bool {
        let end = self.trail.len().saturating_sub(ago);
        let from = end.saturating_sub(cycles);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut unseen = 0;
        for &(position, seen) in self.trail.range(from..end) {
            unseen = if seen { 0 } else { unseen + 1 };
            // 6064h is what was seen. Where nothing was for longer than that, what was before it says nothing.
            if seen || unseen > self.settle * 3 / 8 {
                low = low.min(position);
                high = high.max(position);
            }
        }
        high - low <= within + 2.0 * f64::from(self.drive.making.dither) + 4.0
    }

    /// One bus cycle.
    fn step(&mut self, lane: StopRequest) -> Result<(), ()> {
        if self.wider.expires && self.program.one_in(if self.expired { 100 } else { 800 }) {
            self.expired = !self.expired;
            self.say(|scenario| format!("expired {}", scenario.expired));
            self.core.set_expired(self.expired);
            if self.expired {
                let halt = StopRequest::HALT;
                self.core.apply_stop(self.now, halt, &mut self.outputs);
            }
        }
        if !lane.is_empty() {
            self.say(|_| format!("lane {lane:?}"));
            let held = self.must_stop();
            self.core.apply_stop(self.now, lane, &mut self.outputs);
            if held {
                self.has_stopped(Kind::Stop)?;
            }
        }
        if !self.gated.is_empty()
            && self.program.one_in(3)
            && let Some(&id) = self
                .gated
                .iter()
                .find(|id| self.core.is_armed(CommandId(**id)))
        {
            self.core.fire(self.now, CommandId(id), &mut self.outputs);
        }
        self.drain()?;
        self.sent_before = self.sent;
        self.sent = Outputs::read(&self.outputs);
        self.judge_word()?;
        let image = *self.drive.image();
        let (delivered, fresh, answered) = self.link();
        if delivered {
            self.drive.take(self.sent);
        }
        self.now += self.period;
        let inputs = if fresh {
            Inputs::Fresh(&image)
        } else if answered {
            Inputs::Answered(&image)
        } else {
            Inputs::Stale
        };
        self.blind = !fresh;
        if self.kept {
            let unchanged = !matches!(inputs, Inputs::Stale) && self.last_inputs == image;
            self.core
                .step_kept(self.now, inputs, unchanged, &mut self.outputs);
            if !matches!(inputs, Inputs::Stale) {
                self.last_inputs = image;
            }
        } else {
            self.core.step(self.now, inputs, &mut self.outputs);
        }
        if self.verbose {
            self.show(&image, inputs);
        }
        self.drain()?;
        self.cycle += 1;
        self.slow_left += 1;
        if self.slow_left >= self.slow {
            self.slow_left = 0;
            if self.slow > 1 {
                self.told.hits.hit(Habit::SlowCycle);
            }
            self.drive.cycle();
        }
        self.note_out(answered.then_some(&image));
        if self.trail.len() >= self.trail_length {
            self.trail.pop_front();
        }
        self.trail.push_back((self.drive.position, answered));
        self.match_ledger()?;
        self.judge_state()?;
        self.note_hindrance();
        if self.cycle.is_multiple_of(128) {
            self.judge_waits()?;
        }
        Ok(())
    }

    /// Whether a move is under way of which nothing shows that the drive has dropped it.
    fn is_mistaken(&self) -> bool {
        let mut pending = self.pending.iter().map(|id| &self.issued[*id as usize]);
        pending.any(|issued| issued.unseen)
    }

    /// Where the drive leaves Operation enabled and comes back, and no inputs show it, its set-points are gone unseen: those that are under way, and
    /// those that are reckoned from their ends, look as if it had limited them or taken them. One whose bit 4 is out looks as if it had taken it
    /// where it shows bit 12 when it is enabled.
    fn note_out(&mut self, shows: Option<&[u8; INPUT_BYTES]>) {
        let word = shows.map(|image| u16::from_le_bytes([image[0], image[1]]));
        if let Some(out) = &mut self.out {
            out.shown |= word.is_some_and(|word| word & 0x6F != 0x27);
        }
        if self.drive.state != State::Enabled {
            self.out.get_or_insert(Out {
                since: self.drive.now,
                shown: false,
            });
            return;
        }
        let Some(out) = self.out.take().filter(|out| !out.shown) else {
            return;
        };
        let dropped =
            |latch: &Latch| matches!(latch.end, Some((at, End::Dropped)) if at >= out.since);
        let dropped = self.drive.ledger.iter().any(dropped);
        let seems_taken = self.habits.has(Habit::AckAtEnable);
        if dropped {
            self.say(|_| "the drive has dropped its set-points unseen".into());
        }
        for id in &self.pending {
            let issued = &mut self.issued[*id as usize];
            issued.unseen |= dropped || (seems_taken && !issued.accepted);
        }
    }

    fn show(&mut self, image: &[u8; INPUT_BYTES], inputs: Inputs<'_>) {
        let status = u16::from_le_bytes([image[0], image[1]]);
        let kind = match inputs {
            Inputs::Fresh(_) => "",
            Inputs::Answered(_) => " answered",
            Inputs::Stale => " stale",
        };
        let moves = self.cycle.is_multiple_of(25) && self.drive.velocity.abs() > 1.0;
        if self.shown != (self.sent.word, status) || !kind.is_empty() || moves {
            self.shown = (self.sent.word, status);
            let position = i32::from_le_bytes([image[3], image[4], image[5], image[6]]);
            self.say(|scenario| {
                format!(
                    "{:04X} -> {status:04X}{kind} mode {} target {} shows {position} demand {:.0} at {:.0} v {:.0} {:?} core {:?} {}",
                    scenario.sent.word,
                    image[2],
                    scenario.sent.target,
                    scenario.drive.demand,
                    scenario.drive.position,
                    scenario.drive.velocity,
                    scenario.drive.state,
                    scenario.core.snapshot().state,
                    if scenario.core.snapshot().has_set_point { "holds" } else { "" }
                )
            });
        }
    }

    /// Delivered, fresh, answered.
    fn link(&mut self) -> (bool, bool, bool) {
        const GOOD: (bool, bool, bool) = (true, true, true);
        let lost = self.habits.has(Habit::FramesLost);
        let miscounted = self.habits.has(Habit::FramesMiscounted);
        if !lost && !miscounted {
            return GOOD;
        }
        if self.burst > 0 {
            self.burst -= 1;
        } else if self.cable.one_in(40) {
            self.burst = self.cable.pick(&[0, 0, 0, 1, 3, 9, 12, 40]);
            let kinds: &[u8] = match (lost, miscounted) {
                (true, true) => &[1, 2, 3, 4],
                (true, false) => &[1, 2],
                _ => &[3, 4],
            };
            self.burst_kind = self.cable.pick(kinds);
        } else {
            self.burst_kind = 0;
        }
        let habit = if self.burst_kind <= 2 {
            Habit::FramesLost
        } else {
            Habit::FramesMiscounted
        };
        if self.burst_kind != 0 {
            self.told.hits.hit(habit);
        }
        match self.burst_kind {
            1 => (false, false, false),
            2 => (true, false, false),
            3 => (true, false, true),
            4 => (false, false, true),
            _ => GOOD,
        }
    }

    /// The laws of the word that is about to be sent.
    fn judge_word(&mut self) -> Result<(), ()> {
        let (word, before) = (self.sent.word, self.sent_before.word);
        if self.wider.halt_coasts && word & 0x100 != 0 {
            return self.broken(
                "bit 8 is not sent where the axis would coast",
                format!("{word:04X}h is sent"),
            );
        }
        if self.expired && word & !before & 0x10 != 0 {
            return self.broken(
                "nothing starts while the liveness is expired",
                format!("{before:04X}h, then {word:04X}h"),
            );
        }
        if word & !before & 0x10 != 0 && self.sent.mode == 1 {
            let name = self.sent.velocity.wrapping_sub(self.speed as u32);
            match self.issued.get_mut(name as usize) {
                Some(issued)
                    if issued.kind == Kind::Move
                        && issued.target == self.sent.target
                        && !issued.sent =>
                {
                    issued.sent = true;
                }
                _ => {
                    return self.broken(
                        "a set-point is sent once, with its own target",
                        format!(
                            "bit 4 rose with target {} and velocity {}",
                            self.sent.target, self.sent.velocity
                        ),
                    );
                }
            }
        }
        let drives = word & 0x8F == 0x0F;
        if drives {
            self.stopping_since = None;
            self.setting_off_since = None;
            if before & 0x18F == 0x10F && word & 0x100 == 0 {
                // What is over for all that shows may have its last counts before it.
                let holds = self
                    .drive
                    .holds()
                    .is_some_and(|gap| gap > self.window + 2.0);
                if !self.resume_asked && self.drive.state == State::Enabled && holds {
                    return self.broken(
                        "bit 8 falls by a resume",
                        format!("{before:04X}h, then {word:04X}h, and nobody asked"),
                    );
                }
                self.resume_asked = false;
            }
            return Ok(());
        }
        let since = *self.stopping_since.get_or_insert(self.cycle);
        let leads_down = |word: u16| word & 0x82 == 0 || word & 0x87 == 0x06 || word & 0x8F == 0x07;
        let coasts = leads_down(word)
            && matches!(self.drive.state, State::Enabled | State::QuickStop)
            && self.is_moving();
        if !coasts {
            self.setting_off_since = None;
            return Ok(());
        }
        // An axis that sets off after the word shows it two cycles of the drive later, and the next word answers that.
        let off = *self.setting_off_since.get_or_insert(self.cycle);
        let unseen = leads_down(before) && self.cycle - off <= 2 * self.slow + 1;
        if !unseen && self.cycle - since <= self.stop_limit && !self.drive_is_deaf() {
            return self.broken(
                "a moving axis does not coast",
                format!(
                    "{word:04X}h is sent {} cycles after the stop began, at {:.0} counts/s",
                    self.cycle - since,
                    self.drive.velocity
                ),
            );
        }
        Ok(())
    }

    fn drive_is_deaf(&self) -> bool {
        self.habits.has(Habit::QuickStopIgnored)
    }

    /// Each set-point that the drive has taken belongs to one move.
    fn match_ledger(&mut self) -> Result<(), ()> {
        if let Some(velocity) = self.drive.overrun.take() {
            let name = velocity.wrapping_sub(self.speed as u32);
            return self.broken(
                "no set-point goes into a full buffer",
                format!("that of {name} came while the drive held two"),
            );
        }
        while let Some(latch) = self.drive.ledger.get(self.ledger_seen).copied() {
            let index = self.ledger_seen;
            self.ledger_seen += 1;
            let name = latch.velocity.wrapping_sub(self.speed as u32);
            self.say(|scenario| {
                format!(
                    "drive takes {name}, to {:.0} (it counts from {:.0})",
                    latch.goal, scenario.drive.demand
                )
            });
            // 6061h has shown homing mode before the drive was in it: it takes bit 4 for an order to go to where the axis stands.
            let by_mistake =
                self.sent.mode != 1 && (latch.goal - self.drive.position).abs() <= self.no_way();
            match self.issued.get_mut(name as usize) {
                Some(issued)
                    if issued.latch.is_none() && issued.target == latch.target && issued.sent =>
                {
                    issued.latch = Some(index);
                }
                _ if by_mistake => {}
                _ => {
                    return self.broken(
                        "latched = accepted + unknown",
                        format!("the drive has taken {latch:?}, which nobody asked for, or twice"),
                    );
                }
            }
        }
        Ok(())
    }

    /// A way of this length is none, for all that 6064h shows.
    fn no_way(&self) -> f64 {
        self.window + 2.0 + 2.0 * f64::from(self.drive.making.dither)
    }

    /// The laws of what the core knows.
    fn judge_state(&mut self) -> Result<(), ()> {
        let drive = &self.drive;
        // The time in which something has to begin begins anew after a halt.
        let halted = self.sent.bit(8);
        if drive.demand_velocity != 0.0 || drive.holds().is_some() || self.blind || halted {
            self.at_rest_since = self.cycle;
        }
        if self.sent.bit(8) {
            // Of what the axis passes while it halts the core claims nothing.
            for id in &self.pending {
                self.issued[*id as usize].halted = true;
            }
        }
        let Some(gap) = drive.holds() else {
            return Ok(());
        };
        if drive.mode == 3 && self.sent.target_velocity == 0 {
            // Its 0 is on its way.
            return Ok(());
        }
        let snapshot = self.core.snapshot();
        let drives = snapshot.controlword.bits() & 0x8F == 0x0F && self.sent.word & 0x8F == 0x0F;
        if drives
            && !snapshot.has_set_point
            && gap > self.no_way()
            && drive.word_in_effect() & 0x0F == 0x0F
        {
            let waits = drive.waits();
            return self.broken(
                "the drive holds a set-point: the core has one",
                format!("its demand is {gap:.0} counts from the end (waits: {waits}), and the core knows of none"),
            );
        }
        Ok(())
    }

    /// Notes whether something is in the way of the next set-point: as long as nothing is, it has to go out.
    fn note_hindrance(&mut self) {
        let snapshot = self.core.snapshot();
        let sent = |id: &u32| {
            let issued = &self.issued[*id as usize];
            issued.kind != Kind::Move || issued.sent
        };
        let free = self.drive.is_free()
            && !self.blind
            && snapshot.state == ds402::State::OperationEnabled
            && snapshot.mode == Mode::ProfilePosition
            && !snapshot.halted
            && !self.pending.iter().any(sent);
        if !free {
            self.hindered = self.cycle;
        }
        if !free || self.drive.image()[1] & 0x10 != 0 {
            self.blocked = self.cycle;
        }
    }

    /// Every future ends.
    fn judge_waits(&mut self) -> Result<(), ()> {
        if let Some(&id) = self.pending.first()
            && !self.gated.contains(&id)
        {
            let issued = self.issued[id as usize];
            let waited = self.cycle - self.hindered.max(issued.since);
            if issued.kind == Kind::Move && waited > self.send_limit {
                return self.broken(
                    "what nothing is in the way of goes out, or ends",
                    format!("{id} waits, and for {waited} cycles the axis was ready for it"),
                );
            }
        }
        for at in 0..self.pending.len() {
            let id = self.pending[at];
            let issued = self.issued[id as usize];
            let waited = self.cycle - issued.since;
            let endless = matches!(issued.kind, Kind::Move | Kind::Home | Kind::Jog);
            if !endless && waited > self.limit {
                return self.broken(
                    "every future ends",
                    format!("{id} {:?} has waited for {waited} cycles", issued.kind),
                );
            }
            let rest = self
                .cycle
                .saturating_sub(self.at_rest_since.max(issued.since));
            let seconds = rest as f64 * self.period.as_secs_f64();
            let wider = self.wider.begin.is_some();
            let patience = match issued.kind {
                Kind::Move if issued.accepted && wider => {
                    // A stop that its drive does not obey has deadlines of its own, and may be asked for again.
                    let stops = if self.sent.word & 0x8F == 0x0F {
                        0
                    } else {
                        3 * self.stop_limit
                    };
                    (self.begin_limit + stops) as f64 * self.period.as_secs_f64()
                }
                Kind::Move if issued.accepted => 6.0,
                Kind::Home => 3.0,
                _ => f64::INFINITY,
            };
            if seconds > patience && !self.core.snapshot().halted {
                return self.broken(
                    "every future ends",
                    format!(
                        "{id} {:?} waits, and the drive has had nothing to do for {seconds:.1} s",
                        issued.kind
                    ),
                );
            }
        }
        Ok(())
    }

    fn drain(&mut self) -> Result<(), ()> {
        while let Some((CommandId(id), event)) = self.core.poll_event() {
            self.say(|_| format!("    {id}: {event:?}"));
            if self
                .issued
                .get(id as usize)
                .is_none_or(|issued| issued.done)
            {
                return self.broken(
                    "one outcome",
                    format!("{id} is reported on after its end: {event:?}"),
                );
            }
            match event {
                Event::Accepted => self.judge_accepted(id)?,
                Event::Halted => {}
                Event::Done(result) => {
                    self.issued[id as usize].done = true;
                    self.pending.retain(|pending| *pending != id);
                    self.gated.retain(|gated| *gated != id);
                    if self.jog == Some(id) {
                        self.jog = None;
                    }
                    self.judge_done(id, result)?;
                    if result.is_ok() {
                        self.issued[id as usize].since = u64::MAX;
                    }
                }
                other => return self.broken("known events", format!("{id}: {other:?}")),
            }
        }
        Ok(())
    }

    fn judge_accepted(&mut self, id: u32) -> Result<(), ()> {
        // One without a way is over in the drive as soon as it was taken.
        self.at_rest_since = self.cycle;
        let issued = &mut self.issued[id as usize];
        issued.accepted = true;
        if issued.kind == Kind::Home && issued.homings.0 == self.drive.homings.0 {
            return self.broken(
                "Accepted: the homing has begun",
                format!(
                    "{id} is accepted, and the drive has begun no homing since it was asked for"
                ),
            );
        }
        if issued.kind == Kind::Move && issued.latch.is_none() && !issued.unseen {
            return self.broken(
                "latched = accepted + unknown",
                format!("{id} is accepted, and the drive has not taken it"),
            );
        }
        Ok(())
    }

    fn judge_done(&mut self, id: u32, result: Result<Completion, Failure>) -> Result<(), ()> {
        let issued = self.issued[id as usize];
        if issued.kind == Kind::Move {
            return self.judge_move(id, issued, result);
        }
        if matches!(result, Ok(Completion::Homed { .. }))
            && self.drive.homings.1 == issued.homings.1
        {
            return self.broken(
                "Homed: the drive has homed",
                format!(
                    "{id} is {result:?}, and the drive has ended no homing since it was asked for"
                ),
            );
        }
        if let (Kind::Disable, Ok(Completion::Stopped { state })) = (issued.kind, result)
            && shows_power(state)
        {
            return self.broken(
                "a disable ends without power",
                format!("{id} is done in {state:?}"),
            );
        }
        if issued.kind == Kind::Resume && result.is_ok() && self.sent.word & 0x100 != 0 {
            let word = self.sent.word;
            return self.broken(
                "a resume is done when bit 8 was sent low",
                format!("{id} is done, and the word is {word:04X}h"),
            );
        }
        let stopped = matches!(result, Ok(Completion::Stopped { .. }));
        if !stopped || self.drive_is_deaf() {
            return Ok(());
        }
        let halts_nothing = issued.kind == Kind::Halt && self.drive.state != State::Enabled;
        // One without power that coasts stops by nothing that is asked for.
        let coasts = !issued.powered && !self.drive.state.is_powered();
        if issued.kind.stops() && !halts_nothing && !coasts && self.stops_while_moving() {
            return self.broken(
                "a stop ends at standstill",
                format!(
                    "{id} {:?} is {result:?} at {:.0} counts/s, in {:?}",
                    issued.kind, self.drive.velocity, self.drive.state
                ),
            );
        }
        let gone = matches!(
            issued.kind,
            Kind::Stop | Kind::QuickStop | Kind::Disable | Kind::Release
        );
        // A jog ends by its 0, which is in the next frame.
        let jog_ends = self.drive.mode == 3 && Outputs::read(&self.outputs).target_velocity == 0;
        if gone
            && !jog_ends
            && let Some(gap) = self.drive.holds()
            && gap > self.no_way()
            && self.sent.word & 0x0F == 0x0F
        {
            return self.broken(
                "after a stop the set-point is gone",
                format!(
                    "{id} {:?} is {result:?}, and the drive is {gap:.0} counts from its end",
                    issued.kind
                ),
            );
        }
        Ok(())
    }

    /// Whether the axis moved in every settle time that the core can have looked at.
    fn stops_while_moving(&self) -> bool {
        let late = (8 * self.slow as usize).min(self.trail_length - self.settle);
        self.is_moving() && (0..=late).all(|ago| !self.stood(ago))
    }

    /// A drive without habits leaves no doubt. Of others it is counted how often there is one.
    fn count_end(
        &mut self,
        id: u32,
        issued: Issued,
        result: Result<Completion, Failure>,
    ) -> Result<(), ()> {
        let doubts = result.is_err_and(|failure| {
            let text = format!("{failure:?}");
            DOUBTS.iter().any(|name| text.starts_with(name)) && !text.contains("NotSent")
        });
        // What a distance counts from need not be documented, and of what the axis passes while it halts the core claims nothing.
        let shows_nothing = issued.halted
            || issued
                .latch
                .is_some_and(|index| self.drive.ledger[index].relative);
        // It had no way, and while the drive was at it the axis swung beyond the window of its end: nothing shows of it. Nor does it where
        // the axis passes its end before bit 12 is low again, which takes three of the drive's cycles.
        let out_of_window = issued.latch.is_some_and(|index| {
            let latch = &self.drive.ledger[index];
            let in_a_cycle = f64::from(latch.velocity) * self.drive.making.tick;
            let short = latch.way.min(latch.axis_way) <= 3.0 * self.window.max(in_a_cycle);
            (latch.way <= self.window && latch.axis_nearest > self.window)
                || (latch.passes && short)
        });
        // Whether a target was missed is judged by itself: the axis may have swung around it by more than the window.
        let judged = matches!(result, Err(Failure::MissedTarget { .. }));
        if self.wider.sound && doubts && !shows_nothing && !out_of_window && !judged {
            return self.broken(
                "of a drive without habits everything is known",
                format!("{id} is {result:?}"),
            );
        }
        if issued.latch.is_some() {
            let ends = &mut self.told.ends;
            match result {
                Ok(_) => ends.arrived += 1,
                Err(_) if doubts => ends.doubtful += 1,
                Err(_) => ends.ended += 1,
            }
        }
        Ok(())
    }

    fn judge_move(
        &mut self,
        id: u32,
        issued: Issued,
        result: Result<Completion, Failure>,
    ) -> Result<(), ()> {
        self.count_end(id, issued, result)?;
        let ready = self.cycle - self.blocked.max(issued.since).min(self.cycle);
        if let Err(Failure::Timeout {
            delivery: Delivery::NotSent,
            ..
        }) = result
            && ready > self.acknowledge / 2 + self.seen
        {
            return self.broken(
                "what nothing is in the way of goes out, or ends",
                format!("{id} is {result:?}, and for {ready} cycles the axis was ready for it"),
            );
        }
        let slack = self.no_way();
        if let (Ok(_), Some(index)) = (result, issued.latch) {
            self.drive.note_over(index, slack);
        }
        let ledger = &self.drive.ledger;
        let making = &self.drive.making;
        let latch = issued.latch.map(|index| {
            // One that was replaced by another to the same end may show itself there by that.
            let mut latch = ledger[index];
            let replaced = matches!(latch.end, Some((_, End::Replaced)));
            for later in ledger.iter().skip(index + 1).filter(|_| replaced) {
                if (later.goal - latch.goal).abs() <= slack {
                    latch.nearest = latch.nearest.min(later.nearest);
                    latch.axis_nearest = latch.axis_nearest.min(later.axis_nearest);
                    latch.axis_came = latch.axis_came.min(later.axis_came);
                }
            }
            latch
        });
        // On its ramp the axis is ahead of the demand by what the ramp takes to follow; one that swings by more than that is
        // not at its end. And what shows in two ticks is on its way.
        let ramp = f64::from(self.ramp);
        let ahead = ramp / making.frequency.powi(2);
        let ahead_of_rest = if making.frequency >= 400.0 {
            ahead
        } else {
            0.0
        };
        let two_ticks = |latch: &Latch| {
            2.0 * making.tick * f64::from(latch.velocity).min((2.0 * ramp * latch.nearest).sqrt())
        };
        // Of one that its drive has dropped unseen its word is left, and that the axis was there, if that is not a distance from nobody
        // knows where.
        let dropped = latch.is_some_and(|latch| {
            let near = latch
                .axis_nearest
                .min((latch.goal - self.drive.position).abs());
            let there = latch.relative || near <= slack + two_ticks(&latch);
            matches!(latch.end, Some((_, End::Dropped))) && there
        });
        // One with no way to go that the drive has not begun is at its end where the demand rests within the window of it;
        // of several such in a row each may be further on by a window.
        let rests_at_end = |latch: &Latch| {
            let index = issued.latch.unwrap_or_default();
            let unseen = ledger[..=index].iter().rev();
            let unseen = unseen.take_while(|latch| latch.began.is_none()).count();
            let way = self.drive.apart(self.drive.demand, latch.goal);
            unseen > 0
                && (latch.way <= slack * unseen as f64
                    || (making.turn.is_some() && !latch.relative))
                && way <= slack * unseen as f64
        };
        match (result, latch) {
            (Ok(_), None) if !issued.unseen => self.broken(
                "Reached: that set-point ended",
                format!("{id} is {result:?}, and was never taken"),
            ),
            (Ok(Completion::Reached { .. }), Some(latch)) => {
                if latch.nearest > slack + ahead_of_rest + two_ticks(&latch)
                    && !dropped
                    && !rests_at_end(&latch)
                {
                    return self.broken(
                        "Reached: that set-point ended",
                        format!("{id} is Reached, and the demand is {:.0} counts from its end: {latch:?}", latch.nearest),
                    );
                }
                Ok(())
            }
            (Ok(Completion::Passed { .. }), Some(latch)) => {
                let tick = 2.0 * making.tick * f64::from(latch.velocity);
                // It has at least gone on its way.
                let dropped = dropped && latch.began.is_some();
                if latch.nearest > slack + ahead + tick && !dropped && !rests_at_end(&latch) {
                    return self.broken(
                        "Passed: that set-point was passed",
                        format!("{id} is Passed, and the demand is {:.0} counts from its end: {latch:?}", latch.nearest),
                    );
                }
                Ok(())
            }
            (Ok(_), _) => Ok(()),
            (Err(failure), latch) => {
                let text = format!("{failure:?}");
                let name = text
                    .split(|c: char| !c.is_alphanumeric())
                    .next()
                    .unwrap_or_default();
                if (text.contains("NotSent")
                    || matches!(
                        name,
                        "Withdrawn" | "Busy" | "NeedsStop" | "Unsupported" | "NotEnabled"
                    ))
                    && latch.is_some()
                {
                    return self.broken(
                        "latched = accepted + unknown",
                        format!("{id} is {text}, and the drive has taken it: {latch:?}"),
                    );
                }
                let Some(latch) = latch else { return Ok(()) };
                let forgets = self.habits.has(Habit::HaltForgets);
                // One with no way to go is over for all that shows, and what then shows is of it.
                let before = issued
                    .latch
                    .and_then(|index| self.drive.ledger.get(index.checked_sub(1)?));
                let behind_a_short_one = before.is_some_and(|before| before.way <= slack);
                // An axis that still swings through its ends before the acknowledge shows two ends as one.
                let late = [Habit::AckOf100Ms, Habit::AckLate];
                let swings = late.iter().any(|&habit| self.habits.has(habit))
                    && (self.habits.has(Habit::Overshoot) || ahead > self.window);
                match name {
                    // The drive may have gone on before the axis was there.
                    "MissedTarget"
                        if !forgets
                            && !issued.halted
                            && !issued.unseen
                            && !behind_a_short_one
                            && !swings
                            && (latch.end.is_none()
                                || (!matches!(latch.end, Some((_, End::Dropped)))
                                    && latch.axis_came
                                        <= self.window
                                            - 1.0
                                            - f64::from(self.drive.making.dither))) =>
                    {
                        self.broken(
                            "MissedTarget: it did not end there",
                            format!("{id} is {text}, and the drive limits nothing: {latch:?}"),
                        )
                    }
                    "Superseded" if issued.accepted && latch.end.is_none() => self.broken(
                        "Superseded: another took its place",
                        format!("{id} is superseded, and the drive holds it: {latch:?}"),
                    ),
                    _ => Ok(()),
                }
            }
        }
    }
}

/// Whether a drive in this state may have power.
const fn shows_power(state: ds402::State) -> bool {
    matches!(
        state,
        ds402::State::SwitchedOn | ds402::State::OperationEnabled | ds402::State::QuickStopActive
    )
}

fn fields(velocity: bool, end_velocity: bool) -> AxisFields {
    let mut fields = AxisFields::at(0, 0);
    fields.controlword = 0;
    fields.mode = Some(2);
    fields.target = 3;
    fields.velocity = Some(7);
    fields.acceleration = Some(11);
    fields.deceleration = Some(15);
    fields.target_velocity = Some(19);
    fields.end_velocity = end_velocity.then_some(23);
    fields.statusword = 0;
    fields.mode_display = Some(2);
    fields.position = 3;
    fields.actual_velocity = velocity.then_some(7);
    fields.error_code = Some(11);
    fields
}

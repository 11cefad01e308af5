//! How a scenario is made: which habits it has, and the settings of drive, axis and program, all from its seed.

use core::time::Duration;

use servocrab::ds402::QuickStopOption;
use servocrab::profile_position::{
    BufferSignal, Parameters, PositionRange, RelativeBase, StartBits, Traits,
};
use servocrab::{Referencing, axis::CoreConfig};

use crate::drive::{Ack, Base, Making};
use crate::habits::{BEYOND, Habit, Habits, MODEL, Side, all};
use crate::random::Random;
use crate::words::fields;

/// One scenario, before it begins.
pub struct Made {
    pub side: Side,
    pub habits: Habits,
    /// Drive, cable and host have no habits at all.
    pub sound: bool,
    pub making: Making,
    pub config: CoreConfig,
    /// From one frame to the next, and how many of them one cycle of the drive takes.
    pub period: Duration,
    pub slow: u64,
    pub program: Program,
    /// Of the core: whether it steps on outputs that are kept, and whether another beside it steps the other way.
    pub kept: bool,
    pub both: bool,
    /// Where the drive, the cable and the program take their numbers from.
    pub drive: Random,
    pub cable: Random,
    pub choices: Random,
    /// Its drive takes set-points while it is halted, and half of the halts hold the axis.
    pub holds: bool,
}

/// What the program is like.
#[derive(Debug, Clone, Copy)]
pub struct Program {
    /// Velocity of its moves, counts/s, to which the number of each is added; acceleration and deceleration.
    pub speed: u32,
    pub ramp: u32,
    /// How far its targets are, as a multiple.
    pub far: i32,
    /// Every so many cycles it does something.
    pub busy: u64,
    /// It uses other modes, too.
    pub homes: bool,
    /// Before the end everything that was asked for comes to its own.
    pub patient: bool,
    /// At the end it homes twice.
    pub homes_twice: bool,
    /// Its liveness expires at times.
    pub expires: bool,
    /// Some moves pass their ends at this velocity.
    pub end_velocity: Option<u32>,
}

/// So that it is drawn beside all others.
const HOLDS: u64 = 0x0040_01D5;

impl Made {
    /// The scenario of this seed without these habits. What it draws is the same whatever is left out.
    pub fn new(seed: u64, without: Habits) -> Self {
        let side = Side::of(seed);
        let mut random = Random::new(seed);
        let mut drawn = random.fork();
        let (drive, cable, choices) = (random.fork(), random.fork(), random.fork());
        let mut holds = Random::new(seed ^ HOLDS);
        let (sound, habits) = draw_habits(side, &mut drawn);
        let habits = Habits(habits.0 & !without.0);
        let program = draw_program(&mut random);
        let (period, slow, making) = draw_drive(habits, sound, &program, &mut random);
        let shows_velocity = random.one_in(2);
        let described = random.pick(&[true, true, false]);
        let known_base = random.one_in(2);
        let mut config = draw_config(
            habits,
            &making,
            fields(shows_velocity, program.end_velocity.is_some()),
            (described, known_base),
            period * slow as u32 * making.drive_cycle,
            &mut random,
        );
        let holds = holds.one_in(4);
        config.traits.acknowledges_while_halted = holds;
        Self {
            side,
            habits,
            sound,
            making,
            config,
            period,
            slow,
            program,
            kept: random.one_in(2),
            both: random.one_in(8),
            drive,
            cable,
            choices,
            holds,
        }
    }
}

/// Whether the scenario has no habits, and those that it has.
fn draw_habits(side: Side, random: &mut Random) -> (bool, Habits) {
    let mut habits = Habits::default();
    let roll = random.below(8);
    let density = random.pick(&[4, 8, 16]);
    let beyond = side == Side::Outside;
    if beyond {
        habits = habits.with(random.pick(BEYOND));
    } else if roll == 0 {
        return (true, habits);
    }
    // One alone, or many.
    if roll <= 2 {
        if !beyond {
            habits = habits.with(random.pick(MODEL));
        }
        return (false, habits);
    }
    for habit in all() {
        let may = beyond || (habit as usize) < MODEL.len();
        // Those with which little else can be judged come seldom.
        let rare = matches!(habit, Habit::QuickStopIgnored | Habit::HaltIgnored);
        if random.one_in(density) && may && (!rare || random.one_in(4)) {
            habits = habits.with(habit);
        }
    }
    (false, habits)
}

fn draw_program(random: &mut Random) -> Program {
    Program {
        speed: random.pick(&[10_000, 40_000, 80_000]),
        ramp: random.pick(&[60_000, 500_000, 2_000_000]),
        far: if random.one_in(8) { 20 } else { 1 },
        busy: random.pick(&[10, 30, 100, 300]),
        homes: random.one_in(3),
        patient: random.one_in(4),
        homes_twice: random.one_in(4),
        expires: random.one_in(6),
        // No slower than what is surely no standstill.
        end_velocity: Some(random.pick(&[20_000, 40_000])).filter(|_| random.one_in(6)),
    }
}

fn draw_drive(
    habits: Habits,
    sound: bool,
    program: &Program,
    random: &mut Random,
) -> (Duration, u64, Making) {
    let period_us: u64 = random.pick(&[250, 500, 1000, 1000, 1000, 2000]);
    let slow_by = random.pick(&[2, 3, 4]);
    let slow = if habits.has(Habit::SlowCycle) {
        slow_by
    } else {
        1
    };
    let tick = period_us as f64 * slow as f64 * 1e-6;
    let window = f64::from(random.pick(&[10_u16, 10, 100]));
    let begin_ms = random.pick(&[400.0, 1_000.0]);
    // It follows its demand within half the window, on twice its ramp: what it slows down with.
    let stiff = (2.0 * 1.5 * f64::from(program.ramp) / window)
        .sqrt()
        .max(400.0);
    let plain = random.pick(&[400.0, stiff]);
    let overshoot = (
        random.pick(&[60.0, 150.0]),
        random.pick(&[0.25, 0.5]),
        random.pick(&[0.9, 1.0]),
    );
    let creep = (random.pick(&[40.0, 80.0]), 1.0, random.pick(&[0.5, 0.9]));
    let (frequency, damping, feed_forward) = if habits.has(Habit::Overshoot) {
        overshoot
    } else if habits.has(Habit::Creeps) {
        creep
    } else {
        (if sound { stiff } else { plain }, 1.0, 1.0)
    };
    let dither = random.pick(&[1, 2, 3]);
    let noise = random.pick(&[1, 5, 40]);
    let late = habits.any(Habits::of(&[Habit::OutputsLate, Habit::InputsLate]));
    let drive_cycle = if late { 3 } else { 1 };
    // Inputs that are late already are no older than two drive cycles in all.
    let held = if habits.has(Habit::InputsLate) { 2 } else { 0 };
    let ages = [(); 4].map(|()| {
        let age = random.below(u64::from(2 * drive_cycle - held) + 1) as u8;
        if habits.has(Habit::Skew) { age } else { 0 }
    });
    let turns = [(0, 3_600), (-1_800, 3_600), (-9_000, 20_000)];
    let turn = Some(random.pick(&turns)).filter(|_| random.one_in(8));
    let limits = (
        f64::from(-random.between(200, 3_000)),
        f64::from(random.between(200, 3_000)),
    );
    let passes_by_bit_5 = random.one_in(8);
    let ack = random.pick(&[Ack::Buffer, Ack::Handshake, Ack::Handshake]);
    let making = Making {
        // That bit 12 of such a drive shows a full buffer is documented.
        ack: if passes_by_bit_5 { Ack::Buffer } else { ack },
        base: random.pick(&[Base::PreviousTarget, Base::Demand, Base::Actual]),
        quick_stop: random.pick(&[1, 2, 5, 6, 7, 8]),
        turn,
        one_way: random.one_in(2),
        bits_first: random.one_in(6),
        passes_by_bit_5,
        tick,
        drive_cycle,
        begin: (begin_ms * 1e-3 / tick) as u32,
        window,
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
        ages,
        limits: if turn.is_some() {
            (f64::NEG_INFINITY, f64::INFINITY)
        } else {
            limits
        },
        shows_limit: random.one_in(2),
        rises_between: random.one_in(2),
        at_once: random.one_in(2),
        incidents: random.pick(&[60, 250, 900]),
    };
    (Duration::from_micros(period_us), slow, making)
}

fn draw_config(
    habits: Habits,
    making: &Making,
    fields: servocrab::axis::AxisFields,
    (described, known_base): (bool, bool),
    drive_cycle: Duration,
    random: &mut Random,
) -> CoreConfig {
    let mut config = CoreConfig::new(fields);
    config.referencing = Referencing::UnreferencedMovesAllowed;
    config.traits = Traits {
        buffer_signal: match (described, making.ack) {
            (false, _) => BufferSignal::Unknown,
            (true, Ack::Buffer) => BufferSignal::Acknowledge,
            (true, Ack::Handshake) => BufferSignal::None,
        },
        relative_base: match (known_base, making.base) {
            (false, _) => RelativeBase::Undocumented,
            (true, Base::PreviousTarget) => RelativeBase::PreviousTarget,
            (true, Base::Demand) => RelativeBase::Demand,
            (true, Base::Actual) => RelativeBase::Actual,
        },
        halt_keeps_set_point: !habits.has(Habit::HaltForgets),
        start_bits_first: making.bits_first,
        drive_cycle,
        ..Traits::cia402()
    };
    if making.passes_by_bit_5 {
        config.traits.immediately = StartBits::Unsupported("it ends the active one first");
        config.traits.after_current = StartBits::Sequenced;
        config.traits.blend = StartBits::Bits {
            change_set_immediately: true,
            change_on_set_point: false,
        };
    }
    config.modulo = making.turn.map(|(least, length)| PositionRange {
        min: least as i32,
        max: (least + length - 1) as i32,
    });
    if random.one_in(8) {
        config.stop_options.halt = Some(0);
    }
    config.quick_stop = QuickStopOption(making.quick_stop.into());
    config.defaults = Parameters {
        velocity: Some(50_000),
        acceleration: Some(500_000),
        deceleration: Some(500_000),
        ..Parameters::default()
    };
    config.tolerances.position = making.window as u32;
    // An axis that swings or creeps stays within the window for a while on its way: the settle time is longer than that.
    let settle_ms = random.pick(&[20, 20, 100]);
    let swings = habits.any(Habits::of(&[Habit::Overshoot, Habit::Creeps]));
    config.tolerances.settle = Duration::from_millis(if swings { 100 } else { settle_ms });
    config.deadlines.enable = Duration::from_millis(400);
    config.deadlines.disable = Duration::from_millis(400);
    config.deadlines.acknowledge = Duration::from_millis(random.pick(&[40, 150, 500]));
    config.deadlines.standstill = Duration::from_millis(800);
    config.deadlines.mode = Duration::from_millis(100);
    config.deadlines.fault_reset = Duration::from_millis(40);
    config.deadlines.begin = Duration::from_secs_f64(f64::from(making.begin) * making.tick);
    config
}

//! A random scenario of an axis, made from one number: drive, timing, commands, stops, lost frames, disturbances.
//!
//! The plant and the crystal of the drive come from the seeded faults of `servocrab-sim`. What else goes wrong here cannot: those
//! faults meet frames, devices and mailboxes, and this world has bytes and one axis. Its losses are drawn for each cycle,
//! as what the core is told; its other disturbances are those that only a hand on the axis makes, such as a bit 12 that lies.

use core::time::Duration;

use servocrab::axis::{Command, CommandId, CoreConfig, Referencing, StopRequest};
use servocrab::ds402::{Mode, QuickStopOption};
use servocrab::profile_position::{
    BufferMode, BufferSignal, MoveCommand, Parameters, Reference, RelativeBase, SetPoint,
    StartBits, Traits,
};
use servocrab_sim::ds402::{AckFault, AckPolicy, Axis, Behaviour, Plant, ReachedPolicy, State};
use servocrab_sim::{Faults, FaultyLine, PlantChoice, Segment, personality};

use super::rarer::Rarer;
use super::wider::Wider;
use super::world::{DRIVE_CYCLE, World};
use crate::frames::{Link, Random};

/// What the drive was made to do wrong in a run; some judgements do not hold then.
#[derive(Debug, Clone, Copy, Default)]
pub struct Lies {
    /// Bit 12 showed what was not so.
    pub ack: bool,
    /// The position jumped when a blocked shaft came free.
    pub blocked: bool,
    /// The drive did not obey a stop.
    pub deaf: bool,
}

/// The bits of a seed that choose another drive begin here.
pub const OTHER_DRIVES: u32 = 40;
/// Set for a scenario whose shaft is where the demand is; else it is on a plant, another one for each seed.
const IDEAL: u64 = 1 << 44;

pub const fn ideal(seed: u64) -> u64 {
    seed | IDEAL
}

/// Cycles of a run with disturbances, before the quiet end.
pub const RUN: usize = 2_500;
/// Acceleration and deceleration of moves that name none, counts/s².
pub const RAMP: u32 = 500_000;
/// Time in which, with everything in order, each move that is not halted comes to its end.
const QUIET: Duration = Duration::from_secs(4);

/// Whether the drive's ledger tells one move from another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Names {
    /// Each move has a velocity of its own.
    Unique,
    /// Many moves are equal in everything.
    Equal,
}

/// Which bits start a move on the drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Starts {
    /// Bit 5 starts at once, bit 9 blends (AKD2G and the plain CiA 402 drive).
    Cia402,
    /// Bit 5 starts at once, nothing blends (the drive with 2010h).
    WithoutBlend,
    /// Bit 5 blends, nothing starts at once (AX2000).
    Ax2000,
}

pub struct Scenario {
    pub world: World,
    pub starts: Starts,
    /// Drive cycles by which the actual position is late.
    pub lag_cycles: usize,
    pub lies: Lies,
    /// The frame from which on nothing was disturbed and nothing asked for.
    pub quiet_from: usize,
    /// The frame of the last quick stop.
    pub last_stop: usize,
}

/// Runs the scenario of this seed: the same one on a plant and without.
pub fn live(seed: u64, names: Names) -> Scenario {
    let (is_ideal, seed) = (seed & IDEAL != 0, seed & !IDEAL);
    let mut random = Random::new(seed);
    let lag_cycles = random.pick(&[0, 0, 2, 6]);
    let starts = match seed >> OTHER_DRIVES & 3 {
        1 => Starts::WithoutBlend,
        2 => Starts::Ax2000,
        _ => Starts::Cia402,
    };
    let mut wider = Wider::of(seed);
    let mut rarer = Rarer::of(seed);
    let mut world = build(
        &mut random,
        lag_cycles,
        starts,
        wider.as_mut(),
        rarer.as_mut(),
    );
    if is_ideal {
        world.drive.set_plant(Plant::ideal());
    } else {
        let (plant, drive_cycle) = seeded_faults(seed);
        world.drive.set_plant(plant);
        world.drive_cycle = drive_cycle;
    }
    let mut player = Player {
        wider,
        rarer,
        world,
        starts,
        names,
        lag_cycles: lag_cycles as usize,
        lies: Lies::default(),
        loss: random.pick(&[0, 0, 400, 60, 15]),
        trouble: random.pick(&[0, 0, 600, 250]),
        busy: random.pick(&[15, 40, 120]),
        lane: random.pick(&[0, 900, 250]),
        slow: random.one_in(3),
        burst: None,
        troubles: Vec::new(),
        random,
    };
    for _ in 0..RUN {
        player.cycle();
    }
    player.end()
}

/// The plant that the simulator's faults hang on an axis, and how long its drive cycle takes by a crystal that is off.
fn seeded_faults(seed: u64) -> (Plant, Duration) {
    let faults = Faults {
        plant: PlantChoice::Seeded,
        drift_ppm: 100,
        ..Faults::default().seed(seed)
    };
    let segment = Segment::new().with(personality::akd2g());
    let line = FaultyLine::new(segment, &faults).expect("no outage of a device that is not there");
    let device = line.segment().device(0).expect("the only one");
    let second = device.system_time(Duration::from_secs(1));
    let drive_cycle = DRIVE_CYCLE.as_nanos() as u64 * second / 1_000_000_000;
    (*device.axes()[0].plant(), Duration::from_nanos(drive_cycle))
}

fn build(
    random: &mut Random,
    lag_cycles: u32,
    starts: Starts,
    mut wider: Option<&mut Wider>,
    mut rarer: Option<&mut Rarer>,
) -> World {
    let akd2g = !random.one_in(4) && starts == Starts::Cia402;
    let base = match starts {
        Starts::Cia402 if akd2g => Behaviour::akd2g(),
        Starts::Cia402 => Behaviour::generic(),
        Starts::WithoutBlend => Behaviour {
            supported_modes: Behaviour::generic().supported_modes,
            // 606Ch is mapped, 607Dh makes trouble.
            without: &[],
            ..Behaviour::pp2010()
        },
        Starts::Ax2000 => Behaviour {
            without: &[],
            ..Behaviour::ax2000()
        },
    };
    let option = random.pick(&[1, 2, 5, 6]);
    let sticky = akd2g && random.one_in(12);
    let mut behaviour = Behaviour {
        quick_stop_option: option,
        power_on_cycles: random.pick(&[0, 0, 5]),
        mode_change_cycles: random.pick(&[0, 3, 20]),
        auto_3_4: random.one_in(2),
        open_bit_5: random.one_in(2),
        reached: random.pick(&[
            ReachedPolicy::WindowAfterEnd,
            ReachedPolicy::WindowAfterEnd,
            ReachedPolicy::TrajectoryEnd,
        ]),
        actual_lag_cycles: lag_cycles,
        bit_4_filter_cycles: random.pick(&[0, 0, 0, 1]),
        halt_keeps: !random.one_in(6),
        manufacturer_bits: random.pick(&[0, 0xC100]),
        abort_connection_option: random.pick(&[1, 2, 3]),
        ack: if sticky {
            AckPolicy::StickyAtEnable
        } else {
            base.ack
        },
        ..base
    };
    let mut config = CoreConfig::new(World::fields(!random.one_in(4)));
    config.referencing = Referencing::UnreferencedMovesAllowed;
    config.traits = Traits {
        buffer_signal: if behaviour.ack == AckPolicy::BufferFree {
            BufferSignal::Acknowledge
        } else {
            BufferSignal::None
        },
        relative_base: if akd2g {
            random.pick(&[RelativeBase::Undocumented, RelativeBase::Demand])
        } else {
            RelativeBase::Undocumented
        },
        halt_keeps_set_point: behaviour.halt_keeps,
        shows_voltage: random.one_in(2),
        ..traits_of(starts)
    };
    config.quick_stop = QuickStopOption(option);
    config.defaults = Parameters {
        velocity: Some(50_000),
        acceleration: Some(RAMP),
        deceleration: Some(RAMP),
        ..Parameters::default()
    };
    config.tolerances.settle = Duration::from_millis(20);
    config.deadlines.enable = Duration::from_millis(400);
    config.deadlines.disable = Duration::from_millis(400);
    config.deadlines.acknowledge = Duration::from_millis(40);
    config.deadlines.standstill = Duration::from_millis(800);
    config.deadlines.mode = Duration::from_millis(100);
    config.deadlines.fault_reset = Duration::from_millis(40);
    if let Some(wider) = &mut wider {
        wider.change(&mut behaviour, &mut config);
    }
    if let Some(rarer) = &mut rarer {
        rarer.change(&mut behaviour, &mut config);
    }
    let mut drive = Axis::new(behaviour);
    if let Some(wider) = wider {
        wider.set_up(&mut drive);
    }
    if let Some(rarer) = rarer {
        rarer.set_up(&mut drive);
    }
    drive
        .set(0x6085, 0, random.pick(&[300_000, 2_000_000]))
        .expect("a ramp");
    drive
        .set(0x6068, 0, random.pick(&[0, 0, 5]))
        .expect("a window");
    let period = random.pick(&[250, 500, 1000, 1000, 1000, 2000]);
    let latency = random.pick(&[0, 0, 0, 1, 3]);
    World::new(drive, config, Duration::from_micros(period), latency)
}

/// The starts as a description of the drive would give them, after the source documents.
fn traits_of(starts: Starts) -> Traits {
    let cia402 = Traits::cia402();
    match starts {
        Starts::Cia402 => cia402,
        Starts::WithoutBlend => Traits {
            blend: StartBits::Unsupported("it has no bit for it"),
            ..cia402
        },
        Starts::Ax2000 => Traits {
            immediately: StartBits::Unsupported("nothing replaces a move on this drive"),
            after_current: StartBits::Sequenced,
            blend: StartBits::Bits {
                change_set_immediately: true,
                change_on_set_point: false,
            },
            ..cia402
        },
    }
}

struct Player {
    world: World,
    starts: Starts,
    names: Names,
    wider: Option<Wider>,
    rarer: Option<Rarer>,
    lag_cycles: usize,
    random: Random,
    lies: Lies,
    /// One frame in so many is lost in one way or another; 0 for none.
    loss: u64,
    /// One cycle in so many begins a disturbance of the drive.
    trouble: u64,
    /// One cycle in so many brings a command.
    busy: u64,
    /// One cycle in so many brings a stop by the lane.
    lane: u64,
    /// Slow ramps.
    slow: bool,
    burst: Option<(Link, u64)>,
    /// What is to be undone, and when.
    troubles: Vec<(usize, Incident)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Incident {
    AckDelay,
    AckNever,
    AckStuck,
    StaleReached,
    Deaf,
    Blocked,
    Fault,
    LastingFault,
    Voltage,
    Remote,
    Inhibit,
    OwnStop,
    Warning,
    Limits,
}

impl Player {
    fn cycle(&mut self) {
        let silent = self.rarer.as_ref().is_some_and(Rarer::is_silent);
        if self.random.one_in(self.busy) && !silent {
            self.command();
            for _ in 0..self.wider.as_mut().map_or(0, Wider::volley) {
                self.command();
            }
        }
        if self.random.one_in(60)
            && let Some(issued) = self.world.pending().last()
        {
            self.world.withdraw(issued.id);
        }
        let lane = if self.lane > 0 && self.random.one_in(self.lane) {
            self.random.pick(&[
                StopRequest::HALT,
                StopRequest::STOP,
                StopRequest::QUICK_STOP,
                StopRequest::HALT.union(StopRequest::QUICK_STOP),
            ])
        } else {
            StopRequest::empty()
        };
        self.disturb();
        if let Some(rarer) = &mut self.rarer {
            self.lies.deaf |= rarer.pass(&mut self.world.drive);
            if let Some(stop) = rarer.stop() {
                self.world.submit(stop);
            }
        }
        let hit = match &mut self.wider {
            Some(wider) => wider.hit(&mut self.world),
            None => None,
        };
        if let Some((link, more)) = hit {
            self.burst = Some((link, more));
        }
        let link = self.link();
        let fire = !self.random.one_in(4);
        self.world.cycle(lane, fire, link);
    }

    fn command(&mut self) {
        let state = self.world.drive.state();
        let random = &mut self.random;
        let roll = random.below(100);
        let command = if state == State::OperationEnabled && roll < 62 {
            self.a_move()
        } else if state == State::Fault && roll < 50 {
            Command::ResetFault
        } else if state != State::OperationEnabled && roll < 80 {
            Command::Enable
        } else {
            random.pick(&[
                Command::Halt,
                Command::Halt,
                Command::Resume,
                Command::Resume,
                Command::Resume,
                Command::Stop,
                Command::QuickStop,
                Command::Disable,
                Command::Release,
                Command::Enable,
                Command::ResetFault,
                Command::SelectMode(Mode::ProfilePosition),
                Command::SelectMode(Mode::CyclicPosition),
                Command::SelectMode(Mode::Homing),
            ])
        };
        self.world.submit(command);
        // Another one in the same cycle, now and then.
        if self.random.one_in(6) {
            let second = self.a_move();
            self.world.submit(second);
        }
        // A mode that was left is taken again, or no move would ever start.
        if self.world.core.snapshot().mode != Mode::ProfilePosition && self.random.one_in(2) {
            self.world
                .submit(Command::SelectMode(Mode::ProfilePosition));
        }
    }

    fn a_move(&mut self) -> Command {
        // The velocity names the move in the drive's ledger.
        let equal = self.names == Names::Equal;
        let name = if equal {
            0
        } else {
            self.world.issued.len() as u32 + 1
        };
        let slow = self.slow;
        let random = &mut self.random;
        let relative = random.one_in(3);
        let position = self.world.drive.position() as i32;
        let target = if equal {
            random.pick(&[0, 300])
        } else if relative {
            random.pick(&[0, 5, -5, 1000, -700, 15])
        } else {
            match random.below(6) {
                0 => position,
                1 => position + random.between(-30, 30),
                2 => 1000,
                _ => {
                    let far = self.rarer.as_mut().map_or(1, Rarer::far);
                    far * random.between(-4000, 4000)
                }
            }
        };
        let velocity = if equal {
            50_000
        } else {
            random.pick(&[10_000, 30_000, 80_000]) + name
        };
        let ramp = if slow { 60_000 } else { 1_000_000 };
        let mut set_point = SetPoint::new()
            .velocity(velocity)
            .buffer_mode(random.pick(&[
                BufferMode::Aborting,
                BufferMode::Buffered,
                BufferMode::Blending,
            ]));
        if !random.one_in(4) {
            set_point = set_point
                .acceleration(ramp + name)
                .deceleration(2 * ramp + name);
        }
        Command::Move(MoveCommand {
            reference: if relative {
                Reference::Relative
            } else {
                Reference::Absolute
            },
            target,
            set_point,
            gated: random.one_in(8),
        })
    }

    fn link(&mut self) -> Link {
        if let Some((link, left)) = self.burst {
            self.burst = (left > 0).then(|| (link, left - 1));
            return link;
        }
        if self.loss == 0 {
            return Link::Good;
        }
        if !self.random.one_in(self.loss) {
            return Link::Good;
        }
        let link = self.random.pick(&[
            Link::RequestLost,
            Link::ReplyLost,
            Link::Miscounted,
            Link::Undelivered,
        ]);
        let more = self.random.pick(&[0, 0, 0, 1, 3, 9, 12, 40]);
        self.burst = (more > 0).then_some((link, more));
        link
    }

    fn disturb(&mut self) {
        let at = self.world.frames.len();
        while let Some(due) = self.troubles.iter().position(|(until, _)| *until <= at) {
            let (_, trouble) = self.troubles.remove(due);
            self.undo(trouble);
        }
        if self.trouble == 0 || !self.random.one_in(self.trouble) {
            return;
        }
        let trouble = self.random.pick(&[
            Incident::AckDelay,
            Incident::AckNever,
            Incident::AckStuck,
            Incident::StaleReached,
            Incident::StaleReached,
            Incident::Deaf,
            Incident::Blocked,
            Incident::Fault,
            Incident::Fault,
            Incident::LastingFault,
            Incident::Voltage,
            Incident::Remote,
            Incident::Inhibit,
            Incident::OwnStop,
            Incident::Warning,
            Incident::Limits,
        ]);
        let until = at + self.random.pick(&[1, 20, 100, 1500]);
        self.troubles.push((until, trouble));
        let drive = &mut self.world.drive;
        match trouble {
            Incident::AckDelay => {
                drive.disturbances().ack_delay_cycles = self.random.pick(&[3, 20, 60]);
            }
            Incident::AckNever => {
                self.lies.ack = true;
                drive.disturbances().ack = AckFault::Never;
            }
            Incident::AckStuck => {
                self.lies.ack = true;
                drive.disturbances().ack = AckFault::StuckHigh;
            }
            Incident::StaleReached => {
                drive.disturbances().stale_reached_cycles = self.random.pick(&[2, 8]);
            }
            Incident::Deaf => drive.disturbances().deaf_to_bit_4 = true,
            Incident::Blocked => {
                self.lies.blocked = true;
                drive.disturbances().blocked = true;
            }
            Incident::Fault => drive.inject_fault(0x7305),
            Incident::LastingFault => drive.inject_lasting_fault(0x4310),
            Incident::Voltage => drive.set_voltage(false),
            Incident::Remote => drive.set_remote(false),
            Incident::Inhibit => drive.set_inhibited(true),
            Incident::OwnStop => {
                drive.connection_lost();
                drive.connection_restored();
            }
            Incident::Warning => drive.set_warning(true),
            Incident::Limits => {
                for (subindex, limit) in [(1, -500), (2, 500)] {
                    drive.set(0x607D, subindex, limit).expect("a limit");
                }
            }
        }
    }

    fn undo(&mut self, trouble: Incident) {
        let drive = &mut self.world.drive;
        match trouble {
            Incident::AckDelay => {
                let late = self.wider.as_ref().map_or(0, Wider::late);
                drive.disturbances().ack_delay_cycles = late;
            }
            Incident::AckNever | Incident::AckStuck => drive.disturbances().ack = AckFault::None,
            Incident::StaleReached => drive.disturbances().stale_reached_cycles = 0,
            Incident::Deaf => drive.disturbances().deaf_to_bit_4 = false,
            Incident::Blocked => drive.disturbances().blocked = false,
            Incident::LastingFault => drive.clear_cause(),
            Incident::Voltage => drive.set_voltage(true),
            Incident::Remote => drive.set_remote(true),
            Incident::Inhibit => drive.set_inhibited(false),
            Incident::Warning => drive.set_warning(false),
            Incident::Limits => {
                for subindex in [1, 2] {
                    drive.set(0x607D, subindex, 0).expect("a limit");
                }
            }
            Incident::Fault | Incident::OwnStop => {}
        }
    }

    /// Everything in order and no command until each move is over, then a quick stop for what is left.
    fn end(mut self) -> Scenario {
        for (_, trouble) in core::mem::take(&mut self.troubles) {
            self.undo(trouble);
        }
        Rarer::heal(&mut self.world.drive);
        let quiet_from = self.world.frames.len();
        let far = self.rarer.as_ref().map_or(1, |_| Rarer::FAR.unsigned_abs());
        let until = self.world.now + far * QUIET;
        while self.world.now < until && !self.world.pending().is_empty() {
            self.world.cycle(StopRequest::empty(), true, Link::Good);
        }
        let last_stop = self.world.frames.len();
        let left: Vec<CommandId> = self.world.gated.clone();
        for id in left {
            self.world.withdraw(id);
        }
        self.world.submit(Command::QuickStop);
        let until = self.world.now + Duration::from_secs(2);
        while self.world.now < until {
            self.world.cycle(StopRequest::empty(), true, Link::Good);
            if self.world.pending().is_empty() && self.world.drive.velocity() == 0.0 {
                break;
            }
        }
        Scenario {
            world: self.world,
            starts: self.starts,
            lag_cycles: self.lag_cycles,
            lies: self.lies,
            quiet_from,
            last_stop,
        }
    }
}

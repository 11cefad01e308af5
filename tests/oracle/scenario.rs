//! One scenario: a core, a cable, a drive of some habits and a program, all from one seed, judged in every cycle.

use core::time::Duration;
use std::collections::VecDeque;

use servocrab::ds402::Mode;
use servocrab::{
    BufferMode,
    profile_position::{MoveCommand, Reference},
};
use servocrab::{
    Failure, StopRequest,
    axis::{Command, CommandId, Completion, CoreConfig, Event, Inputs},
};
use servocrab::{HomingMethod, homing::HomingCommand};

use crate::cable::{Cable, Told};
use crate::drive::Drive;
use crate::habits::{Habit, Habits, Side};
use crate::host::Host;
use crate::laws::Watch;
use crate::making::{Made, Program};
use crate::outcome::is_unsent;
use crate::random::Random;
use crate::tally::Tally;
use crate::words::{INPUT_BYTES, Outputs, Sample, State};

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
pub struct Lived {
    pub tally: Tally,
    pub commands: u32,
    pub habits: Habits,
    pub violation: Option<Violation>,
    pub transcript: VecDeque<String>,
    /// How the scenario is made, for a reader.
    pub making: String,
}

/// Lines of a transcript that are kept.
const LINES: usize = 160;
/// Cycles of a scenario before everything is in order again.
const DISTURBED: u64 = 2_500;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Kind {
    Enable,
    Disable,
    Reset,
    Mode,
    Home,
    Jog,
    Move,
    Halt,
    Hold,
    Resume,
    Stop,
    QuickStop,
    #[default]
    Release,
}

impl Kind {
    const fn of(command: &Command) -> Self {
        match command {
            Command::Enable => Self::Enable,
            Command::Disable => Self::Disable,
            Command::ResetFault => Self::Reset,
            Command::Home(_) => Self::Home,
            Command::Jog(_) => Self::Jog,
            Command::Move(_) => Self::Move,
            Command::Halt => Self::Halt,
            Command::Hold => Self::Hold,
            Command::Resume => Self::Resume,
            Command::Stop => Self::Stop,
            Command::QuickStop => Self::QuickStop,
            Command::Release => Self::Release,
            _ => Self::Mode,
        }
    }

    pub const fn stops(self) -> bool {
        matches!(
            self,
            Self::Halt | Self::Hold | Self::Stop | Self::QuickStop | Self::Disable | Self::Release
        )
    }

    /// Whether it has no deadline.
    pub const fn is_endless(self) -> bool {
        matches!(self, Self::Move | Self::Home | Self::Jog)
    }
}

#[derive(Debug, Clone, Copy, Default)]
pub struct Issued {
    pub kind: Kind,
    pub a_move: Option<MoveCommand>,
    /// The cycle in which it was asked for, and how many the host had run by then.
    pub since: u64,
    pub ran: u64,
    /// The drive had the power to move the axis when it was asked for.
    pub powered: bool,
    /// How many homings the drive had begun and ended by then.
    pub homings: (u64, u64),
    /// The axis was halted while it was under way.
    pub halted: bool,
    /// Its bit 4 went out with its name.
    pub sent: bool,
    pub accepted: bool,
    /// The cycle of its acknowledge.
    pub acknowledged: u64,
    /// Its end says that the drive has not got it.
    pub unsent: bool,
    pub done: bool,
    pub good: bool,
    /// Index in the drive's ledger.
    pub latch: Option<usize>,
}

impl Issued {
    /// A move that the drive has acknowledged and whose outcome is open.
    pub const fn is_open_move(&self) -> bool {
        self.a_move.is_some() && self.accepted && !self.done
    }
}

pub struct Scenario {
    pub host: Host,
    pub config: CoreConfig,
    pub drive: Drive,
    pub cable: Cable,
    pub habits: Habits,
    pub side: Side,
    pub sound: bool,
    pub program: Program,
    choices: Random,
    holds: bool,
    pub period: Duration,
    pub now: Duration,
    pub cycle: u64,
    /// Cycles in which the host has run.
    pub ran: u64,
    /// Cycles of the bus for one of the drive.
    pub slow: u64,
    slow_left: u64,
    pub issued: Vec<Issued>,
    pub pending: Vec<u32>,
    pub gated: Vec<u32>,
    pub jog: Option<u32>,
    pub sent_before: Outputs,
    pub sent: Outputs,
    /// What arrived last, and how.
    pub sample: Sample,
    pub told: Told,
    /// The same while the core is stepped: when something is reported.
    pub stepping: Option<Told>,
    pub expired: bool,
    pub watch: Watch,
    next_command: u64,
    cut: Cut,
    pub lived: Lived,
    verbose: bool,
    shown: (u16, u16),
}

/// Runs the scenario of this seed.
pub fn live(seed: u64, cut: &Cut, verbose: bool) -> Lived {
    let mut scenario = Scenario::new(seed, cut.clone(), verbose);
    if scenario.run().is_err() {
        let what = scenario.lived.violation.as_ref();
        let line = format!("VIOLATION {:?}", what.map(|violation| &violation.what));
        scenario.lived.transcript.push_back(line);
    }
    let mut lived = scenario.lived;
    lived.commands = scenario.issued.len() as u32;
    lived.habits = scenario.habits;
    let tally = &mut lived.tally;
    tally.cycles = scenario.cycle;
    tally.scenarios = 1;
    tally.set_points = scenario.drive.ledger.len() as u64;
    tally.hits.add(&scenario.drive.hits);
    tally.idle = scenario.host.idle;
    if scenario.sound {
        tally.sound = tally.ends;
    }
    lived
}

impl Scenario {
    fn new(seed: u64, cut: Cut, verbose: bool) -> Self {
        let made = Made::new(seed, cut.habits);
        let lived = Lived {
            making: if verbose {
                format!(
                    "{:?}, {:?}, {:?}, period {:?}, slow {}, {:?}",
                    made.side, made.making, made.program, made.period, made.slow, made.config
                )
            } else {
                String::new()
            },
            ..Lived::default()
        };
        Self {
            watch: Watch::new(&made),
            host: Host::new(made.config.clone(), made.kept, made.both),
            config: made.config,
            drive: Drive::new(made.making, made.habits, made.drive),
            cable: Cable::new(made.habits, made.cable),
            habits: made.habits,
            side: made.side,
            sound: made.sound,
            program: made.program,
            choices: made.choices,
            holds: made.holds,
            period: made.period,
            now: Duration::ZERO,
            cycle: 0,
            ran: 0,
            slow: made.slow,
            slow_left: 0,
            issued: Vec::new(),
            pending: Vec::new(),
            gated: Vec::new(),
            jog: None,
            sent_before: Outputs::default(),
            sent: Outputs::default(),
            sample: Sample::default(),
            told: Told::Stale,
            stepping: None,
            expired: false,
            next_command: 5,
            cut,
            lived,
            verbose,
            shown: (0, 0),
        }
    }

    pub fn is_inside(&self) -> bool {
        self.side == Side::Inside
    }

    pub fn cycles(&self, time: Duration) -> u64 {
        (time.as_micros() / self.period.as_micros()) as u64
    }

    fn run(&mut self) -> Result<(), ()> {
        while self.cycle < DISTURBED {
            if self.cycle >= self.next_command {
                self.next_command = self.cycle + 1 + self.choices.below(self.program.busy * 2);
                self.act()?;
            }
            if self.program.expires && self.choices.one_in(if self.expired { 100 } else { 800 }) {
                self.expire(!self.expired)?;
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
        self.cable.heal();
        if self.expired {
            self.expire(false)?;
        }
        for _ in 0..60 {
            self.step(StopRequest::empty())?;
        }
        if self.program.patient {
            // The laws of what waits for nothing see to it that this ends.
            let until = self.cycle + self.cycles(Duration::from_secs(12));
            while self.cycle < until && self.waits_for_itself() {
                self.step(StopRequest::empty())?;
            }
        }
        let last = if self.choices.one_in(2) {
            Command::Disable
        } else {
            Command::Stop
        };
        self.submit(last)?;
        let until = self.cycle + self.cycles(Duration::from_secs(4));
        while self.cycle < until && !self.pending.is_empty() {
            self.step(StopRequest::empty())?;
        }
        if let Some(&left) = self.pending.first() {
            let what = format!(
                "{left} {:?} has not, at the end",
                self.issued[left as usize]
            );
            return self.broken("every future ends", what);
        }
        // The second one finds in bit 12 what the first has left there.
        let home = Command::Home(HomingCommand {
            method: HomingMethod(17),
            offset: None,
            until: None,
        });
        for command in [
            Command::Disable,
            Command::ResetFault,
            Command::Enable,
            Command::SelectMode(Mode::Homing),
            home,
            home,
            Command::SelectMode(Mode::ProfilePosition),
            Command::Enable,
            self.last_move(),
            Command::Disable,
        ] {
            let homes = matches!(
                command,
                Command::Home(_) | Command::SelectMode(Mode::Homing)
            );
            let resets = command == Command::ResetFault;
            if homes && !self.program.homes_twice || resets && self.drive.state != State::Fault {
                continue;
            }
            let command = match command {
                Command::Move(_) => self.last_move(),
                other => other,
            };
            self.use_it(command)?;
        }
        Ok(())
    }

    /// A short way from where the axis is.
    fn last_move(&self) -> Command {
        let start = if self.drive.making.passes_by_bit_5 {
            BufferMode::Buffered
        } else {
            BufferMode::Aborting
        };
        let target = self.in_turn(self.host.snapshot().position + 500);
        self.a_move(Reference::Absolute, target, start, false, None)
    }

    /// A drive in order does what it is asked for.
    fn use_it(&mut self, command: Command) -> Result<(), ()> {
        // It coasts first, where its drive has no power.
        let wait = self.cycle + self.cycles(Duration::from_secs(3));
        let mut rests = 0;
        while rests < 2 * self.watch.settle && self.cycle < wait {
            rests = if self.is_moving() { 0 } else { rests + 1 };
            self.step(StopRequest::empty())?;
        }
        let id = self.submit(command)?;
        let until = self.cycle + self.cycles(Duration::from_secs(6));
        while self.cycle < until && !self.issued[id as usize].done {
            self.step(StopRequest::empty())?;
        }
        let issued = self.issued[id as usize];
        if issued.good {
            return Ok(());
        }
        let ends = if issued.done { "failed" } else { "has no end" };
        let what = format!("{:?} {ends} on a drive in order", issued.kind);
        self.broken("a sound drive can be used", what)
    }

    /// Whether a move is under way that nothing holds up.
    fn waits_for_itself(&self) -> bool {
        let mut pending = self.pending.iter().map(|id| self.issued[*id as usize]);
        pending.any(|issued| issued.kind == Kind::Move) && !self.host.snapshot().halted
    }

    pub fn broken(&mut self, law: &'static str, what: String) -> Result<(), ()> {
        self.say(|scenario| {
            format!(
                "next word {:04X}, sent {:?}, drive {:?}, at {:.0} v {:.0}, {:?}",
                scenario.host.outputs().word,
                scenario.sent,
                scenario.drive.state,
                scenario.drive.position,
                scenario.drive.velocity,
                scenario.host.snapshot()
            )
        });
        let cycle = self.cycle;
        self.lived.violation = Some(Violation { law, what, cycle });
        Err(())
    }

    pub fn say(&mut self, line: impl FnOnce(&Self) -> String) {
        if self.verbose {
            let line = format!("{:6} {}", self.cycle, line(self));
            self.lived.transcript.push_back(line);
            if self.lived.transcript.len() > LINES {
                self.lived.transcript.pop_front();
            }
        }
    }

    fn lane(&mut self) -> StopRequest {
        if !self.choices.one_in(400) {
            return StopRequest::empty();
        }
        self.choices.pick(&[
            StopRequest::HALT,
            StopRequest::STOP,
            StopRequest::QUICK_STOP,
            StopRequest::HALT.union(StopRequest::QUICK_STOP),
        ])
    }

    fn expire(&mut self, expired: bool) -> Result<(), ()> {
        self.expired = expired;
        self.say(|_| format!("expired {expired}"));
        self.host.call(|core, _| core.set_expired(expired));
        if expired {
            self.apply_lane(StopRequest::HALT)?;
        }
        Ok(())
    }

    /// What the program does now.
    fn act(&mut self) -> Result<(), ()> {
        let mut random = self.choices.fork();
        let volley = if random.one_in(8) { 3 } else { 1 };
        for _ in 0..volley {
            let mut random = random.fork();
            let number = self.issued.len() as u32;
            let command = match self.choose(&mut random) {
                Command::Halt if self.holds && number.is_multiple_of(2) => Command::Hold,
                command => command,
            };
            if self.cut.commands.binary_search(&number).is_ok() {
                // A place in the numbering, so that the names of the others stay.
                self.issued.push(Issued {
                    done: true,
                    ..self.as_issued(&Command::Release)
                });
            } else {
                self.submit(command)?;
            }
        }
        if random.one_in(12)
            && let Some(&id) = self.pending.last()
        {
            self.say(|_| format!("withdraw {id}"));
            let now = self.now;
            self.host
                .call(|core, outputs| core.withdraw(now, CommandId(id), outputs));
            self.drain()?;
        }
        if let Some(id) = self.jog
            && random.one_in(3)
        {
            if random.one_in(2) {
                let now = self.now;
                self.host
                    .call(|core, outputs| core.release_jog(now, CommandId(id), outputs));
            } else {
                let velocity = random.between(-9_000, 9_000);
                self.host
                    .call(|core, outputs| core.set_jog(CommandId(id), velocity, outputs));
            }
            self.drain()?;
        }
        Ok(())
    }

    fn as_issued(&self, command: &Command) -> Issued {
        Issued {
            kind: Kind::of(command),
            a_move: match command {
                Command::Move(a_move) => Some(*a_move),
                _ => None,
            },
            since: self.cycle,
            ran: self.ran,
            powered: self.drive.state.is_powered(),
            homings: self.drive.homings,
            ..Issued::default()
        }
    }

    pub fn submit(&mut self, command: Command) -> Result<u32, ()> {
        let id = self.issued.len() as u32;
        self.say(|_| format!("{id} {command:?}"));
        let issued = self.as_issued(&command);
        self.issued.push(issued);
        self.pending.push(id);
        if let Command::Move(MoveCommand { gated: true, .. }) = command {
            self.gated.push(id);
        }
        if issued.kind == Kind::Jog {
            self.jog = Some(id);
        }
        // Where the axis would coast at bit 8 a halt is refused.
        let refused = issued.kind == Kind::Halt && self.watch.halt_coasts;
        let held = self.must_stop();
        if issued.kind != Kind::Hold && !refused {
            self.note_asked(issued.kind);
        }
        let now = self.now;
        self.host
            .call(|core, outputs| core.submit(now, CommandId(id), command, outputs));
        if issued.kind == Kind::Hold {
            // What its drive cannot do is refused, and is no stop.
            self.drain()?;
            if self.issued[id as usize].done {
                return Ok(id);
            }
            self.note_asked(issued.kind);
        }
        if issued.kind.stops() && held && !refused {
            self.judge_stop(issued.kind)?;
        }
        self.drain()?;
        Ok(id)
    }

    fn apply_lane(&mut self, lane: StopRequest) -> Result<(), ()> {
        self.say(|_| format!("lane {lane:?}"));
        self.note_lane(lane);
        let held = self.must_stop();
        let now = self.now;
        self.host
            .call(|core, outputs| core.apply_stop(now, lane, outputs));
        if held {
            self.judge_stop(Kind::Stop)?;
        }
        self.drain()
    }

    /// One bus cycle, and those before it in which the host stands still.
    pub fn step(&mut self, lane: StopRequest) -> Result<(), ()> {
        for _ in 0..self.cable.pause(&mut self.lived.tally.hits) {
            self.cable.rest(&mut self.drive);
            self.now += self.period;
            self.pass(false)?;
        }
        if !lane.is_empty() {
            self.apply_lane(lane)?;
        }
        if !self.gated.is_empty() && self.choices.one_in(3) {
            let armed = |id: &&u32| self.host.is_armed(CommandId(**id));
            if let Some(&id) = self.gated.iter().find(armed) {
                let now = self.now;
                self.host
                    .call(|core, outputs| core.fire(now, CommandId(id), outputs));
            }
        }
        self.drain()?;
        self.sent_before = self.sent;
        self.sent = self.host.outputs();
        self.judge_word()?;
        self.drive.expect(self.sent.starts());
        let image = self.drive.image();
        self.told = self
            .cable
            .pass(self.sent, &mut self.drive, &mut self.lived.tally.hits);
        if self.told != Told::Stale {
            self.drive.note_arrival();
            self.sample = Sample::read(&image);
        }
        self.now += self.period;
        self.note_low();
        self.ran += 1;
        self.stepping = Some(self.told);
        self.host.step(self.now, self.told, &image);
        if self.verbose {
            self.show(&image);
        }
        self.drain()?;
        self.stepping = None;
        self.judge_step()?;
        self.pass(self.told != Told::Stale)
    }

    /// The drive's part of a cycle, and what is judged after it.
    fn pass(&mut self, seen: bool) -> Result<(), ()> {
        self.cycle += 1;
        self.slow_left += 1;
        if self.slow_left >= self.slow {
            self.slow_left = 0;
            if self.slow > 1 {
                self.lived.tally.hits.hit(Habit::SlowCycle);
            }
            self.drive.cycle();
        }
        self.judge_drive(seen)
    }

    fn show(&mut self, image: &[u8; INPUT_BYTES]) {
        let sample = Sample::read(image);
        let kind = match self.told.inputs(image) {
            Inputs::Fresh(_) => "",
            Inputs::Answered(_) => " answered",
            Inputs::Stale => " stale",
        };
        let moves = self.cycle.is_multiple_of(25) && self.drive.velocity.abs() > 1.0;
        if self.shown != (self.sent.word, sample.word) || !kind.is_empty() || moves {
            self.shown = (self.sent.word, sample.word);
            self.say(|scenario| {
                let (drive, snapshot) = (&scenario.drive, scenario.host.snapshot());
                format!(
                    "{:04X} -> {:04X}{kind} mode {} target {} shows {} demand {:.0} at {:.0} v {:.0} {:?} {} core {:?} {}",
                    scenario.sent.word,
                    sample.word,
                    sample.mode,
                    scenario.sent.target,
                    sample.position,
                    drive.demand,
                    drive.position,
                    drive.velocity,
                    drive.state,
                    drive.phase(),
                    snapshot.state,
                    if snapshot.has_set_point { "holds" } else { "" }
                )
            });
        }
    }

    pub fn drain(&mut self) -> Result<(), ()> {
        while let Some((CommandId(id), event)) = self.host.poll_event() {
            self.say(|_| format!("    {id}: {event:?}"));
            let known = self.issued.get(id as usize);
            if known.is_none_or(|issued| issued.done) {
                let what = format!("{id} is reported on after its end: {event:?}");
                return self.broken("one outcome", what);
            }
            match event {
                Event::Accepted => self.judge_accepted(id)?,
                Event::Halted => {}
                Event::Done(result) => self.take_end(id, result)?,
                other => return self.broken("known events", format!("{id}: {other:?}")),
            }
        }
        Ok(())
    }

    fn take_end(&mut self, id: u32, result: Result<Completion, Failure>) -> Result<(), ()> {
        let issued = &mut self.issued[id as usize];
        issued.done = true;
        issued.unsent = result.err().is_some_and(|failure| is_unsent(&failure));
        self.pending.retain(|pending| *pending != id);
        self.gated.retain(|gated| *gated != id);
        if self.jog == Some(id) {
            self.jog = None;
        }
        self.judge_done(id, &result)?;
        self.issued[id as usize].good = result.is_ok();
        Ok(())
    }
}

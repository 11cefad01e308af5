//! The small world: five positions, a drive after CiA 402 that does what it must now or a cycle later, and what may go wrong.

use core::fmt;
use core::hash::{Hash, Hasher};
use core::time::Duration;
use std::hash::DefaultHasher;

use servocrab::ds402::{Controlword, QuickStopOption};
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{BufferSignal, MoveCommand, Parameters, Reference, StartBits, Traits},
};
use servocrab::{
    Failure, Referencing,
    axis::{
        AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Deadlines, Delivery,
        Event, Inputs, Loss,
    },
};

use crate::fingerprint::{self, Fingerprint, MOST};

/// One cycle.
pub const CYCLE: Duration = Duration::from_millis(50);
/// The settle time, and the deadlines: of a standstill, which five samples have to show; of all else but a beginning.
const SETTLE: u32 = 2;
const STANDSTILL: u32 = 6;
const DEADLINE: u32 = 4;
/// Counts from one position to the next; the window is 10.
const STEP: i32 = 100;
/// Positions on each side of 0.
const SIDE: i8 = 2;
/// Deviations under way at most, and for how many cycles each is.
const DEVIATIONS: usize = 2;
const RECOVERY: u8 = 3;

/// How much may be under way at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    pub commands: usize,
    pub deviations: usize,
    /// The deviations that there are, by bit: that of the number n is bit n.
    pub kinds: u32,
}

impl Size {
    /// Whether nothing goes beyond docs/fault-model.md: then no outcome is wrong.
    const fn is_inside(&self) -> bool {
        self.deviations == 0 || self.kinds & OUTSIDE == 0
    }

    /// Whether an act is none of the deviations that are left out.
    fn allows(&self, act: u8) -> bool {
        let kind = usize::from(act).checked_sub(FIRST_DEVIATION);
        kind.is_none_or(|kind| self.kinds >> kind & 1 != 0)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ack {
    /// Bit 12 stays high while the buffer is full.
    Buffer,
    /// Bit 12 follows bit 4.
    Handshake,
}

/// What bits 5 and 9 do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Starts {
    /// As in CiA 402.
    Standard,
    /// Bit 5 passes into the next one, and nothing replaces: as the AX2000.
    Never,
}

/// A drive, and what the core is told of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Description {
    pub ack: Ack,
    /// Whether the core is told what bit 12 shows.
    pub described: bool,
    pub starts: Starts,
    pub halt_keeps: bool,
    /// 605Dh = 0: bit 8 takes the axis' power, and is never to be sent.
    pub halt_coasts: bool,
    pub quick_stop: u8,
    /// Bit 4 of the statusword shows the supply, which comes some time after Ready to switch on.
    pub shows_voltage: bool,
    /// Bits 5 and 9 are taken from the word before the edge.
    pub bits_first: bool,
    /// The deadline of a beginning, in cycles. Beyond the five that show a rest, a move that is over where the axis rests may not have begun.
    pub begin: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Power {
    Disabled,
    Ready,
    SwitchedOn,
    Enabled,
    QuickStop,
    Reaction,
    Fault,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Held {
    name: u8,
    goal: i8,
}

impl Hash for Held {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (fingerprint::number(self.name), i32::from(self.goal)).hash(state);
    }
}

/// What a command is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    Move,
    Stop,
    /// Of a fault: without one it says nothing of the axis.
    Reset,
    Other,
}

/// What is known of a command that is under way, or whose set-point the drive holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Asked {
    kind: Kind,
    goal: i8,
    /// Of a move, bits 5 and 9.
    bits: u16,
    sent: bool,
    taken: bool,
    ended: bool,
    accepted: bool,
    pending: bool,
}

impl Hash for Asked {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.kind, i32::from(self.goal), self.bits).hash(state);
        (
            self.sent,
            self.taken,
            self.ended,
            self.accepted,
            self.pending,
        )
            .hash(state);
    }
}

/// Everything but the core.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Around {
    power: Power,
    /// The power stage has its supply, or nothing shows whether it has.
    voltage: bool,
    position: i8,
    moved: bool,
    ack: bool,
    reached: bool,
    before: u16,
    active: Option<Held>,
    pending: Option<Held>,
    /// By name, from 1.
    asked: [Option<Asked>; MOST],
    /// For how many more cycles each deviation is under way.
    deviations: [u8; DEVIATIONS],
    /// Cycles since the words drive no more, by bit 8 or otherwise, at most the longest deadline.
    stopping: u8,
    /// The last statusword that came was of another state. What two in a row show counts as true.
    wrong: bool,
}

const OUTPUTS: usize = 11;
const INPUTS: usize = 7;

/// One state.
#[derive(Debug, Clone)]
pub struct World {
    pub core: AxisCore,
    pub around: Around,
    pub now: Duration,
    pub outputs: [u8; OUTPUTS],
    sent: u16,
    description: Description,
    size: Size,
    /// What the core has told, where somebody wants to know.
    pub told: Option<Vec<(CommandId, Event)>>,
}

/// What happens in one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Act {
    Nothing,
    /// A stop, a power command, a resume.
    Ask(Ask),
    Move {
        goal: i8,
        buffer_mode: BufferMode,
    },
    Withdraw(u8),
    /// The statusword of another state.
    Wrong(u8),
    /// 6061h shows no mode.
    NoMode,
    Stale,
    ReplyLost,
    Answered,
    AnsweredUndelivered,
    /// The drive has a fault, with a reaction.
    Fault,
    /// Fault reaction active, then Operation enabled without any set-point.
    ReactionLeft,
    /// The drive falls to Switched on by itself.
    Falls,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ask {
    Enable,
    Disable,
    Halt,
    Resume,
    Stop,
    QuickStop,
    Reset,
}

/// All acts: what the program may do, then what may go wrong. A state names its act by the number in here.
pub const ACTS: [Act; 35] = [
    Act::Nothing,
    Act::Ask(Ask::Enable),
    Act::Ask(Ask::Disable),
    Act::Ask(Ask::Halt),
    Act::Ask(Ask::Resume),
    Act::Ask(Ask::Stop),
    Act::Ask(Ask::QuickStop),
    Act::Ask(Ask::Reset),
    towards(-SIDE, BufferMode::Aborting),
    towards(-SIDE, BufferMode::Buffered),
    towards(-SIDE, BufferMode::Blending),
    towards(SIDE, BufferMode::Aborting),
    towards(SIDE, BufferMode::Buffered),
    towards(SIDE, BufferMode::Blending),
    Act::Withdraw(1),
    Act::Withdraw(2),
    Act::Withdraw(3),
    Act::Withdraw(4),
    Act::Withdraw(5),
    Act::Withdraw(6),
    Act::Wrong(0x40),
    Act::Wrong(0x21),
    Act::Wrong(0x23),
    Act::Wrong(0x27),
    Act::Wrong(0x07),
    Act::Wrong(0x0F),
    Act::Wrong(0x08),
    Act::NoMode,
    Act::Stale,
    Act::ReplyLost,
    Act::Answered,
    Act::AnsweredUndelivered,
    Act::Fault,
    Act::ReactionLeft,
    Act::Falls,
];
const FIRST_DEVIATION: usize = 20;
/// What is outside of docs/fault-model.md, by bit: words of another state, and a mode that is not the drive's.
const OUTSIDE: u32 = 0xFF;
/// So many deviations there are.
pub const KINDS: usize = ACTS.len() - FIRST_DEVIATION;
/// All of them, by bit.
pub const EVERY_KIND: u32 = (1 << KINDS) - 1;

const fn towards(goal: i8, buffer_mode: BufferMode) -> Act {
    Act::Move { goal, buffer_mode }
}

/// What the drive sees of a cycle, and what is known of the core after it.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    word: u16,
    sent: u16,
    target: i32,
    velocity: u32,
    /// In the outputs now.
    next: u16,
    next_velocity: u32,
    has_set_point: bool,
    falls: bool,
}

/// A law that did not hold.
pub type Broken = Result<(), String>;

impl World {
    pub fn new(description: Description, size: Size) -> Self {
        assert!(size.deviations <= DEVIATIONS && size.commands + 3 <= MOST);
        let mut fields = AxisFields::at(0, 0);
        fields.controlword = 0;
        fields.target = 2;
        fields.mode = Some(6);
        fields.velocity = Some(7);
        fields.statusword = 0;
        fields.position = 2;
        fields.mode_display = Some(6);
        let mut config = CoreConfig::new(fields);
        config.referencing = Referencing::UnreferencedMovesAllowed;
        config.traits = Traits {
            buffer_signal: match (description.described, description.ack) {
                (false, _) => BufferSignal::Unknown,
                (true, Ack::Buffer) => BufferSignal::Acknowledge,
                (true, Ack::Handshake) => BufferSignal::None,
            },
            halt_keeps_set_point: description.halt_keeps,
            drive_cycle: CYCLE / 2,
            shows_voltage: description.shows_voltage,
            start_bits_first: description.bits_first,
            ..Traits::cia402()
        };
        if description.starts == Starts::Never {
            config.traits.immediately = StartBits::Unsupported("nothing replaces");
            config.traits.after_current = StartBits::Sequenced;
            config.traits.blend = StartBits::Bits {
                change_set_immediately: true,
                change_on_set_point: false,
            };
        }
        if description.halt_coasts {
            config.stop_options.halt = Some(0);
        }
        config.quick_stop = QuickStopOption(description.quick_stop.into());
        config.defaults = Parameters {
            velocity: Some(100),
            ..Parameters::default()
        };
        config.tolerances.settle = SETTLE * CYCLE;
        config.deadlines = Deadlines {
            enable: STANDSTILL * CYCLE,
            disable: DEADLINE * CYCLE,
            acknowledge: DEADLINE * CYCLE,
            begin: description.begin * CYCLE,
            standstill: STANDSTILL * CYCLE,
            mode: DEADLINE * CYCLE,
            fault_reset: DEADLINE * CYCLE,
        };
        config.loss = Loss {
            stale_cycles: 2,
            undelivered_cycles: 3,
        };
        Self {
            core: AxisCore::new(config),
            now: Duration::ZERO,
            outputs: [0; OUTPUTS],
            sent: 0,
            description,
            size,
            told: None,
            around: Around {
                power: Power::Disabled,
                voltage: !description.shows_voltage,
                position: 0,
                moved: false,
                ack: false,
                reached: true,
                before: 0,
                active: None,
                pending: None,
                asked: [None; MOST],
                deviations: [0; DEVIATIONS],
                stopping: 0,
                wrong: false,
            },
        }
    }

    /// What tells this state from others, with these surroundings: names are numbered by the core. How long ago the core was stepped last
    /// is no part of its hash: it knows for how many cycles its drive has not answered, which is two at most here.
    pub fn print_of_core(&self) -> Fingerprint {
        fingerprint::of(&self.core)
    }

    /// The same, where neither names nor sides are alike.
    pub fn exact_print(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        (&self.core, &self.around, self.sent, self.outputs).hash(&mut hasher);
        hasher.finish()
    }

    fn word(&self) -> u16 {
        u16::from_le_bytes([self.outputs[0], self.outputs[1]])
    }

    /// The profile velocity in the outputs, by which a set-point has its name.
    fn velocity(&self) -> u32 {
        let [.., a, b, c, d] = self.outputs;
        u32::from_le_bytes([a, b, c, d])
    }

    fn target(&self) -> i32 {
        let [_, _, a, b, c, d, ..] = self.outputs;
        i32::from_le_bytes([a, b, c, d])
    }

    /// Everything that may happen now, by number.
    pub fn acts(&self, acts: &mut Vec<u8>) {
        let around = &self.around;
        let under_way = around.asked.iter().flatten();
        let under_way = under_way.filter(|asked| asked.pending).count();
        let asks = under_way < self.size.commands && self.free().is_some();
        let moves = asks && self.core.snapshot().controlword.bits() & 0x0F == 0x0F;
        let under_way = around.deviations.iter().filter(|left| **left > 0).count();
        let deviates = under_way < self.size.deviations;
        let powered = matches!(around.power, Power::Enabled | Power::QuickStop);
        let standard = self.description.starts == Starts::Standard;
        let may = |act: &Act| match *act {
            Act::Nothing => true,
            Act::Ask(_) => asks,
            Act::Move { buffer_mode, .. } => {
                moves && (standard || buffer_mode != BufferMode::Aborting)
            }
            Act::Withdraw(name) => around.asked[usize::from(name) - 1]
                .is_some_and(|asked| asked.pending && asked.kind == Kind::Move && !asked.accepted),
            Act::Wrong(bits) => deviates && !around.wrong && bits != around.power.bits(),
            Act::NoMode
            | Act::Stale
            | Act::ReplyLost
            | Act::Answered
            | Act::AnsweredUndelivered => deviates,
            Act::Fault => deviates && powered,
            Act::ReactionLeft | Act::Falls => deviates && around.power == Power::Enabled,
        };
        acts.clear();
        acts.extend(
            (0..)
                .zip(&ACTS)
                .filter(|(number, act)| may(act) && self.size.allows(*number))
                .map(|(number, _)| number),
        );
    }

    /// A name that nothing uses.
    fn free(&self) -> Option<u8> {
        let around = &self.around;
        (1..=MOST as u8).find(|name| {
            let held = [around.active, around.pending];
            around.asked[usize::from(*name) - 1].is_none()
                && held.iter().flatten().all(|held| held.name != *name)
        })
    }

    /// One cycle. `prompt`: the drive does what it can now.
    pub fn step(&mut self, act: u8, prompt: bool) -> Broken {
        let seen = self.exchange(act)?;
        self.drive(&seen, prompt)
    }

    /// What the drive does in it, later, in place of at once.
    pub fn drive_lazily(&self, around: &mut Around, seen: &Seen) -> Broken {
        around.end(&self.description, seen, false)
    }

    /// What the drive does in it.
    pub fn drive(&mut self, seen: &Seen, prompt: bool) -> Broken {
        self.around.end(&self.description, seen, prompt)
    }

    /// A cycle as far as the drive has not done anything in it.
    pub fn exchange(&mut self, act: u8) -> Result<Seen, String> {
        self.now += CYCLE;
        let mut link = (true, true, true);
        let mut shown = None;
        let mut mode = 1;
        if usize::from(act) >= FIRST_DEVIATION {
            let deviations = &mut self.around.deviations;
            if let Some(place) = deviations.iter_mut().find(|left| **left == 0) {
                *place = RECOVERY;
            }
            deviations.sort_unstable();
        }
        let mut resumed = false;
        let act = ACTS[usize::from(act)];
        match act {
            Act::Nothing => {}
            Act::Ask(ask) => {
                resumed = ask == Ask::Resume;
                self.ask(ask)?;
            }
            Act::Move { goal, buffer_mode } => self.ask_move(goal, buffer_mode)?,
            Act::Withdraw(name) => {
                let id = CommandId(fingerprint::number(name));
                self.core.withdraw(self.now, id, &mut self.outputs);
                self.drain()?;
            }
            Act::Wrong(bits) => shown = Some(bits),
            Act::NoMode => mode = 0,
            Act::Stale => link = (false, false, false),
            Act::ReplyLost => link = (true, false, false),
            Act::Answered => link = (true, false, true),
            Act::AnsweredUndelivered => link = (false, false, true),
            Act::Fault => {
                self.around.drop_all();
                self.around.power = Power::Reaction;
            }
            Act::ReactionLeft => {
                self.around.drop_all();
                shown = Some(0x0F);
            }
            Act::Falls => {
                self.around.drop_all();
                self.around.power = Power::SwitchedOn;
            }
        }
        let image = self.image(shown, mode);
        self.judge_word(resumed)?;
        let (word, target, velocity) = (self.word(), self.target(), self.velocity());
        self.sent = word;
        let (delivered, fresh, answered) = link;
        if fresh {
            self.around.wrong = shown.is_some();
        }
        let inputs = if fresh {
            Inputs::Fresh(&image)
        } else if answered {
            Inputs::Answered(&image)
        } else {
            Inputs::Stale
        };
        // Steps are computed as a whole: what may be left out of them is shown to be the same elsewhere.
        self.core.set_manufacturer_bits(Controlword::empty());
        self.core
            .step_kept(self.now, inputs, false, &mut self.outputs);
        self.drain()?;
        Ok(Seen {
            // What the drive does with the frame shows in the next.
            word: if delivered { word } else { self.around.before },
            sent: word,
            target,
            velocity,
            next: self.word(),
            next_velocity: self.velocity(),
            has_set_point: self.core.snapshot().has_set_point,
            falls: act == Act::Falls,
        })
    }

    fn ask(&mut self, ask: Ask) -> Broken {
        let Some(name) = self.free() else {
            return Ok(());
        };
        let (command, kind) = match ask {
            Ask::Enable => (Command::Enable, Kind::Other),
            Ask::Disable => (Command::Disable, Kind::Stop),
            Ask::Halt => (Command::Halt, Kind::Other),
            Ask::Resume => (Command::Resume, Kind::Other),
            Ask::Stop => (Command::Stop, Kind::Stop),
            Ask::QuickStop => (Command::QuickStop, Kind::Stop),
            Ask::Reset => (Command::ResetFault, Kind::Reset),
        };
        let snapshot = self.core.snapshot();
        let halts = ask == Ask::Halt && !self.description.halt_coasts;
        let stops = kind == Kind::Stop || halts;
        let must_stop = stops
            && self.sent & 0x8F == 0x0F
            && self.word() & 0x8F == 0x0F
            && snapshot.state == servocrab::ds402::State::OperationEnabled
            && self.around.power == Power::Enabled
            && (snapshot.has_set_point || self.around.moved);
        self.submit(name, command, kind, (0, 0))?;
        let word = self.word();
        if must_stop && word & 0x100 == 0 && word & 0x04 != 0 {
            return Err(format!(
                "{ask:?} is asked for, and the next word is {word:04X}h"
            ));
        }
        Ok(())
    }

    fn ask_move(&mut self, goal: i8, buffer_mode: BufferMode) -> Broken {
        let Some(name) = self.free() else {
            return Ok(());
        };
        let command = Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target: i32::from(goal) * STEP,
            set_point: SetPoint::new()
                .velocity(fingerprint::number(name))
                .buffer_mode(buffer_mode),
            gated: false,
        });
        let bits = match (self.description.starts, buffer_mode) {
            (_, BufferMode::Buffered) | (Starts::Never, BufferMode::Aborting) => 0,
            (Starts::Never, BufferMode::Blending) | (_, BufferMode::Aborting) => 0x020,
            (Starts::Standard, BufferMode::Blending) => 0x200,
        };
        self.submit(name, command, Kind::Move, (goal, bits))
    }

    fn submit(
        &mut self,
        name: u8,
        command: Command,
        kind: Kind,
        (goal, bits): (i8, u16),
    ) -> Broken {
        self.around.asked[usize::from(name) - 1] = Some(Asked {
            kind,
            goal,
            bits,
            sent: false,
            taken: false,
            ended: false,
            accepted: false,
            pending: true,
        });
        self.core.submit(
            self.now,
            CommandId(fingerprint::number(name)),
            command,
            &mut self.outputs,
        );
        self.drain()
    }

    fn image(&self, shown: Option<u8>, mode: u8) -> [u8; INPUTS] {
        let around = &self.around;
        let mut word = 0x0200 | u16::from(shown.unwrap_or(around.power.bits()));
        if around.voltage {
            word |= 0x0010;
        }
        if around.reached {
            word |= 0x0400;
        }
        if around.ack {
            word |= 0x1000;
        }
        let mut image = [0; INPUTS];
        image[..2].copy_from_slice(&word.to_le_bytes());
        image[2..6].copy_from_slice(&(i32::from(around.position) * STEP).to_le_bytes());
        image[6] = mode;
        image
    }

    fn judge_word(&mut self, resumed: bool) -> Broken {
        let (word, before, velocity) = (self.word(), self.sent, self.velocity());
        let around = &mut self.around;
        if word & !before & 0x10 != 0 {
            let asked = around.asked_of(velocity);
            match asked {
                Some(asked) if asked.kind == Kind::Move && !asked.sent => asked.sent = true,
                _ => return Err(format!("bit 4 rises with the velocity {velocity}")),
            }
        }
        if word & 0x10F == 0x10F && self.description.halt_coasts {
            return Err(format!("{word:04X}h is sent, and 605Dh is 0"));
        }
        if word & 0x18F == 0x0F {
            around.stopping = 0;
        } else {
            around.stopping = (around.stopping + 1).min(STANDSTILL as u8 + 1);
        }
        if word & 0x8F == 0x0F {
            if before & 0x18F == 0x10F && word & 0x100 == 0 && !resumed && around.holds() {
                return Err(format!(
                    "{before:04X}h, then {word:04X}h, and nobody resumed"
                ));
            }
            return Ok(());
        }
        let leads_down = word & 0x82 == 0 || word & 0x87 == 0x06 || word & 0x8F == 0x07;
        if leads_down && around.is_powered() && around.moved && around.stopping <= STANDSTILL as u8
        {
            return Err(format!(
                "{word:04X}h is sent to a moving axis, {} cycles after its stop began",
                around.stopping
            ));
        }
        Ok(())
    }

    fn drain(&mut self) -> Broken {
        while let Some((id, event)) = self.core.poll_event() {
            if let Some(told) = &mut self.told {
                told.push((id, event));
            }
            let holds = self.around.holds();
            let asked = self.around.asked_of(id.0).filter(|asked| asked.pending);
            let Some(asked) = asked else {
                return Err(format!("{id:?} is reported on after its end: {event:?}"));
            };
            match event {
                Event::Accepted => {
                    asked.accepted = true;
                    if asked.kind == Kind::Move && !asked.taken {
                        return Err(format!(
                            "{id:?} is accepted, and the drive has not taken it"
                        ));
                    }
                }
                Event::Halted => {}
                Event::Done(result) => {
                    asked.pending = false;
                    let was = *asked;
                    self.around.clear_taken(id.0);
                    let inside = self.size.is_inside();
                    let broken = match (was.kind, result) {
                        (Kind::Move, Ok(_))
                            if inside && !was.ended && !self.around.has_no_way(id.0) =>
                        {
                            "the drive has not come to its end"
                        }
                        (Kind::Stop, Ok(Completion::Stopped { .. }))
                            if holds && self.sent & 0x0F == 0x0F =>
                        {
                            "the drive still holds a set-point"
                        }
                        (Kind::Stop | Kind::Other, Ok(Completion::Stopped { .. }))
                            if self.around.moved && self.around.is_powered() =>
                        {
                            "the axis moves"
                        }
                        (Kind::Move, Err(Failure::MissedTarget { .. })) if inside => {
                            "the drive limits nothing"
                        }
                        (Kind::Move, Err(failure)) if was.taken && is_not_sent(failure) => {
                            "the drive has taken it"
                        }
                        _ => continue,
                    };
                    return Err(format!("{id:?} is {result:?}, and {broken}"));
                }
                other => return Err(format!("{id:?}: no rule for {other:?}")),
            }
        }
        Ok(())
    }

    /// Whether everything has ended and the axis is disabled.
    pub fn is_at_the_end(&self) -> bool {
        let down = matches!(self.around.power, Power::Disabled | Power::Ready);
        down && self
            .around
            .asked
            .iter()
            .flatten()
            .all(|asked| !asked.pending)
            && self.word() & 0x0F != 0x0F
    }

    /// Whether anybody waits for something that has a deadline, whatever the drive does: everything but a move that is under way, or that
    /// waits behind another.
    pub fn awaits_an_answer(&self) -> bool {
        let asked = self.around.asked.iter().flatten();
        let mut asked = asked.filter(|asked| asked.pending);
        asked.any(|asked| asked.kind != Kind::Move || (asked.sent && !asked.accepted))
    }

    /// What leads there with a sound drive and a good cable.
    pub fn way_to_the_end(&self) -> u8 {
        let pending = |kind: fn(Kind) -> bool| {
            let asked = self.around.asked.iter().flatten();
            asked
                .filter(|asked| asked.pending)
                .any(|asked| kind(asked.kind))
        };
        // A halted move waits for more to be said.
        let halted = self.core.snapshot().halted;
        let answers =
            pending(|kind| kind != Kind::Move) || (!halted && pending(|kind| kind == Kind::Move));
        let act = if answers {
            Act::Nothing
        } else if self.around.power == Power::Fault {
            Act::Ask(Ask::Reset)
        } else {
            Act::Ask(Ask::Disable)
        };
        (0..)
            .zip(&ACTS)
            .find(|(_, other)| **other == act)
            .map_or(0, |(number, _)| number)
    }
}

/// Whether it says that no set-point was sent.
fn is_not_sent(failure: Failure) -> bool {
    let delivery = match failure {
        Failure::Timeout { delivery, .. } | Failure::BusLost { delivery, .. } => delivery,
        Failure::Halted { delivery } | Failure::QuickStopped { delivery } => delivery,
        Failure::Withdrawn | Failure::NeedsStop => Delivery::NotSent,
        _ => return false,
    };
    delivery == Delivery::NotSent
}

impl Around {
    /// With the core's state before them: all that tells this state from others.
    pub fn print_after(&self, core: &Fingerprint) -> u128 {
        let mut print = core.clone();
        let Self {
            power,
            voltage,
            position,
            moved,
            ack,
            reached,
            before,
            active,
            pending,
            asked,
            deviations,
            stopping,
            wrong,
        } = self;
        (power, voltage, moved, ack, reached, before).hash(&mut print);
        i32::from(*position).hash(&mut print);
        (active, pending, deviations, stopping, wrong).hash(&mut print);
        // In the order in which the core and the drive name them; then those that neither does.
        let (names, named) = print.names();
        let known = names[..named].iter().copied();
        let others = (1..=MOST as u8).filter(|name| !names[..named].contains(name));
        for name in known.chain(others) {
            asked[usize::from(name) - 1].hash(&mut print);
        }
        print.value()
    }

    fn asked_of(&mut self, number: u32) -> Option<&mut Asked> {
        let name = fingerprint::name(number)?;
        self.asked[usize::from(name) - 1].as_mut()
    }

    /// One that has ended is remembered as long as the drive may still take it.
    fn clear_taken(&mut self, number: u32) {
        if let Some(name) = fingerprint::name(number) {
            let asked = &mut self.asked[usize::from(name) - 1];
            *asked = asked.filter(|asked| !asked.taken && asked.sent);
        }
    }

    /// Whether this is the active one, and the axis at its goal: it may be over by that.
    fn has_no_way(&self, number: u32) -> bool {
        let here =
            |held: Held| fingerprint::number(held.name) == number && held.goal == self.position;
        self.active.is_some_and(here)
    }

    /// Whether the drive would set the axis in motion by itself.
    fn holds(&self) -> bool {
        let away = |held: Held| held.goal != self.position;
        self.power == Power::Enabled && (self.active.is_some_and(away) || self.pending.is_some())
    }

    const fn is_powered(&self) -> bool {
        matches!(self.power, Power::Enabled | Power::QuickStop)
    }

    /// What the drive does in a cycle.
    pub fn end(&mut self, description: &Description, seen: &Seen, prompt: bool) -> Broken {
        self.drive(description, seen, prompt && !seen.falls)?;
        self.forget(description, seen);
        for left in &mut self.deviations {
            *left = left.saturating_sub(1);
        }
        self.deviations.sort_unstable();
        let drives = [seen.next, seen.sent, seen.word]
            .iter()
            .all(|word| word & 0x8F == 0x0F);
        if drives && self.holds() && !seen.has_set_point {
            return Err("the drive holds a set-point, and the core knows of none".into());
        }
        Ok(())
    }

    /// Of what makes no difference any more nothing is kept. A set-point that was sent and not taken may be taken as long as its
    /// bit 4 goes out, whatever was told of it.
    fn forget(&mut self, description: &Description, seen: &Seen) {
        let rises = seen.next & 0x10 != 0;
        for (name, asked) in (1..).zip(&mut self.asked) {
            let may_come = rises && seen.next_velocity == fingerprint::number(name);
            *asked = asked.filter(|asked| asked.pending || (!asked.taken && may_come));
        }
        // Edges of bits 4 and 7, and whether it drove.
        let bits = if description.bits_first {
            0x9F | 0x220
        } else {
            0x9F
        };
        self.before = seen.word & bits;
        if !self.is_powered() {
            self.stopping = 0;
        }
    }

    fn drop_all(&mut self) {
        self.active = None;
        self.pending = None;
        self.ack = false;
    }

    /// One of the drive's cycles.
    fn drive(&mut self, description: &Description, seen: &Seen, prompt: bool) -> Broken {
        let (word, before) = (seen.word, self.before);
        if prompt {
            self.lead(description, word, before);
        }
        let enabled = self.power == Power::Enabled;
        if enabled && word & !before & 0x10 != 0 {
            self.latch(description, seen)?;
        } else if word & 0x10 == 0 && (description.ack == Ack::Handshake || self.pending.is_none())
        {
            self.ack = false;
        }
        let moved = core::mem::take(&mut self.moved);
        let halts = word & 0x100 != 0;
        // A ramp: an axis that is halted may go on for some cycles.
        if enabled && (if halts { moved && !prompt } else { prompt }) {
            self.follow();
        } else if enabled && halts {
            if !description.halt_keeps && prompt {
                self.drop_all();
            }
            self.reached = true;
        } else if !enabled {
            self.reached = true;
        }
        Ok(())
    }

    fn lead(&mut self, description: &Description, word: u16, before: u16) {
        let disable_voltage = word & 0x82 == 0;
        let quick_stop = word & 0x86 == 0x02;
        let shutdown = word & 0x87 == 0x06;
        let switch_on = word & 0x8F == 0x07;
        let enable = word & 0x8F == 0x0F;
        let power = self.power;
        let supplied = self.voltage;
        // The supply comes after Ready to switch on, and goes below it.
        self.voltage = !description.shows_voltage || power != Power::Disabled;
        self.power = match power {
            Power::Disabled if shutdown => Power::Ready,
            Power::Ready | Power::SwitchedOn if disable_voltage || quick_stop => Power::Disabled,
            Power::Ready if (switch_on || enable) && supplied => Power::SwitchedOn,
            Power::SwitchedOn if shutdown => Power::Ready,
            Power::SwitchedOn if enable => Power::Enabled,
            Power::Enabled | Power::QuickStop if disable_voltage => Power::Disabled,
            Power::Enabled if quick_stop => Power::QuickStop,
            Power::Enabled if shutdown => Power::Ready,
            Power::Enabled if switch_on => Power::SwitchedOn,
            Power::QuickStop if description.quick_stop < 5 => Power::Disabled,
            Power::QuickStop if enable => Power::Enabled,
            Power::Reaction => Power::Fault,
            Power::Fault if word & !before & 0x80 != 0 => Power::Disabled,
            other => other,
        };
        if power == Power::Enabled && self.power != Power::Enabled {
            self.drop_all();
        }
    }

    fn latch(&mut self, description: &Description, seen: &Seen) -> Broken {
        let bits = if description.bits_first {
            self.before
        } else {
            seen.word
        };
        let immediate = bits & 0x20 != 0 && description.starts == Starts::Standard;
        let asked_for = self.asked_of(seen.velocity).map(|asked| asked.bits);
        if asked_for.is_some_and(|asked_for| asked_for != bits & 0x220) {
            return Err(format!(
                "the drive takes a set-point with the bits {bits:04X}h"
            ));
        }
        // One that had no way to go is over.
        self.end_active();
        if self.pending.is_some() && !immediate {
            return Err("a set-point goes into a full buffer".into());
        }
        let (alone, position) = (immediate || self.active.is_none(), self.position);
        let asked = self.asked_of(seen.velocity);
        let asked = asked.filter(|asked| {
            asked.sent && !asked.taken && i32::from(asked.goal) * STEP == seen.target
        });
        let (Some(asked), Some(name)) = (asked, fingerprint::name(seen.velocity)) else {
            return Err(format!(
                "the drive takes a set-point to {}, which nobody asked for, or twice",
                seen.target
            ));
        };
        asked.taken = true;
        asked.ended = alone && asked.goal == position;
        let held = Held {
            name,
            goal: asked.goal,
        };
        let full = self.ack;
        if alone {
            self.active = Some(held);
            self.pending = None;
        } else {
            self.pending = Some(held);
        }
        if !(full && description.ack == Ack::Buffer) {
            self.ack = true;
        }
        self.reached = false;
        Ok(())
    }

    /// One position nearer.
    fn follow(&mut self) {
        let Some(active) = self.active else {
            self.reached = true;
            return;
        };
        let way = (active.goal - self.position).signum();
        self.position += way;
        self.moved = way != 0;
        self.end_active();
        self.reached = self.active.is_none();
    }

    /// The active one is over at its goal.
    fn end_active(&mut self) {
        let position = self.position;
        if let Some(active) = self.active.filter(|active| active.goal == position) {
            if let Some(asked) = &mut self.asked[usize::from(active.name) - 1] {
                asked.ended = true;
            }
            self.active = self.pending.take();
        }
    }
}

impl fmt::Display for World {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (around, seen) = (&self.around, self.core.snapshot());
        write!(
            f,
            "sent {:04X}h, shown {:04X}h, the drive {:?} at {}",
            self.sent,
            seen.statusword.bits(),
            around.power,
            around.position
        )?;
        for held in [around.active, around.pending].iter().flatten() {
            write!(f, ", holds {}", held.goal)?;
        }
        write!(f, "; ")
    }
}

impl Power {
    const fn bits(self) -> u8 {
        match self {
            Self::Disabled => 0x40,
            Self::Ready => 0x21,
            Self::SwitchedOn => 0x23,
            Self::Enabled => 0x27,
            Self::QuickStop => 0x07,
            Self::Reaction => 0x0F,
            Self::Fault => 0x08,
        }
    }
}

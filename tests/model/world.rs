//! The small world: five positions, a drive after CiA 402 that does what it must now or a cycle later, and what may go wrong.

use core::time::Duration;

use servocrab::axis::{
    AxisConfig, AxisCore, AxisFields, Command, CommandId, Completion, Event, Inputs, Loss,
    Referencing,
};
use servocrab::ds402::QuickStopOption;
use servocrab::profile_position::{
    BufferSignal, MoveCommand, Parameters, Reference, SetPoint, Start, Traits,
};

use crate::fingerprint::START;

/// One cycle.
pub const CYCLE: Duration = Duration::from_millis(50);
/// Longer than the longest deadline: older instants mean the same.
pub const LONGEST: Duration = Duration::from_millis(250);
/// Counts from one position to the next; the window is 10.
const STEP: i32 = 100;
const POSITIONS: i8 = 5;
/// Names of moves: their profile velocity is 100 and this.
const NAMES: u8 = 4;
/// Deviations under way at most, and for how many cycles each is.
const DEVIATIONS: usize = 2;
const RECOVERY: u8 = 3;

/// How much may be under way at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    pub commands: usize,
    pub deviations: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ack {
    Buffer,
    Handshake,
}

/// A drive, and what the core is told of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Description {
    pub ack: Ack,
    pub described: bool,
    pub halt_keeps: bool,
    pub quick_stop: u8,
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
    blend: bool,
}

/// What is known of a command that is under way, or whose set-point the drive holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Move,
    Stop,
    Other,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Asked {
    kind: Kind,
    goal: i8,
    sent: bool,
    taken: bool,
    ended: bool,
    accepted: bool,
    pending: bool,
}

/// Everything but the core.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Around {
    power: Power,
    position: i8,
    moved: bool,
    ack: bool,
    reached: bool,
    before: u16,
    active: Option<Held>,
    pending: Option<Held>,
    /// By number, from 1.
    asked: [Option<Asked>; NAMES as usize],
    /// For how many more cycles each deviation is under way.
    deviations: [u8; DEVIATIONS],
    /// Cycles since the words drive no more, at most the longest deadline.
    stopping: u8,
    resumed: bool,
    outputs: [u8; OUTPUTS],
    sent: u16,
}

const OUTPUTS: usize = 11;
const INPUTS: usize = 7;

/// One state.
#[derive(Debug, Clone)]
pub struct World {
    pub core: AxisCore,
    pub around: Around,
    pub now: Duration,
    description: Description,
    size: Size,
}

/// What may happen in one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Act {
    Nothing,
    /// A stop, a power command, a resume.
    Ask(Ask),
    Move {
        goal: i8,
        start: Start,
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
    /// Fault reaction active, then Operation enabled.
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

pub const ASKS: [Ask; 7] = [
    Ask::Enable,
    Ask::Disable,
    Ask::Halt,
    Ask::Resume,
    Ask::Stop,
    Ask::QuickStop,
    Ask::Reset,
];

/// A law that did not hold.
pub type Broken = Result<(), String>;

impl World {
    pub fn new(description: Description, size: Size) -> Self {
        let mut fields = AxisFields::at(0, 0);
        fields.controlword = 0;
        fields.target = 2;
        fields.mode = Some(6);
        fields.velocity = Some(7);
        fields.statusword = 0;
        fields.position = 2;
        fields.mode_display = Some(6);
        let mut config = AxisConfig::new(fields);
        config.referencing = Referencing::UnreferencedMovesAllowed;
        config.traits = Traits {
            buffer_signal: match (description.described, description.ack) {
                (false, _) => BufferSignal::Unknown,
                (true, Ack::Buffer) => BufferSignal::Acknowledge,
                (true, Ack::Handshake) => BufferSignal::None,
            },
            halt_keeps_set_point: description.halt_keeps,
            drive_cycle: CYCLE / 2,
            ..Traits::cia402()
        };
        config.quick_stop = QuickStopOption(description.quick_stop.into());
        config.defaults = Parameters {
            velocity: Some(100),
            ..Parameters::default()
        };
        config.tolerances.settle = 2 * CYCLE;
        config.deadlines.enable = 4 * CYCLE;
        config.deadlines.disable = 4 * CYCLE;
        config.deadlines.acknowledge = 4 * CYCLE;
        config.deadlines.standstill = 4 * CYCLE;
        config.deadlines.mode = 4 * CYCLE;
        config.deadlines.fault_reset = 4 * CYCLE;
        config.loss = Loss {
            stale_cycles: 2,
            undelivered_cycles: 3,
        };
        Self {
            core: AxisCore::new(config),
            now: START,
            description,
            size,
            around: Around {
                power: Power::Disabled,
                position: 2,
                moved: false,
                ack: false,
                reached: true,
                before: 0,
                active: None,
                pending: None,
                asked: [None; NAMES as usize],
                deviations: [0; DEVIATIONS],
                stopping: 0,
                resumed: false,
                outputs: [0; OUTPUTS],
                sent: 0,
            },
        }
    }

    fn word(&self) -> u16 {
        u16::from_le_bytes([self.around.outputs[0], self.around.outputs[1]])
    }

    /// Everything that may happen now.
    pub fn acts(&self, acts: &mut Vec<Act>) {
        acts.clear();
        acts.push(Act::Nothing);
        let around = &self.around;
        let under_way = around
            .asked
            .iter()
            .flatten()
            .filter(|asked| asked.pending)
            .count();
        if under_way < self.size.commands && self.free().is_some() {
            acts.extend(ASKS.map(Act::Ask));
            if self.core.snapshot().controlword.bits() & 0x0F == 0x0F {
                for goal in [0, 4] {
                    for start in [Start::Immediately, Start::AfterCurrent, Start::Blend] {
                        acts.push(Act::Move { goal, start });
                    }
                }
            }
        }
        for (name, asked) in (1..).zip(&around.asked) {
            if asked
                .is_some_and(|asked| asked.pending && asked.kind == Kind::Move && !asked.accepted)
            {
                acts.push(Act::Withdraw(name));
            }
        }
        if around.deviations.iter().filter(|left| **left > 0).count() < self.size.deviations {
            for wrong in [0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08] {
                if wrong != around.power.bits() {
                    acts.push(Act::Wrong(wrong));
                }
            }
            acts.extend([
                Act::NoMode,
                Act::Stale,
                Act::ReplyLost,
                Act::Answered,
                Act::AnsweredUndelivered,
            ]);
            if matches!(around.power, Power::Enabled | Power::QuickStop) {
                acts.extend([Act::Fault, Act::ReactionLeft]);
            }
            if around.power == Power::Enabled {
                acts.push(Act::Falls);
            }
        }
    }

    /// A name that nothing uses.
    fn free(&self) -> Option<u8> {
        let around = &self.around;
        (1..=NAMES).find(|name| {
            let held = [around.active, around.pending];
            around.asked[usize::from(*name) - 1].is_none()
                && held.iter().flatten().all(|held| held.name != *name)
        })
    }

    /// One cycle. `prompt`: the drive does what it can now.
    pub fn step(&mut self, act: Act, prompt: bool) -> Broken {
        self.now += CYCLE;
        let mut link = (true, true, true);
        let mut shown = None;
        let mut mode = 1;
        if !matches!(
            act,
            Act::Nothing | Act::Ask(_) | Act::Move { .. } | Act::Withdraw(_)
        ) {
            if let Some(place) = self.around.deviations.iter_mut().find(|left| **left == 0) {
                *place = RECOVERY;
            }
            self.around.deviations.sort_unstable();
        }
        match act {
            Act::Nothing => {}
            Act::Ask(ask) => self.ask(ask)?,
            Act::Move { goal, start } => self.ask_move(goal, start)?,
            Act::Withdraw(name) => {
                self.core
                    .withdraw(CommandId(name.into()), &mut self.around.outputs);
                self.drain()?;
            }
            Act::Wrong(bits) => shown = Some(bits),
            Act::NoMode => mode = 0,
            Act::Stale => link = (false, false, false),
            Act::ReplyLost => link = (true, false, false),
            Act::Answered => link = (true, false, true),
            Act::AnsweredUndelivered => link = (false, false, true),
            Act::Fault => {
                self.drop_all();
                self.around.power = Power::Reaction;
            }
            Act::ReactionLeft => {
                // Shown once; it goes on as if nothing had been.
                shown = Some(0x0F);
            }
            Act::Falls => {
                self.drop_all();
                self.around.power = Power::SwitchedOn;
            }
        }
        let image = self.image(shown, mode);
        self.judge_word()?;
        let word = self.word();
        self.around.sent = word;
        let target = i32::from_le_bytes([
            self.around.outputs[2],
            self.around.outputs[3],
            self.around.outputs[4],
            self.around.outputs[5],
        ]);
        let velocity = u16::from_le_bytes([self.around.outputs[7], self.around.outputs[8]]);
        let (delivered, fresh, answered) = link;
        let inputs = if fresh {
            Inputs::Fresh(&image)
        } else if answered {
            Inputs::Answered(&image)
        } else {
            Inputs::Stale
        };
        self.core
            .step_kept(self.now, inputs, false, &mut self.around.outputs);
        self.drain()?;
        // What the drive does with the frame shows in the next.
        let seen = if delivered { word } else { self.around.before };
        self.drive(seen, target, velocity, prompt && act != Act::Falls)?;
        self.around.before = seen;
        self.forget();
        for left in &mut self.around.deviations {
            *left = left.saturating_sub(1);
        }
        self.around.deviations.sort_unstable();
        self.judge_state()
    }

    /// A set-point that was sent and not taken may be taken as long as its bit 4 goes out, whatever was told of it.
    fn forget(&mut self) {
        let rises = self.word() & 0x10 != 0;
        let velocity = u16::from_le_bytes([self.around.outputs[7], self.around.outputs[8]]);
        for (name, asked) in (101..).zip(&mut self.around.asked) {
            let may_come = rises && velocity == name;
            if asked.is_some_and(|asked| !asked.pending && (asked.taken || !may_come)) {
                *asked = None;
            }
        }
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
            Ask::Reset => (Command::ResetFault, Kind::Other),
        };
        self.around.resumed |= ask == Ask::Resume;
        let snapshot = self.core.snapshot();
        let stops = kind == Kind::Stop || ask == Ask::Halt;
        let must_stop = stops
            && self.around.sent & 0x8F == 0x0F
            && self.word() & 0x8F == 0x0F
            && snapshot.state == servocrab::ds402::State::OperationEnabled
            && self.around.power == Power::Enabled
            && (snapshot.has_set_point || self.around.moved);
        self.submit(name, command, kind, 0)?;
        let word = self.word();
        if must_stop && word & 0x100 == 0 && word & 0x04 != 0 {
            return Err(format!(
                "{ask:?} is asked for, and the next word is {word:04X}h"
            ));
        }
        Ok(())
    }

    fn ask_move(&mut self, goal: i8, start: Start) -> Broken {
        let Some(name) = self.free() else {
            return Ok(());
        };
        let command = Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target: i32::from(goal) * STEP,
            set_point: SetPoint::new().velocity(100 + u32::from(name)).start(start),
            gated: false,
        });
        self.submit(name, command, Kind::Move, goal)
    }

    fn submit(&mut self, name: u8, command: Command, kind: Kind, goal: i8) -> Broken {
        self.around.asked[usize::from(name) - 1] = Some(Asked {
            kind,
            goal,
            sent: false,
            taken: false,
            ended: false,
            accepted: false,
            pending: true,
        });
        self.core.submit(
            self.now,
            CommandId(name.into()),
            command,
            &mut self.around.outputs,
        );
        self.drain()
    }

    fn image(&self, shown: Option<u8>, mode: u8) -> [u8; INPUTS] {
        let around = &self.around;
        let mut word = 0x0210 | u16::from(shown.unwrap_or(around.power.bits()));
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

    fn drop_all(&mut self) {
        self.around.active = None;
        self.around.pending = None;
        self.around.ack = false;
    }

    fn end(&mut self, held: Held) {
        if let Some(asked) = &mut self.around.asked[usize::from(held.name) - 1] {
            asked.ended = true;
        }
    }

    /// One of the drive's cycles, with these outputs.
    fn drive(&mut self, word: u16, target: i32, velocity: u16, prompt: bool) -> Broken {
        let before = self.around.before;
        if prompt {
            self.power(word, before);
        }
        let enabled = self.around.power == Power::Enabled;
        if enabled && word & !before & 0x10 != 0 {
            self.latch(word, target, velocity)?;
        } else if word & 0x10 == 0
            && (self.description.ack == Ack::Handshake || self.around.pending.is_none())
        {
            self.around.ack = false;
        }
        self.around.moved = false;
        if enabled && prompt && word & 0x100 == 0 {
            self.follow();
        } else if enabled && word & 0x100 != 0 {
            if !self.description.halt_keeps && prompt {
                self.drop_all();
            }
            self.around.reached = true;
        } else if !enabled {
            self.around.reached = true;
        }
        Ok(())
    }

    fn power(&mut self, word: u16, before: u16) {
        let disable_voltage = word & 0x82 == 0;
        let quick_stop = word & 0x86 == 0x02;
        let shutdown = word & 0x87 == 0x06;
        let switch_on = word & 0x8F == 0x07;
        let enable = word & 0x8F == 0x0F;
        let power = self.around.power;
        self.around.power = match power {
            Power::Disabled if shutdown => Power::Ready,
            Power::Ready | Power::SwitchedOn if disable_voltage || quick_stop => Power::Disabled,
            Power::Ready if switch_on || enable => Power::SwitchedOn,
            Power::SwitchedOn if shutdown => Power::Ready,
            Power::SwitchedOn if enable => Power::Enabled,
            Power::Enabled | Power::QuickStop if disable_voltage => Power::Disabled,
            Power::Enabled if quick_stop => Power::QuickStop,
            Power::Enabled if shutdown => Power::Ready,
            Power::Enabled if switch_on => Power::SwitchedOn,
            Power::QuickStop if self.description.quick_stop < 5 => Power::Disabled,
            Power::QuickStop if enable => Power::Enabled,
            Power::Reaction => Power::Fault,
            Power::Fault if word & !before & 0x80 != 0 => Power::Disabled,
            other => other,
        };
        if power == Power::Enabled && self.around.power != Power::Enabled {
            self.drop_all();
        }
    }

    fn latch(&mut self, word: u16, target: i32, velocity: u16) -> Broken {
        let name = velocity.wrapping_sub(100) as u8;
        let immediate = word & 0x20 != 0;
        let around = &mut self.around;
        if around.pending.is_some() && !immediate {
            return Err(format!("the set-point of {name} goes into a full buffer"));
        }
        let asked = around
            .asked
            .get_mut(usize::from(name).wrapping_sub(1))
            .and_then(Option::as_mut);
        let Some(asked) = asked
            .filter(|asked| asked.sent && !asked.taken && i32::from(asked.goal) * STEP == target)
        else {
            return Err(format!(
                "the drive takes a set-point of {name} to {target}, which nobody asked for, or twice"
            ));
        };
        asked.taken = true;
        let held = Held {
            name,
            goal: asked.goal,
            blend: word & 0x200 != 0 && !immediate,
        };
        let full = around.ack;
        if immediate {
            around.active = Some(held);
            around.pending = None;
        } else if around.active.is_none() {
            around.active = Some(held);
        } else {
            around.pending = Some(held);
        }
        if !(full && self.description.ack == Ack::Buffer) {
            around.ack = true;
        }
        around.reached = false;
        Ok(())
    }

    /// One position nearer.
    fn follow(&mut self) {
        let Some(active) = self.around.active else {
            self.around.reached = true;
            return;
        };
        let way = (active.goal - self.around.position).signum();
        if way != 0 {
            self.around.position += way;
            self.around.moved = true;
        }
        if self.around.position == active.goal {
            self.end(active);
            self.around.active = self.around.pending.take();
            self.around.reached = self.around.active.is_none();
            let _ = active.blend;
        }
        debug_assert!((0..POSITIONS).contains(&self.around.position));
    }

    fn judge_word(&mut self) -> Broken {
        let word = self.word();
        let before = self.around.sent;
        if word & !before & 0x10 != 0 {
            let velocity = u16::from_le_bytes([self.around.outputs[7], self.around.outputs[8]]);
            let name = usize::from(velocity.wrapping_sub(101));
            match self.around.asked.get_mut(name).and_then(Option::as_mut) {
                Some(asked) if asked.kind == Kind::Move && !asked.sent => asked.sent = true,
                _ => return Err(format!("bit 4 rises with the velocity {velocity}")),
            }
        }
        if word & 0x8F == 0x0F {
            self.around.stopping = 0;
            if before & 0x18F == 0x10F && word & 0x100 == 0 {
                if !self.around.resumed && self.holds() {
                    return Err(format!(
                        "{before:04X}h, then {word:04X}h, and nobody resumed"
                    ));
                }
                self.around.resumed = false;
            }
            return Ok(());
        }
        self.around.stopping = (self.around.stopping + 1).min(6);
        let leads_down = word & 0x82 == 0 || word & 0x87 == 0x06 || word & 0x8F == 0x07;
        let powered = matches!(self.around.power, Power::Enabled | Power::QuickStop);
        if leads_down && powered && self.around.moved && self.around.stopping <= 5 {
            return Err(format!(
                "{word:04X}h is sent to a moving axis, {} cycles after its stop began",
                self.around.stopping
            ));
        }
        Ok(())
    }

    fn holds(&self) -> bool {
        self.around.power == Power::Enabled
            && (self.around.active.is_some() || self.around.pending.is_some())
    }

    fn judge_state(&self) -> Broken {
        let drives = self.word() & 0x8F == 0x0F
            && self.around.sent & 0x8F == 0x0F
            && self.around.before & 0x8F == 0x0F;
        let snapshot = self.core.snapshot();
        if drives && self.holds() && !snapshot.has_set_point {
            return Err("the drive holds a set-point, and the core knows of none".into());
        }
        Ok(())
    }

    fn drain(&mut self) -> Broken {
        while let Some((CommandId(id), event)) = self.core.poll_event() {
            let holds = self.holds();
            let sent = self.around.sent;
            let place = id as usize - 1;
            let Some(asked) = self
                .around
                .asked
                .get_mut(place)
                .and_then(Option::as_mut)
                .filter(|asked| asked.pending)
            else {
                return Err(format!("{id} is reported on after its end: {event:?}"));
            };
            match event {
                Event::Accepted => {
                    asked.accepted = true;
                    if asked.kind == Kind::Move && !asked.taken {
                        return Err(format!("{id} is accepted, and the drive has not taken it"));
                    }
                }
                Event::Halted => {}
                Event::Done(result) => {
                    asked.pending = false;
                    let asked = *asked;
                    if asked.taken || !asked.sent {
                        self.around.asked[place] = None;
                    }
                    match (asked.kind, result) {
                        (Kind::Move, Ok(_)) if !asked.ended => {
                            return Err(format!(
                                "{id} is {result:?}, and the drive has not come to its end"
                            ));
                        }
                        (Kind::Stop, Ok(Completion::Stopped { .. }))
                            if holds && sent & 0x0F == 0x0F =>
                        {
                            return Err(format!(
                                "{id} is {result:?}, and the drive still holds a set-point"
                            ));
                        }
                        (Kind::Move, Err(failure))
                            if asked.taken && format!("{failure:?}").contains("NotSent") =>
                        {
                            return Err(format!("{id} is {failure:?}, and the drive has taken it"));
                        }
                        _ => {}
                    }
                }
            }
        }
        Ok(())
    }

    /// Whether everything has ended and the axis is disabled.
    pub fn is_at_the_end(&self) -> bool {
        let down = matches!(self.around.power, Power::Disabled | Power::Ready);
        down && self.is_idle() && self.word() & 0x0F != 0x0F
    }

    fn is_idle(&self) -> bool {
        self.around
            .asked
            .iter()
            .flatten()
            .all(|asked| !asked.pending)
    }

    /// What leads there with a sound drive and a good cable.
    pub fn way_to_the_end(&self) -> Act {
        match self.around.power {
            _ if !self.is_idle() => Act::Nothing,
            Power::Fault => Act::Ask(Ask::Reset),
            _ => Act::Ask(Ask::Disable),
        }
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

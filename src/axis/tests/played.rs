//! An axis core against a drive that is played word by word: what a simulated one never does.

use alloc::{collections::VecDeque, vec::Vec};
use core::time::Duration;

use crate::{
    Failure, Referencing, StopRequest,
    axis::{
        AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Deadlines, Event, Inputs,
    },
};
use crate::{
    HomingMethod, SetPoint,
    ds402::{Mode, QuickStopOption, State},
    homing::HomingCommand,
    profile_position::{MoveCommand, Reference},
};

/// Statuswords of the states, with bit 9 (remote).
pub(super) const NOT_READY: u16 = 0x0200;
pub(super) const SWITCH_ON_DISABLED: u16 = 0x0250;
pub(super) const READY: u16 = 0x0231;
pub(super) const SWITCHED_ON: u16 = 0x0233;
/// Bits 10 and 12 low.
pub(super) const ENABLED: u16 = 0x0237;
/// With bit 10, target reached.
pub(super) const REACHED: u16 = 0x0637;
/// With bit 12, set-point acknowledge.
pub(super) const ACKNOWLEDGED: u16 = 0x1237;
pub(super) const QUICK_STOP_ACTIVE: u16 = 0x0217;
pub(super) const FAULT_REACTION: u16 = 0x023F;
pub(super) const FAULT: u16 = 0x0238;

/// Controlwords: enabled, the same with bit 8, and with bit 2 low.
pub(super) const GO: u16 = 0x000F;
pub(super) const HALT: u16 = 0x010F;
pub(super) const QUICK_STOP: u16 = 0x000B;

/// A homing by this method, with nothing else asked for.
pub(super) const fn home(method: HomingMethod) -> Command {
    Command::Home(HomingCommand {
        method,
        offset: None,
        until: None,
    })
}

pub(super) const HOME: Command = home(HomingMethod::NEGATIVE_LIMIT);

/// Outputs: 6040h, 607Ah, 6060h, 60FFh. Inputs: 6041h, 6064h, 6061h, 606Ch, 603Fh.
pub(super) const FIELDS: AxisFields = AxisFields {
    mode: Some(6),
    target_velocity: Some(7),
    mode_display: Some(6),
    actual_velocity: Some(7),
    error_code: Some(11),
    ..AxisFields::at(0, 0)
};

/// What one cycle brings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Brings {
    Fresh,
    /// Inputs, and outputs that were perhaps not delivered.
    Answered,
    Nothing,
}

/// Cycles of 1 ms.
pub(super) struct Played {
    pub core: AxisCore,
    pub outputs: [u8; 11],
    pub now: Duration,
    pub mode: i8,
    pub position: i32,
    /// In counts per cycle, and what 606Ch shows.
    pub velocity: i32,
    pub error_code: u16,
    pub reports: Vec<(CommandId, Event)>,
    last: u32,
}

impl Played {
    /// With deadlines that are different from one another and soon over.
    pub fn config() -> CoreConfig {
        let mut config = CoreConfig {
            deadlines: Deadlines {
                enable: Duration::from_millis(300),
                disable: Duration::from_millis(200),
                acknowledge: Duration::from_millis(50),
                begin: Duration::from_millis(90),
                standstill: Duration::from_millis(400),
                mode: Duration::from_millis(60),
                fault_reset: Duration::from_millis(30),
            },
            referencing: Referencing::UnreferencedMovesAllowed,
            ..CoreConfig::new(FIELDS)
        };
        // So short that a test need not wait for it.
        config.tolerances.settle = Duration::from_millis(12);
        config
    }

    /// Its drive stays in Quick stop active.
    pub fn staying() -> CoreConfig {
        CoreConfig {
            quick_stop: QuickStopOption(6),
            ..Self::config()
        }
    }

    /// Before the first cycle.
    pub fn new(config: CoreConfig) -> Self {
        Self {
            core: AxisCore::new(config),
            outputs: [0; 11],
            now: Duration::ZERO,
            mode: 1,
            position: 0,
            velocity: 0,
            error_code: 0,
            reports: Vec::new(),
            last: 0,
        }
    }

    /// At rest in Switch on disabled, for some time.
    pub fn disabled(config: CoreConfig) -> Self {
        let mut this = Self::new(config);
        this.shows_for(20, SWITCH_ON_DISABLED);
        this
    }

    /// At rest in Operation enabled, in mode 1.
    pub fn enabled(config: CoreConfig) -> Self {
        let mut this = Self::disabled(config);
        this.enable();
        this.shows_for(20, REACHED);
        this
    }

    #[track_caller]
    pub fn enable(&mut self) {
        let enabling = self.submit(Command::Enable);
        for statusword in [READY, SWITCHED_ON, ENABLED, ENABLED, ENABLED] {
            self.shows(statusword);
        }
        assert_eq!(self.outcome(enabling), Some(Ok(Completion::Done)));
    }

    /// The same in another mode.
    pub fn enabled_in(mode: Mode, config: CoreConfig) -> Self {
        let mut this = Self::enabled(config);
        let selecting = this.submit(Command::SelectMode(mode));
        for _ in 0..30 {
            this.shows(REACHED);
            this.mode = this.outputs[6] as i8;
        }
        assert_eq!(this.outcome(selecting), Some(Ok(Completion::Done)));
        this
    }

    /// On its way to this position by a move that the drive has acknowledged.
    pub fn moving(config: CoreConfig, target: i32) -> (Self, CommandId) {
        let mut this = Self::enabled(config);
        let id = this.move_to(target);
        this.shows(REACHED);
        this.shows(ACKNOWLEDGED);
        this.velocity = 20;
        this.shows_for(5, ENABLED);
        assert!(this.reports.contains(&(id, Event::Accepted)));
        (this, id)
    }

    /// Its end velocity 6082h is in the outputs.
    pub fn passing() -> CoreConfig {
        CoreConfig {
            fields: AxisFields {
                target_velocity: None,
                end_velocity: Some(7),
                ..FIELDS
            },
            ..Self::config()
        }
    }

    /// Gone on at the end velocity of a move that has ended.
    pub fn at_end_velocity() -> Self {
        Self::at_end_velocity_of(Self::passing())
    }

    pub fn at_end_velocity_of(config: CoreConfig) -> Self {
        let mut this = Self::enabled(config);
        let id = this.passes(100, 20);
        this.shows_for(5, ENABLED);
        this.velocity = 0;
        let (_, result) = this.cycles_to_end(id, REACHED);
        assert!(result.is_ok(), "{result:?}");
        this.velocity = 20;
        this.shows_for(30, REACHED);
        this
    }

    /// Sets off to pass this position at this speed, counts in a cycle.
    pub fn passes(&mut self, target: i32, velocity: i32) -> CommandId {
        let mut command = absolute(target);
        command.set_point = SetPoint::new().end_velocity(velocity.unsigned_abs());
        let id = self.submit(Command::Move(command));
        self.shows(REACHED);
        self.shows(ACKNOWLEDGED);
        self.velocity = velocity;
        id
    }

    /// Halts it, and it comes to rest. It gets slower: an axis that freezes at once may be at work unseen.
    pub fn halt_to_rest(&mut self) {
        let halting = self.submit(Command::Halt);
        for velocity in [20, 10, 0] {
            self.velocity = velocity;
            self.shows(ENABLED);
        }
        assert!(self.cycles_to_end(halting, ENABLED).1.is_ok());
    }

    pub fn submit(&mut self, command: Command) -> CommandId {
        self.last += 1;
        let id = CommandId(self.last);
        self.submit_as(id, command);
        id
    }

    pub fn submit_as(&mut self, id: CommandId, command: Command) {
        self.core.submit(self.now, id, command, &mut self.outputs);
        self.drain();
    }

    pub fn move_to(&mut self, target: i32) -> CommandId {
        self.submit(Command::Move(absolute(target)))
    }

    /// What a command that is answered at once is answered.
    pub fn answer(&mut self, command: Command) -> Option<Result<Completion, Failure>> {
        let id = self.submit(command);
        self.outcome(id)
    }

    pub fn stop_lane(&mut self, stop: StopRequest) -> bool {
        let withdrawn = self.core.apply_stop(self.now, stop, &mut self.outputs);
        self.drain();
        withdrawn
    }

    pub fn shows(&mut self, statusword: u16) {
        self.cycle(Brings::Fresh, statusword);
    }

    pub fn shows_for(&mut self, cycles: u32, statusword: u16) {
        for _ in 0..cycles {
            self.shows(statusword);
        }
    }

    pub fn cycle(&mut self, brings: Brings, statusword: u16) {
        self.now += Duration::from_millis(1);
        self.position += self.velocity;
        let bytes = self.inputs(statusword);
        let inputs = match brings {
            Brings::Fresh => Inputs::Fresh(&bytes),
            Brings::Answered => Inputs::Answered(&bytes),
            Brings::Nothing => Inputs::Stale,
        };
        self.core.step(self.now, inputs, &mut self.outputs);
        self.drain();
    }

    pub fn cycles(&mut self, cycles: u32, brings: Brings, statusword: u16) {
        for _ in 0..cycles {
            self.cycle(brings, statusword);
        }
    }

    /// After how many cycles with this statusword the word in the outputs is this.
    #[track_caller]
    pub fn cycles_until(&mut self, word: u16, statusword: u16) -> u32 {
        for cycle in 0..2_000 {
            if self.word() == word {
                return cycle;
            }
            self.shows(statusword);
        }
        panic!("{word:04X}h does not come: {:04X}h", self.word());
    }

    /// After how many cycles with this statusword the command ends.
    #[track_caller]
    pub fn cycles_to_end(
        &mut self,
        of: CommandId,
        statusword: u16,
    ) -> (u32, Result<Completion, Failure>) {
        for cycle in 0..2_000 {
            if let Some(result) = self.outcome(of) {
                return (cycle, result);
            }
            self.shows(statusword);
        }
        panic!("it does not end: {:04X}h", self.word());
    }

    pub fn inputs(&self, statusword: u16) -> [u8; 13] {
        let mut inputs = [0; 13];
        inputs[..2].copy_from_slice(&statusword.to_le_bytes());
        inputs[2..6].copy_from_slice(&self.position.to_le_bytes());
        inputs[6] = self.mode as u8;
        inputs[7..11].copy_from_slice(&self.velocity.to_le_bytes());
        inputs[11..].copy_from_slice(&self.error_code.to_le_bytes());
        inputs
    }

    /// The last report of this command, which it had once.
    pub fn outcome(&self, of: CommandId) -> Option<Result<Completion, Failure>> {
        let mut ends = self.reports.iter().filter_map(|&(id, event)| match event {
            Event::Done(result) if id == of => Some(result),
            _ => None,
        });
        let end = ends.next();
        assert_eq!(ends.next(), None, "{of:?} ends twice");
        end
    }

    /// The controlword in the outputs.
    pub fn word(&self) -> u16 {
        u16::from_le_bytes([self.outputs[0], self.outputs[1]])
    }

    /// Target position 607Ah in the outputs.
    pub fn target(&self) -> i32 {
        self.outputs[2..6].try_into().map_or(0, i32::from_le_bytes)
    }

    /// Target velocity 60FFh in the outputs.
    pub fn target_velocity(&self) -> i32 {
        self.outputs[7..].try_into().map_or(0, i32::from_le_bytes)
    }

    pub fn drain(&mut self) {
        self.reports
            .extend(core::iter::from_fn(|| self.core.poll_event()));
    }
}

/// The answer to who waits for a stop, in this state.
pub(super) fn stopped(state: State) -> Option<Result<Completion, Failure>> {
    Some(Ok(Completion::Stopped { state }))
}

pub(super) fn absolute(target: i32) -> MoveCommand {
    MoveCommand {
        reference: Reference::Absolute,
        target,
        set_point: SetPoint::new(),
        gated: false,
    }
}

/// A drive that comes to a mode so many cycles after it was commanded.
pub(super) struct SlowModes {
    later: VecDeque<i8>,
}

impl SlowModes {
    pub fn new(mode: Mode, cycles: usize) -> Self {
        let later = core::iter::repeat_n(mode.raw(), cycles);
        Self {
            later: later.collect(),
        }
    }

    /// A cycle of it. Bit 4 is never high in homing mode: it would start a homing there.
    #[track_caller]
    pub fn shows(&mut self, drive: &mut Played, statusword: u16) {
        self.later.push_back(drive.outputs[6] as i8);
        drive.mode = self.later.pop_front().unwrap();
        let starts_homing = drive.mode == Mode::Homing.raw() && drive.word() & 0x0010 != 0;
        assert!(!starts_homing, "{:?}", drive.now);
        drive.shows(statusword);
    }
}

//! An axis core, a wire that loses frames and a simulated drive, in virtual time; everything that crossed the wire is
//! recorded.

use core::time::Duration;

use servocrab::axis::{
    AxisFields, Command, CommandId, Completion, CoreConfig, Event, Failure, Inputs, StopRequest,
};
use servocrab::ds402::Statusword;
use servocrab::profile_position::MoveCommand;
use servocrab_sim::ds402::{Axis, Executed, State};

use crate::differential::CorePair;
use crate::frames::{Late, Link, value};

/// What came back of a frame, as the core was told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Got {
    Fresh,
    Answered,
    Stale,
}

/// The outputs as bytes, and what they mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outputs {
    pub word: u16,
    pub mode: i8,
    pub target: i32,
    pub velocity: u32,
    pub acceleration: u32,
    pub deceleration: u32,
}

impl Outputs {
    pub fn bit(&self, bit: u16) -> bool {
        self.word & (1 << bit) != 0
    }
}

/// The inputs as bytes, and what they mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    pub statusword: Statusword,
    pub mode: i8,
    pub position: i32,
}

impl Sample {
    pub fn bit(&self, bit: u16) -> bool {
        self.statusword.bits() & (1 << bit) != 0
    }
}

/// One bus cycle.
#[derive(Debug, Clone)]
pub struct Frame {
    pub now: Duration,
    /// What was sent.
    pub sent: Outputs,
    /// What the core had written for the frame after its last step, before commands and the stop lane of this cycle.
    pub before: Outputs,
    /// Whether the drive has the outputs.
    pub delivered: bool,
    pub got: Got,
    /// The inputs that came back with this frame, where some came.
    pub sample: Option<Sample>,
    /// The drive after its cycles that followed.
    pub position: i64,
    pub velocity: f64,
    /// Where its trajectory generator was, and how fast, while the drive controlled the axis.
    pub demand: Option<(i64, f64)>,
    pub lane: StopRequest,
    pub lost_after: bool,
}

/// A command that was submitted before frame `frame` was sent.
#[derive(Debug, Clone, Copy)]
pub struct Issued {
    pub id: CommandId,
    pub frame: usize,
    pub now: Duration,
    pub command: Command,
}

/// Who called when a report came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Before frame `frame` was sent.
    Submit,
    /// While its answer was taken in.
    Step,
}

#[derive(Debug, Clone, Copy)]
pub struct Report {
    pub frame: usize,
    pub now: Duration,
    pub phase: Phase,
    pub id: CommandId,
    pub event: Event,
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
    actual_velocity: Some(7),
    error_code: Some(11),
};

const OUTPUTS: [(u16, usize, usize); 6] = [
    (0x6040, 0, 2),
    (0x6060, 2, 1),
    (0x607A, 3, 4),
    (0x6081, 7, 4),
    (0x6083, 11, 4),
    (0x6084, 15, 4),
];
const INPUTS: [(u16, usize); 5] = [
    (0x6041, 2),
    (0x6061, 1),
    (0x6064, 4),
    (0x606C, 4),
    (0x603F, 2),
];
const OUTPUT_BYTES: usize = 19;

/// The drive's own cycle, by its own crystal.
pub const DRIVE_CYCLE: Duration = Duration::from_millis(1);

pub struct World {
    pub core: CorePair,
    pub config: CoreConfig,
    pub drive: Axis,
    pub now: Duration,
    /// From one frame to the next.
    pub period: Duration,
    /// Inputs are this many frames older than the frame that brings them.
    pub latency: usize,
    pub frames: Vec<Frame>,
    pub issued: Vec<Issued>,
    pub reports: Vec<Report>,
    outputs: [u8; OUTPUT_BYTES],
    /// The outputs after the last step.
    stepped: Outputs,
    /// The drive's cycle by the clock of the bus.
    pub drive_cycle: Duration,
    next_drive_cycle: Duration,
    late: Late,
    /// Gated moves that wait to be fired.
    pub gated: Vec<CommandId>,
}

impl World {
    pub fn new(drive: Axis, config: CoreConfig, period: Duration, latency: usize) -> Self {
        Self {
            core: CorePair::new(config.clone()),
            config,
            drive,
            now: Duration::ZERO,
            period,
            latency,
            frames: Vec::new(),
            issued: Vec::new(),
            reports: Vec::new(),
            outputs: [0; OUTPUT_BYTES],
            stepped: Outputs::default(),
            drive_cycle: DRIVE_CYCLE,
            next_drive_cycle: DRIVE_CYCLE / 2,
            late: Late::default(),
            gated: Vec::new(),
        }
    }

    /// The process data of every world; without 606Ch if not `velocity`.
    pub fn fields(velocity: bool) -> AxisFields {
        AxisFields {
            actual_velocity: FIELDS.actual_velocity.filter(|_| velocity),
            ..FIELDS
        }
    }

    pub fn submit(&mut self, command: Command) -> CommandId {
        let id = CommandId(self.issued.len() as u32 + 1);
        self.issued.push(Issued {
            id,
            frame: self.frames.len(),
            now: self.now,
            command,
        });
        if let Command::Move(MoveCommand { gated: true, .. }) = command {
            self.gated.push(id);
        }
        self.core.submit(self.now, id, command, &mut self.outputs);
        self.drain(Phase::Submit);
        id
    }

    pub fn withdraw(&mut self, id: CommandId) {
        self.core.withdraw(id, &mut self.outputs);
        self.drain(Phase::Submit);
    }

    /// One bus cycle: the stop lane, gated moves that may start, frame out and back, the core, the drive.
    pub fn cycle(&mut self, lane: StopRequest, fire: bool, link: Link) {
        let before = self.stepped;
        self.core.apply_stop(self.now, lane, &mut self.outputs);
        if fire && let Some(&id) = self.gated.iter().find(|id| self.core.is_armed(**id)) {
            self.core.fire(self.now, id, &mut self.outputs);
        }
        self.drain(Phase::Submit);

        let sent = self.outputs_now();
        let inputs = self.drive_inputs();
        let delivered = link.delivers();
        if delivered {
            self.deliver();
        }
        let arrived = self.late.pass(inputs, self.latency);
        let told = link.tells(arrived.as_deref());
        let (got, shown) = match told {
            Inputs::Fresh(inputs) => (Got::Fresh, Some(sample(inputs))),
            Inputs::Answered(inputs) => (Got::Answered, Some(sample(inputs))),
            Inputs::Stale => (Got::Stale, None),
        };
        self.now += self.period / 2;
        self.core.step(self.now, told, &mut self.outputs);
        self.drain(Phase::Step);
        self.stepped = self.outputs_now();
        let stepped = self.now;
        self.now += self.period / 2;
        while self.next_drive_cycle <= self.now {
            self.drive.cycle(self.next_drive_cycle);
            self.next_drive_cycle += self.drive_cycle;
        }
        self.frames.push(Frame {
            now: stepped,
            sent,
            before,
            delivered,
            got,
            sample: shown,
            position: self.drive.position(),
            velocity: self.drive.velocity(),
            demand: controls(self.drive.state()).then(|| self.drive.demand()),
            lane,
            lost_after: self.core.snapshot().lost,
        });
    }

    pub fn ledger(&self) -> &[Executed] {
        self.drive.ledger()
    }

    pub fn outputs_now(&self) -> Outputs {
        let at = |from: usize| {
            let mut raw = [0; 4];
            raw.copy_from_slice(&self.outputs[from..from + 4]);
            u32::from_le_bytes(raw)
        };
        Outputs {
            word: u16::from_le_bytes([self.outputs[0], self.outputs[1]]),
            mode: self.outputs[2].cast_signed(),
            target: at(3).cast_signed(),
            velocity: at(7),
            acceleration: at(11),
            deceleration: at(15),
        }
    }

    /// The command's last report.
    pub fn done(&self, id: CommandId) -> Option<(Report, Result<Completion, Failure>)> {
        self.reports.iter().find_map(|report| match report.event {
            Event::Done(result) if report.id == id => Some((*report, result)),
            _ => None,
        })
    }

    pub fn accepted(&self, id: CommandId) -> Option<Report> {
        self.reports
            .iter()
            .find(|report| report.id == id && report.event == Event::Accepted)
            .copied()
    }

    pub fn pending(&self) -> Vec<Issued> {
        self.issued
            .iter()
            .filter(|issued| self.done(issued.id).is_none())
            .copied()
            .collect()
    }

    /// The moves, with their last report.
    pub fn moves(
        &self,
    ) -> impl Iterator<Item = (Issued, MoveCommand, Option<Result<Completion, Failure>>)> + '_ {
        self.issued
            .iter()
            .filter_map(|issued| match issued.command {
                Command::Move(command) => Some((
                    *issued,
                    command,
                    self.done(issued.id).map(|(_, result)| result),
                )),
                _ => None,
            })
    }

    fn drain(&mut self, phase: Phase) {
        while let Some((id, event)) = self.core.poll_event() {
            self.reports.push(Report {
                frame: self.frames.len(),
                now: self.now,
                phase,
                id,
                event,
            });
            if matches!(event, Event::Done(_)) {
                self.gated.retain(|gated| *gated != id);
            }
        }
    }

    fn deliver(&mut self) {
        for (index, at, bytes) in OUTPUTS {
            let value = value(index, &self.outputs[at..at + bytes]);
            // A value that the drive refuses stays what it was, as with a PDO.
            let _ = self.drive.set(index, 0, value);
        }
    }

    fn drive_inputs(&self) -> Vec<u8> {
        let mut image = Vec::new();
        for (index, bytes) in INPUTS {
            // An object that the drive lacks is not mapped.
            let value = self.drive.get(index, 0).unwrap_or_default();
            image.extend_from_slice(&value.to_le_bytes()[..bytes]);
        }
        image
    }
}

fn sample(inputs: &[u8]) -> Sample {
    Sample {
        statusword: Statusword::from_bits_retain(u16::from_le_bytes([inputs[0], inputs[1]])),
        mode: inputs[2].cast_signed(),
        position: i32::from_le_bytes([inputs[3], inputs[4], inputs[5], inputs[6]]),
    }
}

/// Whether a drive in this state turns its axis.
fn controls(state: State) -> bool {
    matches!(
        state,
        State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
    )
}

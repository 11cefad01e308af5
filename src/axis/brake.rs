//! The brake that holds an axis without power: who opens and closes it, and how far that is.
//!
//! A brake on an output of the drive is the host's: it is opened once the axis is enabled, and closed before its power goes. Until it is
//! closed, quick stop goes out in place of every word that leads down; by 605Ah the drive holds the axis in Quick stop active.

use core::time::Duration;

use crate::{
    Failure,
    ds402::{DigitalInput, DigitalOutput},
    timer::{Due, Elapsed, Timer},
};

use super::{machines::Step, power::Power};

/// What holds the axis where it has no power.
///
/// ```
/// use core::time::Duration;
/// use servocrab::{AxisConfig, axis::{Brake, OutputBrake}, ds402::{DigitalInput, DigitalOutput}};
///
/// let lift = AxisConfig::new("lift").vertical().brake(Brake::DriveManaged);
/// // A brake on output 16 of the drive, which its valve opens by 1; a switch says that it is open.
/// let (release, set) = (Duration::from_millis(120), Duration::from_millis(60));
/// let brake = OutputBrake::new(DigitalOutput::Bit(16), release, set)
///     .released_by_one()
///     .feedback(DigitalInput::Bit(17));
/// let table = AxisConfig::new("table").brake(brake);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Brake {
    /// The drive opens it before it shows Operation enabled, and closes it before it takes the axis' power. Nothing is sent for it.
    DriveManaged,
    /// It is opened and closed by an output of the drive, which the host sets.
    Output(OutputBrake),
}

/// A brake on an output of the drive: bit of 60FEh:1, times and feedback.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct OutputBrake {
    /// Its output.
    pub output: DigitalOutput,
    /// Whether 1 closes it; else 0 does.
    pub set_by_one: bool,
    /// How long it takes to open.
    pub release: Duration,
    /// How long it takes to close.
    pub set: Duration,
    /// An input that shows it, and whether that is 1 while it is open.
    pub feedback: Option<(DigitalInput, bool)>,
    /// Whether the drive itself closes it in a fault, and when its process data stop.
    pub is_set_by_drive: bool,
}

impl OutputBrake {
    /// A brake on this output, with how long it takes to open (`release`) and to close (`set`). 1 closes it, as bit 0 of 60FEh:1 does.
    #[must_use]
    pub const fn new(output: DigitalOutput, release: Duration, set: Duration) -> Self {
        Self {
            output,
            set_by_one: true,
            release,
            set,
            feedback: None,
            is_set_by_drive: false,
        }
    }

    /// Its output opens it by 1 and closes it by 0.
    #[must_use]
    pub const fn released_by_one(mut self) -> Self {
        self.set_by_one = false;
        self
    }

    /// An input that is 1 while the brake is open, in 60FDh. Then nothing waits longer than until it shows what it should. If it does not show
    /// within `release` that the brake is open, `enable()` fails as [`Failure::BrakeNotReleased`](crate::Failure::BrakeNotReleased).
    #[must_use]
    pub const fn feedback(mut self, input: DigitalInput) -> Self {
        self.feedback = Some((input, true));
        self
    }

    /// As [`feedback`](Self::feedback), by an input that is 0 while the brake is open.
    #[must_use]
    pub const fn inverted_feedback(mut self, input: DigitalInput) -> Self {
        self.feedback = Some((input, false));
        self
    }

    /// The drive itself closes it by this output in a fault, and when its process data stop: its manual says so, and somebody has set it so.
    /// A [vertical](crate::AxisConfig::vertical) axis needs that, since a host comes too late there.
    #[must_use]
    pub const fn set_by_drive(mut self) -> Self {
        self.is_set_by_drive = true;
        self
    }

    /// Its bit of 60FEh:1.
    #[must_use]
    pub fn bit(&self) -> u32 {
        self.output.mask().unwrap_or(0)
    }

    /// This value of 60FEh:1 with its bit so that the brake is closed (`is_set`), or open.
    #[must_use]
    pub fn in_outputs(&self, held: u32, is_set: bool) -> u32 {
        if is_set == self.set_by_one {
            held | self.bit()
        } else {
            held & !self.bit()
        }
    }

    /// Whether it is open, as its feedback in 60FDh shows it; none without one.
    #[must_use]
    pub fn is_released(&self, inputs: u32) -> Option<bool> {
        let (input, released_by_one) = self.feedback?;
        Some((inputs & input.mask()? != 0) == released_by_one)
    }
}

impl From<OutputBrake> for Brake {
    fn from(brake: OutputBrake) -> Self {
        Self::Output(brake)
    }
}

/// How far a brake is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum BrakeStage {
    /// There is none.
    NotThere,
    /// The drive opens and closes it.
    Managed,
    /// It is closed.
    Set,
    /// It opens.
    Releasing { left: Timer },
    /// It has had its time, and its feedback does not show that it is open.
    NotReleased,
    /// It is open.
    Released,
    /// It closes. `was_open`: its feedback has shown that it was open, and so shows when it is closed.
    Setting { left: Timer, was_open: bool },
}

/// Where the axis stands that is to be held without power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum HeldAt {
    Unknown,
    /// Here it stood last.
    Here(i32),
    /// It has left the window around the place where it stood, without power.
    Slipped,
}

/// The brake of an axis, or that there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct HoldingBrake {
    stage: BrakeStage,
    held_at: HeldAt,
}

impl HoldingBrake {
    /// As its axis begins: the outputs say that it is closed, and it may have been open before.
    pub fn new(brake: Option<&Brake>) -> Self {
        let stage = match brake {
            Some(Brake::Output(brake)) => BrakeStage::Setting {
                left: Timer::new(brake.set),
                was_open: false,
            },
            Some(Brake::DriveManaged) => BrakeStage::Managed,
            None => BrakeStage::NotThere,
        };
        let held_at = HeldAt::Unknown;
        Self { stage, held_at }
    }

    /// One cycle with inputs. Where the axis stood, if it has just slipped from there.
    pub fn update(&mut self, step: &Step<'_>, released: Option<bool>) -> Option<i32> {
        match &step.config.brake {
            None => return None,
            Some(Brake::DriveManaged) => {}
            Some(Brake::Output(brake)) => self.move_on(brake, step, released),
        }
        self.watch(step)
    }

    fn move_on(&mut self, brake: &OutputBrake, step: &Step<'_>, released: Option<bool>) {
        let leads_up = step.power.leads_up();
        let is_enabled = leads_up && step.is_enabled_by_us();
        let may_close = step.stands() || step.guard.has_given_up();
        // Whatever was asked for, an axis without power has nothing but its brake.
        let must_close = !step.state.holds_axis() || (!leads_up && may_close);
        let seen = step.config.traits.surely_seen();
        let timer = |time: Duration| Timer::new(time.saturating_add(seen));
        self.stage = match self.stage {
            BrakeStage::Set | BrakeStage::Setting { .. } if is_enabled => BrakeStage::Releasing {
                left: timer(brake.release),
            },
            BrakeStage::Releasing { .. } | BrakeStage::NotReleased | BrakeStage::Released
                if must_close =>
            {
                BrakeStage::Setting {
                    left: timer(brake.set),
                    was_open: self.stage == BrakeStage::Released,
                }
            }
            BrakeStage::Releasing { .. } if released == Some(true) => BrakeStage::Released,
            BrakeStage::Releasing { left } => match after(left, step) {
                Some(left) => BrakeStage::Releasing { left },
                None if brake.feedback.is_some() => BrakeStage::NotReleased,
                None => BrakeStage::Released,
            },
            BrakeStage::Setting { was_open: true, .. } if released == Some(false) => {
                BrakeStage::Set
            }
            BrakeStage::Setting { left, was_open } => match after(left, step) {
                Some(left) => BrakeStage::Setting { left, was_open },
                None => BrakeStage::Set,
            },
            stage => stage,
        };
    }

    /// Whether an axis that stood slips where its brake is closed and its power gone. What its drive shows of its power may be two cycles
    /// late: only an axis that is led to move has left its place by that.
    fn watch(&mut self, step: &Step<'_>) -> Option<i32> {
        let (stands, position) = (step.stands(), step.position());
        let is_powered = step.state.holds_axis();
        let is_closed = matches!(self.stage, BrakeStage::Set | BrakeStage::Managed);
        match self.held_at {
            _ if is_powered && stands => self.held_at = HeldAt::Here(position),
            _ if step.power.leads_up() && !stands => self.held_at = HeldAt::Unknown,
            HeldAt::Unknown if stands => self.held_at = HeldAt::Here(position),
            HeldAt::Here(from)
                if is_closed && !is_powered && !step.bounds.is_within_window(from, position) =>
            {
                self.held_at = HeldAt::Slipped;
                return Some(from);
            }
            _ => {}
        }
        None
    }

    pub const fn is_there(&self) -> bool {
        !matches!(self.stage, BrakeStage::NotThere)
    }

    /// What its output is to be; none where the host has none.
    pub const fn is_set(&self) -> Option<bool> {
        match self.stage {
            BrakeStage::NotThere | BrakeStage::Managed => None,
            BrakeStage::Set | BrakeStage::Setting { .. } => Some(true),
            BrakeStage::Releasing { .. } | BrakeStage::NotReleased | BrakeStage::Released => {
                Some(false)
            }
        }
    }

    /// Whether the axis must keep its power: its brake does not hold it yet.
    pub const fn needs_power(&self) -> bool {
        matches!(
            self.stage,
            BrakeStage::Releasing { .. }
                | BrakeStage::NotReleased
                | BrakeStage::Released
                | BrakeStage::Setting { .. }
        )
    }

    /// Whether an enabled axis may be moved; none while its brake opens.
    pub const fn released(&self) -> Option<Result<(), Failure>> {
        match self.stage {
            BrakeStage::NotThere | BrakeStage::Managed | BrakeStage::Released => Some(Ok(())),
            BrakeStage::NotReleased => Some(Err(Failure::BrakeNotReleased)),
            BrakeStage::Set | BrakeStage::Setting { .. } | BrakeStage::Releasing { .. } => None,
        }
    }

    /// Whether the axis has left, without power, the place where its brake was to hold it.
    pub const fn has_slipped(&self) -> bool {
        matches!(self.held_at, HeldAt::Slipped)
    }

    pub const fn due(&self, power: &Power) -> Due {
        Due::next_if(match self.stage {
            BrakeStage::NotThere | BrakeStage::Managed | BrakeStage::Set => false,
            BrakeStage::Releasing { .. } | BrakeStage::Setting { .. } => true,
            BrakeStage::Released | BrakeStage::NotReleased => !power.leads_up(),
        })
    }
}

/// What is left of a time after this cycle, in which the drive has its outputs; none where it is over.
fn after(mut left: Timer, step: &Step<'_>) -> Option<Timer> {
    left.pass(if step.delivered {
        step.elapsed
    } else {
        Elapsed::default()
    });
    (!left.is_over()).then_some(left)
}

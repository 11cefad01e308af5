//! The recorder: what a program sees of every cycle, read from the ring of the last cycles on the program's own thread.
//!
//! The bus thread does nothing for it. A [`Signal`] is resolved once into a place in a cycle's frames, and decoded when it is read.

use core::{fmt, str::FromStr};
use std::{collections::VecDeque, sync::Arc, time::Duration};

use super::cycle::black_box::{CycleRecord, CycleRing, RingLook};
use crate::{
    coe::{AnyObject, DataType, ObjectAddress, ObjectUnit, obj},
    ds402::{State, Statusword},
    pdo_map::BitRange,
    units::AxisScale,
};

/// The names by which values of an axis are asked for, beside their objects.
const NAMES: [(&str, ObjectAddress); 12] = [
    ("controlword", obj::CONTROLWORD.address()),
    ("digital_inputs", obj::DIGITAL_INPUTS.address()),
    ("error_code", obj::ERROR_CODE.address()),
    ("following_error", obj::FOLLOWING_ERROR_ACTUAL.address()),
    ("mode", obj::MODE_OF_OPERATION_DISPLAY.address()),
    ("position", obj::POSITION_ACTUAL.address()),
    ("position_demand", obj::POSITION_DEMAND.address()),
    ("statusword", obj::STATUSWORD.address()),
    ("target", obj::TARGET_POSITION.address()),
    ("target_velocity", obj::TARGET_VELOCITY.address()),
    ("torque", obj::TORQUE_ACTUAL.address()),
    ("velocity", obj::VELOCITY_ACTUAL.address()),
];

/// What an error says of a signal that is none of this axis.
pub(in crate::bus) fn no_signal(axis: &str, value: &str) -> String {
    let names: Vec<_> = NAMES.iter().map(|(name, _)| *name).collect();
    let names = names.join(", ");
    format!(
        "axis `{axis}` has no signal `{value}`: it has state, {names}, or an object such as 6077h"
    )
}

/// A value of every cycle that a [`Recorder`] shows.
///
/// As text: `x.position`, `x.state` and `x.6077h` are of the axis `x`, `6077h@1` is of the device at position 1 of the line,
/// `buttons.Channel 1.Input` is a point of the device `buttons`, and `lateness` is that of the cycle. The names for an axis are
/// `controlword`, `digital_inputs`, `error_code`, `following_error`, `mode`, `position`, `position_demand`, `state`, `statusword`,
/// `target`, `target_velocity`, `torque` and `velocity`.
///
/// ```
/// use servocrab::{bus::Signal, coe::obj};
/// assert_eq!("x.position".parse(), Ok(Signal::axis("x", obj::POSITION_ACTUAL)));
/// assert_eq!("6077h@1".parse(), Ok(Signal::device(1, obj::TORQUE_ACTUAL)));
/// assert_eq!(Signal::axis("x", obj::FOLLOWING_ERROR_ACTUAL).to_string(), "x.following_error");
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Signal {
    /// A mapped object of an axis, by the numbering of its drive's first axis; in the unit of the axis where it is a position, a
    /// velocity or an acceleration.
    Axis {
        /// The axis' name.
        axis: String,
        /// The object.
        object: ObjectAddress,
    },
    /// The state of an axis that its statusword shows, as a number from 0 (Not ready to switch on) to 7 (Fault) in the order of
    /// [`State`]; none where the statusword shows no state.
    State {
        /// The axis' name.
        axis: String,
    },
    /// A mapped object of the device at this position of the line, as it is in the process data.
    Device {
        /// The position in the line, from 0.
        position: u16,
        /// The object.
        object: ObjectAddress,
    },
    /// An input or output of a device that is no drive.
    Point {
        /// The device's name.
        io: String,
        /// The point's name, or its object.
        point: String,
    },
    /// By how much the cycle's frames were sent later than planned, in microseconds.
    Lateness,
}

impl Signal {
    /// An object of an axis.
    pub fn axis(axis: &str, object: impl Into<AnyObject>) -> Self {
        Self::Axis {
            axis: axis.to_owned(),
            object: object.into().address(),
        }
    }

    /// The state of an axis.
    #[must_use]
    pub fn state(axis: &str) -> Self {
        Self::State {
            axis: axis.to_owned(),
        }
    }

    /// An object of a device, by its own numbering.
    pub fn device(position: u16, object: impl Into<AnyObject>) -> Self {
        Self::Device {
            position,
            object: object.into().address(),
        }
    }

    /// An input or output.
    #[must_use]
    pub fn point(io: &str, point: &str) -> Self {
        Self::Point {
            io: io.to_owned(),
            point: point.to_owned(),
        }
    }
}

impl fmt::Display for Signal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Axis { axis, object } => {
                match NAMES.iter().find(|(_, address)| address == object) {
                    Some((name, _)) => write!(f, "{axis}.{name}"),
                    None => write!(f, "{axis}.{object}"),
                }
            }
            Self::State { axis } => write!(f, "{axis}.state"),
            Self::Device { position, object } => write!(f, "{object}@{position}"),
            Self::Point { io, point } => write!(f, "{io}.{point}"),
            Self::Lateness => f.write_str("lateness"),
        }
    }
}

/// A text that names no [`Signal`], or no [`Trigger`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not understood: {expected}")]
pub struct NoSignal {
    /// The text.
    pub text: String,
    /// What is expected in its place.
    pub expected: &'static str,
}

impl FromStr for Signal {
    type Err = NoSignal;

    fn from_str(text: &str) -> Result<Self, NoSignal> {
        let error = || NoSignal {
            text: text.to_owned(),
            expected: "a signal is `x.position`, `x.state` or `x.6077h` of an axis, `6077h@1` of the device at position 1, \
                       `valves.Channel 1.Output` of another device, or `lateness`",
        };
        let text = text.trim();
        if text == "lateness" {
            return Ok(Self::Lateness);
        }
        if let Some((object, position)) = text.split_once('@') {
            let object = object.trim().parse().map_err(|_| error())?;
            let position = position.trim().parse().map_err(|_| error())?;
            return Ok(Self::Device { position, object });
        }
        let (owner, value) = text.split_once('.').ok_or_else(error)?;
        if owner.is_empty() || value.is_empty() {
            return Err(error());
        }
        if value == "state" {
            return Ok(Self::state(owner));
        }
        let named = NAMES.iter().find(|(name, _)| *name == value);
        let object = named.map(|(_, object)| *object).or(value.parse().ok());
        Ok(match object {
            Some(object) => Self::Axis {
                axis: owner.to_owned(),
                object,
            },
            None => Self::point(owner, value),
        })
    }
}

/// Where a signal lies in a cycle, and what its bits mean.
#[derive(Debug, Clone)]
pub(in crate::bus) enum SignalSource {
    Value {
        /// The device's place in the exchange.
        device: usize,
        /// Whether it is among what the device sends, and not among what it gets.
        is_input: bool,
        place: BitRange,
        data_type: DataType,
        scaled: ObjectUnit,
        scale: AxisScale,
    },
    State {
        device: usize,
        place: BitRange,
    },
    Lateness,
}

/// A [`Signal`] that a [`Recorder`] shows.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct RecordedSignal {
    /// The signal.
    pub signal: Signal,
    /// Its unit, such as `mm/s`; empty where there is none.
    pub unit: String,
}

/// The signals of one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedValues {
    /// The number of the cycle, from 1.
    pub number: u64,
    /// When its frames were sent, in the link's time.
    pub time: Duration,
    /// The signals in the order in which they were asked for; `None` of what the device did not send in this cycle.
    pub values: Vec<Option<f64>>,
}

/// The cycles since the last time that a [`Recorder`] was read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RecordedCycles {
    /// The oldest first.
    pub cycles: Vec<RecordedValues>,
    /// How many are missing, since they were overwritten before they were read.
    pub lost: u64,
}

/// Shows the values of every cycle. Made by [`Network::recorder`](crate::Network::recorder).
///
/// It reads what the bus thread keeps in any case: the last thousand cycles. So it costs the cycle nothing, however many signals and
/// recorders there are, and a program that reads at least every half second at cycles of 1 ms loses none.
#[derive(Debug)]
pub struct Recorder {
    ring: Arc<CycleRing>,
    signals: Vec<RecordedSignal>,
    sources: Vec<SignalSource>,
    /// The next place of the ring to be read.
    next: u64,
    /// The number of the cycle that was read last.
    last: Option<u64>,
}

impl Recorder {
    pub(in crate::bus) fn new(
        ring: Arc<CycleRing>,
        signals: Vec<(RecordedSignal, SignalSource)>,
    ) -> Self {
        let next = ring.written();
        let (signals, sources) = signals.into_iter().unzip();
        Self {
            ring,
            signals,
            sources,
            next,
            last: None,
        }
    }

    /// The signals, in the order of their values.
    #[must_use]
    pub fn signals(&self) -> &[RecordedSignal] {
        &self.signals
    }

    /// The cycles since the last time, or since the recorder was made; none when there is nothing new yet. `None` once the network
    /// has ended and all was read. Does not wait.
    pub fn read(&mut self) -> Option<RecordedCycles> {
        let is_over = self.ring.is_over();
        let mut read = RecordedCycles::default();
        loop {
            let found = self.ring.look(self.next, |record| self.values(record));
            match found {
                RingLook::Record(values) => {
                    if let Some(last) = self.last {
                        read.lost += values.number.saturating_sub(last.saturating_add(1));
                    }
                    self.last = Some(values.number);
                    read.cycles.push(values);
                }
                RingLook::LeftOut => {}
                RingLook::Overwritten => {
                    self.next = self.ring.not_soon_overwritten();
                    continue;
                }
                RingLook::NotYet => break,
            }
            self.next += 1;
        }
        let is_empty = read.cycles.is_empty() && self.next >= self.ring.written();
        (!(is_over && is_empty)).then_some(read)
    }

    fn values(&self, record: &CycleRecord) -> RecordedValues {
        let values = self.sources.iter().map(|source| self.value(record, source));
        RecordedValues {
            number: record.number,
            time: record.time,
            values: values.collect(),
        }
    }

    fn value(&self, record: &CycleRecord, source: &SignalSource) -> Option<f64> {
        match source {
            SignalSource::Lateness => Some(record.late.as_secs_f64() * 1e6),
            SignalSource::State { device, place } => {
                let inputs = self.ring.device(record, *device)?.inputs?;
                state_number(
                    Statusword::from_bits_retain(u16::try_from(place.read(inputs)?).ok()?).state(),
                )
            }
            SignalSource::Value {
                device,
                is_input,
                place,
                data_type,
                scaled,
                scale,
            } => {
                let device = self.ring.device(record, *device)?;
                let bytes = if *is_input {
                    device.inputs
                } else {
                    device.outputs
                }?;
                let raw = number(place.read(bytes)?, *place, *data_type);
                let scale = scale.scale();
                Some(match scaled {
                    ObjectUnit::Position => scale.position_of(raw),
                    ObjectUnit::Velocity => scale.velocity_of(raw),
                    ObjectUnit::Acceleration => scale.acceleration_of(u32::try_from(raw).ok()?),
                    _ => raw as f64,
                })
            }
        }
    }
}

/// The number that these bits are.
const fn number(bits: u64, place: BitRange, data_type: DataType) -> i64 {
    let is_signed = matches!(data_type, DataType::I8 | DataType::I16 | DataType::I32);
    if is_signed && place.bits > 0 && place.bits < 64 {
        let unused = 64 - place.bits as u32;
        return ((bits << unused) as i64) >> unused;
    }
    bits as i64
}

/// A state as a [`Signal::State`] has it.
fn state_number(state: State) -> Option<f64> {
    let position = STATES.iter().position(|listed| *listed == state)?;
    Some(position as f64)
}

/// When a [`Capture`] begins to be complete: in the first cycle in which this holds after one in which it did not.
///
/// As text: `x.velocity > 100`, `x.following_error < -0.5`, `x.state == Fault`, `x.statusword & 2000h`.
///
/// ```
/// use servocrab::bus::{Trigger, TriggerCondition};
/// let trigger = Trigger {
///     signal: "x.velocity".parse()?,
///     condition: TriggerCondition::Above(100.0),
/// };
/// assert_eq!("x.velocity > 100".parse(), Ok(trigger));
/// # Ok::<(), servocrab::bus::NoSignal>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Trigger {
    /// The signal.
    pub signal: Signal,
    /// What it is compared with.
    pub condition: TriggerCondition,
}

/// What the value of a [`Trigger`]'s signal has to be.
///
/// ```
/// use servocrab::bus::{Capture, TriggerCondition};
/// // Bit 13 of the first recorded signal, a statusword; a hundred cycles before it and after it.
/// let capture = Capture::new(0, TriggerCondition::AnyBit(0x2000), 100, 100);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum TriggerCondition {
    /// More than this.
    Above(f64),
    /// Less than this.
    Below(f64),
    /// This.
    Equal(f64),
    /// One of these bits is set.
    AnyBit(u32),
}

impl TriggerCondition {
    fn holds(self, value: f64) -> bool {
        match self {
            Self::Above(level) => value > level,
            Self::Below(level) => value < level,
            #[expect(
                clippy::float_cmp,
                reason = "numbers of whole counts and states are exact"
            )]
            Self::Equal(level) => value == level,
            Self::AnyBit(mask) => (value as i64) & i64::from(mask) != 0,
        }
    }
}

impl FromStr for Trigger {
    type Err = NoSignal;

    fn from_str(text: &str) -> Result<Self, NoSignal> {
        let error = || NoSignal {
            text: text.to_owned(),
            expected: "a trigger is a signal and what it is compared with: `x.velocity > 100`, `x.position < 0`, \
                       `x.state == Fault`, `x.statusword & 2000h`",
        };
        let (at, operator) = ["==", ">", "<", "&"]
            .into_iter()
            .find_map(|operator| Some((text.find(operator)?, operator)))
            .ok_or_else(error)?;
        let (signal, level) = (
            text.get(..at).unwrap_or_default().parse()?,
            text.get(at + operator.len()..).unwrap_or_default().trim(),
        );
        let condition = match operator {
            "&" => TriggerCondition::AnyBit(word(level).ok_or_else(error)?),
            "==" if matches!(signal, Signal::State { .. }) => {
                let state = STATES.iter().find(|state| format!("{state:?}") == level);
                let number = state.and_then(|state| state_number(*state));
                TriggerCondition::Equal(number.or(level.parse().ok()).ok_or_else(error)?)
            }
            operator => {
                let level = level.parse().ok().or(word(level).map(f64::from));
                let level = level.filter(|level| level.is_finite()).ok_or_else(error)?;
                match operator {
                    ">" => TriggerCondition::Above(level),
                    "<" => TriggerCondition::Below(level),
                    _ => TriggerCondition::Equal(level),
                }
            }
        };
        Ok(Self { signal, condition })
    }
}

/// The states in the order of their numbers.
const STATES: [State; 8] = [
    State::NotReadyToSwitchOn,
    State::SwitchOnDisabled,
    State::ReadyToSwitchOn,
    State::SwitchedOn,
    State::OperationEnabled,
    State::QuickStopActive,
    State::FaultReactionActive,
    State::Fault,
];

/// A number in hexadecimal, with its mark, or in decimal.
fn word(text: &str) -> Option<u32> {
    let digits = text
        .strip_suffix(['h', 'H'])
        .or_else(|| text.strip_prefix("0x"));
    match digits {
        Some(digits) if digits.bytes().all(|digit| digit.is_ascii_hexdigit()) => {
            u32::from_str_radix(digits, 16).ok()
        }
        Some(_) => None,
        None => text.parse().ok(),
    }
}

/// Keeps cycles before and after a [`Trigger`].
///
/// ```
/// # use std::time::Duration;
/// use servocrab::bus::{Capture, RecordedCycles, RecordedValues, TriggerCondition};
/// let cycle = |number: u64, value: f64| RecordedValues {
///     number,
///     time: Duration::from_millis(number),
///     values: vec![Some(value)],
/// };
/// // One cycle before the first value rises above 5, and one after.
/// let mut capture = Capture::new(0, TriggerCondition::Above(5.0), 1, 1);
/// let first = RecordedCycles { cycles: vec![cycle(1, 0.0), cycle(2, 0.0), cycle(3, 9.0)], lost: 0 };
/// assert!(capture.take_in(first).is_none());
/// let then = RecordedCycles { cycles: vec![cycle(4, 9.0), cycle(5, 9.0)], lost: 0 };
/// let captured = capture.take_in(then).ok_or("the trigger has come")?;
/// let numbers: Vec<u64> = captured.cycles.iter().map(|cycle| cycle.number).collect();
/// assert_eq!(numbers, [2, 3, 4]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Capture {
    column: usize,
    condition: TriggerCondition,
    before: usize,
    after: usize,
    kept: VecDeque<RecordedValues>,
    /// Whether the condition held in the last cycle that had a value.
    held: Option<bool>,
    /// How many cycles are still to come, after the trigger.
    to_come: Option<usize>,
    lost: u64,
}

impl Capture {
    /// Waits for this condition of the signal that is in this column, counted from 0, and keeps so many cycles before it and after it.
    #[must_use]
    pub const fn new(
        column: usize,
        condition: TriggerCondition,
        before: usize,
        after: usize,
    ) -> Self {
        Self {
            column,
            condition,
            before,
            after,
            kept: VecDeque::new(),
            held: None,
            to_come: None,
            lost: 0,
        }
    }

    /// Takes in what a recorder has read. Gives the cycles around the trigger once they are complete, and then waits for the next one.
    pub fn take_in(&mut self, read: RecordedCycles) -> Option<RecordedCycles> {
        let mut complete = None;
        self.lost = self.lost.saturating_add(read.lost);
        for cycle in read.cycles {
            let value = cycle.values.get(self.column).copied().flatten();
            let holds = value.map(|value| self.condition.holds(value));
            let begins = holds == Some(true) && self.held == Some(false);
            self.held = holds.or(self.held);
            self.kept.push_back(cycle);
            if let Some(left) = &mut self.to_come {
                *left = left.saturating_sub(1);
            } else if begins && complete.is_none() {
                self.to_come = Some(self.after);
            } else if self.kept.len() > self.before {
                self.kept.pop_front();
            }
            if self.to_come == Some(0) {
                self.to_come = None;
                complete = Some(RecordedCycles {
                    cycles: self.kept.drain(..).collect(),
                    lost: core::mem::take(&mut self.lost),
                });
            }
        }
        complete
    }
}

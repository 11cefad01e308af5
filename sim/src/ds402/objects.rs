//! The drive profile objects of one axis: what exists, how it may be accessed, and the stored values.

use super::behaviour::Behaviour;

/// A basic data type of CiA 301.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DataType {
    /// INTEGER8
    I8,
    /// UNSIGNED8
    U8,
    /// INTEGER16
    I16,
    /// UNSIGNED16
    U16,
    /// INTEGER32
    I32,
    /// UNSIGNED32
    U32,
}

impl DataType {
    /// Length in bytes.
    pub fn size(self) -> usize {
        match self {
            DataType::I8 | DataType::U8 => 1,
            DataType::I16 | DataType::U16 => 2,
            DataType::I32 | DataType::U32 => 4,
        }
    }

    /// Whether the value fits.
    fn holds(self, value: i64) -> bool {
        match self {
            DataType::I8 => i8::try_from(value).is_ok(),
            DataType::U8 => u8::try_from(value).is_ok(),
            DataType::I16 => i16::try_from(value).is_ok(),
            DataType::U16 => u16::try_from(value).is_ok(),
            DataType::I32 => i32::try_from(value).is_ok(),
            DataType::U32 => u32::try_from(value).is_ok(),
        }
    }
}

/// Access by SDO.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Can only be read.
    ReadOnly,
    /// Can be read and written.
    ReadWrite,
}

/// The PDOs into which an object can be mapped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mapping {
    /// None.
    None,
    /// RxPDOs: what the master writes.
    Rx,
    /// TxPDOs: what the master reads.
    Tx,
    /// Both.
    Both,
}

/// One entry of the object dictionary of axis 1; axis n adds 800h for each axis before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// Index, as for axis 1.
    pub index: u16,
    /// Subindex.
    pub subindex: u8,
    /// Data type.
    pub kind: DataType,
    /// Access by SDO.
    pub access: Access,
    /// PDO mapping.
    pub mapping: Mapping,
    /// The object's name.
    pub name: &'static str,
}

/// Why a value was not stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SetError {
    /// No such object or subindex.
    #[error("object does not exist")]
    Unknown,
    /// The object can only be read.
    #[error("object is read-only")]
    ReadOnly,
    /// The value is outside the object's range.
    #[error("value is out of range")]
    OutOfRange,
}

/// The address of an entry: index and subindex.
pub(super) type Address = (u16, u8);

pub(super) const ABORT_CONNECTION_OPTION: Address = (0x6007, 0);
pub(super) const ERROR_CODE: Address = (0x603F, 0);
pub(super) const CONTROLWORD: Address = (0x6040, 0);
pub(super) const STATUSWORD: Address = (0x6041, 0);
pub(super) const QUICK_STOP_OPTION: Address = (0x605A, 0);
pub(super) const SHUTDOWN_OPTION: Address = (0x605B, 0);
pub(super) const DISABLE_OPERATION_OPTION: Address = (0x605C, 0);
pub(super) const HALT_OPTION: Address = (0x605D, 0);
pub(super) const FAULT_REACTION_OPTION: Address = (0x605E, 0);
pub(super) const MODE: Address = (0x6060, 0);
pub(super) const MODE_DISPLAY: Address = (0x6061, 0);
pub(super) const POSITION_DEMAND: Address = (0x6062, 0);
pub(super) const POSITION_INTERNAL: Address = (0x6063, 0);
pub(super) const POSITION_ACTUAL: Address = (0x6064, 0);
pub(super) const FOLLOWING_WINDOW: Address = (0x6065, 0);
pub(super) const FOLLOWING_TIMEOUT: Address = (0x6066, 0);
pub(super) const POSITION_WINDOW: Address = (0x6067, 0);
pub(super) const POSITION_WINDOW_TIME: Address = (0x6068, 0);
pub(super) const VELOCITY_DEMAND: Address = (0x606B, 0);
pub(super) const VELOCITY_ACTUAL: Address = (0x606C, 0);
pub(super) const TARGET_POSITION: Address = (0x607A, 0);
pub(super) const HOME_OFFSET: Address = (0x607C, 0);
pub(super) const LIMIT_MIN: Address = (0x607D, 1);
pub(super) const LIMIT_MAX: Address = (0x607D, 2);
pub(super) const MAX_PROFILE_VELOCITY: Address = (0x607F, 0);
pub(super) const PROFILE_VELOCITY: Address = (0x6081, 0);
pub(super) const END_VELOCITY: Address = (0x6082, 0);
pub(super) const PROFILE_ACCELERATION: Address = (0x6083, 0);
pub(super) const PROFILE_DECELERATION: Address = (0x6084, 0);
pub(super) const QUICK_STOP_DECELERATION: Address = (0x6085, 0);
pub(super) const PROFILE_TYPE: Address = (0x6086, 0);
pub(super) const ENCODER_INCREMENTS: Address = (0x608F, 1);
pub(super) const ENCODER_REVOLUTIONS: Address = (0x608F, 2);
pub(super) const GEAR_MOTOR: Address = (0x6091, 1);
pub(super) const GEAR_SHAFT: Address = (0x6091, 2);
pub(super) const FEED: Address = (0x6092, 1);
pub(super) const FEED_SHAFT: Address = (0x6092, 2);
pub(super) const MAX_ACCELERATION: Address = (0x60C5, 0);
pub(super) const MAX_DECELERATION: Address = (0x60C6, 0);
pub(super) const POSITIONING_OPTION: Address = (0x60F2, 0);
pub(super) const FOLLOWING_ERROR_ACTUAL: Address = (0x60F4, 0);
pub(super) const DIGITAL_INPUTS: Address = (0x60FD, 0);
pub(super) const DIGITAL_OUTPUTS: Address = (0x60FE, 1);
pub(super) const DIGITAL_OUTPUT_MASK: Address = (0x60FE, 2);
pub(super) const SUPPORTED_MODES: Address = (0x6502, 0);

/// The stored values, one for each entry of [`ENTRIES`].
#[derive(Debug, Clone)]
pub(super) struct Objects {
    values: [i64; ENTRIES.len()],
    profile_types: &'static [i16],
}

impl Objects {
    pub(super) fn new(behaviour: &Behaviour) -> Objects {
        let mut values = [0; ENTRIES.len()];
        for (value, entry) in values.iter_mut().zip(&ENTRIES) {
            *value = default_of((entry.index, entry.subindex));
        }
        let mut objects = Objects {
            values,
            profile_types: behaviour.profile_types,
        };
        objects.put(SUPPORTED_MODES, behaviour.supported_modes.into());
        objects.put(QUICK_STOP_OPTION, behaviour.quick_stop_option.into());
        objects.put(
            ABORT_CONNECTION_OPTION,
            behaviour.abort_connection_option.into(),
        );
        objects
    }

    pub(super) fn get(&self, address: Address) -> Option<i64> {
        self.values.get(slot_of(address)?).copied()
    }

    /// The value of an object that exists; 0 for one that does not.
    pub(super) fn value(&self, address: Address) -> i64 {
        self.get(address).unwrap_or(0)
    }

    /// Stores a value of the drive's own, without checks.
    pub(super) fn put(&mut self, address: Address, value: i64) {
        if let Some(stored) = slot_of(address).and_then(|slot| self.values.get_mut(slot)) {
            *stored = value;
        }
    }

    /// Stores a value from outside.
    pub(super) fn set(&mut self, address: Address, value: i64) -> Result<(), SetError> {
        let slot = slot_of(address).ok_or(SetError::Unknown)?;
        let entry = ENTRIES.get(slot).ok_or(SetError::Unknown)?;
        if entry.access == Access::ReadOnly {
            return Err(SetError::ReadOnly);
        }
        if !entry.kind.holds(value) || !self.accepts(address, value) {
            return Err(SetError::OutOfRange);
        }
        self.put(address, value);
        Ok(())
    }

    /// The ranges that are narrower than the type (DSP 402 v2, option codes; 60F2h: what this drive implements).
    fn accepts(&self, address: Address, value: i64) -> bool {
        match address {
            ABORT_CONNECTION_OPTION => (0..=3).contains(&value),
            QUICK_STOP_OPTION => (0..=8).contains(&value),
            SHUTDOWN_OPTION | DISABLE_OPERATION_OPTION => (0..=1).contains(&value),
            HALT_OPTION | FAULT_REACTION_OPTION => (0..=4).contains(&value),
            PROFILE_TYPE => self
                .profile_types
                .iter()
                .any(|&kind| i64::from(kind) == value),
            POSITIONING_OPTION => (0..=2).contains(&value),
            ENCODER_INCREMENTS | ENCODER_REVOLUTIONS | GEAR_MOTOR | GEAR_SHAFT | FEED
            | FEED_SHAFT => value > 0,
            _ => true,
        }
    }
}

/// One turn of the assumed encoder, in counts.
const TURN: i64 = 1 << 20;

/// Values at power-up. Where DSP 402 v2 names a default it is taken; ramps and velocities are one turn per second and
/// more, so that a drive that nobody configured still moves.
fn default_of(address: Address) -> i64 {
    match address {
        (0x607D | 0x608F | 0x6091 | 0x6092 | 0x60FE, 0)
        | QUICK_STOP_OPTION
        | FAULT_REACTION_OPTION => 2,
        DISABLE_OPERATION_OPTION
        | HALT_OPTION
        | ENCODER_REVOLUTIONS
        | GEAR_MOTOR
        | GEAR_SHAFT
        | FEED_SHAFT => 1,
        FOLLOWING_TIMEOUT | POSITION_WINDOW => 10,
        MAX_PROFILE_VELOCITY | MAX_ACCELERATION | MAX_DECELERATION => 0xFFFF_FFFF,
        FOLLOWING_WINDOW | PROFILE_VELOCITY | ENCODER_INCREMENTS | FEED => TURN,
        PROFILE_ACCELERATION | PROFILE_DECELERATION => 10 * TURN,
        QUICK_STOP_DECELERATION => 20 * TURN,
        _ => 0,
    }
}

fn slot_of(address: Address) -> Option<usize> {
    ENTRIES
        .binary_search_by_key(&address, |entry| (entry.index, entry.subindex))
        .ok()
}

const fn entry(
    address: Address,
    kind: DataType,
    access: Access,
    mapping: Mapping,
    name: &'static str,
) -> Entry {
    Entry {
        index: address.0,
        subindex: address.1,
        kind,
        access,
        mapping,
        name,
    }
}

use Access::{ReadOnly as Ro, ReadWrite as Rw};
use DataType::{I8, I16, I32, U8, U16, U32};
use Mapping::{Both, None as No, Rx, Tx};

/// All entries, by index and subindex. 605Ah is mappable because the AKD2G lists it among its PDO data.
pub(super) static ENTRIES: [Entry; 50] = [
    entry(
        ABORT_CONNECTION_OPTION,
        I16,
        Rw,
        Rx,
        "Abort connection option code",
    ),
    entry(ERROR_CODE, U16, Ro, Tx, "Error code"),
    entry(CONTROLWORD, U16, Rw, Rx, "Controlword"),
    entry(STATUSWORD, U16, Ro, Tx, "Statusword"),
    entry(QUICK_STOP_OPTION, I16, Rw, Both, "Quick stop option code"),
    entry(SHUTDOWN_OPTION, I16, Rw, No, "Shutdown option code"),
    entry(
        DISABLE_OPERATION_OPTION,
        I16,
        Rw,
        No,
        "Disable operation option code",
    ),
    entry(HALT_OPTION, I16, Rw, No, "Halt option code"),
    entry(
        FAULT_REACTION_OPTION,
        I16,
        Rw,
        No,
        "Fault reaction option code",
    ),
    entry(MODE, I8, Rw, Rx, "Modes of operation"),
    entry(MODE_DISPLAY, I8, Ro, Tx, "Modes of operation display"),
    entry(POSITION_DEMAND, I32, Ro, Tx, "Position demand value"),
    entry(
        POSITION_INTERNAL,
        I32,
        Ro,
        Tx,
        "Position actual internal value",
    ),
    entry(POSITION_ACTUAL, I32, Ro, Tx, "Position actual value"),
    entry(FOLLOWING_WINDOW, U32, Rw, Rx, "Following error window"),
    entry(FOLLOWING_TIMEOUT, U16, Rw, Rx, "Following error time out"),
    entry(POSITION_WINDOW, U32, Rw, Rx, "Position window"),
    entry(POSITION_WINDOW_TIME, U16, Rw, Rx, "Position window time"),
    entry(VELOCITY_DEMAND, I32, Ro, Tx, "Velocity demand value"),
    entry(VELOCITY_ACTUAL, I32, Ro, Tx, "Velocity actual value"),
    entry(TARGET_POSITION, I32, Rw, Rx, "Target position"),
    entry(HOME_OFFSET, I32, Rw, Rx, "Home offset"),
    entry((0x607D, 0), U8, Ro, No, "Software position limit"),
    entry(LIMIT_MIN, I32, Rw, Rx, "Min position limit"),
    entry(LIMIT_MAX, I32, Rw, Rx, "Max position limit"),
    entry(MAX_PROFILE_VELOCITY, U32, Rw, Rx, "Max profile velocity"),
    entry(PROFILE_VELOCITY, U32, Rw, Rx, "Profile velocity"),
    entry(END_VELOCITY, U32, Rw, Rx, "End velocity"),
    entry(PROFILE_ACCELERATION, U32, Rw, Rx, "Profile acceleration"),
    entry(PROFILE_DECELERATION, U32, Rw, Rx, "Profile deceleration"),
    entry(
        QUICK_STOP_DECELERATION,
        U32,
        Rw,
        Rx,
        "Quick stop deceleration",
    ),
    entry(PROFILE_TYPE, I16, Rw, Rx, "Motion profile type"),
    entry((0x608F, 0), U8, Ro, No, "Position encoder resolution"),
    entry(ENCODER_INCREMENTS, U32, Rw, No, "Encoder increments"),
    entry(ENCODER_REVOLUTIONS, U32, Rw, No, "Motor revolutions"),
    entry((0x6091, 0), U8, Ro, No, "Gear ratio"),
    entry(GEAR_MOTOR, U32, Rw, No, "Motor revolutions"),
    entry(GEAR_SHAFT, U32, Rw, No, "Shaft revolutions"),
    entry((0x6092, 0), U8, Ro, No, "Feed constant"),
    entry(FEED, U32, Rw, No, "Feed"),
    entry(FEED_SHAFT, U32, Rw, No, "Shaft revolutions"),
    entry(MAX_ACCELERATION, U32, Rw, Rx, "Max acceleration"),
    entry(MAX_DECELERATION, U32, Rw, Rx, "Max deceleration"),
    entry(POSITIONING_OPTION, U16, Rw, Rx, "Positioning option code"),
    entry(
        FOLLOWING_ERROR_ACTUAL,
        I32,
        Ro,
        Tx,
        "Following error actual value",
    ),
    entry(DIGITAL_INPUTS, U32, Ro, Tx, "Digital inputs"),
    entry((0x60FE, 0), U8, Ro, No, "Digital outputs"),
    entry(DIGITAL_OUTPUTS, U32, Rw, Rx, "Physical outputs"),
    entry(DIGITAL_OUTPUT_MASK, U32, Rw, Rx, "Bit mask"),
    entry(SUPPORTED_MODES, U32, Ro, Tx, "Supported drive modes"),
];

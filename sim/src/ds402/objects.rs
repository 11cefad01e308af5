//! The drive profile objects of one axis: what one is, and the values that the axis stores.

use std::sync::Arc;

use super::behaviour::Behaviour;
use super::entries::ENTRIES;
use super::positioning::Positioning;

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

    /// Lowest and highest value.
    const fn range(self) -> (i64, i64) {
        match self {
            DataType::I8 => (i8::MIN as i64, i8::MAX as i64),
            DataType::U8 => (0, u8::MAX as i64),
            DataType::I16 => (i16::MIN as i64, i16::MAX as i64),
            DataType::U16 => (0, u16::MAX as i64),
            DataType::I32 => (i32::MIN as i64, i32::MAX as i64),
            DataType::U32 => (0, u32::MAX as i64),
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
    /// Value at power-up, where none was saved.
    pub default: i64,
    /// Lowest value that it takes.
    pub min: i64,
    /// Highest value that it takes.
    pub max: i64,
    /// Its value outlives a power failure once 1010h has saved it.
    pub saved: bool,
}

impl Entry {
    /// An entry that is 0 at power-up, takes every value of its type and is not saved.
    pub const fn new(
        address: (u16, u8),
        kind: DataType,
        access: Access,
        mapping: Mapping,
        name: &'static str,
    ) -> Entry {
        let (min, max) = kind.range();
        Entry {
            index: address.0,
            subindex: address.1,
            kind,
            access,
            mapping,
            name,
            default: 0,
            min,
            max,
            saved: false,
        }
    }

    /// Subindex 0 of a record or array: how many entries follow.
    pub const fn count(index: u16, entries: i64, name: &'static str) -> Entry {
        Entry::new(
            (index, 0),
            DataType::U8,
            Access::ReadOnly,
            Mapping::None,
            name,
        )
        .default(entries)
    }

    /// The same entry with a value at power-up.
    #[must_use]
    pub const fn default(mut self, value: i64) -> Entry {
        self.default = value;
        self
    }

    /// The same entry with a range that is narrower than its type.
    #[must_use]
    pub const fn range(mut self, min: i64, max: i64) -> Entry {
        self.min = min;
        self.max = max;
        self
    }

    /// The same entry, saved by 1010h.
    #[must_use]
    pub const fn saved(mut self) -> Entry {
        self.saved = true;
        self
    }

    pub(super) fn address(&self) -> Address {
        (self.index, self.subindex)
    }
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

pub(super) const START_STOP_SPEED: Address = (0x2010, 0);
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
pub(super) const VELOCITY_WINDOW: Address = (0x606D, 0);
pub(super) const VELOCITY_WINDOW_TIME: Address = (0x606E, 0);
pub(super) const VELOCITY_THRESHOLD: Address = (0x606F, 0);
pub(super) const VELOCITY_THRESHOLD_TIME: Address = (0x6070, 0);
pub(super) const MAX_TORQUE: Address = (0x6072, 0);
pub(super) const TORQUE_ACTUAL: Address = (0x6077, 0);
pub(super) const TARGET_POSITION: Address = (0x607A, 0);
pub(super) const RANGE_MIN: Address = (0x607B, 1);
pub(super) const RANGE_MAX: Address = (0x607B, 2);
pub(super) const HOME_OFFSET: Address = (0x607C, 0);
pub(super) const LIMIT_MIN: Address = (0x607D, 1);
pub(super) const LIMIT_MAX: Address = (0x607D, 2);
pub(super) const POLARITY: Address = (0x607E, 0);
pub(super) const MAX_PROFILE_VELOCITY: Address = (0x607F, 0);
pub(super) const MAX_MOTOR_SPEED: Address = (0x6080, 0);
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
pub(super) const POSITION_NUMERATOR: Address = (0x6093, 1);
pub(super) const POSITION_DIVISOR: Address = (0x6093, 2);
pub(super) const VELOCITY_ENCODER_NUMERATOR: Address = (0x6094, 1);
pub(super) const VELOCITY_ENCODER_DIVISOR: Address = (0x6094, 2);
pub(super) const VELOCITY_NUMERATOR: Address = (0x6096, 1);
pub(super) const VELOCITY_DIVISOR: Address = (0x6096, 2);
pub(super) const ACCELERATION_NUMERATOR: Address = (0x6097, 1);
pub(super) const ACCELERATION_DIVISOR: Address = (0x6097, 2);
pub(super) const HOMING_METHOD: Address = (0x6098, 0);
pub(super) const HOMING_SPEED_SWITCH: Address = (0x6099, 1);
pub(super) const HOMING_SPEED_ZERO: Address = (0x6099, 2);
pub(super) const HOMING_ACCELERATION: Address = (0x609A, 0);
pub(super) const TOUCH_PROBE_FUNCTION: Address = (0x60B8, 0);
pub(super) const TOUCH_PROBE_STATUS: Address = (0x60B9, 0);
pub(super) const MAX_ACCELERATION: Address = (0x60C5, 0);
pub(super) const MAX_DECELERATION: Address = (0x60C6, 0);
pub(super) const POSITIVE_TORQUE_LIMIT: Address = (0x60E0, 0);
pub(super) const NEGATIVE_TORQUE_LIMIT: Address = (0x60E1, 0);
pub(super) const POSITIONING_OPTION: Address = (0x60F2, 0);
pub(super) const FOLLOWING_ERROR_ACTUAL: Address = (0x60F4, 0);
pub(super) const DIGITAL_INPUTS: Address = (0x60FD, 0);
pub(super) const DIGITAL_OUTPUTS: Address = (0x60FE, 1);
pub(super) const DIGITAL_OUTPUT_MASK: Address = (0x60FE, 2);
pub(super) const TARGET_VELOCITY: Address = (0x60FF, 0);
pub(super) const SUPPORTED_MODES: Address = (0x6502, 0);

/// The entries of one drive and their values.
#[derive(Debug, Clone)]
pub(super) struct Objects {
    entries: Arc<[Entry]>,
    /// Their addresses, close to each other: they are searched many times in a cycle.
    keys: Arc<[u32]>,
    values: Vec<i64>,
    profile_types: &'static [i16],
    /// What 6098h takes; none takes all of its type.
    homing_methods: Option<&'static [i8]>,
}

impl Objects {
    /// The general list without those that this drive lacks, its own added or put in place of the general ones.
    pub(super) fn new(behaviour: &Behaviour) -> Objects {
        let own = behaviour.own_objects;
        let is_own = |entry: &Entry| own.iter().any(|own| own.address() == entry.address());
        let mut entries: Vec<Entry> = ENTRIES
            .iter()
            .filter(|entry| !behaviour.without.contains(&entry.index) && !is_own(entry))
            .chain(own)
            .copied()
            .collect();
        // 6502h, bit 5: homing.
        if behaviour.supported_modes & 1 << 5 != 0 && !behaviour.without.contains(&0x60E3) {
            entries.extend(supported_homing_methods(behaviour.homing_methods));
        }
        entries.sort_by_key(Entry::address);
        let mut objects = Objects {
            keys: entries.iter().map(|entry| key(entry.address())).collect(),
            values: entries.iter().map(|entry| entry.default).collect(),
            entries: entries.into(),
            profile_types: behaviour.profile_types,
            homing_methods: behaviour
                .homing_method_refused_at_write
                .then_some(behaviour.homing_methods),
        };
        objects.put(SUPPORTED_MODES, behaviour.supported_modes.into());
        objects.put(QUICK_STOP_OPTION, behaviour.quick_stop_option.into());
        let (first, last) = behaviour.position_range;
        objects.put(RANGE_MIN, first.into());
        objects.put(RANGE_MAX, last.into());
        objects.put(
            ABORT_CONNECTION_OPTION,
            behaviour.abort_connection_option.into(),
        );
        objects
    }

    pub(super) fn entries(&self) -> &[Entry] {
        &self.entries
    }

    pub(super) fn get(&self, address: Address) -> Option<i64> {
        self.values.get(self.slot(address)?).copied()
    }

    /// The value of an object that exists; 0 for one that does not.
    pub(super) fn value(&self, address: Address) -> i64 {
        self.get(address).unwrap_or(0)
    }

    /// The value of an object that limits others; without it there is no such limit.
    pub(super) fn limit(&self, address: Address) -> i64 {
        self.get(address).unwrap_or(i64::MAX)
    }

    /// Stores a value of the drive's own, without checks.
    pub(super) fn put(&mut self, address: Address, value: i64) {
        if let Some(stored) = self
            .slot(address)
            .and_then(|slot| self.values.get_mut(slot))
        {
            *stored = value;
        }
    }

    /// Stores a value from outside.
    pub(super) fn set(&mut self, address: Address, value: i64) -> Result<(), SetError> {
        let entry = self
            .slot(address)
            .and_then(|slot| self.entries.get(slot))
            .ok_or(SetError::Unknown)?;
        if entry.access == Access::ReadOnly {
            return Err(SetError::ReadOnly);
        }
        if !(entry.min..=entry.max).contains(&value) || !self.accepts(address, value) {
            return Err(SetError::OutOfRange);
        }
        self.put(address, value);
        Ok(())
    }

    /// The values that outlive a power failure once they are saved.
    pub(super) fn to_save(&self) -> Vec<(Address, i64)> {
        let values = self.entries.iter().zip(&self.values);
        values
            .filter(|(entry, _)| entry.saved)
            .map(|(entry, value)| (entry.address(), *value))
            .collect()
    }

    /// Values of which not all in a range are known to the drive.
    fn accepts(&self, address: Address, value: i64) -> bool {
        match address {
            PROFILE_TYPE => self
                .profile_types
                .iter()
                .any(|&kind| i64::from(kind) == value),
            HOMING_METHOD => self
                .homing_methods
                .is_none_or(|methods| methods.iter().any(|&method| i64::from(method) == value)),
            POSITIONING_OPTION => Positioning::decode(value).is_some(),
            _ => true,
        }
    }

    fn slot(&self, address: Address) -> Option<usize> {
        self.keys.binary_search(&key(address)).ok()
    }
}

/// In the order of the addresses.
fn key((index, subindex): Address) -> u32 {
    u32::from(index) << 8 | u32::from(subindex)
}

/// 60E3h, the list of homing methods.
fn supported_homing_methods(methods: &[i8]) -> impl Iterator<Item = Entry> {
    let name = "Supported homing methods";
    let element = |(subindex, method): (u8, &i8)| {
        let entry = Entry::new(
            (0x60E3, subindex),
            DataType::I8,
            Access::ReadOnly,
            Mapping::None,
            name,
        );
        entry.default(i64::from(*method))
    };
    let count = i64::try_from(methods.len()).unwrap_or(0);
    core::iter::once(Entry::count(0x60E3, count, name)).chain((1..).zip(methods).map(element))
}

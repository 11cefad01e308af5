//! Typed objects of a drive's dictionary: index, subindex, type, access, unit and name as one value. A wrong width or a write to a
//! read-only object does not compile.

use core::fmt;
use core::marker::PhantomData;

use super::value::{Access, DataType, ReadWrite, Value};

/// An object of the dictionary with the type `T` of its value and its access `A`.
///
/// ```
/// use servocrab::coe::{Object, ReadWrite, ObjectUnit, obj};
///
/// // The constants of `obj` cover the standard's objects …
/// assert_eq!(obj::POSITION_WINDOW_TIME.to_string(), "6068h:00 position window time");
/// assert_eq!(obj::TARGET_POSITION.axis(2).index(), 0x687A);
/// // … and a manufacturer's own object is declared the same way.
/// const MIN_VELOCITY: Object<u16, ReadWrite> = Object::new(0x2010, 0, "min profile velocity").unit(ObjectUnit::Velocity);
/// assert_eq!(MIN_VELOCITY.index(), 0x2010);
/// ```
pub struct Object<T, A = ReadWrite> {
    index: u16,
    subindex: u8,
    name: &'static str,
    unit: ObjectUnit,
    mappable: Mappable,
    kind: PhantomData<fn() -> (T, A)>,
}

impl<T, A> Object<T, A> {
    /// An object without unit that cannot be mapped into a PDO; see [`Object::unit`], [`Object::mappable`].
    #[must_use]
    pub const fn new(index: u16, subindex: u8, name: &'static str) -> Self {
        Self {
            index,
            subindex,
            name,
            unit: ObjectUnit::None,
            mappable: Mappable::NO,
            kind: PhantomData,
        }
    }

    /// The same object with the unit of its value.
    #[must_use]
    pub const fn unit(mut self, unit: ObjectUnit) -> Self {
        self.unit = unit;
        self
    }

    /// The same object with the directions in which it may be mapped into a PDO.
    #[must_use]
    pub const fn mappable(mut self, mappable: Mappable) -> Self {
        self.mappable = mappable;
        self
    }

    /// The same object of axis `axis`, counted from 1 as in the drives' documents.
    ///
    /// Axis 1 (and 0) changes nothing; see [`AxisOffset::of_axis`] for the rule.
    #[must_use]
    pub const fn axis(self, axis: u8) -> Self {
        self.offset(AxisOffset::of_axis(axis))
    }

    /// The same object moved by the offsets of one axis of a drive.
    #[must_use]
    pub const fn offset(mut self, offset: AxisOffset) -> Self {
        self.index = offset.apply(self.index);
        self
    }

    /// The index.
    #[must_use]
    pub const fn index(&self) -> u16 {
        self.index
    }

    /// The subindex; 0 for an object that is a single variable.
    #[must_use]
    pub const fn subindex(&self) -> u8 {
        self.subindex
    }

    /// Index and subindex together.
    #[must_use]
    pub const fn address(&self) -> ObjectAddress {
        ObjectAddress::new(self.index, self.subindex)
    }

    /// The name, in the standard's words.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.name
    }

    /// The unit of the value.
    #[must_use]
    pub const fn value_unit(&self) -> ObjectUnit {
        self.unit
    }

    /// The directions in which the object may be mapped into a PDO.
    #[must_use]
    pub const fn mapping(&self) -> Mappable {
        self.mappable
    }
}

impl<T, A> Clone for Object<T, A> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T, A> Copy for Object<T, A> {}

impl<T, A> fmt::Debug for Object<T, A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Object({self})")
    }
}

impl<T, A> fmt::Display for Object<T, A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.address(), self.name)
    }
}

/// An object whose type is known at run time only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnyObject {
    /// The index.
    pub index: u16,
    /// The subindex.
    pub subindex: u8,
    /// The type of the value.
    pub data_type: DataType,
    /// Whether the value can be read.
    pub readable: bool,
    /// Whether the value can be written.
    pub writable: bool,
    /// The directions in which it may be mapped into a PDO.
    pub mappable: Mappable,
    /// The unit of the value.
    pub unit: ObjectUnit,
    /// The name.
    pub name: &'static str,
}

impl AnyObject {
    /// The length of the value in bits; 0 for a string, whose length varies.
    #[must_use]
    pub const fn bits(&self) -> u8 {
        self.data_type.bits()
    }

    /// Index and subindex together.
    #[must_use]
    pub const fn address(&self) -> ObjectAddress {
        ObjectAddress::new(self.index, self.subindex)
    }

    /// The same object moved by the offsets of one axis of a drive.
    #[must_use]
    pub const fn offset(mut self, offset: AxisOffset) -> Self {
        self.index = offset.apply(self.index);
        self
    }
}

impl<T: Value, A: Access> From<Object<T, A>> for AnyObject {
    fn from(object: Object<T, A>) -> Self {
        Self {
            index: object.index,
            subindex: object.subindex,
            data_type: T::DATA_TYPE,
            readable: A::READABLE,
            writable: A::WRITABLE,
            mappable: object.mappable,
            unit: object.unit,
            name: object.name,
        }
    }
}

/// Index and subindex of an object; shown as `6041h:00`.
///
/// ```
/// use servocrab::coe::ObjectAddress;
/// assert_eq!(ObjectAddress::new(0x6041, 0).to_string(), "6041h:00");
/// assert_eq!("607Bh:02".parse(), Ok(ObjectAddress::new(0x607B, 2)));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ObjectAddress {
    /// The index.
    pub index: u16,
    /// The subindex.
    pub subindex: u8,
}

impl ObjectAddress {
    /// The address of `index:subindex`.
    #[must_use]
    pub const fn new(index: u16, subindex: u8) -> Self {
        Self { index, subindex }
    }
}

/// A text that is no index and subindex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "an index and a subindex are expected, both in hexadecimal, such as 607Bh:02 or 0x607B:2; without a subindex 00 is meant"
)]
pub struct NoAddress;

/// Reads what is shown, `607Bh:02`, and the other ways to write it: `607bh:2`, `0x607B:02`; `6041h` and `0x6041` are subindex 0. A
/// number without a mark is none, since nothing says that it is hexadecimal.
impl core::str::FromStr for ObjectAddress {
    type Err = NoAddress;

    fn from_str(text: &str) -> Result<Self, NoAddress> {
        let (index, subindex) = text.split_once(':').unwrap_or((text, "0"));
        let index = index
            .strip_suffix(['h', 'H'])
            .or_else(|| index.strip_prefix("0x"))
            .or_else(|| index.strip_prefix("0X"))
            .ok_or(NoAddress)?;
        let number = |digits: &str, most: usize| {
            let good = (1..=most).contains(&digits.len())
                && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
            good.then(|| u16::from_str_radix(digits, 16).ok()).flatten()
        };
        let subindex = number(subindex, 2).and_then(|number| u8::try_from(number).ok());
        match (number(index, 4), subindex) {
            (Some(index), Some(subindex)) => Ok(Self::new(index, subindex)),
            _ => Err(NoAddress),
        }
    }
}

impl fmt::Display for ObjectAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}h:{:02X}", self.index, self.subindex)
    }
}

/// By how much the objects of one axis of a drive lie above those of its first axis.
///
/// Objects 6000h–67FFh move by `profile`, 5000h–50FFh by `manufacturer`; all others belong to the whole
/// device and stay. (Kollmorgen AKD2G, Profile Position Mode: 6040h/6840h, 5000h/5100h.)
///
/// ```
/// use servocrab::coe::AxisOffset;
/// assert_eq!(AxisOffset::of_axis(2).apply(0x6040), 0x6840);
/// assert_eq!(AxisOffset::of_axis(2).apply(0x1C12), 0x1C12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AxisOffset {
    /// Added to indices 6000h to 67FFh.
    pub profile: u16,
    /// Added to indices 5000h to 50FFh.
    pub manufacturer: u16,
}

impl AxisOffset {
    /// Distance of two axes in the profile area.
    pub const PROFILE_STEP: u16 = 0x0800;
    /// Distance of two axes in the 5000h area of the AKD2G.
    pub const MANUFACTURER_STEP: u16 = 0x0100;

    /// The offsets of axis `axis`, counted from 1: 0800h and 0100h for each axis before it.
    ///
    /// The profile has room for eight axes; a higher number counts as the eighth, 0 as the first.
    #[must_use]
    pub const fn of_axis(axis: u8) -> Self {
        let before = match axis {
            0 | 1 => 0,
            2..=8 => axis as u16 - 1,
            _ => 7,
        };
        Self {
            profile: Self::PROFILE_STEP * before,
            manufacturer: Self::MANUFACTURER_STEP * before,
        }
    }

    /// `index` of the first axis, moved to this axis.
    #[must_use]
    pub const fn apply(&self, index: u16) -> u16 {
        match index {
            0x6000..=0x67FF => index.wrapping_add(self.profile),
            0x5000..=0x50FF => index.wrapping_add(self.manufacturer),
            _ => index,
        }
    }
}

/// The directions in which an object may be mapped, seen from the master.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Mappable {
    /// May be mapped into an RxPDO: the master writes it.
    pub outputs: bool,
    /// May be mapped into a TxPDO: the master reads it.
    pub inputs: bool,
}

impl Mappable {
    /// Reached by SDO alone.
    pub const NO: Self = Self {
        outputs: false,
        inputs: false,
    };
    /// Mappable into RxPDOs.
    pub const OUTPUTS: Self = Self {
        outputs: true,
        inputs: false,
    };
    /// Mappable into TxPDOs.
    pub const INPUTS: Self = Self {
        outputs: false,
        inputs: true,
    };
    /// Mappable both ways.
    pub const BOTH: Self = Self {
        outputs: true,
        inputs: true,
    };
}

/// The unit of an object's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ObjectUnit {
    /// None: a word of bits, a code, a ratio.
    #[default]
    None,
    /// Position units, as the drive's scaling sets them.
    Position,
    /// Encoder increments.
    Increments,
    /// Velocity units, as the drive's scaling sets them.
    Velocity,
    /// Acceleration units, as the drive's scaling sets them.
    Acceleration,
    /// Milliseconds.
    Milliseconds,
    /// Nanoseconds.
    Nanoseconds,
    /// Revolutions.
    Revolutions,
    /// Increments per second.
    IncrementsPerSecond,
    /// Revolutions per second.
    RevolutionsPerSecond,
    /// Revolutions per minute.
    RevolutionsPerMinute,
    /// Jerk units, as the drive's scaling sets them.
    Jerk,
    /// Thousandths of the motor's rated torque 6076h.
    ThousandthsOfRatedTorque,
    /// Thousandths of the motor's rated current 6075h.
    ThousandthsOfRatedCurrent,
    /// Milliamperes.
    Milliamperes,
    /// Thousandths of a newton metre.
    MillinewtonMetres,
    /// Millivolts.
    Millivolts,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::obj;
    use alloc::string::ToString;

    #[test]
    fn the_position_window_time_is_sixteen_bits_wide() {
        // Pitfall 34; the width is in object_6068 of the list of related objects of the 2010h drive.
        let any = AnyObject::from(obj::POSITION_WINDOW_TIME);
        assert_eq!((any.index, any.bits()), (0x6068, 16));
        assert_eq!(10u16.encode(), [10, 0]);
    }

    #[test]
    fn objects_of_the_second_axis_lie_0800h_and_0100h_higher() {
        // Pitfall 36; AKD2G, Profile Position Mode: 6041h/6841h, 605Ah/685Ah, 5000h/5100h.
        assert_eq!(obj::STATUSWORD.axis(2).index(), 0x6841);
        assert_eq!(obj::QUICK_STOP_OPTION.axis(2).index(), 0x685A);
        let motion_status = obj::AKD2G_MOTION_STATUS.axis(2);
        assert_eq!(motion_status.address(), ObjectAddress::new(0x5100, 4));
        assert_eq!(
            obj::STATUSWORD.axis(8).index(),
            0x9841,
            "eight axes reach to 9FFFh"
        );
    }

    #[test]
    fn the_first_axis_and_objects_of_the_device_do_not_move() {
        assert_eq!(obj::STATUSWORD.axis(1).index(), 0x6041);
        assert_eq!(obj::VENDOR_ID.axis(2).index(), 0x1018);
        assert_eq!(obj::MIN_PROFILE_VELOCITY.axis(2).index(), 0x2010);
    }

    #[test]
    fn an_address_is_read_in_each_way_that_it_is_written() {
        for (text, index, subindex) in [
            ("6081h", 0x6081, 0),
            ("0x6081", 0x6081, 0),
            ("607Bh:02", 0x607B, 2),
            ("607bh:2", 0x607B, 2),
            ("0x1018:1", 0x1018, 1),
            ("0X1018:0A", 0x1018, 0x0A),
        ] {
            assert_eq!(
                text.parse(),
                Ok(ObjectAddress::new(index, subindex)),
                "{text}"
            );
        }
        let wrong = [
            "",
            "6081",
            "h",
            "0x",
            "0x6081h",
            "16081h",
            "6081h:",
            "6081h:100",
            "60g1h",
            "6081h:+1",
            "-6081h",
        ];
        for text in wrong {
            assert_eq!(text.parse::<ObjectAddress>(), Err(NoAddress), "{text}");
        }
    }

    #[test]
    fn an_object_shows_its_address_and_name() {
        assert_eq!(
            obj::AKD2G_MOTION_STATUS.to_string(),
            "5000h:04 AXIS#.MOTIONSTAT"
        );
    }
}

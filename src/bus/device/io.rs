//! Devices of the line that are no drives: what they send and take, by name and typed.

use std::{fmt, marker::PhantomData, sync::Arc};

use crate::{
    axis::{Sampled, Stale},
    bus::{
        device::{
            io_cell::Head,
            io_points::{IoPoint, PointName},
            io_port::Shared,
        },
        expected::Expected,
    },
    coe::{DataType, DriveId, Number},
    parameters::{StartUpLines, StartUpList},
    pdo_map::{BitRange, Direction},
};

/// A device of the line whose process data the program uses: an I/O terminal, a valve island, a sensor.
///
/// ```
/// use servocrab::{Network, bus::{Expected, IoConfig}};
/// let builder = Network::builder()
///     .io(1, IoConfig::new("buttons", Expected::new(0x2, 0x03F0_3052).named("EL1008")))
///     .io(2, IoConfig::new("valves", Expected::new(0x2, 0x07D8_3052).named("EL2008")));
/// ```
#[derive(Debug, Clone)]
pub struct IoConfig {
    pub(in crate::bus) name: String,
    pub(in crate::bus) expected: Expected,
    pub(in crate::bus) start_up: Vec<StartUpList>,
}

impl IoConfig {
    /// The device that is called `name` in the program, and what it must be.
    ///
    /// Its process data are those of its PDO assignment, which is read from it, if it has CoE; else those that its SII assigns.
    /// Outputs are 0 until they are set.
    #[must_use]
    pub fn new(name: &str, expected: Expected) -> Self {
        Self {
            name: name.to_owned(),
            expected,
            start_up: Vec::new(),
        }
    }

    /// Writes this start-up list, or a single line of one, at its transitions: those of PREOP before the PDO assignment is read.
    #[must_use]
    pub fn start_up(mut self, list: impl Into<StartUpList>) -> Self {
        self.start_up.push(list.into());
        self
    }

    /// What is wrong with the declaration itself.
    pub(in crate::bus) fn mistake(&self) -> Option<String> {
        let mistake = StartUpLines::all(&self.start_up).mistake()?;
        Some(format!("start-up list: {mistake}"))
    }
}

// A device's inputs and outputs, as a program holds them.

/// A device that is no drive, in OP: [`Network::io`](crate::Network::io).
///
/// ```no_run
/// # async fn example(net: servocrab::Network) -> Result<(), Box<dyn std::error::Error>> {
/// let start = net.io("buttons")?.input::<bool>("Channel 1.Input")?;
/// let valve = net.io("valves")?.output::<bool>((0x7000, 1))?;
/// valve.set(start.get()?);
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct Io {
    shared: Arc<Shared>,
}

/// A type that an input or output can have: `bool` for one bit, `u8`, `i8`, `u16`, `i16`, `u32`, `i32`.
pub trait IoValue: Copy + private::Sealed {
    /// The length in bits.
    const BITS: u8;
    /// Whether a shorter input can be read as this type.
    const UNSIGNED: bool;

    /// The value's bits.
    fn to_bits(self) -> u32;

    /// The value with these bits.
    fn from_bits(bits: u32) -> Self;
}

mod private {
    pub trait Sealed {}
    impl<T: crate::coe::Number> Sealed for T {}
    impl Sealed for bool {}
}

impl<T: Number> IoValue for T {
    const BITS: u8 = <T as Number>::BITS;
    const UNSIGNED: bool = matches!(T::DATA_TYPE, DataType::U8 | DataType::U16 | DataType::U32);

    fn to_bits(self) -> u32 {
        self.to_raw()
    }

    fn from_bits(bits: u32) -> Self {
        Self::from_raw(bits)
    }
}

impl IoValue for bool {
    const BITS: u8 = 1;
    const UNSIGNED: bool = false;

    fn to_bits(self) -> u32 {
        self.into()
    }

    fn from_bits(bits: u32) -> Self {
        bits != 0
    }
}

impl Io {
    pub(in crate::bus) const fn new(shared: Arc<Shared>) -> Self {
        Self { shared }
    }

    /// What it is called in the program.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    /// Where it stands and what it says it is.
    #[must_use]
    pub fn device(&self) -> &DriveId {
        &self.shared.device
    }

    /// All its inputs and outputs.
    #[must_use]
    pub fn points(&self) -> &[IoPoint] {
        &self.shared.points
    }

    /// An input, by its name or by index and subindex.
    ///
    /// # Errors
    /// [`IoErrorKind::NoPoint`], [`IoErrorKind::NotUnique`]; [`IoErrorKind::OtherWidth`] if it is not as long as the type.
    /// Inputs of other lengths are read as the next longer of `u8`, `u16`, `u32`.
    pub fn input<'a, T: IoValue>(
        &self,
        point: impl Into<PointName<'a>>,
    ) -> Result<IoInput<T>, IoError> {
        let (_, place) = self.find(
            Direction::Inputs,
            point.into(),
            |bits| bits == T::BITS || T::UNSIGNED && bits < T::BITS,
            T::BITS,
        )?;
        Ok(IoInput {
            shared: Arc::clone(&self.shared),
            place,
            kind: PhantomData,
        })
    }

    /// An output, by its name or by index and subindex. Until it is set it is 0.
    ///
    /// # Errors
    /// [`IoErrorKind::NoPoint`], [`IoErrorKind::NotUnique`]; [`IoErrorKind::OtherWidth`] if it is not as long as the type.
    pub fn output<'a, T: IoValue>(
        &self,
        point: impl Into<PointName<'a>>,
    ) -> Result<IoOutput<T>, IoError> {
        let (point, _) = self.find(
            Direction::Outputs,
            point.into(),
            |bits| bits == T::BITS,
            T::BITS,
        )?;
        Ok(IoOutput {
            shared: Arc::clone(&self.shared),
            point,
            kind: PhantomData,
        })
    }

    /// Whether the device answers, and takes its outputs.
    #[must_use]
    pub fn status(&self) -> IoStatus {
        self.shared.cell.read(0).0.into()
    }

    fn find(
        &self,
        direction: Direction,
        name: PointName<'_>,
        fits: impl Fn(u8) -> bool,
        expected: u8,
    ) -> Result<(usize, BitRange), IoError> {
        let of_direction = || {
            let points = self.shared.points.iter().enumerate();
            points.filter(|(_, point)| point.direction == direction)
        };
        let mut found = of_direction().filter(|(_, point)| name.means(point));
        let kind = match (found.next(), found.next()) {
            (Some((at, point)), None) if fits(point.place.bits) => return Ok((at, point.place)),
            (Some((_, point)), None) => IoErrorKind::OtherWidth {
                point: point.clone(),
                expected,
            },
            (Some((_, first)), Some((_, second))) => IoErrorKind::NotUnique {
                name: name.to_string(),
                points: [first.clone(), second.clone()]
                    .into_iter()
                    .chain(found.map(|(_, point)| point.clone()))
                    .collect(),
            },
            (None, _) => IoErrorKind::NoPoint {
                name: name.to_string(),
                direction,
                there: of_direction().map(|(_, point)| point.clone()).collect(),
            },
        };
        Err(IoError {
            io: self.shared.name.clone(),
            device: self.shared.device.clone(),
            kind: Box::new(kind),
        })
    }
}

impl fmt::Debug for Io {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Io")
            .field("name", &self.shared.name)
            .field("status", &self.status())
            .finish_non_exhaustive()
    }
}

/// What a device does, as of the last cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct IoStatus {
    /// Counts the cycles.
    pub cycle: u64,
    /// Cycles since it last answered; none if it never did.
    pub age: Option<u32>,
    /// It has not answered for so long that nothing is expected of it: as long as an axis that is lost. After the end of the
    /// network it is true.
    pub lost: bool,
    /// It is in OP: it acts on its outputs.
    pub operational: bool,
    /// The last cycle is known to have delivered the outputs that the program has set. Not so where they are held at 0: while it is
    /// being brought back into OP, from an attempt that failed until one succeeds ([`Network::recover`](crate::Network::recover)), and at
    /// the end of the network.
    pub delivered: bool,
}

impl From<Head> for IoStatus {
    fn from(head: Head) -> Self {
        let Head {
            cycle,
            age,
            lost,
            operational,
            delivered,
        } = head;
        Self {
            cycle,
            age,
            lost,
            operational,
            delivered,
        }
    }
}

/// An input of a device.
pub struct IoInput<T> {
    shared: Arc<Shared>,
    place: BitRange,
    kind: PhantomData<fn() -> T>,
}

impl<T: IoValue> IoInput<T> {
    /// The value that the last cycle brought.
    ///
    /// # Errors
    /// [`Stale`] if it brought none: the device is silent, or a frame was lost. [`last`](Self::last) has the one before.
    pub fn get(&self) -> Result<T, Stale> {
        let (head, value) = self.read();
        match head.age {
            Some(0) => Ok(value),
            age => Err(Stale { age }),
        }
    }

    /// The value that came last, with its age; none if there never was one.
    #[must_use]
    pub fn last(&self) -> Option<Sampled<T>> {
        let (head, value) = self.read();
        let age = head.age?;
        Some(Sampled { value, age })
    }

    fn read(&self) -> (Head, T) {
        let (head, bytes) = self.shared.cell.read(self.place.byte);
        (head, T::from_bits(self.place.read_eight(bytes) as u32))
    }
}

/// An output of a device.
pub struct IoOutput<T> {
    shared: Arc<Shared>,
    point: usize,
    kind: PhantomData<fn(T)>,
}

impl<T: IoValue> IoOutput<T> {
    /// Sends this value from the next cycle on. If the program dies, the device's watchdog ends it; at the end of the network
    /// it becomes 0 once all axes stand.
    pub fn set(&self, value: T) {
        self.shared.set(self.point, value.to_bits());
    }

    /// The value that was set last, by whoever holds this output; none before the first.
    #[must_use]
    pub fn get(&self) -> Option<T> {
        self.shared.was_set(self.point).map(T::from_bits)
    }
}

impl<T> Clone for IoInput<T> {
    fn clone(&self) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
            ..*self
        }
    }
}

impl<T> Clone for IoOutput<T> {
    fn clone(&self) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
            ..*self
        }
    }
}

impl<T: IoValue + fmt::Debug> fmt::Debug for IoInput<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("IoInput").field(&self.last()).finish()
    }
}

impl<T: IoValue + fmt::Debug> fmt::Debug for IoOutput<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("IoOutput").field(&self.get()).finish()
    }
}

// Why an input or output cannot be had: what was asked for, beside what there is.

/// An input or output that cannot be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("io `{io}`, {device:#}: {kind}")]
#[non_exhaustive]
pub struct IoError {
    /// What the device is called in the program.
    pub io: String,
    /// The device.
    pub device: DriveId,
    /// What is the matter.
    pub kind: Box<IoErrorKind>,
}

/// Why an input or output cannot be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum IoErrorKind {
    /// There is none with this name.
    #[error("{name} is not among its {direction}: {}", List(.there))]
    NoPoint {
        /// What was asked for.
        name: String,
        /// Inputs or outputs.
        direction: Direction,
        /// What there is.
        there: Vec<IoPoint>,
    },
    /// There are several with this name: take index and subindex.
    #[error("{name} is not unique, take index and subindex: {}", List(.points))]
    NotUnique {
        /// What was asked for.
        name: String,
        /// What has this name.
        points: Vec<IoPoint>,
    },
    /// It has another length.
    #[error("{point} does not have the {expected} of the type")]
    OtherWidth {
        /// What there is.
        point: IoPoint,
        /// Bits of the type.
        expected: u8,
    },
}

struct List<'a>(&'a [IoPoint]);

impl fmt::Display for List<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("there are none");
        }
        for (number, point) in self.0.iter().enumerate() {
            let comma = if number == 0 { "" } else { ", " };
            write!(f, "{comma}{point}")?;
        }
        Ok(())
    }
}

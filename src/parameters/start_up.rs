//! Start-up lists: what is written to a drive on its way to OP.

use std::fmt;
use std::str::FromStr;

use super::value::{ObjectValue, known_name};
use crate::coe::{Object, ObjectAddress, SdoError, SdoHandle, Value, Writable};

/// The change of the AL state before which a line of a start-up list is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Transition {
    /// In PREOP, before the PDO mapping; `PREOP-SAFEOP` in files.
    #[default]
    PreOpToSafeOp,
    /// In SAFEOP, while process data are exchanged already; `SAFEOP-OP` in files. A line for an object of the outputs is refused: the
    /// process data would overwrite it in OP.
    SafeOpToOp,
}

impl fmt::Display for Transition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PreOpToSafeOp => "PREOP-SAFEOP",
            Self::SafeOpToOp => "SAFEOP-OP",
        })
    }
}

/// A text that is no transition of a start-up list.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no transition of a start-up list: PREOP-SAFEOP or SAFEOP-OP is expected")]
pub struct UnknownTransition(pub String);

impl FromStr for Transition {
    type Err = UnknownTransition;

    fn from_str(text: &str) -> Result<Self, UnknownTransition> {
        [Self::PreOpToSafeOp, Self::SafeOpToOp]
            .into_iter()
            .find(|transition| transition.to_string() == text)
            .ok_or_else(|| UnknownTransition(text.into()))
    }
}

/// One line of a start-up list.
///
/// ```
/// use servocrab::{coe::{ObjectAddress, obj}, parameters::{StartUpWrite, Transition}};
/// // The type follows from the object …
/// let window = StartUpWrite::new(obj::POSITION_WINDOW.axis(2), 50).comment("50 counts").verified();
/// // … or, for an object that the library does not know, from the value.
/// let own = StartUpWrite::to(ObjectAddress::new(0x2345, 1), 1.5_f32).at(Transition::SafeOpToOp);
/// assert_eq!(own.value.encode().len(), 4);
/// assert!(window.verify);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct StartUpWrite {
    /// The object.
    pub object: ObjectAddress,
    /// What is written to it.
    pub value: ObjectValue,
    /// What it is for.
    pub comment: String,
    /// When it is written.
    pub transition: Transition,
    /// Whether it is read back and compared.
    pub verify: bool,
    /// The line of the file from which it came.
    pub(super) line: Option<usize>,
}

impl StartUpWrite {
    /// Writes `value` to an object with a type, before SAFEOP.
    #[must_use]
    pub fn new<T: Value + Into<ObjectValue>, A: Writable>(object: Object<T, A>, value: T) -> Self {
        Self::to(object.address(), value)
    }

    /// Writes `value` to an object whose type is the value's, before SAFEOP.
    #[must_use]
    pub fn to(object: ObjectAddress, value: impl Into<ObjectValue>) -> Self {
        Self {
            object,
            value: value.into(),
            comment: String::new(),
            transition: Transition::default(),
            verify: false,
            line: None,
        }
    }

    /// Says what it is for; errors quote it.
    #[must_use]
    pub fn comment(mut self, comment: &str) -> Self {
        comment.clone_into(&mut self.comment);
        self
    }

    /// Writes it at this transition.
    #[must_use]
    pub const fn at(mut self, transition: Transition) -> Self {
        self.transition = transition;
        self
    }

    /// Reads it back, and fails if the drive holds something else.
    #[must_use]
    pub const fn verified(mut self) -> Self {
        self.verify = true;
        self
    }
}

/// What is written to a drive on its way to OP, in order, but scaling first.
///
/// A scale factor decides what the numbers in other objects mean. Lines that write one (607Eh, 6089h to 6097h, 60A8h to 60AAh,
/// 60E6h to 60EEh, of any axis) therefore go out before all lines for other objects of the profile (6000h to 9FFFh), in whatever
/// order they are declared. All else keeps its place: objects of the maker and of the communication, and lines of one kind among
/// themselves. Scaling objects of the maker are not known as such: declare them before what they scale.
///
/// Built in code, or read from a file by [`StartUpList::load`](StartUpList::load).
///
/// ```
/// use servocrab::{DriveConfig, coe::obj, drives, parameters::{StartUpList, StartUpWrite}};
/// let list = StartUpList::new()
///     .write(StartUpWrite::new(obj::POSITION_WINDOW, 50))
///     .write(StartUpWrite::new(obj::QUICK_STOP_DECELERATION, 1_000_000).verified());
/// let drive = DriveConfig::new(drives::akd2g()).axis("x").start_up(list);
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StartUpList {
    /// The lines.
    pub writes: Vec<StartUpWrite>,
    /// The file from which it came.
    pub(super) file: Option<String>,
}

impl StartUpList {
    /// An empty list.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a line.
    #[must_use]
    pub fn write(mut self, write: StartUpWrite) -> Self {
        self.writes.push(write);
        self
    }

    /// Writes the lines of one transition to a drive, scaling first, up to the first that fails. A list with a line that no start-up list may
    /// have (6040h, 6041h, 6060h, or a target: 6042h, 6071h, 607Ah, 60FFh, of any axis) is refused as a whole.
    ///
    /// A [`Network`](crate::Network) does this by itself with the lists of its
    /// [`DriveConfig`](crate::DriveConfig::start_up).
    ///
    /// # Errors
    /// [`StartUpError`]: which line failed and how; those before it have been written.
    pub async fn apply(&self, sdo: &SdoHandle, transition: Transition) -> Result<(), StartUpError> {
        let lists = core::slice::from_ref(self);
        if let Some(mistake) = StartUpLines::all(lists).mistake() {
            return Err(mistake);
        }
        for lines in StartUpLines::of(lists, transition).scaling_first() {
            lines.write(sdo).await?;
        }
        Ok(())
    }

    fn error(&self, place: usize, write: &StartUpWrite, fault: WriteFault) -> StartUpError {
        StartUpError {
            file: self.file.clone(),
            line: write.line,
            number: place.saturating_add(1),
            of: self.writes.len(),
            object: write.object,
            comment: write.comment.clone(),
            fault,
        }
    }
}

impl From<StartUpWrite> for StartUpList {
    fn from(write: StartUpWrite) -> Self {
        Self::new().write(write)
    }
}

/// Lines of one or more lists, in the order in which they go out.
pub(crate) struct StartUpLines<'a>(Vec<StartUpLine<'a>>);

#[derive(Clone, Copy)]
struct StartUpLine<'a> {
    list: &'a StartUpList,
    /// In its list, from 0.
    place: usize,
    write: &'a StartUpWrite,
}

impl<'a> StartUpLines<'a> {
    /// As they are declared.
    pub fn all(lists: &'a [StartUpList]) -> Self {
        let lines = lists.iter().flat_map(|list| {
            let writes = list.writes.iter().enumerate();
            writes.map(move |(place, write)| StartUpLine { list, place, write })
        });
        Self(lines.collect())
    }

    /// Those of one transition.
    pub fn of(lists: &'a [StartUpList], transition: Transition) -> Self {
        let mut lines = Self::all(lists);
        lines.0.retain(|line| line.write.transition == transition);
        lines
    }

    /// In two parts, of which the first has the scaling.
    pub fn scaling_first(self) -> [Self; 2] {
        Self::split_at_scaling(self.0, |line| line.write.object).map(Self)
    }

    /// All up to the last scaling object, but other objects of the profile; and then these, and the rest. What has no need to move keeps
    /// its order: a maker's object may unlock the scaling, and a command may load or store what was written before it.
    pub fn split_at_scaling<T>(
        writes: Vec<T>,
        object: impl Fn(&T) -> ObjectAddress,
    ) -> [Vec<T>; 2] {
        let last = writes.iter().rposition(|write| is_scaling(object(write)));
        let until = last.map_or(0, |last| last + 1);
        let (mut first, mut then) = (Vec::new(), Vec::new());
        for (place, write) in writes.into_iter().enumerate() {
            let address = object(&write);
            let is_scaled = on_first_axis(address).is_some() && !is_scaling(address);
            if place < until && !is_scaled {
                first.push(write);
            } else {
                then.push(write);
            }
        }
        [first, then]
    }

    pub async fn write(&self, sdo: &SdoHandle) -> Result<(), StartUpError> {
        for line in &self.0 {
            let StartUpWrite {
                object,
                value,
                verify,
                ..
            } = line.write;
            write_value(sdo, *object, value, *verify)
                .await
                .map_err(|fault| line.error(fault))?;
        }
        Ok(())
    }

    /// The first line that a start-up list must not have.
    pub fn mistake(&self) -> Option<StartUpError> {
        let mut lines = self.0.iter();
        lines.find_map(|line| Some(line.error(Self::of_the_library(line.write.object)?)))
    }

    /// Why no start-up list may have an object. The controlword could switch an axis on before anything watches it; a mode or a target that
    /// it holds then could move it; the statusword can only be read.
    pub fn of_the_library(object: ObjectAddress) -> Option<WriteFault> {
        Some(match of_first_axis(object)? {
            0x6040 => WriteFault::Controlword,
            0x6041 => WriteFault::Statusword,
            0x6060 => WriteFault::Mode,
            // Velocity, torque, position, and the velocity of mode 3.
            0x6042 | 0x6071 | 0x607A | 0x60FF => WriteFault::Target,
            _ => return None,
        })
    }

    /// The first line of SAFEOP that changes what numbers mean which have been read and written in PREOP.
    pub fn late_scaling(&self) -> Option<StartUpError> {
        let mut lines = self.0.iter();
        let line = lines.find(|line| line.is_late() && is_scaling(line.write.object))?;
        Some(line.error(WriteFault::LateScaling))
    }

    /// The first line of SAFEOP that the process data overwrite in OP.
    pub fn overwritten(&self, is_output: impl Fn(ObjectAddress) -> bool) -> Option<StartUpError> {
        let mut lines = self.0.iter();
        let line = lines.find(|line| line.is_late() && is_output(line.write.object))?;
        Some(line.error(WriteFault::Output))
    }

    /// The first line that would open a brake which goes with the process data: nobody has enabled the axis then.
    pub fn opens_brake(
        &self,
        opens: impl Fn(ObjectAddress, &[u8]) -> bool,
    ) -> Option<StartUpError> {
        let mut lines = self.0.iter();
        let line = lines.find(|line| {
            let StartUpWrite { object, value, .. } = line.write;
            opens(*object, &value.encode())
        })?;
        Some(line.error(WriteFault::Brake))
    }

    /// What an object holds by its last line.
    pub fn value_of(&self, object: ObjectAddress) -> Option<Vec<u8>> {
        let mut lines = self.0.iter().rev();
        let line = lines.find(|line| line.write.object == object)?;
        Some(line.write.value.encode())
    }
}

impl StartUpLine<'_> {
    fn is_late(&self) -> bool {
        self.write.transition == Transition::SafeOpToOp
    }

    fn error(&self, fault: WriteFault) -> StartUpError {
        self.list.error(self.place, self.write, fault)
    }
}

/// Whether an object decides what the numbers of others mean: polarity; the factors and dimensions of CiA 402 and DSP 402; the SI
/// units; the factors of further encoders.
fn is_scaling(object: ObjectAddress) -> bool {
    matches!(
        on_first_axis(object),
        Some(0x607E | 0x6089..=0x6097 | 0x60A8..=0x60AA | 0x60E6..=0x60EE)
    )
}

/// The index that an object of the profile has on the first axis.
fn on_first_axis(object: ObjectAddress) -> Option<u16> {
    let is_profile = (0x6000..0xA000).contains(&object.index);
    is_profile.then(|| 0x6000 + (object.index - 0x6000) % 0x0800)
}

/// The index that a variable of the profile has on the first axis.
pub(super) fn of_first_axis(object: ObjectAddress) -> Option<u16> {
    on_first_axis(object).filter(|_| object.subindex == 0)
}

/// A line of a start-up list that could not be written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}: {fault}", ObjectAndLine(self))]
#[non_exhaustive]
pub struct StartUpError {
    /// The file of the list.
    pub file: Option<String>,
    /// The line of the file.
    pub line: Option<usize>,
    /// The place in the list, from 1.
    pub number: usize,
    /// How many lines the list has.
    pub of: usize,
    /// The object.
    pub object: ObjectAddress,
    /// What it was for.
    pub comment: String,
    /// What went wrong.
    #[source]
    pub fault: WriteFault,
}

struct ObjectAndLine<'a>(&'a StartUpError);

impl fmt::Display for ObjectAndLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let error = self.0;
        match (&error.file, error.line) {
            (Some(file), Some(line)) => write!(f, "{file}:{line}")?,
            _ => write!(f, "line {} of {}", error.number, error.of)?,
        }
        write!(f, ", {}", error.object)?;
        if let Some(name) = known_name(error.object) {
            write!(f, " {name}")?;
        }
        if !error.comment.is_empty() {
            write!(f, " (\"{}\")", error.comment)?;
        }
        Ok(())
    }
}

/// Why an object does not hold what it was to hold.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WriteFault {
    /// The transfer failed; the drive's own reason is in it if it refused.
    #[error(transparent)]
    Sdo(#[from] SdoError),
    /// The drive took the value, but holds another.
    #[error(
        "wrote {expected}, but the drive holds {got}: is it limited, rounded, or written by the process data?"
    )]
    Differs {
        /// What was written.
        expected: ObjectValue,
        /// What was read back.
        got: ObjectValue,
    },
    /// It is a controlword.
    #[error("the controlword is no parameter: enable the axis by its handle")]
    Controlword,
    /// It is a mode of operation.
    #[error(
        "the mode of operation is no parameter: take the line out; the lease of a mode selects it when the axis stands"
    )]
    Mode,
    /// It is a target: of position, velocity or torque.
    #[error("a target is no parameter: take the line out; an axis is moved by its handle")]
    Target,
    /// It is written in SAFEOP, and the process data hold it.
    #[error(
        "the process data overwrite this object in OP: write it at PREOP-SAFEOP, and it goes out until the program sets it by its handle"
    )]
    Output,
    /// It is a scale factor, and written in SAFEOP.
    #[error(
        "it changes what numbers mean that were read and written in PREOP: write it at PREOP-SAFEOP"
    )]
    LateScaling,
    /// It opens the brake of an axis that nobody has enabled: bit 0 of a mapped 60FEh:1 is 0.
    #[error(
        "bit 0 is 0, which opens the brake before anybody has enabled the axis: write it as 1; the program opens the brake by its handle"
    )]
    Brake,
    /// It is a statusword.
    #[error(
        "the statusword can only be read: take the line out; an axis is commanded by its handle, and parameters are other objects"
    )]
    Statusword,
}

/// Writes an object, and compares what it holds then.
pub(super) async fn write_value(
    sdo: &SdoHandle,
    object: ObjectAddress,
    value: &ObjectValue,
    verify: bool,
) -> Result<(), WriteFault> {
    sdo.write_bytes(object.index, object.subindex, value.encode())
        .await
        .map_err(|error| error.error)?;
    if !verify {
        return Ok(());
    }
    let held = sdo
        .read_bytes(object.index, object.subindex)
        .await
        .map_err(|error| error.error)?;
    if value.is_held_by(&held) {
        return Ok(());
    }
    Err(WriteFault::Differs {
        expected: value.clone(),
        got: ObjectValue::decode(value.value_type(), &held),
    })
}

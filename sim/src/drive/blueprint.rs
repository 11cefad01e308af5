//! What a CoE drive is made of.

use crate::ds402::Behaviour;
use crate::pdo::{PdoHabit, PdoLimits};

/// An object that a maker adds for each axis: a word of status bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisStatusObject {
    /// Index for axis 1.
    pub index: u16,
    /// What is added to the index for each further axis.
    pub increment: u16,
    /// Subindex.
    pub subindex: u8,
}

/// An object of which this simulation knows no behaviour: it keeps what is written to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlainObject {
    /// Index.
    pub index: u16,
    /// Name.
    pub name: String,
    /// Its elements are all of one type.
    pub is_array: bool,
    /// Its subindices, with 0.
    pub entries: Vec<PlainEntry>,
}

/// A subindex of a [`PlainObject`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlainEntry {
    /// Subindex.
    pub subindex: u8,
    /// Name.
    pub name: String,
    /// Number of the data type (ETG.1000.6); 0 for one that has none.
    pub data_type: u16,
    /// Length in bytes; of a text the most.
    pub bytes: usize,
    /// It is a text, which may be shorter.
    pub varies: bool,
    /// Its bytes at power-up; `None` for zeros.
    pub default: Option<Vec<u8>>,
    /// It can be read.
    pub readable: bool,
    /// It can be written.
    pub writable: bool,
    /// It can be mapped into an RxPDO.
    pub outputs: bool,
    /// It can be mapped into a TxPDO.
    pub inputs: bool,
}

/// What makes one CoE drive different from another, apart from its description.
#[derive(Clone, Debug)]
pub struct DriveBlueprint {
    /// One behaviour for each axis.
    pub axes: Vec<Behaviour>,
    /// What is added to a profile object's index for each further axis.
    pub axis_increment: u16,
    /// The maker's status word of each axis.
    pub status_object: Option<AxisStatusObject>,
    /// An object for text of the user: index and the most bytes.
    pub note: Option<(u16, usize)>,
    /// How much can be mapped in each direction.
    pub limits: PdoLimits,
    /// Device type (1000h).
    pub device_type: u32,
    /// PDOs that 1C12h and 1C13h name at power-up; `None` for those that the SII gives a sync manager.
    pub assigned: Option<Vec<u16>>,
    /// What it makes of single writes to its PDO lists in place of what the rules say.
    pub pdo_habits: Vec<PdoHabit>,
    /// Further objects. Where the drive has the object itself, its values at power-up are those given here.
    pub objects: Vec<PlainObject>,
    /// It shows those, the PDO lists and what the PDOs hold by default, and no other object.
    pub shows_only_these: bool,
    /// It has a diagnosis history (10F3h) with room for so many messages.
    pub diagnosis: Option<u8>,
    /// 1010h saves the objects that are kept in the EEPROM, and 1011h empties it.
    pub saves: bool,
    /// Software version (100Ah).
    pub software_version: String,
    /// Hardware version (1009h).
    pub hardware_version: String,
}

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
    /// 1010h saves the objects that are kept in the EEPROM, and 1011h empties it.
    pub saves: bool,
    /// Software version (100Ah).
    pub software_version: String,
    /// Hardware version (1009h).
    pub hardware_version: String,
}

//! The SII image of a SubDevice (its EEPROM): identity, mailbox, and the categories that configuration needs
//! (ETG.1000.6, SII; ETG.2010). Unknown categories are skipped.
//!
//! What is read of an image takes at most 32 KiB and 16 times the image: strings, PDOs and FMMUs of no content take their place in a list.

use alloc::{string::String, vec::Vec};
use core::fmt;

mod image;
#[cfg(test)]
mod tests;

pub use image::{SiiImage, SiiImageError};

/// Word address of the first category.
const FIRST_CATEGORY: usize = 0x40;

/// What a SubDevice says it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Identity {
    /// The vendor ID, which the ETG assigns.
    pub vendor: u32,
    /// The vendor's product code.
    pub product: u32,
    /// The revision number.
    pub revision: u32,
    /// The serial number; often 0.
    pub serial: u32,
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "vendor {:08X}h, product {:08X}h, revision {:08X}h, serial {:08X}h",
            self.vendor, self.product, self.revision, self.serial
        )
    }
}

/// What an SII image says.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Sii {
    /// Vendor, product, revision and serial number.
    pub identity: Identity,
    /// The mailbox of the states from PREOP on; `None` if the device has none.
    pub mailbox: Option<Mailbox>,
    /// The strings of category 10; other categories name them by their place, the first being 1.
    pub strings: Vec<String>,
    /// Category 30.
    pub general: Option<General>,
    /// Category 40: what each FMMU is meant for.
    pub fmmu_usage: Vec<FmmuUsage>,
    /// Category 41.
    pub sync_managers: Vec<SyncManager>,
    /// Category 50: what the device sends by default. CoE may say otherwise.
    pub tx_pdos: Vec<Pdo>,
    /// Category 51: what the device receives by default. CoE may say otherwise.
    pub rx_pdos: Vec<Pdo>,
    /// Category 60: modes of the distributed clock.
    pub clock_modes: Vec<ClockMode>,
}

impl Sii {
    /// Reads an image, as it lies in the EEPROM from its first byte on.
    ///
    /// # Errors
    /// [`SiiError`] if the image ends before its header or one of its categories does.
    pub fn parse(image: &[u8]) -> Result<Self, SiiError> {
        let word = |address: usize| Bytes::new(image, address * 2).u16();
        let dword = |address: usize| Bytes::new(image, address * 2).u32();
        let mut sii = Self {
            identity: Identity {
                vendor: dword(0x08)?,
                product: dword(0x0A)?,
                revision: dword(0x0C)?,
                serial: dword(0x0E)?,
            },
            mailbox: Mailbox {
                receive_offset: word(0x18)?,
                receive_length: word(0x19)?,
                send_offset: word(0x1A)?,
                send_length: word(0x1B)?,
                protocols: Protocols(word(0x1C)?),
            }
            .if_any(),
            strings: Vec::new(),
            general: None,
            fmmu_usage: Vec::new(),
            sync_managers: Vec::new(),
            tx_pdos: Vec::new(),
            rx_pdos: Vec::new(),
            clock_modes: Vec::new(),
        };
        let mut bytes = Bytes::new(image, FIRST_CATEGORY * 2);
        loop {
            let category = bytes.u16()?;
            if category == 0xFFFF {
                return Ok(sii);
            }
            let length = usize::from(bytes.u16()?) * 2;
            sii.category(category, bytes.take(length)?)?;
        }
    }

    /// The string with this number, as other categories use it; `None` for 0 or a number that is not there.
    #[must_use]
    pub fn string(&self, number: u8) -> Option<&str> {
        let place = usize::from(number).checked_sub(1)?;
        self.strings.get(place).map(String::as_str)
    }

    /// The device's name: the general category's, if it has one.
    #[must_use]
    pub fn name(&self) -> Option<&str> {
        self.string(self.general.as_ref()?.name)
    }

    fn category(&mut self, category: u16, mut bytes: Bytes<'_>) -> Result<(), SiiError> {
        match category {
            10 => self.strings = strings(&mut bytes)?,
            30 => self.general = Some(General::parse(&mut bytes)?),
            40 => self.fmmu_usage = bytes.rest().iter().copied().map(FmmuUsage::from).collect(),
            41 => {
                // A category is padded to whole words, not to whole entries.
                while bytes.rest().len() >= 8 {
                    self.sync_managers.push(SyncManager::parse(&mut bytes)?);
                }
            }
            50 => pdos(&mut self.tx_pdos, &mut bytes)?,
            51 => pdos(&mut self.rx_pdos, &mut bytes)?,
            60 => {
                while bytes.rest().len() >= 24 {
                    self.clock_modes.push(ClockMode::parse(&mut bytes)?);
                }
            }
            _ => {}
        }
        Ok(())
    }
}

/// An image that ends too early.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("SII image cut: expected {needed} more bytes at {at:04X}h")]
pub struct SiiError {
    /// The byte address.
    pub at: usize,
    /// Bytes needed from there on.
    pub needed: usize,
}

/// A text of a device, without control characters: whoever shows it is to be sure that it moves no cursor and makes no line.
pub(crate) fn text_of_device(bytes: &[u8]) -> String {
    let mut text = String::from_utf8_lossy(bytes).into_owned();
    text.retain(|char| !char.is_control());
    text
}

fn strings(bytes: &mut Bytes<'_>) -> Result<Vec<String>, SiiError> {
    let [count] = bytes.array()?;
    let mut strings = Vec::new();
    for _ in 0..count {
        let [length] = bytes.array()?;
        let text = bytes.take(usize::from(length))?;
        strings.push(text_of_device(text.rest()));
    }
    Ok(strings)
}

/// Bytes being read from front to back, with the address at which they lie in the image.
struct Bytes<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn new(image: &'a [u8], at: usize) -> Self {
        Self {
            bytes: image.get(at..).unwrap_or_default(),
            at,
        }
    }

    fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    fn take(&mut self, length: usize) -> Result<Self, SiiError> {
        let (bytes, rest) = self.bytes.split_at_checked(length).ok_or(SiiError {
            at: self.at,
            needed: length,
        })?;
        let at = self.at;
        (self.bytes, self.at) = (rest, at + length);
        Ok(Self { bytes, at })
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], SiiError> {
        let at = self.at;
        self.take(N)?
            .bytes
            .try_into()
            .map_err(|_| SiiError { at, needed: N })
    }

    fn u16(&mut self) -> Result<u16, SiiError> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    fn u32(&mut self) -> Result<u32, SiiError> {
        Ok(u32::from_le_bytes(self.array()?))
    }
}

// What the categories of an SII image contain.

/// Where a device has its mailbox and what it speaks there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mailbox {
    /// Address of the mailbox that the master writes (sync manager 0).
    pub receive_offset: u16,
    /// Its length in bytes.
    pub receive_length: u16,
    /// Address of the mailbox that the master reads (sync manager 1).
    pub send_offset: u16,
    /// Its length in bytes.
    pub send_length: u16,
    /// The protocols.
    pub protocols: Protocols,
}

impl Mailbox {
    fn if_any(self) -> Option<Self> {
        (self.receive_length != 0 && self.send_length != 0).then_some(self)
    }
}

/// The mailbox protocols of a device, one bit each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Protocols(pub u16);

impl Protocols {
    /// Whether CANopen over EtherCAT is among them.
    #[must_use]
    pub const fn coe(self) -> bool {
        self.0 & 4 != 0
    }
}

/// Category 30, general. Names are numbers of strings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct General {
    /// The group's name.
    pub group: u8,
    /// The order number.
    pub order: u8,
    /// The device's name.
    pub name: u8,
    /// What its CoE can do.
    pub coe: CoeDetails,
}

impl General {
    /// How much of the category is read here; there is more of it.
    pub(crate) const BYTES: usize = 6;

    fn parse(bytes: &mut Bytes<'_>) -> Result<Self, SiiError> {
        let [group, _image, order, name, _reserved, coe] = bytes.array::<{ Self::BYTES }>()?;
        Ok(Self {
            group,
            order,
            name,
            coe: CoeDetails(coe),
        })
    }
}

/// What a device's CoE can do, one bit each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct CoeDetails(pub u8);

impl CoeDetails {
    /// SDO transfers.
    #[must_use]
    pub const fn sdo(self) -> bool {
        self.0 & 0x01 != 0
    }

    /// SDO information.
    #[must_use]
    pub const fn sdo_information(self) -> bool {
        self.0 & 0x02 != 0
    }

    /// The assignment of PDOs can be written.
    #[must_use]
    pub const fn pdo_assignment(self) -> bool {
        self.0 & 0x04 != 0
    }

    /// The content of PDOs can be written.
    #[must_use]
    pub const fn pdo_configuration(self) -> bool {
        self.0 & 0x08 != 0
    }

    /// Complete access.
    #[must_use]
    pub const fn complete_access(self) -> bool {
        self.0 & 0x20 != 0
    }
}

/// What an FMMU is meant for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FmmuUsage {
    /// Nothing.
    Unused,
    /// Outputs.
    Outputs,
    /// Inputs.
    Inputs,
    /// The state of the mailbox.
    MailboxStatus,
    /// A value that the standard does not list.
    Unknown(u8),
}

impl From<u8> for FmmuUsage {
    fn from(value: u8) -> Self {
        match value {
            0 | 0xFF => Self::Unused,
            1 => Self::Outputs,
            2 => Self::Inputs,
            3 => Self::MailboxStatus,
            other => Self::Unknown(other),
        }
    }
}

/// One sync manager of category 41.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SyncManager {
    /// Where its buffer starts.
    pub start: u16,
    /// The default length in bytes.
    pub length: u16,
    /// The control byte (register 0804h + 8·n).
    pub control: u8,
    /// The enable byte.
    pub enable: u8,
    /// What it is for.
    pub usage: SyncManagerUsage,
}

impl SyncManager {
    fn parse(bytes: &mut Bytes<'_>) -> Result<Self, SiiError> {
        let [s0, s1, l0, l1, control, _status, enable, usage] = bytes.array()?;
        Ok(Self {
            start: u16::from_le_bytes([s0, s1]),
            length: u16::from_le_bytes([l0, l1]),
            control,
            enable,
            usage: usage.into(),
        })
    }

    /// Whether writes of the master trigger the process-data watchdog (control bit 6).
    #[must_use]
    pub const fn triggers_watchdog(&self) -> bool {
        self.control & 0x40 != 0
    }
}

/// What a sync manager is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SyncManagerUsage {
    /// Nothing.
    Unused,
    /// The mailbox that the master writes.
    MailboxOut,
    /// The mailbox that the master reads.
    MailboxIn,
    /// Process data that the master writes.
    Outputs,
    /// Process data that the master reads.
    Inputs,
    /// A value that the standard does not list.
    Unknown(u8),
}

impl From<u8> for SyncManagerUsage {
    fn from(value: u8) -> Self {
        match value {
            0 => Self::Unused,
            1 => Self::MailboxOut,
            2 => Self::MailboxIn,
            3 => Self::Outputs,
            4 => Self::Inputs,
            other => Self::Unknown(other),
        }
    }
}

/// One PDO of category 50 or 51.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Pdo {
    /// Its index, from 1600h or 1A00h on.
    pub index: u16,
    /// The sync manager to which it is assigned by default; `None` if to none.
    pub sync_manager: Option<u8>,
    /// The number of its name's string.
    pub name: u8,
    /// Flags: bit 0 mandatory, bit 4 fixed content.
    pub flags: u16,
    /// What it contains, in order.
    pub entries: Vec<PdoEntry>,
}

/// One entry of a PDO of category 50 or 51.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PdoEntry {
    /// The object's index; 0 for padding.
    pub index: u16,
    /// The object's subindex.
    pub subindex: u8,
    /// The number of its name's string.
    pub name: u8,
    /// The length in bits.
    pub bits: u8,
}

/// One mode of category 60.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClockMode {
    /// The cycle of SYNC0 in nanoseconds; 0 leaves it to the master.
    pub sync0_cycle_ns: u32,
    /// The shift of SYNC0 in nanoseconds.
    pub sync0_shift_ns: u32,
    /// What to write to registers 0980h and 0981h.
    pub assign_activate: u16,
    /// The number of the name's string.
    pub name: u8,
}

impl ClockMode {
    fn parse(bytes: &mut Bytes<'_>) -> Result<Self, SiiError> {
        let sync0_cycle_ns = bytes.u32()?;
        let sync0_shift_ns = bytes.u32()?;
        let _sync1_shift_ns = bytes.u32()?;
        let _sync1_factor = bytes.u16()?;
        let assign_activate = bytes.u16()?;
        let _sync0_factor = bytes.u16()?;
        let [name, ..] = bytes.array::<6>()?;
        Ok(Self {
            sync0_cycle_ns,
            sync0_shift_ns,
            assign_activate,
            name,
        })
    }
}

fn pdos(pdos: &mut Vec<Pdo>, bytes: &mut Bytes<'_>) -> Result<(), SiiError> {
    while bytes.rest().len() >= 8 {
        let [i0, i1, count, sync_manager, _clock, name, f0, f1] = bytes.array()?;
        let mut entries = Vec::new();
        for _ in 0..count {
            let [i0, i1, subindex, name, _type, bits, _f0, _f1] = bytes.array()?;
            entries.push(PdoEntry {
                index: u16::from_le_bytes([i0, i1]),
                subindex,
                name,
                bits,
            });
        }
        pdos.push(Pdo {
            index: u16::from_le_bytes([i0, i1]),
            sync_manager: (sync_manager != 0xFF).then_some(sync_manager),
            name,
            flags: u16::from_le_bytes([f0, f1]),
            entries,
        });
    }
    Ok(())
}

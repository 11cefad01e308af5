//! What the categories of an SII image contain.

use alloc::vec::Vec;

use super::{Bytes, SiiError};

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
    pub(super) fn if_any(self) -> Option<Self> {
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
    pub(super) fn parse(bytes: &mut Bytes<'_>) -> Result<Self, SiiError> {
        let [group, _image, order, name, _reserved, coe] = bytes.array()?;
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
    pub(super) fn parse(bytes: &mut Bytes<'_>) -> Result<Self, SiiError> {
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
    pub(super) fn parse(bytes: &mut Bytes<'_>) -> Result<Self, SiiError> {
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

pub(super) fn pdos(pdos: &mut Vec<Pdo>, bytes: &mut Bytes<'_>) -> Result<(), SiiError> {
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

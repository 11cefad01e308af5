//! What a SubDevice says about itself: identity, mailbox, sync managers, PDOs. The SII image is made from it, and the AL
//! state machine checks the MainDevice's settings against it.

use core::time::Duration;

/// Which way process data goes, seen from the MainDevice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Written by the MainDevice: an RxPDO of the SubDevice.
    Outputs,
    /// Read by the MainDevice: a TxPDO of the SubDevice.
    Inputs,
}

/// The four numbers that identify a SubDevice (object 1018h and SII words 8 to Fh).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Vendor id.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision number.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
}

/// What a sync manager is for (SII category 41, last byte).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SyncManagerUse {
    /// Mailbox that the MainDevice writes.
    MailboxOut,
    /// Mailbox that the MainDevice reads.
    MailboxIn,
    /// Process data that the MainDevice writes.
    Outputs,
    /// Process data that the MainDevice reads.
    Inputs,
}

/// A sync manager as SII category 41 recommends it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncManagerDescription {
    /// First address of the memory.
    pub start: u16,
    /// Length in bytes.
    pub length: u16,
    /// Control byte.
    pub control: u8,
    /// What it is for.
    pub purpose: SyncManagerUse,
}

/// One object in a PDO of SII category 50 or 51.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoEntryDescription {
    /// Index of the object.
    pub index: u16,
    /// Subindex of the object.
    pub subindex: u8,
    /// Its name; empty for none.
    pub name: &'static str,
    /// Data type as the SII codes it (1 BOOLEAN, 2 I8, 3 I16, 4 I32, 5 U8, 6 U16, 7 U32).
    pub data_type: u8,
    /// Length in bits.
    pub bits: u8,
}

/// One PDO of SII category 50 or 51.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PdoDescription {
    /// Index of the PDO (16xxh or 1Axxh).
    pub index: u16,
    /// Its name; empty for none.
    pub name: &'static str,
    /// Which way its data goes.
    pub direction: Direction,
    /// Sync manager that carries it by default; `None` when it is not assigned.
    pub sync_manager: Option<u8>,
    /// Its content cannot be changed.
    pub fixed: bool,
    /// It must be assigned.
    pub mandatory: bool,
    /// PDOs that cannot be assigned beside it.
    pub excludes: Vec<u16>,
    /// What is in it.
    pub entries: Vec<PdoEntryDescription>,
}

/// A distributed-clock mode of SII category 60.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClockMode {
    /// Name of the mode.
    pub name: String,
    /// Value for register 0980h.
    pub assign_activate: u16,
}

/// How wide a distributed clock is (feature register 0008h, bit 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockWidth {
    /// The system time begins again every 4.3 s.
    Bits32,
    /// It never does.
    Bits64,
}

/// What a drive that insists on its distributed clock asks of the MainDevice. Without SYNC0 it refuses SAFEOP (AL status
/// code 0030h). Its counter of mistakes goes up by three for a pulse without outputs in time, and down by one for one with;
/// above the limit (10F1h:02) it falls to SAFEOP: 0034h where no outputs came, 001Ah where they came at a wrong time
/// (ETG.1020, synchronisation).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockDemand {
    /// Outputs must be complete this long before the pulse with which they take effect.
    pub before: Duration,
    /// And not sooner than this after the pulse before.
    pub after: Duration,
    /// Pulses in a row with outputs in time before it takes OP; else 0032h.
    pub lock_pulses: u32,
    /// With this error code (603Fh) all axes go into a fault when it falls out of OP.
    pub fault: Option<u16>,
}

/// Addresses and sizes of the standard mailbox (SII words 18h to 1Bh).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mailbox {
    /// Where the MainDevice writes: address and length in bytes.
    pub out: (u16, u16),
    /// Where the MainDevice reads: address and length in bytes.
    pub input: (u16, u16),
    /// Protocols (1 AoE, 2 EoE, 4 CoE, 8 FoE, 10h SoE, 20h VoE). With EoE an address can be set, with FoE no file is there.
    pub protocols: u16,
    /// CoE details byte of SII category 30. What it offers is served, and nothing else.
    pub coe_details: u8,
}

impl Mailbox {
    /// CoE details: SDO transfers are served.
    pub const SDO: u8 = 0x01;
    /// CoE details: the dictionary can be read by the SDO information service.
    pub const SDO_INFORMATION: u8 = 0x02;
    /// CoE details: the assignment 1C12h and 1C13h can be written.
    pub const PDO_ASSIGNMENT: u8 = 0x04;
    /// CoE details: the mappings 16xxh and 1Axxh can be written.
    pub const PDO_CONFIGURATION: u8 = 0x08;
    /// CoE details: arrays and records can be read and written as a whole.
    pub const COMPLETE_ACCESS: u8 = 0x20;

    /// Whether complete access is served; it follows from the CoE details.
    #[must_use]
    pub fn offers_complete_access(&self) -> bool {
        self.coe_details & Self::COMPLETE_ACCESS != 0
    }

    /// Whether the SDO information service is served; it follows from the CoE details.
    #[must_use]
    pub fn offers_sdo_information(&self) -> bool {
        self.coe_details & Self::SDO_INFORMATION != 0
    }
}

/// All that a SubDevice says about itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name that a MainDevice finds.
    pub name: String,
    /// Order text.
    pub order: String,
    /// Group text.
    pub group: String,
    /// Who it is.
    pub identity: Identity,
    /// Station alias (SII word 4).
    pub alias: u16,
    /// Its mailbox, when it has one.
    pub mailbox: Option<Mailbox>,
    /// Its sync managers.
    pub sync_managers: Vec<SyncManagerDescription>,
    /// FMMU usage bytes of SII category 40 (1 outputs, 2 inputs, 3 mailbox state, FFh none).
    pub fmmu_usage: Vec<u8>,
    /// Its PDOs by default.
    pub pdos: Vec<PdoDescription>,
    /// Its distributed-clock modes.
    pub clock_modes: Vec<ClockMode>,
    /// Its distributed clock, when it has one.
    pub clock: Option<ClockWidth>,
    /// Whether it insists on that.
    pub clock_demand: Option<ClockDemand>,
    /// Nanoseconds of which a SYNC0 cycle must be a multiple.
    pub sync0_step_ns: u32,
    /// SII categories that nothing here interprets, as number and content: those of vendors (0800h and above) stand before
    /// all others, in this order; the rest between them by its number.
    pub other_categories: Vec<(u16, Vec<u8>)>,
    /// Number of DS402 axes as SII category 30 gives it.
    pub ds402_channels: u8,
    /// Whether it refuses SAFEOP unless the outputs' sync manager triggers the process-data watchdog exactly when that has a
    /// time (AL status code 001Fh), as devices with a widely used SubDevice stack do.
    pub checks_watchdog: bool,
    /// Whether it executes LRW (feature register 0008h, bit 9).
    pub supports_lrw: bool,
    /// Whether an SII read gives eight bytes instead of four.
    pub sii_reads_eight_bytes: bool,
    /// Whether 1C32h:1 and 1C33h:1 take the synchronisation with the process data (1 and 34) as well.
    pub sm_synchronous: bool,
    /// Whether its processor serves the EEPROM (0502h, bit 5), and needs it for PREOP: while it belongs to the MainDevice (0500h is 0)
    /// PREOP is refused with AL status code 0051h.
    pub emulates_eeprom: bool,
    /// Whether its mailboxes may be set shorter than the SII says, as devices with a widely used SubDevice stack let them be.
    pub takes_shorter_mailboxes: bool,
}

impl Description {
    /// A SubDevice with neither mailbox nor process data.
    #[must_use]
    pub fn new(name: &str, identity: Identity) -> Self {
        Self {
            name: name.to_owned(),
            order: name.to_owned(),
            group: "Simulated".to_owned(),
            identity,
            alias: 0,
            mailbox: None,
            sync_managers: Vec::new(),
            fmmu_usage: Vec::new(),
            pdos: Vec::new(),
            clock_modes: Vec::new(),
            clock: Some(ClockWidth::Bits64),
            clock_demand: None,
            // Assumed: half the shortest cycle that drives usually have.
            sync0_step_ns: 62_500,
            other_categories: Vec::new(),
            ds402_channels: 0,
            checks_watchdog: false,
            supports_lrw: true,
            sii_reads_eight_bytes: true,
            emulates_eeprom: false,
            sm_synchronous: false,
            takes_shorter_mailboxes: false,
        }
    }

    /// Number of the sync manager that serves this purpose.
    #[must_use]
    pub fn sync_manager_for(&self, purpose: SyncManagerUse) -> Option<usize> {
        self.sync_managers
            .iter()
            .position(|sm| sm.purpose == purpose)
    }

    /// Bytes of process data that the PDOs assigned by default make up.
    #[must_use]
    pub fn process_data_bytes(&self, direction: Direction) -> usize {
        let assigned = self
            .pdos
            .iter()
            .filter(|pdo| pdo.direction == direction && pdo.sync_manager.is_some());
        let bits: usize = assigned
            .flat_map(|pdo| &pdo.entries)
            .map(|entry| usize::from(entry.bits))
            .sum();
        bits.div_ceil(8)
    }
}

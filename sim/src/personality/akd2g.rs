//! The Kollmorgen AKD2G with two axes: behaviour after its documents on Profile Position mode and the controlword.
//!
//! No document that was available gives the following, so it is assumed:
//!
//! | what | assumed | reason |
//! |---|---|---|
//! | identity | vendor 0000006Ah, product 414B4432h ("AKD2"), revision 1 | the AKD has vendor 0000006Ah and product 00414B44h |
//! | PDOs | 1600h and 1610h, 1A00h and 1A10h, one of each for an axis, flexible in PREOP | 10h apart leaves room for more |
//! | mapping at power-up | 6040h, 6060h, 607Ah, 6081h, 6083h, 6084h and 6041h, 6061h, 6064h, 606Ch; axis 2 at +0800h | Profile Position with its parameters |
//! | size | 64 bytes in each direction, 16 entries in a PDO | |
//! | mailbox | 1800h and 1C00h, 1024 bytes each; protocols 000Eh; CoE details 0Dh; no SDO information | as the AKD |
//! | outputs | sync manager 2 at 1100h, control 24h: without watchdog trigger | as the AKD |
//! | inputs | sync manager 3 at 1200h, control 20h | the AKD's 1140h leaves no room for three buffers of these outputs |
//! | processor cycle | 1 ms | |
//! | units | counts, counts/s, counts/s² | |
//! | `5000h:4` | bit 0: a set-point is being executed | bits are not described |
//! | note of the user | `5F00h`, text of up to 4096 bytes | longer than the mailbox, so that it takes segmented transfers |
//! | mark of the user | `5F01h`: a number, a key that cannot be read, a place | a record of which a part cannot be read |

use crate::description::{
    ClockMode, Description, Direction, Identity, Mailbox, PdoDescription, PdoEntryDescription,
    SyncManagerDescription, SyncManagerUse,
};
use crate::device::{Blueprint, Device};
use crate::drive::{AxisStatusObject, DriveBlueprint};
use crate::ds402::Behaviour;
use crate::pdo::PdoLimits;

/// What is added to an index for the second axis.
const AXIS_INCREMENT: u16 = 0x0800;

/// Objects in an axis's RxPDO at power-up: index, bits, data type as SII codes it.
const OUTPUTS: [(u16, u8, u8); 6] = [
    (0x6040, 16, 6),
    (0x6060, 8, 2),
    (0x607A, 32, 4),
    (0x6081, 32, 7),
    (0x6083, 32, 7),
    (0x6084, 32, 7),
];
/// Objects in an axis's TxPDO at power-up.
const INPUTS: [(u16, u8, u8); 4] = [
    (0x6041, 16, 6),
    (0x6061, 8, 2),
    (0x6064, 32, 4),
    (0x606C, 32, 4),
];

/// An AKD2G with two axes.
#[must_use]
pub fn akd2g() -> Device {
    Akd2g::new().build()
}

/// An AKD2G of which details can be changed before it is built.
///
/// ```
/// use servocrab_sim::personality::Akd2g;
/// let drive = Akd2g::new().serial(4711).inputs_at(0x1140).build();
/// assert_eq!(drive.axes().len(), 2);
/// ```
#[derive(Clone, Debug)]
pub struct Akd2g {
    behaviours: Vec<Behaviour>,
    identity: Identity,
    inputs_at: u16,
    supports_lrw: bool,
    mailbox_bytes: u16,
    coe_details: u8,
}

impl Default for Akd2g {
    fn default() -> Self {
        Self::new()
    }
}

impl Akd2g {
    /// The drive as its documents describe it.
    #[must_use]
    pub fn new() -> Self {
        Self {
            behaviours: vec![Behaviour::akd2g(); 2],
            identity: Identity {
                vendor: 0x0000_006A,
                product: 0x414B_4432,
                revision: 1,
                serial: 0,
            },
            inputs_at: 0x1200,
            supports_lrw: true,
            mailbox_bytes: 1024,
            coe_details: 0x0D,
        }
    }

    /// Gives the drive a serial number.
    #[must_use]
    pub fn serial(mut self, serial: u32) -> Self {
        self.identity.serial = serial;
        self
    }

    /// Gives the drive another identity.
    #[must_use]
    pub fn identity(mut self, identity: Identity) -> Self {
        self.identity = identity;
        self
    }

    /// Changes how both axes behave.
    #[must_use]
    pub fn behaviour(mut self, behaviour: Behaviour) -> Self {
        self.behaviours = vec![behaviour; 2];
        self
    }

    /// Changes how one axis (0 or 1) behaves.
    #[must_use]
    pub fn axis_behaviour(mut self, axis: usize, behaviour: Behaviour) -> Self {
        if let Some(known) = self.behaviours.get_mut(axis) {
            *known = behaviour;
        }
        self
    }

    /// Sets the address that the SII gives for the inputs; 1140h is the AKD's, which is too near for this mapping.
    #[must_use]
    pub fn inputs_at(mut self, address: u16) -> Self {
        self.inputs_at = address;
        self
    }

    /// Sets the size of both mailboxes, up to 1024 bytes.
    #[must_use]
    pub fn mailbox_bytes(mut self, bytes: u16) -> Self {
        self.mailbox_bytes = bytes.min(1024);
        self
    }

    /// Adds the SDO information service, which the AKD does not have.
    #[must_use]
    pub fn with_sdo_information(mut self) -> Self {
        self.coe_details |= Mailbox::SDO_INFORMATION;
        self
    }

    /// Adds complete access, which the AKD does not have.
    #[must_use]
    pub fn with_complete_access(mut self) -> Self {
        self.coe_details |= Mailbox::COMPLETE_ACCESS;
        self
    }

    /// Takes the LRW command away, so that the MainDevice needs LRD and LWR.
    #[must_use]
    pub fn without_lrw(mut self) -> Self {
        self.supports_lrw = false;
        self
    }

    /// The drive, just switched on.
    #[must_use]
    pub fn build(self) -> Device {
        let cycle = self
            .behaviours
            .first()
            .map_or(core::time::Duration::from_millis(1), |behaviour| {
                behaviour.period
            });
        Device::new(Blueprint {
            description: self.description(),
            drive: Some(self.drive()),
            cycle,
        })
    }

    fn description(&self) -> Description {
        let mut description = Description::new("AKD2G EtherCAT Drive (CoE)", self.identity);
        description.order = "AKD2G".to_owned();
        description.group = "Drives".to_owned();
        description.mailbox = Some(Mailbox {
            out: (0x1800, self.mailbox_bytes),
            input: (0x1C00, self.mailbox_bytes),
            protocols: 0x000E,
            coe_details: self.coe_details,
        });
        description.pdos = [(0x1600, Direction::Outputs), (0x1A00, Direction::Inputs)]
            .into_iter()
            .flat_map(|(first, direction)| (0..2).map(move |axis| pdo(first, axis, direction)))
            .collect();
        let length =
            |direction| u16::try_from(description.process_data_bytes(direction)).unwrap_or(0);
        let (outputs, inputs) = (length(Direction::Outputs), length(Direction::Inputs));
        description.sync_managers = vec![
            SyncManagerDescription {
                start: 0x1800,
                length: self.mailbox_bytes,
                control: 0x26,
                purpose: SyncManagerUse::MailboxOut,
            },
            SyncManagerDescription {
                start: 0x1C00,
                length: self.mailbox_bytes,
                control: 0x22,
                purpose: SyncManagerUse::MailboxIn,
            },
            SyncManagerDescription {
                start: 0x1100,
                length: outputs,
                control: 0x24,
                purpose: SyncManagerUse::Outputs,
            },
            SyncManagerDescription {
                start: self.inputs_at,
                length: inputs,
                control: 0x20,
                purpose: SyncManagerUse::Inputs,
            },
        ];
        description.fmmu_usage = vec![1, 2, 3, 0xFF];
        description.clock_modes = vec![
            ClockMode {
                name: "DcSync".to_owned(),
                assign_activate: 0x0300,
            },
            ClockMode {
                name: "DcOff".to_owned(),
                assign_activate: 0x0000,
            },
        ];
        // The AKD's SII begins with two categories of its maker, the order code and a version; its sync unit stands behind
        // the sync managers.
        description.other_categories = vec![
            (0x0800, b"AKD2G simulated ".to_vec()),
            (0x0801, b"00-00-00-000".to_vec()),
            (43, vec![0xF0, 0xFF]),
        ];
        description.ds402_channels = 2;
        description.supports_lrw = self.supports_lrw;
        description
    }

    fn drive(self) -> DriveBlueprint {
        DriveBlueprint {
            axes: self.behaviours,
            axis_increment: AXIS_INCREMENT,
            status_object: Some(AxisStatusObject {
                index: 0x5000,
                increment: 0x0100,
                subindex: 4,
            }),
            note: Some((0x5F00, 4096)),
            limits: PdoLimits {
                bytes: 64,
                entries: 16,
            },
            software_version: "simulated".to_owned(),
            hardware_version: "simulated".to_owned(),
        }
    }
}

/// A PDO of SII.
fn pdo(first: u16, axis: u16, direction: Direction) -> PdoDescription {
    let (objects, sync_manager): (&[(u16, u8, u8)], u8) = match direction {
        Direction::Outputs => (&OUTPUTS, 2),
        Direction::Inputs => (&INPUTS, 3),
    };
    let entry = |&(index, bits, data_type): &(u16, u8, u8)| PdoEntryDescription {
        index: index + axis * AXIS_INCREMENT,
        subindex: 0,
        data_type,
        bits,
    };
    PdoDescription {
        index: first + axis * 0x10,
        direction,
        sync_manager: Some(sync_manager),
        entries: objects.iter().map(entry).collect(),
    }
}

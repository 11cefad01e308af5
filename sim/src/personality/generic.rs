//! A plain CiA 402 servo drive of no particular maker, on EtherCAT as ETG.6010 lays it out.
//!
//! Identity: vendor 0, product 44530402h, revision 1. PDOs 1600h to 1603h and 1A00h to 1A03h, flexible in PREOP, 8 entries
//! each; 1600h with 6040h, 6060h, 607Ah, 6081h, 6083h, 6084h and 1A00h with 6041h, 6061h, 6064h, 606Ch are assigned at
//! power-up. Mailboxes of 256 bytes at 1000h and 1100h; complete access and SDO information. 5F00h takes a text of up to
//! 4096 bytes, and of 5F01h a part cannot be read.

use super::servo::{INPUTS, Memory, Model, OUTPUTS, Pdo, Servo};
use crate::description::Identity;
use crate::device::Device;
use crate::ds402::Behaviour;
use crate::pdo::PdoLimits;

/// The plain drive; other models name what differs.
pub(super) const GENERIC: Model = Model {
    name: "CiA 402 servo drive",
    order: "CiA402",
    identity: Identity {
        vendor: 0,
        product: 0x4453_0402,
        revision: 1,
        serial: 0,
    },
    device_type: 0x0002_0192,
    axes: 1,
    behaviour: Behaviour::generic,
    mailbox: (0x1000, 0x1100, 256),
    protocols: 0x0004,
    coe_details: 0x2F,
    outputs: Memory {
        start: 0x1400,
        control: 0x64,
    },
    inputs: Memory {
        start: 0x1800,
        control: 0x20,
    },
    rx_pdos: &[
        Pdo::assigned(0x1600, OUTPUTS),
        Pdo::offered(0x1601, &[0x6040, 0x607A]),
        Pdo::offered(0x1602, &[0x6040, 0x6060]),
        Pdo::offered(0x1603, &[]),
    ],
    tx_pdos: &[
        Pdo::assigned(0x1A00, INPUTS),
        Pdo::offered(0x1A01, &[0x6041, 0x6064]),
        Pdo::offered(0x1A02, &[0x6041, 0x6061]),
        Pdo::offered(0x1A03, &[]),
    ],
    pdo_increment: 0x10,
    limits: PdoLimits {
        bytes: 64,
        entries: 8,
        assigned: 4,
    },
    fmmu_usage: &[1, 2, 3],
    other_categories: &[],
    status_object: None,
    note: Some((0x5F00, 4096)),
    saves: false,
    checks_watchdog: true,
    emulates_eeprom: false,
};

impl Servo {
    /// A plain CiA 402 drive.
    #[must_use]
    pub fn generic() -> Self {
        Self::new(GENERIC)
    }
}

/// A plain CiA 402 drive.
#[must_use]
pub fn generic() -> Device {
    Servo::generic().build()
}

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
//! | EEPROM | emulated by its processor, which needs it for PREOP (AL status code 0051h) | as the AKD, whose 0502h has bit 5 set |
//! | processor cycle | 1 ms | |
//! | units | counts, counts/s, counts/s² | |
//! | quick stop ramp | AXIS#.CS.DEC is 6085h | no page names the object |
//! | window of bit 10 | AXIS#.SETTLE.P is 6067h | no page names the object |
//! | `5000h:4` | bits 0 to 4, 11 and 15 by the maker's public help; a set-point counts as a motion task | the help names the bits |
//! | note of the user | `5F00h`, text of up to 4096 bytes | longer than the mailbox, so that it takes segmented transfers |
//! | mark of the user | `5F01h`: a number, a key that cannot be read, a place | a record of which a part cannot be read |

use super::generic::GENERIC;
use super::servo::{INPUTS, Memory, Model, OUTPUTS, Pdo, Servo};
use crate::description::Identity;
use crate::device::Device;
use crate::drive::AxisStatusObject;
use crate::ds402::Behaviour;
use crate::pdo::PdoLimits;

const MODEL: Model = Model {
    name: "AKD2G EtherCAT Drive (CoE)",
    order: "AKD2G",
    identity: Identity {
        vendor: 0x0000_006A,
        product: 0x414B_4432,
        revision: 1,
        serial: 0,
    },
    axes: 2,
    behaviour: Behaviour::akd2g,
    mailbox: (0x1800, 0x1C00, 1024),
    protocols: 0x000E,
    coe_details: 0x0D,
    outputs: Memory {
        start: 0x1100,
        control: 0x24,
    },
    inputs: Memory {
        start: 0x1200,
        control: 0x20,
    },
    rx_pdos: &[Pdo::assigned(0x1600, OUTPUTS)],
    tx_pdos: &[Pdo::assigned(0x1A00, INPUTS)],
    limits: PdoLimits {
        bytes: 64,
        entries: 16,
        assigned: 2,
    },
    fmmu_usage: &[1, 2, 3, 0xFF],
    // The AKD's SII begins with two categories of its maker, the order code and a version; its sync unit stands behind
    // the sync managers.
    other_categories: &[
        (0x0800, b"AKD2G simulated "),
        (0x0801, b"00-00-00-000"),
        (43, &[0xF0, 0xFF]),
    ],
    status_object: Some(AxisStatusObject {
        index: 0x5000,
        increment: 0x0100,
        subindex: 4,
    }),
    note: Some((0x5F00, 4096)),
    // Its own SII has a sync manager that triggers no watchdog.
    checks_watchdog: false,
    // As the AKD does: 0502h of a real one has bit 5 set.
    emulates_eeprom: true,
    ..GENERIC
};

impl Servo {
    /// An AKD2G as its documents describe it.
    #[must_use]
    pub fn akd2g() -> Self {
        Self::new(MODEL)
    }
}

/// An AKD2G with two axes.
#[must_use]
pub fn akd2g() -> Device {
    Servo::akd2g().build()
}

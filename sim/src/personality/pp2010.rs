//! The drive with object 2010h (Min_Profile_Velocity): a stepper drive of a maker that its page does not name.
//!
//! From its page on profile position mode: the objects of that mode and their types, up to two set-points, bits 4, 5, 10
//! and 12, linear ramps only, 6086h and 2010h mandatory. What its table of objects leaves out, the drive leaves out.
//! Assumed:
//!
//! | what | assumed | reason |
//! |---|---|---|
//! | identity | vendor 0, product 50502010h, revision 1 | unknown |
//! | device type | 00040192h, a stepper | a speed at which ramps start is of steppers |
//! | 2010h | counts/s, 0 at power-up; ramps start and end at it; a slower profile velocity runs without ramps | from its name |
//! | PDOs | 1600h and 1A00h, flexible in PREOP, 8 entries | |
//! | mapping at power-up | 6040h, 6060h, 607Ah, 6081h, 6083h, 6084h and 6041h, 6061h, 6064h | Profile Position with its parameters |
//! | modes | profile position and homing | |
//! | mailbox | 1000h and 1100h, 256 bytes each; SDO information, no complete access | |

use super::generic::GENERIC;
use super::servo::{Model, OUTPUTS, Pdo, Servo};
use crate::description::Identity;
use crate::device::Device;
use crate::ds402::Behaviour;
use crate::pdo::PdoLimits;

const MODEL: Model = Model {
    name: "Stepper drive with 2010h",
    order: "PP2010",
    identity: Identity {
        vendor: 0,
        product: 0x5050_2010,
        revision: 1,
        serial: 0,
    },
    device_type: 0x0004_0192,
    behaviour: Behaviour::pp2010,
    rx_pdos: &[Pdo::assigned(0x1600, OUTPUTS)],
    tx_pdos: &[Pdo::assigned(0x1A00, &[0x6041, 0x6061, 0x6064])],
    limits: PdoLimits {
        bytes: 64,
        entries: 8,
        assigned: 1,
    },
    coe_details: 0x0F,
    ..GENERIC
};

impl Servo {
    /// The drive with 2010h as its page describes it.
    #[must_use]
    pub fn pp2010() -> Self {
        Self::new(MODEL)
    }
}

/// The drive with 2010h.
#[must_use]
pub fn pp2010() -> Device {
    Servo::pp2010().build()
}

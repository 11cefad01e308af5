//! The Beckhoff AX2000: set-points, ramps and factors after its CANopen manual, pages 101 and 102, on EtherCAT.
//!
//! From the manual: 6086h with 0 and 1 and nothing else, kept in the EEPROM; single set-points, of which the next is taken
//! after arrival; a set of set-points, which goes on through the target where the ramps are linear; bits 4, 5 and 12;
//! that bit 5 chooses between the two is from page 102. Assumed:
//!
//! | what | assumed | reason |
//! |---|---|---|
//! | identity | vendor 00000002h (Beckhoff), product 41582000h, revision 1 | |
//! | CoE | the objects of the CANopen manual | the manual is of the CANopen drive |
//! | sin² ramps | the velocity follows sin² of the time; 6083h and 6084h are reached at the steepest point | the name |
//! | a single set-point while another runs | taken after arrival if bit 4 is still high, not acknowledged before | page 101 |
//! | factors | 6093h, 6094h, 6097h, as of DSP 402 v2 | page 69 of the manual |
//! | PDOs | 1600h and 1A00h, flexible in PREOP, 16 entries | |
//! | mapping at power-up | 6040h, 6060h, 607Ah, 6081h, 6083h, 6084h and 6041h, 6061h, 6064h, 606Ch | Profile Position with its parameters |
//! | modes | profile position, profile velocity, homing | |
//! | mailbox | 1000h and 1200h, 512 bytes each; neither SDO information nor complete access; 1010h saves, 1011h forgets | |

use super::generic::GENERIC;
use super::servo::{INPUTS, Model, OUTPUTS, Pdo, Servo};
use crate::description::Identity;
use crate::device::Device;
use crate::ds402::Behaviour;
use crate::pdo::PdoLimits;

const MODEL: Model = Model {
    name: "AX2000 servo drive",
    order: "AX2000",
    identity: Identity {
        vendor: 0x0000_0002,
        product: 0x4158_2000,
        revision: 1,
        serial: 0,
    },
    behaviour: Behaviour::ax2000,
    mailbox: (0x1000, 0x1200, 512),
    rx_pdos: &[Pdo::assigned(0x1600, OUTPUTS)],
    tx_pdos: &[Pdo::assigned(0x1A00, INPUTS)],
    limits: PdoLimits {
        bytes: 64,
        entries: 16,
        assigned: 1,
    },
    saves: true,
    coe_details: 0x0D,
    ..GENERIC
};

impl Servo {
    /// An AX2000 as its manual describes it.
    #[must_use]
    pub fn ax2000() -> Self {
        Self::new(MODEL)
    }
}

/// An AX2000.
#[must_use]
pub fn ax2000() -> Device {
    Servo::ax2000().build()
}

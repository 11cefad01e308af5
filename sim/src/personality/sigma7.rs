//! The Yaskawa Sigma-7 with EtherCAT: target, position limits and highest velocity after its page on 607Ah, 607Dh and
//! 607Fh.
//!
//! From the page: types, ranges, defaults, PDO mapping and EEPROM of the three; the limits less the home offset, in force
//! when homing is completed or with an absolute encoder, off where the minimum is not below the maximum. From its
//! maker's answers: 1600h to 1603h and 1A00h to 1A03h with up to 8 objects, of which two go on a sync manager. Assumed:
//!
//! | what | assumed | reason |
//! |---|---|---|
//! | identity | vendor 00000539h (Yaskawa), product 53474437h ("SGD7"), revision 1 | |
//! | encoder | incremental, unless the builder says absolute | then the limits wait for homing |
//! | home position | reads 607Ch with the other sign after homing | limits count from it and are corrected by taking 607Ch off; so do positions |
//! | a target outside the limits | the axis moves to the limit, bit 11 is set | the page says that it is checked |
//! | mapping at power-up | 1601h with 6040h and 607Ah, 1A01h with 6041h and 6064h; 1600h and 1A00h are for Profile Position | the mode is set by SDO |
//! | the rest | plain CiA 402 | |
//! | mailbox | 1000h and 1100h, 256 bytes each; SDO information and complete access; 1010h saves, 1011h forgets | |

use super::generic::GENERIC;
use super::servo::{INPUTS, Model, OUTPUTS, Pdo, Servo};
use crate::description::Identity;
use crate::device::Device;
use crate::ds402::Behaviour;
use crate::pdo::PdoLimits;

const MODEL: Model = Model {
    name: "SGD7S EtherCAT servo drive",
    order: "SGD7S",
    identity: Identity {
        vendor: 0x0000_0539,
        product: 0x5347_4437,
        revision: 1,
        serial: 0,
    },
    behaviour: Behaviour::sigma7,
    rx_pdos: &[
        Pdo::offered(0x1600, OUTPUTS),
        Pdo::assigned(0x1601, &[0x6040, 0x607A]),
        Pdo::offered(0x1602, &[0x6040, 0x6060]),
        Pdo::offered(0x1603, &[0x6040]),
    ],
    tx_pdos: &[
        Pdo::offered(0x1A00, INPUTS),
        Pdo::assigned(0x1A01, &[0x6041, 0x6064]),
        Pdo::offered(0x1A02, &[0x6041, 0x6061]),
        Pdo::offered(0x1A03, &[0x6041]),
    ],
    limits: PdoLimits {
        bytes: 64,
        entries: 8,
        assigned: 2,
    },
    saves: true,
    ..GENERIC
};

impl Servo {
    /// A Sigma-7 with an incremental encoder, as its page describes it.
    #[must_use]
    pub fn sigma7() -> Self {
        Self::new(MODEL)
    }
}

/// A Sigma-7 with an incremental encoder.
#[must_use]
pub fn sigma7() -> Device {
    Servo::sigma7().build()
}

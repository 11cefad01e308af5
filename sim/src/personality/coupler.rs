//! A plain coupler: it stands in the line, answers to its address, and has neither mailbox nor process data.

use core::time::Duration;

use crate::description::{Description, Identity};
use crate::device::{Blueprint, Device};

/// A coupler of no particular maker.
#[must_use]
pub fn coupler() -> Device {
    let identity = Identity {
        vendor: 0,
        product: 0x434F_5550,
        revision: 1,
        serial: 0,
    };
    Device::new(Blueprint {
        description: Description::new("Coupler", identity),
        drive: None,
        cycle: Duration::from_millis(1),
    })
}

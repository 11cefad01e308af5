//! One test for each pitfall of public DS402 masters, named after it: judged by the simulated drive's ledger and by
//! the words on the wire. `tests/mutants.toml` holds each defect, `cargo xtask mutants` shows that its test finds it.
#![allow(missing_docs)]

#[path = "../common/mod.rs"]
mod common;

#[cfg(feature = "std")]
mod by_sdo;
mod configuration;
mod handshake;
mod list;
mod set_points;
mod simulator;
mod states;
mod stops;

use common::Rig;
use servocrab_sim::ds402::Behaviour;

const BIT_4: u16 = 1 << 4;
const BIT_7: u16 = 1 << 7;
const BIT_8: u16 = 1 << 8;

/// How often `bit` rises in the words, in the order in which they were sent.
fn rises(words: &[u16], bit: u16) -> usize {
    words
        .windows(2)
        .filter(|pair| pair[0] & bit == 0 && pair[1] & bit != 0)
        .count()
}

/// An AKD2G that differs by `change`, in Operation enabled.
fn enabled(change: impl FnOnce(&mut Behaviour)) -> Rig {
    let mut behaviour = Behaviour::akd2g();
    change(&mut behaviour);
    let mut rig = Rig::new(behaviour, |_| {});
    rig.enable();
    rig
}

/// Target position 607Ah in the outputs.
fn target(rig: &Rig) -> i32 {
    i32::from_le_bytes(rig.outputs[3..7].try_into().expect("four bytes"))
}

//! The masters that are Rust.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use ethercrab::{PduStorage, std::tx_rx_task};
use servocrab::{
    DriveConfig, Network,
    bus::{AlState, BringUpStep, NetworkBuilder},
    drives,
};

use crate::stock_set_up::{in_op, main_device};

/// This library until all drives are in OP, until its start has returned, and until its first axis is enabled. Before OP all that motion
/// needs is read of all drives.
pub(crate) fn servocrab(interface: &str, drives: usize) -> Vec<Duration> {
    let begun = Instant::now();
    let op = Arc::new(Mutex::new(Duration::ZERO));
    let seen = Arc::clone(&op);
    let builder = builder(interface, drives).on_progress(move |progress| {
        if progress.step == BringUpStep::State(AlState::Op) {
            *seen.lock().expect("no listener panics") = begun.elapsed();
        }
    });
    let network = smol::block_on(builder.start()).expect("the line comes up");
    let started = begun.elapsed();
    let axis = network.axis("x0").expect("it was declared");
    smol::block_on(axis.enable()).expect("the axis is enabled");
    let enabled = begun.elapsed();
    smol::block_on(network.shutdown()).unwrap();
    let op = *op.lock().expect("no listener panics");
    vec![op, started, enabled]
}

fn builder(interface: &str, drives: usize) -> NetworkBuilder {
    let mut builder = Network::builder()
        .interface(interface)
        .cycle(Duration::from_millis(1));
    for position in 0..u16::try_from(drives).expect("fewer drives") {
        let drive = DriveConfig::new(drives::akd2g())
            .axis(format!("x{position}"))
            .axis(format!("y{position}"));
        builder = builder.drive(position, drive);
    }
    builder
}

const FRAMES: usize = 64;
const DATA: usize = PduStorage::element_size(1100);
static STORAGE: PduStorage<FRAMES, DATA> = PduStorage::new();

/// ethercrab as its examples use it, with its own transmit and receive task on a thread of its own, and with the mapping
/// that the drives have at power-up.
pub(crate) fn ethercrab(interface: &str, drives: usize) -> Vec<Duration> {
    let begun = Instant::now();
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let main_device = main_device(pdu_loop);
    let task = tx_rx_task(interface, tx, rx).expect("the interface is there");
    std::thread::spawn(move || smol::block_on(task));
    smol::block_on(in_op::<64>(&main_device, drives));
    vec![begun.elapsed()]
}

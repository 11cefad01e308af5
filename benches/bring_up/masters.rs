//! The masters that are Rust: from nothing to every drive in OP.

use std::time::{Duration, Instant};

use ethercrab::{PduStorage, std::tx_rx_task};
use servocrab::{
    bus::{DriveConfig, Network},
    drives,
};

use crate::stock_set_up::{in_op, main_device};

/// This library: mapping of both axes written and read back, parameters read, watchdog armed and verified.
pub(crate) fn servocrab(interface: &str, drives: usize) -> Duration {
    let begun = Instant::now();
    let mut builder = Network::builder()
        .interface(interface)
        .cycle(Duration::from_millis(1));
    for position in 0..u16::try_from(drives).expect("fewer drives") {
        let drive = DriveConfig::new(drives::akd2g())
            .axis(&format!("x{position}"))
            .axis(&format!("y{position}"));
        builder = builder.drive(position, drive);
    }
    let network = smol::block_on(builder.start()).expect("the line comes up");
    let took = begun.elapsed();
    smol::block_on(network.shutdown()).unwrap();
    took
}

const FRAMES: usize = 64;
const DATA: usize = PduStorage::element_size(1100);
static STORAGE: PduStorage<FRAMES, DATA> = PduStorage::new();

/// ethercrab as its examples use it, with its own transmit and receive task on a thread of its own, and with the mapping
/// that the drives have at power-up.
pub(crate) fn ethercrab(interface: &str, drives: usize) -> Duration {
    let begun = Instant::now();
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let main_device = main_device(pdu_loop);
    let task = tx_rx_task(interface, tx, rx).expect("the interface is there");
    std::thread::spawn(move || smol::block_on(task));
    smol::block_on(in_op::<64>(&main_device, drives));
    begun.elapsed()
}

//! The masters that are Rust: from nothing to every drive in OP, and this library's first enabled axis.

use std::{
    process::exit,
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
    time::{Duration, Instant},
};

use ethercrab::{PduStorage, std::tx_rx_task};
use servocrab::{
    DriveConfig, Network,
    bus::{AlState, BringUpStep, NetworkBuilder},
    drives,
};

use crate::stock_set_up::{in_op, main_device};

/// This library until all drives are in OP: mapping of both axes compared, defaults that the outputs overwrite read, watchdog armed and
/// verified. What only motion needs is read after that: the process ends with the time, so that hardly any of it is counted.
pub(crate) fn servocrab_to_op(interface: &str, drives: usize) -> ! {
    let begun = Instant::now();
    let left = AtomicUsize::new(drives);
    let builder = builder(interface, drives).on_progress(move |progress| {
        let in_op = progress.step == BringUpStep::State(AlState::Op);
        if in_op && left.fetch_sub(1, Relaxed) == 1 {
            println!("{}", begun.elapsed().as_secs_f64() * 1e3);
            exit(0);
        }
    });
    smol::block_on(builder.start()).expect("the line comes up");
    panic!("not all drives were reported in OP")
}

/// This library until its first axis is enabled: before that all that motion needs was read of all drives.
pub(crate) fn servocrab_to_enable(interface: &str, drives: usize) -> Duration {
    let begun = Instant::now();
    let network = smol::block_on(builder(interface, drives).start()).expect("the line comes up");
    let axis = network.axis("x0").expect("it was declared");
    smol::block_on(axis.enable()).expect("the axis is enabled");
    let took = begun.elapsed();
    smol::block_on(network.shutdown()).unwrap();
    took
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
pub(crate) fn ethercrab(interface: &str, drives: usize) -> Duration {
    let begun = Instant::now();
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let main_device = main_device(pdu_loop);
    let task = tx_rx_task(interface, tx, rx).expect("the interface is there");
    std::thread::spawn(move || smol::block_on(task));
    smol::block_on(in_op::<64>(&main_device, drives));
    begun.elapsed()
}

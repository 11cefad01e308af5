//! ethercrab as its examples use it: `tx_rx` in the thread, frames on a task of its own.

use std::thread;

use ethercrab::{
    PduStorage,
    std::{tx_rx_task, tx_rx_task_io_uring},
};

use crate::{
    measure::{cycles, serve},
    stock_set_up::{in_op, main_device},
};

const FRAMES: usize = 64;
/// Its task cuts frames that are longer than 1500 bytes with their Ethernet header.
const DATA: usize = PduStorage::element_size(1472);
static STORAGE: PduStorage<FRAMES, DATA> = PduStorage::new();

/// Brings the line up with the mapping that it has, and runs cycles as it is commanded.
pub(crate) fn ethercrab(interface: &str, axes: usize, uring: bool) {
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let main_device = main_device(pdu_loop);
    let interface = interface.to_owned();
    thread::spawn(move || {
        if uring {
            tx_rx_task_io_uring(&interface, tx, rx).expect("the interface is there");
        } else {
            let task = tx_rx_task(&interface, tx, rx).expect("the interface is there");
            smol::block_on(task).expect("it goes on");
        }
    });
    let drives = axes.div_ceil(2);
    let group = smol::block_on(in_op::<128>(&main_device, drives));
    serve(|mode, count| {
        cycles(mode, count, false, || {
            smol::block_on(group.tx_rx(&main_device)).expect("an exchange");
        })
    });
}

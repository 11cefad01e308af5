//! ethercrab as its examples use it: `tx_rx` in the thread, frames on a task of its own.

use std::{sync::Arc, thread, time::Duration};

use ethercrab::{
    MainDevice, MainDeviceConfig, PduStorage, Timeouts,
    std::{ethercat_now, tx_rx_task, tx_rx_task_io_uring},
};

use crate::measure::{cycles, serve};

const FRAMES: usize = 64;
/// Its task cuts frames that are longer than 1500 bytes with their Ethernet header.
const DATA: usize = PduStorage::element_size(1472);
static STORAGE: PduStorage<FRAMES, DATA> = PduStorage::new();

/// Brings the line up with the mapping that it has, and runs cycles as it is told.
pub(crate) fn ethercrab(interface: &str, axes: usize, uring: bool) {
    let (tx, rx, pdu_loop) = STORAGE.try_split().expect("split once");
    let patient = Duration::from_secs(5);
    let main_device = Arc::new(MainDevice::new(
        pdu_loop,
        Timeouts {
            pdu: patient,
            state_transition: 10 * patient,
            mailbox_response: patient,
            mailbox_echo: patient,
            eeprom: patient,
            ..Timeouts::default()
        },
        MainDeviceConfig {
            dc_static_sync_iterations: 0,
            ..MainDeviceConfig::default()
        },
    ));
    let interface = interface.to_owned();
    thread::spawn(move || {
        if uring {
            tx_rx_task_io_uring(&interface, tx, rx).expect("the interface is there");
        } else {
            let task = tx_rx_task(&interface, tx, rx).expect("the interface is there");
            smol::block_on(task).expect("it goes on");
        }
    });
    let group = smol::block_on(async {
        let group = main_device
            .init_single_group::<128, 4096>(ethercat_now)
            .await
            .expect("the line comes up");
        assert_eq!(group.len(), axes.div_ceil(2));
        let group = group.into_safe_op(&main_device).await.expect("SAFEOP");
        group.tx_rx(&main_device).await.expect("an exchange");
        let group = group.request_into_op(&main_device).await.expect("OP");
        while !group
            .tx_rx(&main_device)
            .await
            .expect("an exchange")
            .all_op()
        {}
        group
    });
    serve(|mode, count| {
        cycles(mode, count, false, || {
            smol::block_on(group.tx_rx(&main_device)).expect("an exchange");
        })
    });
}

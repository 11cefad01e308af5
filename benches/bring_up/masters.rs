//! The masters that are Rust: from nothing to every drive in OP.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use ethercrab::{
    MainDevice, MainDeviceConfig, PduStorage, Timeouts,
    std::{ethercat_now, tx_rx_task},
};
use servocrab::{
    bus::{DriveConfig, Network},
    drives,
};

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
    smol::block_on(network.shutdown());
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
    let task = tx_rx_task(interface, tx, rx).expect("the interface is there");
    std::thread::spawn(move || smol::block_on(task));
    smol::block_on(async {
        let group = main_device
            .init_single_group::<64, 4096>(ethercat_now)
            .await
            .expect("the line comes up");
        assert_eq!(group.len(), drives);
        // Nobody else gives it valid outputs for the watchdog's time.
        let group = group.into_safe_op(&main_device).await.expect("SAFEOP");
        group.tx_rx(&main_device).await.expect("an exchange");
        let group = group.request_into_op(&main_device).await.expect("OP");
        loop {
            let answer = group.tx_rx(&main_device).await.expect("an exchange");
            if answer.all_op() {
                break;
            }
        }
    });
    begun.elapsed()
}

//! ethercrab as its examples use it: settings, and from INIT to OP.

use ethercrab::{
    DefaultLock, MainDevice, MainDeviceConfig, PduLoop, SubDeviceGroup, Timeouts,
    std::ethercat_now, subdevice_group::Op,
};
use std::time::Duration;

/// One that waits for longer than anything here takes.
pub(crate) fn main_device(pdu_loop: PduLoop<'static>) -> MainDevice<'static> {
    let patient = Duration::from_secs(5);
    MainDevice::new(
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
    )
}

/// The line of so many drives in OP, with the mapping that they have at power-up.
pub(crate) async fn in_op<const DRIVES: usize>(
    main_device: &MainDevice<'_>,
    drives: usize,
) -> SubDeviceGroup<DRIVES, 4096, DefaultLock, Op> {
    let group = main_device
        .init_single_group::<DRIVES, 4096>(ethercat_now)
        .await
        .expect("the line comes up");
    assert_eq!(group.len(), drives);
    // Nobody else gives it valid outputs for the watchdog's time.
    let group = group.into_safe_op(main_device).await.expect("SAFEOP");
    group.tx_rx(main_device).await.expect("an exchange");
    let group = group.request_into_op(main_device).await.expect("OP");
    loop {
        let answer = group.tx_rx(main_device).await.expect("an exchange");
        if answer.all_op() {
            return group;
        }
    }
}

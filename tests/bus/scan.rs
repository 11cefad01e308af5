//! A line that is looked at and not configured.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    Network, NetworkError,
    bus::{AlState, BringUpStep, Line},
    coe::{SdoError, obj},
    link::Wire,
};
use servocrab_sim::{AlState as SimState, Blueprint, Device, Segment, personality};

use crate::rig::{datagrams, is_write_to};

/// A coupler with alias 7, a drive, a terminal without mailbox, a drive of two axes.
fn line() -> Arc<Mutex<Segment>> {
    let mut description = personality::coupler().description().clone();
    description.alias = 7;
    let coupler = Device::new(Blueprint {
        description,
        drive: None,
        cycle: Duration::from_millis(1),
    });
    let segment = Segment::new()
        .with(coupler)
        .with(personality::generic())
        .with(personality::io_terminal())
        .with(personality::akd2g());
    Arc::new(Mutex::new(segment))
}

fn scan(
    segment: &Arc<Mutex<Segment>>,
    spoil: impl Fn(&mut [u8]) + Send + 'static,
) -> Result<Line, NetworkError> {
    let shared = Arc::clone(segment);
    let wire = Wire::new(move |frame: &mut [u8], now| {
        spoil(frame);
        shared.lock().unwrap().process(frame, now)
    });
    smol::block_on(Network::builder().link(wire).scan())
}

fn states(segment: &Mutex<Segment>) -> Vec<SimState> {
    let segment = segment.lock().unwrap();
    segment.devices().iter().map(Device::al_state).collect()
}

#[test]
fn a_scan_tells_of_each_device_what_it_says_of_itself_and_reads_its_objects() {
    let segment = line();
    let line = scan(&segment, |_| {}).unwrap();
    let devices = line.devices();
    assert_eq!(devices.len(), 4);
    for (device, position) in devices.iter().zip(0..) {
        assert_eq!(device.id.position, position);
        assert!(device.problem.is_none(), "{:?}", device.problem);
        assert_eq!(device.found_in.state, AlState::Init);
        let sii = device.sii.as_ref().unwrap();
        assert_eq!(sii.identity, device.id.identity);
    }
    assert_eq!(states(&segment), [SimState::PreOp; 4]);
    let aliases: Vec<_> = devices.iter().map(|device| device.alias).collect();
    assert_eq!(aliases, [7, 0, 0, 0]);
    let with_coe: Vec<_> = devices.iter().map(|device| device.sdo.is_some()).collect();
    assert_eq!(with_coe, [false, true, false, true]);
    assert_eq!(devices[3].clock_bits, Some(64));
    // Categories that configuration passes over are there as well.
    let terminal = devices[2].sii.as_ref().unwrap();
    assert!(!terminal.tx_pdos.is_empty() || !terminal.rx_pdos.is_empty());
    assert!(!devices[3].sii.as_ref().unwrap().rx_pdos.is_empty());
    smol::block_on(async {
        for device in devices {
            let Some(sdo) = &device.sdo else { continue };
            let vendor = sdo.read(obj::VENDOR_ID).await.unwrap();
            assert_eq!(vendor, device.id.identity.vendor);
        }
        let (generic, akd2g) = (devices[1].sdo.clone(), devices[3].sdo.clone());
        let dictionary = generic.unwrap().dictionary().await.unwrap();
        assert!(dictionary.object(0x6041).is_some());
        let error = akd2g.unwrap().dictionary().await.unwrap_err();
        assert!(matches!(error.error, SdoError::NotSupported { .. }));
    });
    smol::block_on(line.close());
    assert_eq!(states(&segment), [SimState::Init; 4]);
}

#[test]
fn a_device_that_refuses_preop_is_told_apart_and_the_others_are_served() {
    let segment = line();
    // The request for PREOP of the second device becomes one for SAFEOP, which it refuses.
    let line = scan(&segment, |frame| {
        for datagram in datagrams(frame) {
            let to_second = datagram[2..4] == 0x1001u16.to_le_bytes();
            if is_write_to(datagram, 0x0120) && to_second && datagram[10] == 2 {
                datagram[10] = 4;
            }
        }
    })
    .unwrap();
    let broken = &line.devices()[1];
    let Some(NetworkError::Drive { drive, step, .. }) = &broken.problem else {
        panic!("{:?}", broken.problem);
    };
    assert_eq!(*step, BringUpStep::State(AlState::PreOp));
    assert_eq!((drive.position, &broken.id), (1, drive));
    assert!(broken.sdo.is_none());
    let last = line.devices()[3].sdo.clone().unwrap();
    assert!(smol::block_on(last.read(obj::VENDOR_ID)).is_ok());
    drop(line);
    assert_eq!(states(&segment), [SimState::Init; 4]);
    assert!(matches!(
        smol::block_on(last.read(obj::VENDOR_ID)).unwrap_err().error,
        SdoError::Closed { .. }
    ));
}

#[test]
fn a_line_without_devices_is_an_error() {
    let nobody = Arc::new(Mutex::new(Segment::new()));
    assert!(matches!(
        scan(&nobody, |_| {}),
        Err(NetworkError::NoSubDevice | NetworkError::NoAnswer)
    ));
    let without_link = smol::block_on(Network::builder().scan());
    assert!(matches!(without_link, Err(NetworkError::NoLink)));
}

#[test]
fn a_scan_that_is_given_up_leaves_its_link_free_and_the_devices_in_init() {
    let segment = line();
    let shared = Arc::clone(&segment);
    let wire = Wire::new(move |frame: &mut [u8], now| shared.lock().unwrap().process(frame, now));
    let mut scanning = Box::pin(Network::builder().link(wire).scan());
    let scanned = smol::block_on(smol::future::poll_once(&mut scanning));
    assert!(scanned.is_none());
    drop(scanning);
    assert_eq!(Arc::strong_count(&segment), 1, "the link is gone");
    assert_eq!(states(&segment), [SimState::Init; 4]);
}

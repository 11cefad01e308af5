//! What a user reads when a network does not start, word for word.

use std::time::Duration;

use servocrab::{
    DriveConfig, Network,
    bus::{DevicePlace, Expected, NetworkBuilder},
    drives,
    link::Wire,
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, akd2g, datagrams, is_write_to};

/// How the simulated drive is named in every message about it.
const DRIVE: &str = "drive 0 \"AKD2G\" (vendor 0000006Ah, product 414B4432h, revision 00000001h, serial 00000000h): ";

fn one_drive() -> Segment {
    Segment::new().with(personality::akd2g())
}

fn message(builder: NetworkBuilder) -> String {
    match Rig::start(builder) {
        Ok(_) => panic!("it was started"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn no_answer_and_no_subdevice() {
    let latency = Duration::from_micros(10);
    let silent = Wire::in_virtual_time(latency, |_, _| false);
    assert_eq!(
        message(Network::builder().link(silent).drive(0, akd2g())),
        "no frame came back: is the cable plugged in, and the first SubDevice powered?"
    );
    let empty = Wire::in_virtual_time(latency, |frame: &mut [u8], _| {
        frame[6] |= 2;
        true
    });
    assert_eq!(
        message(Network::builder().link(empty).drive(0, akd2g())),
        "no SubDevice answers on this link"
    );
    assert_eq!(
        message(Network::builder().drive(0, akd2g())),
        "no link was given: name an interface, or give a link"
    );
}

#[test]
fn an_sdo_transfer_after_the_shutdown() {
    let line = Line::new(one_drive());
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    rig.shutdown();
    let error = smol::block_on(sdo.read_bytes(0x6041, 0)).unwrap_err();
    assert_eq!(
        error.error.to_string(),
        "reading 6041h:00: nothing serves the mailbox of this device: its network was shut down or has ended, or it has no \
         mailbox"
    );
}

#[test]
fn an_al_state_that_is_refused_with_its_al_status_code() {
    // One byte more in sync manager 2 than the drive has mapped.
    let wire = Line::new(one_drive()).spoiled_wire(|frame| {
        for datagram in datagrams(frame) {
            if is_write_to(datagram, 0x0810) {
                datagram[12] += 1;
            }
        }
    });
    assert_eq!(
        message(Network::builder().link(wire).drive(0, akd2g())),
        format!(
            "{DRIVE}bringing it into SAFEOP: it refused and is in PREOP with AL status code 001Dh \
             (Invalid Output Configuration)"
        )
    );
}

#[test]
fn a_drive_whose_processor_stands_still() {
    // One whose processor does not serve the EEPROM.
    let mut segment = Segment::new().with(personality::generic());
    segment.device_mut(0).unwrap().freeze(true);
    // Its AL status is read all the time: with a slow wire less often.
    let wire = Wire::in_virtual_time(Duration::from_millis(2), move |frame: &mut [u8], now| {
        segment.process(frame, now)
    });
    let drive = DriveConfig::new(drives::generic()).axis("z");
    let said = message(Network::builder().link(wire).drive(0, drive));
    let why = "bringing it into PREOP: nothing happened within 3s: it is in INIT";
    assert!(said.ends_with(why), "{said}");
}

#[test]
fn a_line_that_is_not_the_expected_one_is_shown_beside_it() {
    let segment = Segment::new()
        .with(personality::coupler())
        .with(personality::generic())
        .with(personality::Servo::akd2g().serial(3).alias(7).build())
        .with(personality::io_terminal());
    let line = Line::new(segment);
    let mut generic = drives::generic();
    (generic.vendor, generic.product) = (Some(0), Some(0x4453_0402));
    let generic = DriveConfig::new(generic).axis("z");
    let builder = Network::builder()
        .link(line.wire())
        .expect(0, Expected::any())
        .drive(1, akd2g())
        .drive(2, generic)
        .expect(
            DevicePlace::Alias(9),
            Expected::new(0x2, 0x44C_2C52)
                .named("EK1100")
                .revision(0x11),
        )
        .complete();
    assert_eq!(
        message(builder),
        "the line is not the expected one, and nothing was configured:\n  \
         position  expected                                                   found                                                                              verdict\n  \
         0         any device                                                 Coupler (00000000h:434F5550h, revision 00000001h, serial 00000000h)                right\n  \
         1         AKD2G (0000006Ah:any)                                      CiA402 (00000000h:44530402h, revision 00000001h, serial 00000000h)                 swapped with position 2\n  \
         2         DS402 drive (00000000h:44530402h)                          AKD2G (0000006Ah:414B4432h, revision 00000001h, serial 00000003h, alias 7)         swapped with position 1\n  \
         3         -                                                          16 outputs, 16 inputs (00000000h:494F3136h, revision 00000001h, serial 00000000h)  extra\n  \
         -         alias 9: EK1100 (00000002h:044C2C52h, revision 00000011h)  -                                                                                  missing"
    );
}

//! What a bring-up costs: accesses to the SII and mails of one drive, and the time of a whole line of slow ones.

use std::time::Duration;

use servocrab::{
    bus::{DriveConfig, Network, NetworkBuilder},
    drives,
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig};

const SII: Duration = Duration::from_millis(1);
const MAILBOX: Duration = Duration::from_millis(2);

/// A line of two-axis drives with slow EEPROMs and mailboxes, and who wants them.
fn line_of(count: u16) -> (Line, NetworkBuilder) {
    let mut segment = Segment::new();
    for _ in 0..count {
        let mut device = personality::akd2g();
        device.set_sii_delay(SII);
        device.set_mailbox_delay(MAILBOX);
        segment.push(device);
    }
    let line = Line::new(segment);
    let mut builder = Network::builder().link(line.wire());
    for position in 0..count {
        let names = [format!("x{position}"), format!("y{position}")];
        let drive = DriveConfig::new(drives::akd2g())
            .axis(&names[0])
            .axis(&names[1]);
        builder = builder.drive(position, drive);
    }
    (line, builder)
}

/// Virtual time to OP, accesses to the SII and mails of the first drive.
fn bring_up(count: u16) -> (Duration, u32, u32) {
    let (line, builder) = line_of(count);
    let rig = Rig::start(builder).unwrap();
    let segment = line.segment();
    let device = segment.device(0).unwrap();
    let number = |count: u64| u32::try_from(count).unwrap();
    (
        rig.bus.now(),
        number(device.sii_accesses()),
        number(device.mails_taken()),
    )
}

#[test]
fn a_line_of_slow_drives_takes_hardly_longer_than_one_drives_own_accesses() {
    let (alone, sii, mails) = bring_up(1);
    let own = SII * sii + MAILBOX * mails;
    println!("one drive: {sii} SII accesses, {mails} mails, {own:?} of them, {alone:?} in all");
    for count in [8, 32] {
        let (all, sii_there, mails_there) = bring_up(count);
        println!("{count} drives: {all:?}");
        assert_eq!((sii_there, mails_there), (sii, mails));
        assert!(
            all <= own.mul_f64(1.15),
            "{count} drives: {all:?}, one's own accesses {own:?}"
        );
    }
    // Identity, mailbox, type, general, FMMU, sync managers; eight bytes each.
    assert!(sii <= 24, "{sii} accesses to the SII");
    // Both assignments and four PDOs, each with its number of entries: what is right already is not written. Of each axis
    // window, option codes 605Ah to 605Eh, velocity windows 606Dh to 6070h, supported modes, three parameters of the profile, six limits, and 6007h read, written and read back.
    let (mapping, axis) = (
        2 * (1 + 2) + 2 * (1 + 6) + 2 * (1 + 4),
        1 + 5 + 4 + 1 + 3 + 6 + 3,
    );
    assert_eq!(mails, mapping + 2 * axis);
}

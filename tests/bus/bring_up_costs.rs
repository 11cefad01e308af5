//! What a bring-up costs: accesses to the SII and messages of one drive, the time of a whole line of slow ones, and what is read when.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    DriveConfig, Network, NetworkError, Outcome, SetPoint,
    bus::{DriveFault, Recovered},
    coe::obj,
    drives,
    link::Wire,
    parameters::StartUpWrite,
};
use servocrab_sim::{AlState, Segment, personality};

use crate::rig::{Line, Rig, akd2g, datagrams};

const SII: Duration = Duration::from_millis(1);
const MAILBOX: Duration = Duration::from_millis(2);

/// Virtual time to OP and to the end of the start; accesses to the SII and messages of the first drive, of these what it took before OP.
struct Cost {
    to_op: Duration,
    in_all: Duration,
    sii: u32,
    mails_to_op: u32,
    messages: u32,
}

/// Brings up a line of two-axis drives with slow EEPROMs and mailboxes.
fn bring_up(count: u16) -> Cost {
    let mut segment = Segment::new();
    for _ in 0..count {
        let mut device = personality::akd2g();
        device.set_sii_delay(SII);
        device.set_mailbox_delay(MAILBOX);
        segment.push(device);
    }
    let line = Line::new(segment);
    let number = |count: u64| u32::try_from(count).unwrap();
    let in_op = Arc::new(Mutex::new(None));
    let (noted, shared) = (Arc::clone(&in_op), line.0.clone());
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let mut segment = shared.lock().unwrap();
        let comes_back = segment.process(frame, now);
        let mut devices = segment.devices().iter();
        if devices.all(|device| device.al_state() == AlState::Op) {
            let messages = segment.devices()[0].messages_taken();
            noted.lock().unwrap().get_or_insert((now, messages));
        }
        comes_back
    });
    let mut builder = Network::builder().link(wire);
    for position in 0..count {
        let names = [format!("x{position}"), format!("y{position}")];
        let drive = DriveConfig::new(drives::akd2g())
            .axis(&names[0])
            .axis(&names[1]);
        builder = builder.drive(position, drive);
    }
    let rig = Rig::start(builder).unwrap();
    let (to_op, mails_to_op) = in_op.lock().unwrap().unwrap();
    let segment = line.segment();
    let device = segment.device(0).unwrap();
    Cost {
        to_op,
        in_all: rig.bus.now(),
        sii: number(device.sii_accesses()),
        mails_to_op: number(mails_to_op),
        messages: number(device.messages_taken()),
    }
}

/// What a mail of this drive takes on the cable, there and back: its mailbox and what is around that, 80 ns a byte.
const ON_CABLE: Duration = Duration::from_nanos(2 * (14 + 2 + 12 + 1024 + 24) * 80);

#[test]
fn a_line_of_slow_drives_takes_hardly_longer_than_one_drives_own_accesses() {
    let alone = bring_up(1);
    for count in [1, 8, 32] {
        let cost = bring_up(count);
        let Cost { to_op, in_all, .. } = cost;
        println!("{count} drives: {to_op:?} to OP, {in_all:?} in all");
        assert_eq!(
            (cost.sii, cost.mails_to_op, cost.messages),
            (alone.sii, alone.mails_to_op, alone.messages)
        );
        // The devices are counted for 20 ms, the first cycles take some more.
        let own = SII * cost.sii + MAILBOX * cost.mails_to_op;
        assert!(
            to_op <= own.mul_f64(1.15) + Duration::from_millis(25),
            "{count} drives: {to_op:?} to OP, one's own accesses {own:?}"
        );
        // From then on all drives' messages share what the cycles leave of the cable.
        let behind = cost.messages - cost.mails_to_op;
        let rest = (MAILBOX * behind).max(ON_CABLE * behind * u32::from(count));
        let rest_takes = in_all - to_op;
        assert!(
            rest_takes <= rest.mul_f64(1.5),
            "{count} drives: {rest_takes:?} in OP, {rest:?} of messages"
        );
    }
    // Both assignments and four PDOs, each with its number of entries: what is right already is not written. Of each axis the three
    // parameters of the profile that the outputs overwrite. In OP of each axis the window, option codes 605Ah to 605Eh, velocity
    // windows 606Dh to 6070h, following error 6065h and 6066h, supported modes, the end velocity (since the last handle's drop stops an
    // axis that goes on at it), six limits, whether it is homed, and 6007h read, written and read back.
    let mapping = 2 * (1 + 2) + 2 * (1 + 6) + 2 * (1 + 4);
    assert_eq!(alone.mails_to_op, mapping + 2 * 3);
    let of_motion = 1 + 5 + 4 + 2 + 1 + 1 + 6 + 1 + 3;
    assert_eq!(alone.messages - alone.mails_to_op, 2 * of_motion);
}

#[test]
fn of_the_sii_nothing_is_read_that_configuration_does_not_need() {
    // Eight bytes each. Identity and mailbox; past two categories of its maker, the strings with its type, the beginning of the general
    // category, FMMU, sync managers. Nobody needs the rest of the general category, nor what is behind the sync managers.
    assert_eq!(bring_up(1).sii, 16);
}

/// An SDO request that the first drive took: whether it writes, the object, and the drive's AL state then.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Asked {
    pub(crate) writes: bool,
    pub(crate) index: u16,
    pub(crate) subindex: u8,
    state: AlState,
}

/// The mailbox of the AKD2G that the master writes.
const MAILBOX_OF_DRIVE: u16 = 0x1800;

/// A wire that notes all SDO requests to the first drive which begin a transfer.
pub(crate) fn asking_wire(line: &Line) -> (Wire, Arc<Mutex<Vec<Asked>>>) {
    let asked = Arc::new(Mutex::new(Vec::new()));
    let (noted, shared) = (Arc::clone(&asked), line.0.clone());
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let mut segment = shared.lock().unwrap();
        let state = segment.device(0).unwrap().al_state();
        let comes_back = segment.process(frame, now);
        for datagram in datagrams(frame) {
            let register = u16::from_le_bytes([datagram[4], datagram[5]]);
            let taken = datagram.ends_with(&[1, 0]);
            // CoE (type 3), SDO request (service 2); initiate upload (2) or download (1).
            if datagram[0] == 5
                && register == MAILBOX_OF_DRIVE
                && taken
                && datagram[15] & 0x0F == 3
                && datagram[17] >> 4 == 2
                && matches!(datagram[18] >> 5, 1 | 2)
            {
                noted.lock().unwrap().push(Asked {
                    writes: datagram[18] >> 5 == 1,
                    index: u16::from_le_bytes([datagram[19], datagram[20]]),
                    subindex: datagram[21],
                    state,
                });
            }
        }
        comes_back
    });
    (wire, asked)
}

/// What only motion needs: option codes, window, modes, limits, the end velocity, whether it is homed, 6007h.
const OF_MOTION: [u16; 13] = [
    0x5000, 0x6007, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6067, 0x606F, 0x607C, 0x607D, 0x6082,
    0x6502,
];
/// The defaults that the AKD2G's outputs overwrite.
const OVERWRITTEN: [u16; 3] = [0x6081, 0x6083, 0x6084];

#[test]
fn what_only_motion_needs_is_read_in_op_and_nothing_is_read_twice() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let (wire, asked) = asking_wire(&line);
    let rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    let asked = asked.lock().unwrap().clone();
    for request in &asked {
        let mapping = matches!(request.index, 0x1600..=0x1BFF | 0x1C12 | 0x1C13);
        let overwritten = [0, 0x0800]
            .iter()
            .any(|of_axis| OVERWRITTEN.contains(&(request.index.wrapping_sub(*of_axis))));
        let in_op = request.state == AlState::Op;
        assert_eq!(in_op, !(mapping || overwritten), "{request:04X?}");
    }
    for index in OF_MOTION {
        assert!(
            asked.iter().any(|request| request.index == index),
            "{index:04X}h is not read"
        );
    }
    for (place, request) in asked.iter().enumerate().filter(|(_, one)| !one.writes) {
        let same =
            |other: &&Asked| (other.index, other.subindex) == (request.index, request.subindex);
        // After a write it is read back.
        let before = asked[..place].iter().rfind(same);
        assert!(before.is_none_or(|before| before.writes), "{request:04X?}");
    }
    rig.shutdown();
}

#[test]
fn what_the_outputs_overwrite_is_read_before_they_do() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let (held, profile) = (123_456, SetPoint::new().acceleration(1_000_000));
    let list = StartUpWrite::new(obj::PROFILE_VELOCITY, held);
    let drive = akd2g().start_up(list);
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    let outcome = rig.until(async {
        let mode = axis.profile_position().await.unwrap();
        let motion = mode.move_abs(10_000, profile.deceleration(1_000_000)).await;
        motion.unwrap().done().await.unwrap()
    });
    assert!(matches!(outcome, Outcome::Reached { .. }));
    let segment = line.segment();
    let executed = segment.axis(0, 0).unwrap().ledger();
    assert_eq!(executed[0].velocity, held);
    drop(segment);
    rig.shutdown();
}

#[test]
fn a_drive_that_is_brought_up_again_is_read_before_its_axes_can_be_enabled() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let (wire, asked) = asking_wire(&line);
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    rig.loses_power(&line, 0);
    asked.lock().unwrap().clear();
    let recovered = rig.recover(0).unwrap();
    assert!(matches!(recovered, Recovered::BroughtUp { .. }));
    let asked = asked.lock().unwrap().clone();
    for index in OF_MOTION {
        let mut requests = asked.iter().filter(|request| request.index == index);
        let first = requests.next().map(|request| request.state);
        let before_op = matches!(first, Some(AlState::PreOp | AlState::SafeOp));
        assert!(before_op, "{index:04X}h: {first:?}");
    }
    // The outputs bring again what they have brought before.
    let overwritten = |request: &Asked| OVERWRITTEN.contains(&request.index);
    assert!(!asked.iter().any(overwritten));
}

#[test]
fn what_motion_needs_and_cannot_be_read_ends_the_start_with_the_object() {
    // 605Dh is there, and its reading is refused.
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let shared = line.0.clone();
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        for datagram in datagrams(frame) {
            let register = u16::from_le_bytes([datagram[4], datagram[5]]);
            // What is asked for has a subindex that does not answer: the drive aborts with another code than "no object".
            if datagram[0] == 5 && register == MAILBOX_OF_DRIVE && datagram[19..21] == [0x5D, 0x60]
            {
                // Command specifier 7: not known.
                datagram[18] = 0xE0;
            }
        }
        shared.lock().unwrap().process(frame, now)
    });
    let error = Rig::start(Network::builder().link(wire).drive(0, akd2g())).err();
    let error = error.expect("how the axis stops is not known");
    assert!(error.to_string().contains("605Dh"), "{error}");
    assert!(
        matches!(&error, NetworkError::Drive { error, .. } if matches!(**error, DriveFault::Sdo(_))),
        "{error:?}"
    );
    let mut segment = line.segment();
    assert_eq!(segment.device(0).unwrap().al_state(), AlState::Init);
    assert!(segment.axis_mut(0, 0).unwrap().ledger().is_empty());
}

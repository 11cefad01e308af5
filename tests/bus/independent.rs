//! Who asks something of the network does not wait for what somebody else has asked: deaf drives keep nobody else waiting.

use std::{
    future::Future,
    pin::pin,
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    bus::{DriveConfig, Network},
    coe::{SdoError, obj},
    drives,
    link::Fate,
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig, datagrams};

const MS: Duration = Duration::from_millis(1);
const DRIVES: u16 = 4;
/// The first of the port error counters.
const PORTS: u16 = 0x0300;

fn line() -> Line {
    Line::new((0..DRIVES).fold(Segment::new(), |segment, _| {
        segment.with(personality::akd2g())
    }))
}

fn declared(builder: servocrab::bus::NetworkBuilder) -> servocrab::bus::NetworkBuilder {
    (0..DRIVES).fold(builder, |builder, position| {
        let drive = DriveConfig::new(drives::akd2g());
        builder.drive(position, drive.axis(format!("{position}")))
    })
}

fn poll<T>(future: std::pin::Pin<&mut impl Future<Output = T>>) -> Poll<T> {
    future.poll(&mut Context::from_waker(Waker::noop()))
}

#[test]
fn reading_of_one_drive_takes_as_long_as_ever_while_others_are_deaf() {
    let line = line();
    let mut rig = Rig::start(declared(Network::builder().link(line.wire()))).unwrap();
    let reads = |rig: &mut Rig| {
        let sdo = rig.net().sdo(0).unwrap();
        let begun = rig.bus.now();
        for _ in 0..20 {
            rig.until(sdo.read(obj::PRODUCT_CODE)).unwrap();
        }
        rig.bus.now() - begun
    };
    let before = reads(&mut rig);
    // Their processors stand; what is sent to them stays in their mailboxes.
    for deaf in 1..usize::from(DRIVES) {
        line.segment().device_mut(deaf).unwrap().freeze(true);
    }
    let handles = (1..DRIVES).map(|position| rig.net().sdo(position).unwrap());
    let handles: Vec<_> = handles.collect();
    let many = handles
        .iter()
        .flat_map(|sdo| (0..8).map(|_| Box::pin(sdo.read(obj::PRODUCT_CODE))));
    let mut many: Vec<_> = many.collect();
    for read in &mut many {
        assert!(poll(read.as_mut()).is_pending());
    }
    rig.run_for(5 * MS);
    let beside = reads(&mut rig);
    for read in &mut many {
        assert!(poll(read.as_mut()).is_pending(), "nobody has answered them");
    }
    assert!(beside <= before + MS, "{before:?} alone, {beside:?} beside");
    for read in many {
        let error = rig.until(read).unwrap_err();
        assert!(matches!(error.error, SdoError::Timeout { .. }), "{error}");
    }
}

#[test]
fn a_black_box_and_a_way_back_do_not_wait_for_the_error_counters_of_the_ports() {
    let line = line();
    // Answers about the ports are lost, each time that they are asked for.
    let wire = line.wire_with(|_, frame| {
        let mut frame = frame.to_vec();
        let about_ports =
            |datagram: &&mut [u8]| datagram[0] == 1 && datagram[4..6] == PORTS.to_le_bytes();
        if datagrams(&mut frame).iter().any(about_ports) {
            Fate::LoseAnswer
        } else {
            Fate::Deliver
        }
    });
    let mut rig = Rig::start(declared(Network::builder().link(wire))).unwrap();
    let net = rig.net.take().unwrap();
    let mut ports = pin!(net.port_errors());
    assert!(poll(ports.as_mut()).is_pending());
    rig.run_for(5 * MS);
    let begun = rig.bus.now();
    let black_box = rig.until(net.black_box("0")).unwrap();
    assert_eq!(black_box.axis.axis, "0");
    rig.until(net.recover(1)).unwrap();
    let took = rig.bus.now() - begun;
    assert!(
        poll(ports.as_mut()).is_pending(),
        "it is still being asked for"
    );
    assert!(took < 20 * MS, "{took:?}");
    assert!(rig.until(ports).is_err(), "no frame came back");
}

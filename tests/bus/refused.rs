//! A link that does not take frames: too long ones from the beginning, or all of them from some time on.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
    time::Duration,
};

use servocrab::{Network, bus::NetworkEvent, link::Link};
use servocrab_sim::{Segment, personality};

use crate::{
    otherwise::Otherwise,
    rig::{Line, Rig, akd2g, turn_until},
};

const MS: Duration = Duration::from_millis(1);

/// A line of one drive, and how long frames may be that its link takes.
fn line() -> (Line, Arc<AtomicUsize>, Otherwise) {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let longest = Arc::new(AtomicUsize::new(usize::MAX));
    let taken = Arc::clone(&longest);
    let link = Otherwise::new(line.wire()).sends(move |wire, frame| {
        if frame.len() > taken.load(Relaxed) {
            return Err(io::ErrorKind::NetworkDown.into());
        }
        wire.send(frame)
    });
    (line, longest, link)
}

#[test]
fn frames_that_are_never_taken_end_the_bring_up_with_an_error() {
    let (_line, longest, link) = line();
    // What empties the FMMUs is longer, and so are messages.
    longest.store(100, Relaxed);
    let error = Rig::start(Network::builder().link(link).drive(0, akd2g())).err();
    let error = error.expect("there was no way to configure the drive");
    assert!(error.to_string().contains("no frame came back"), "{error}");
}

#[test]
fn an_interface_that_goes_down_under_way_is_told_and_counted_and_ends_in_order() {
    let (_line, longest, link) = line();
    let mut rig = Rig::start(Network::builder().link(link).drive(0, akd2g())).unwrap();
    let events = rig.net().events();
    rig.run_for(20 * MS);
    let before = rig.net().statistics();
    longest.store(0, Relaxed);
    rig.run_for(100 * MS);
    let after = rig.net().statistics();
    assert_eq!(
        after.not_sent - before.not_sent,
        after.cycles - before.cycles
    );
    // What was not sent is not lost on the cable.
    assert_eq!(after.lost, before.lost);
    assert!(matches!(events.try_next(), Some(NetworkEvent::Lost(_))));
    // Who asks for something meanwhile is told.
    let sdo = rig.net().sdo(0).unwrap();
    let asked = rig.bus.now();
    assert!(rig.until(sdo.read_bytes(0x1000, 0)).is_err());
    assert!(rig.bus.now() - asked < 5_000 * MS);
    // And what is up again goes on, for longer than it takes to see that its axes stand.
    longest.store(usize::MAX, Relaxed);
    rig.run_for(250 * MS);
    let told: Vec<_> = std::iter::from_fn(|| events.try_next()).collect();
    assert!(
        told.iter()
            .any(|event| matches!(event, NetworkEvent::Back(_))),
        "{told:?}"
    );
    rig.until(sdo.read_bytes(0x1000, 0)).unwrap();
    longest.store(0, Relaxed);
    let asked = rig.bus.now();
    let net = rig.net.take().unwrap();
    turn_until(&mut rig.bus, net.shutdown()).unwrap();
    assert!(rig.bus.now() - asked < 30_000 * MS);
}

#[test]
fn a_frame_that_is_taken_at_the_second_attempt_is_sent_once() {
    let (line, longest, link) = line();
    let mut rig = Rig::start(Network::builder().link(link).drive(0, akd2g())).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    rig.until(sdo.write_bytes(0x6081, 0, 1_000_u32.to_le_bytes().to_vec()))
        .unwrap();
    let messages = line.segment().devices()[0].messages_taken();
    let before = rig.net().statistics();
    let mut write = std::pin::pin!(sdo.write_bytes(0x6081, 0, 2_000_u32.to_le_bytes().to_vec()));
    longest.store(0, Relaxed);
    let waits = smol::block_on(smol::future::poll_once(&mut write));
    assert!(waits.is_none());
    rig.run_for(5 * MS);
    longest.store(usize::MAX, Relaxed);
    turn_until(&mut rig.bus, write).unwrap();
    assert_eq!(line.segment().devices()[0].messages_taken(), messages + 1);
    let after = rig.net().statistics();
    // Those of five cycles, and the mail.
    let not_sent = after.not_sent - before.not_sent;
    assert!((5..=7).contains(&not_sent), "{not_sent}");
    rig.shutdown();
}

//! How a network ends: no future is left waiting, and nothing is started on the way down.

use std::{
    future::Future,
    panic::{AssertUnwindSafe, catch_unwind},
    pin::{Pin, pin},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed},
    },
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    DriveConfig, Failure, Network, SetPoint,
    axis::AxisErrorKind,
    coe::SdoError,
    drives,
    link::{Fate, Link},
};
use servocrab_sim::{Segment, personality};
use smol::stream::StreamExt;

use crate::{
    otherwise::Otherwise,
    rig::{Line, Rig, akd2g},
};

const MS: Duration = Duration::from_millis(1);

fn one_drive() -> Line {
    Line::new(Segment::new().with(personality::akd2g()))
}

fn poll<T>(future: &mut Pin<&mut impl Future<Output = T>>) -> Poll<T> {
    future
        .as_mut()
        .poll(&mut Context::from_waker(Waker::noop()))
}

#[test]
fn a_bus_loop_that_panics_leaves_no_future_waiting() {
    let line = one_drive();
    let link = Otherwise::new(line.wire()).sends(|wire, frame| {
        let holds = wire.now() < Duration::from_secs(5);
        assert!(holds, "the link is broken");
        wire.send(frame)
    });
    let mut rig = Rig::start(Network::builder().link(link).drive(0, akd2g())).unwrap();
    let axis = rig.net().axis("x").unwrap();
    rig.until(axis.enable()).unwrap();
    let pp = rig.until(axis.profile_position()).unwrap();
    let set_point = SetPoint::new().velocity(1_000);
    let moved = rig.until(pp.move_abs(1_000_000, set_point)).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    let mut done = pin!(moved.done());
    assert!(poll(&mut done).is_pending());
    let mut bus = rig.bus;
    let died = catch_unwind(AssertUnwindSafe(move || while bus.turn() {}));
    assert!(died.is_err(), "the link has broken");
    let Poll::Ready(Err(error)) = poll(&mut done) else {
        panic!("the move still waits");
    };
    assert!(
        matches!(error.failure(), Some(Failure::BusLost { .. })),
        "{error}"
    );
    assert!(axis.status().lost);
    let mut read = pin!(sdo.read_bytes(0x1018, 1));
    assert!(matches!(poll(&mut read), Poll::Ready(Err(_))));
    let net = rig.net.take().unwrap();
    let mut over = pin!(net.shutdown());
    assert!(poll(&mut over).is_ready());
}

#[test]
fn a_bus_loop_that_is_dropped_leaves_no_future_waiting() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let axis = rig.net().axis("x").unwrap();
    let mut enabled = pin!(axis.enable());
    assert!(poll(&mut enabled).is_pending());
    rig.run_for(MS);
    drop(rig.bus);
    assert!(matches!(poll(&mut enabled), Poll::Ready(Err(_))));
}

#[test]
fn a_bring_up_whose_loop_is_dropped_ends_with_an_error() {
    let line = one_drive();
    let builder = Network::builder().link(line.wire()).drive(0, akd2g());
    let (starting, mut bus) = builder.split().unwrap();
    let mut network = pin!(starting.network());
    for _ in 0..100 {
        assert!(poll(&mut network).is_pending());
        assert!(bus.turn());
    }
    drop(bus);
    assert!(matches!(poll(&mut network), Poll::Ready(Err(_))));
}

#[test]
fn nothing_is_enabled_or_moved_any_more_once_the_network_ends() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let (x, y) = (rig.net().axis("x").unwrap(), rig.net().axis("y").unwrap());
    rig.until(x.enable()).unwrap();
    rig.until(y.enable()).unwrap();
    // It takes a second to stop: time enough for somebody else to begin anew on the other axis.
    let pp = rig.until(x.profile_position()).unwrap();
    let set_point = SetPoint::new()
        .velocity(100_000)
        .acceleration(1_000_000)
        .deceleration(100_000);
    let moved = rig.until(pp.move_abs(900_000, set_point)).unwrap();
    rig.run_for(300 * MS);
    let net = rig.net.take().unwrap();
    let mut over = pin!(net.shutdown());
    assert!(poll(&mut over).is_pending());
    rig.run_for(100 * MS);
    let mut again = pin!(y.enable());
    let mut refused = None;
    while rig.bus.turn() {
        if refused.is_none()
            && let Poll::Ready(result) = poll(&mut again)
        {
            refused = Some(result);
        }
        let segment = line.segment();
        let words = segment.axis(0, 1).unwrap().get(0x6040, 0).unwrap();
        assert!(
            refused.is_none() || words & 0x0F != 0x0F,
            "enabled on the way down"
        );
    }
    let error = refused.expect("it is answered").unwrap_err();
    assert!(
        matches!(
            error.kind,
            AxisErrorKind::Failed(Failure::BusLost { .. }) | AxisErrorKind::Closed
        ),
        "{error}"
    );
    assert!(poll(&mut over).is_ready());
    drop(moved);
}

#[test]
fn a_dead_line_of_eighty_drives_is_shut_down_as_soon_as_one_of_two() {
    let took = [2, 80].map(|drives| {
        let segment = (0..drives).map(|_| personality::generic());
        let line = Line::new(segment.fold(Segment::new(), Segment::with));
        let dead = Arc::new(AtomicBool::new(false));
        let is_dead = Arc::clone(&dead);
        let wire = line.wire_with(move |_, _| {
            if is_dead.load(Relaxed) {
                Fate::LoseRequest
            } else {
                Fate::Deliver
            }
        });
        let builder = Network::builder().link(wire);
        let builder = (0..drives).fold(builder, |builder, position| {
            let drive = DriveConfig::new(drives::generic()).axis(position.to_string());
            builder.drive(position, drive)
        });
        let mut rig = Rig::start(builder).unwrap();
        dead.store(true, Relaxed);
        // Till all are lost, and their states are being asked for.
        rig.run_for(500 * MS);
        let asked = rig.bus.now();
        let net = rig.net.take().unwrap();
        let mut over = pin!(net.shutdown());
        assert!(poll(&mut over).is_pending());
        while rig.bus.turn() {}
        assert!(poll(&mut over).is_ready());
        rig.bus.now() - asked
    });
    // Requests that nobody answers are given up after 120 ms, and 64 of them are on their way at once.
    assert!(took[1] <= took[0] + 500 * MS, "{took:?}");
    assert!(took[1] < Duration::from_secs(3), "{took:?}");
}

/// As on a thread of its own: what is waited for ends with the network, not with the loop's memory.
#[test]
fn what_a_program_in_virtual_time_waits_for_ends_with_the_network() {
    let line = one_drive();
    let frames = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&frames);
    let wire = line.wire_with(move |_, _| {
        counted.fetch_add(1, Relaxed);
        Fate::Deliver
    });
    let builder = Network::builder().link(wire).drive(0, akd2g());
    let (starting, mut bus) = builder.split().unwrap();
    let (mut of_all, mut of_one, sdo) = bus.run_until(async {
        let net = starting.network().await.unwrap();
        let of_all = net.all_emergencies();
        let of_one = net.emergencies(0).unwrap();
        let sdo = net.sdo(0).unwrap();
        net.shutdown().await.unwrap();
        (of_all.stream(), of_one.stream(), sdo)
    });
    let sent = frames.load(Relaxed);
    let polled = async |what: Pin<&mut dyn Future<Output = bool>>| {
        let for_ever = async {
            for _ in 0..20_000 {
                smol::future::yield_now().await;
            }
            false
        };
        smol::future::or(what, for_ever).await
    };
    bus.run_until(async {
        assert!(polled(pin!(async { of_all.next().await.is_none() })).await);
        assert!(polled(pin!(async { of_one.next().await.is_none() })).await);
        let read = async {
            let error = sdo.read_bytes(0x1018, 1).await.unwrap_err();
            matches!(error.error, SdoError::Closed { .. })
        };
        assert!(polled(pin!(read)).await);
    });
    assert_eq!(frames.load(Relaxed), sent, "there are no more turns");
}

/// The network has ended, whoever still has it and whatever they wait for.
#[test]
fn who_waits_for_events_learns_of_an_end_that_nobody_waited_for() {
    let line = one_drive();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, akd2g())).unwrap();
    let events = rig.net().events();
    {
        // As a program does that gives it a time which is over first.
        let mut over = pin!(rig.net().shutdown());
        assert!(poll(&mut over).is_pending());
    }
    while rig.bus.turn() {}
    drop(rig.bus);
    let mut changed = pin!(async {
        let axis = rig.net.as_ref().unwrap().axis("x").unwrap();
        while axis.changed().await.is_some() {}
    });
    assert!(poll(&mut changed).is_ready(), "an axis' changes have ended");
    let mut told = pin!(async { while events.next().await.is_some() {} });
    assert!(poll(&mut told).is_ready(), "and so have the events");
}

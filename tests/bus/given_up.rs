//! Starts that are dropped after each poll, or kept and not polled: nothing stays behind, and the next one works.

use std::{
    future::Future,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    Network, Outcome,
    bus::{BusLoop, DistributedClock, Expected, IoConfig, NetworkBuilder},
    drives,
};
use servocrab_sim::{AlState, Segment, ds402::State, personality};

use crate::rig::{Line, Rig, unhomed};

/// No way down takes longer: four states of a second each.
const END: Duration = Duration::from_secs(4);

/// A drive, and eight outputs.
fn line() -> Line {
    Line::new(
        Segment::new()
            .with(personality::generic())
            .with(personality::digital_outputs()),
    )
}

fn builder() -> NetworkBuilder {
    let drive = unhomed(drives::generic(), &["x"]);
    let valves = IoConfig::new("valves", Expected::new(0, 0x444F_3038));
    Network::builder().drive(0, drive).io(1, valves)
}

fn with_clock() -> NetworkBuilder {
    let drive = unhomed(drives::generic(), &["x"]).dc(DistributedClock::new(0x0300));
    let valves = IoConfig::new("valves", Expected::new(0, 0x444F_3038));
    Network::builder().drive(0, drive).io(1, valves)
}

fn poll<F: Future + ?Sized>(future: &mut Pin<Box<F>>) -> Poll<F::Output> {
    let mut context = Context::from_waker(Waker::noop());
    future.as_mut().poll(&mut context)
}

/// All devices are in INIT, and no axis has power or was asked for anything.
fn is_left(line: &Line, what: &str) {
    let segment = line.segment();
    for device in segment.devices() {
        assert_eq!(device.al_state(), AlState::Init, "{what}");
        for axis in device.axes() {
            assert_ne!(axis.state(), State::OperationEnabled, "{what}");
            assert!(axis.ledger().is_empty(), "{what}");
        }
    }
}

/// The line is brought up and moves, with a time that goes on from `begin`.
fn works(line: &Line, builder: fn() -> NetworkBuilder, begin: Duration, what: &str) {
    let mut rig = Rig::start(builder().link(line.wire_from(begin)))
        .unwrap_or_else(|error| panic!("{what}: {error}"));
    let target = rig.net().axis("x").unwrap().status().position + 500;
    let outcome = rig.moved("x", target);
    assert!(
        matches!(outcome, Outcome::Reached { position } if (position - target).abs() < 20),
        "{what}: {outcome:?}"
    );
    let executed = line.segment().axis(0, 0).unwrap().ledger().len();
    assert_eq!(executed, 1, "{what}");
    rig.shutdown();
}

fn turn_to_the_end(bus: &mut BusLoop, what: &str) {
    let limit = bus.now() + END;
    while bus.turn() {
        assert!(bus.now() < limit, "{what}: the loop goes on");
    }
}

/// Polls `network` so many times, with a turn after each; whether it was ready by then.
fn polled<T>(
    bus: &mut BusLoop,
    network: &mut Pin<Box<impl Future<Output = T>>>,
    polls: usize,
) -> Option<T> {
    for _ in 0..polls {
        if let Poll::Ready(ready) = poll(network) {
            return Some(ready);
        }
        assert!(bus.turn());
    }
    None
}

/// Drops a start after each `step`-th number of polls, for all numbers until it is ready; how many that takes.
fn drop_starts(builder: fn() -> NetworkBuilder, step: usize) -> usize {
    let mut polls = 0;
    loop {
        let line = line();
        let (starting, mut bus) = builder().link(line.wire()).split().unwrap();
        let mut network = Box::pin(starting.network());
        let started = polled(&mut bus, &mut network, polls);
        let what = format!("after {polls} polls");
        let ready = started.is_some();
        drop((network, started));
        turn_to_the_end(&mut bus, &what);
        is_left(&line, &what);
        let begin = bus.now();
        drop(bus);
        assert_eq!(Arc::strong_count(&line.0), 1, "{what}: the link is free");
        if ready || (polls / step).is_multiple_of(4) {
            works(&line, builder, begin, &what);
        }
        if ready {
            return polls;
        }
        polls += step;
    }
}

#[test]
fn a_start_is_dropped_after_every_poll_and_nothing_stays_behind() {
    let polls = drop_starts(builder, 1);
    assert!(polls > 100, "{polls}");
}

#[test]
fn a_start_is_dropped_while_the_clocks_are_set_and_nothing_stays_behind() {
    // Most of it is the time in which the clocks settle.
    let polls = drop_starts(with_clock, 499);
    assert!(polls > 5_000, "{polls}");
}

#[test]
fn a_start_is_kept_after_every_poll_and_its_drives_wait_without_power() {
    let mut polls = 0;
    loop {
        let line = line();
        let (starting, mut bus) = builder().link(line.wire()).split().unwrap();
        let mut network = Box::pin(starting.network());
        let what = format!("after {polls} polls");
        if polled(&mut bus, &mut network, polls).is_some() {
            break;
        }
        let until = bus.now() + END;
        while bus.now() < until {
            assert!(bus.turn(), "{what}");
        }
        for device in line.segment().devices() {
            assert_eq!(device.al_state(), AlState::Op, "{what}");
        }
        assert_ne!(axis_state(&line), State::OperationEnabled, "{what}");
        if polls % 2 == 0 {
            // Whoever takes it up again finds it ready.
            let Poll::Ready(Ok(net)) = poll(&mut network) else {
                panic!("{what}: it is not ready");
            };
            let net = Some(net);
            let mut rig = Rig { net, bus };
            assert!(
                matches!(rig.moved("x", 500), Outcome::Reached { .. }),
                "{what}"
            );
            rig.shutdown();
        } else {
            drop(network);
            turn_to_the_end(&mut bus, &what);
            is_left(&line, &what);
        }
        polls += 5;
    }
    assert!(polls > 100, "{polls}");
}

fn axis_state(line: &Line) -> State {
    line.segment().axis(0, 0).unwrap().state()
}

//! Programs that do with their futures whatever a program can: wakers that block, panic, call the library or drop its last `Network`, and
//! hundreds of tasks that wait. The cycles go on, and none of it runs on the bus thread.

mod many;
mod settings;
mod wakers;

use std::{
    future::Future,
    pin::Pin,
    sync::{Arc, Mutex},
    task::{Context, Poll, Waker},
    time::{Duration, Instant},
};

use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing, bus::NetworkBuilder, drives, link::Wire,
};
use servocrab_sim::{Segment, personality};

/// After so long something that is awaited is not coming. Nothing is measured by it.
const NEVER: Duration = Duration::from_secs(60);

/// One drive with an axis `x`, and its network, which is not started yet.
fn line() -> (Arc<Mutex<Segment>>, NetworkBuilder) {
    let segment = Arc::new(Mutex::new(Segment::new().with(personality::akd2g())));
    let wired = Arc::clone(&segment);
    let wire = Wire::new(move |frame: &mut [u8], now| wired.lock().unwrap().process(frame, now));
    (segment, builder().link(wire))
}

fn builder() -> NetworkBuilder {
    let drive = DriveConfig::new(drives::akd2g())
        .axis(AxisConfig::new("x").referencing(Referencing::AbsoluteEncoder));
    Network::builder()
        .watchdog(Duration::from_secs(2))
        .drive(0, drive)
}

fn started() -> (Arc<Mutex<Segment>>, Network) {
    let (segment, builder) = line();
    (segment, smol::block_on(builder.start()).unwrap())
}

/// Looks again and again until something is so.
fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < NEVER, "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Polls once, with this waker.
fn poll<F: Future + ?Sized>(future: &mut Pin<Box<F>>, waker: &Waker) -> Poll<F::Output> {
    future.as_mut().poll(&mut Context::from_waker(waker))
}

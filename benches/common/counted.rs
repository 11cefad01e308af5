//! What callgrind counts of a network in virtual time: its cycles, without the link and the segment behind it.

use std::{
    future::Future,
    hint, io,
    pin::{Pin, pin},
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    bus::BusLoop,
    link::{Link, Wire},
};

/// Neither what the link does nor the segment behind it counts.
pub(crate) struct Outside(pub(crate) Wire);

impl Link for Outside {
    #[inline(never)]
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        self.0.send(frame)
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        self.0.receive(buffer)
    }

    fn wait(&mut self, until: Duration) {
        self.0.wait(until);
    }

    #[inline(never)]
    fn now(&self) -> Duration {
        self.0.now()
    }

    fn waker(&self) -> Waker {
        self.0.waker()
    }
}

/// What this does counts.
pub(crate) fn counted(of: impl FnOnce()) {
    counting_begins();
    of();
    counting_ends();
}

/// Callgrind forgets what it has counted when this is called,
#[inline(never)]
fn counting_begins() {
    hint::black_box("begins");
}

/// and writes it down when this is.
#[inline(never)]
fn counting_ends() {
    hint::black_box("ends");
}

/// Polls it once.
pub(crate) fn poll<T>(future: Pin<&mut (impl Future<Output = T> + ?Sized)>) -> Poll<T> {
    future.poll(&mut Context::from_waker(Waker::noop()))
}

/// Turns the loop until this is done.
pub(crate) fn until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    loop {
        if let Poll::Ready(value) = poll(future.as_mut()) {
            return value;
        }
        assert!(bus.turn(), "the loop has ended");
    }
}

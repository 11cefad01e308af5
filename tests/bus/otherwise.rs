//! A link that does some of what a wire does otherwise.

use std::{io, task::Waker, time::Duration};

use servocrab::link::{Link, Wire};

type Sending = Box<dyn FnMut(&mut Wire, &[u8]) -> io::Result<()> + Send>;
type Waiting = Box<dyn FnMut(&mut Wire, Duration) + Send>;

/// A wire in all but what a test says of it.
pub(crate) struct Otherwise {
    wire: Wire,
    send: Sending,
    wait: Waiting,
}

impl Otherwise {
    pub(crate) fn new(wire: Wire) -> Self {
        Self {
            wire,
            send: Box::new(Wire::send),
            wait: Box::new(Wire::wait),
        }
    }

    /// This is how it sends.
    pub(crate) fn sends(
        self,
        send: impl FnMut(&mut Wire, &[u8]) -> io::Result<()> + Send + 'static,
    ) -> Self {
        let send = Box::new(send);
        Self { send, ..self }
    }

    /// This is how it waits.
    pub(crate) fn waits(self, wait: impl FnMut(&mut Wire, Duration) + Send + 'static) -> Self {
        let wait = Box::new(wait);
        Self { wait, ..self }
    }
}

impl Link for Otherwise {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        (self.send)(&mut self.wire, frame)
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        self.wire.receive(buffer)
    }

    fn wait(&mut self, until: Duration) {
        (self.wait)(&mut self.wire, until);
    }

    fn pause(&mut self) {
        self.wire.pause();
    }

    fn now(&self) -> Duration {
        self.wire.now()
    }

    fn is_virtual(&self) -> bool {
        self.wire.is_virtual()
    }

    fn waker(&self) -> Waker {
        self.wire.waker()
    }
}

//! How frames leave the process: a raw socket (AF_PACKET), or an in-process wire to a simulated segment.
//!
//! A link also owns the time that the bus loop goes by, so that a wire can run in virtual time.

mod raw;
mod wire;

use std::{io, task::Waker, time::Duration};

pub use raw::{RawSocket, RawSocketError};
pub use wire::{Fate, Wire};

/// The EtherType of EtherCAT.
pub(crate) const ETHERTYPE: u16 = 0x88A4;
/// The longest Ethernet frame without its checksum: 14 bytes of header, 1500 of payload.
pub(crate) const LONGEST_FRAME: usize = 1514;
/// The shortest Ethernet frame without its checksum (IEEE 802.3).
pub(crate) const SHORTEST_FRAME: usize = 60;

/// A way for Ethernet frames out of the process and back, and the clock that goes with it.
///
/// Nothing here blocks but [`wait`](Link::wait), and that only until its end, and [`prepare`](Link::prepare).
pub trait Link {
    /// Sends one Ethernet frame (without checksum). Shorter frames than 60 bytes are padded by the link.
    ///
    /// # Errors
    /// What the operating system says; `WouldBlock` if its queue is full, `NetworkDown` if the cable is out.
    fn send(&mut self, frame: &[u8]) -> io::Result<()>;

    /// Takes one received frame, if there is one, and gives its length. Longer frames than `buffer` are dropped.
    ///
    /// # Errors
    /// What the operating system says.
    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>>;

    /// Waits until a frame has come, the waker was used, or [`now`](Link::now) is `until`. It may return before that.
    fn wait(&mut self, until: Duration);

    /// Passes the time between two looks of a thread that does not sleep. In virtual time, some time must pass.
    fn pause(&mut self) {
        std::hint::spin_loop();
    }

    /// The time since an arbitrary moment. It never goes back.
    fn now(&self) -> Duration;

    /// Whether time passes in [`wait`](Link::wait) and [`pause`](Link::pause) alone, so that nothing comes late because the thread was
    /// kept elsewhere. Then what happens on the bus is logged at once, by the thread that turns the loop.
    fn is_virtual(&self) -> bool {
        false
    }

    /// Ends a [`wait`](Link::wait) early, from any thread.
    fn waker(&self) -> Waker;

    /// Makes ready for cycles, where that takes some milliseconds. Frames that are under way may be lost. A network calls it between two
    /// counts of its devices, when there are none.
    ///
    /// # Errors
    /// What the operating system refuses.
    fn prepare(&mut self) -> Result<(), RawSocketError> {
        Ok(())
    }
}

impl<L: Link + ?Sized> Link for Box<L> {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        (**self).send(frame)
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        (**self).receive(buffer)
    }

    fn wait(&mut self, until: Duration) {
        (**self).wait(until);
    }

    fn pause(&mut self) {
        (**self).pause();
    }

    fn now(&self) -> Duration {
        (**self).now()
    }

    fn is_virtual(&self) -> bool {
        (**self).is_virtual()
    }

    fn waker(&self) -> Waker {
        (**self).waker()
    }

    fn prepare(&mut self) -> Result<(), RawSocketError> {
        (**self).prepare()
    }
}

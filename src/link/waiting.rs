//! An eventfd as a waker, and `ppoll` on it together with a socket.
#![allow(unsafe_code)]

use std::{
    io,
    os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd},
    sync::Arc,
    task::{Wake, Waker},
    time::Duration,
};

/// Ends a `ppoll` from any thread.
pub(super) struct Event {
    fd: OwnedFd,
}

impl Event {
    pub(super) fn new() -> io::Result<Arc<Self>> {
        // SAFETY: eventfd takes no pointers; its result is checked before it is used as a descriptor.
        let fd = unsafe { libc::eventfd(0, libc::EFD_NONBLOCK | libc::EFD_CLOEXEC) };
        if fd < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the descriptor was just made, is valid and belongs to nobody else.
        let fd = unsafe { OwnedFd::from_raw_fd(fd) };
        Ok(Arc::new(Self { fd }))
    }

    pub(super) fn waker(self: &Arc<Self>) -> Waker {
        Waker::from(Arc::clone(self))
    }

    fn clear(&self) {
        let mut count = 0u64;
        // SAFETY: reads at most eight bytes into eight bytes that live until the call is over.
        // Failing (there was nothing to read) is of no consequence: the descriptor does not block.
        unsafe {
            libc::read(
                self.fd.as_raw_fd(),
                (&raw mut count).cast(),
                size_of::<u64>(),
            );
        }
    }
}

impl Wake for Event {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        let one = 1u64;
        // SAFETY: writes eight bytes from eight bytes that live until the call is over. It can only fail when the
        // counter is at its end, and then the descriptor is readable already.
        unsafe {
            libc::write(
                self.fd.as_raw_fd(),
                (&raw const one).cast(),
                size_of::<u64>(),
            );
        }
    }
}

/// Waits until `socket` is readable, the event was set, or `timeout` is over.
pub(super) fn wait(socket: Option<RawFd>, event: &Event, timeout: Duration) {
    let interest = |fd| libc::pollfd {
        fd,
        events: libc::POLLIN,
        revents: 0,
    };
    // A negative descriptor is passed over by ppoll.
    let mut descriptors = [
        interest(event.fd.as_raw_fd()),
        interest(socket.unwrap_or(-1)),
    ];
    let timeout = libc::timespec {
        tv_sec: libc::time_t::try_from(timeout.as_secs()).unwrap_or(libc::time_t::MAX),
        tv_nsec: timeout.subsec_nanos().into(),
    };
    // SAFETY: the array and the timespec live until the call is over, and the count is the array's own.
    // An error (a signal came) is the same as waking early.
    unsafe {
        libc::ppoll(
            descriptors.as_mut_ptr(),
            descriptors.len() as libc::nfds_t,
            &raw const timeout,
            std::ptr::null(),
        );
    }
    if descriptors.first().is_some_and(|d| d.revents != 0) {
        event.clear();
    }
}

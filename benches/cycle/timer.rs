//! Keeps the kernel's tick on one core.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use crate::measure::pin;

/// A timer on the masters' core that rings more often than the kernel's tick. Without one the kernel stops the tick each time that this
/// core is idle, and sets it again: in a virtual machine two exits to the host, which come and go with what else happens on the core.
pub(crate) struct Timer {
    over: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Timer {
    pub(crate) fn start(core: usize) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&over);
        let thread = thread::spawn(move || {
            pin(core);
            while !seen.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(1));
            }
        });
        Self {
            over,
            thread: Some(thread),
        }
    }
}

impl Drop for Timer {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().expect("it does nothing that fails");
        }
    }
}

//! Futures that wait for messages of the bus thread, by waiters in between.

use core::{
    future::{Future, poll_fn},
    pin::pin,
    sync::atomic::Ordering,
    task::{Context, Waker},
};
use std::{cell::Cell, sync::Arc, task::Wake};

use super::waiters::{Seat, Waiters, bit};

/// The channel of those who wait for messages.
const MESSAGES: u32 = 0;

thread_local! {
    /// Whether this thread polls a task of a bus.
    static ON_BUS: Cell<bool> = const { Cell::new(false) };
}

/// Polls a task of the bus: what it waits for wakes it by itself. It is no code of the program, and waits for none.
pub(crate) fn on_bus<T>(poll: impl FnOnce() -> T) -> T {
    let before = ON_BUS.replace(true);
    let result = poll();
    ON_BUS.set(before);
    result
}

impl Waiters {
    /// Does what this future does. Where it waits, on a channel of messages say, it leaves not the waker of its task but one that
    /// only rings.
    pub(crate) async fn relay<T>(self: &Arc<Self>, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        let mut seat = Seat::new(self, MESSAGES);
        let mut ringer = None;
        poll_fn(|context| {
            let is_direct = self.signal.over.load(Ordering::Relaxed);
            if ON_BUS.get() || (is_direct && ringer.is_none()) {
                return future.as_mut().poll(context);
            }
            // First this: what rings from now on wakes the task.
            seat.register(context);
            let ringer = ringer.get_or_insert_with(|| Waker::from(Arc::clone(self)));
            future.as_mut().poll(&mut Context::from_waker(ringer))
        })
        .await
    }
}

impl Wake for Waiters {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.ring_all(bit(MESSAGES));
    }
}

//! Where futures wait to be woken by the bus thread: a fixed number of places, no lock, no allocation.

use core::{
    future::poll_fn,
    sync::atomic::{AtomicU64, Ordering, fence},
    task::{Context, Poll},
};

use atomic_waker::AtomicWaker;

/// Places for wakers. A future that finds none free polls instead of sleeping: slower, never forgotten.
#[derive(Debug)]
pub(crate) struct Waiters {
    wakers: Box<[AtomicWaker]>,
    claimed: AtomicU64,
}

impl Waiters {
    /// `places` of them, at most 64.
    pub(crate) fn new(places: usize) -> Self {
        Self {
            wakers: (0..places.min(64)).map(|_| AtomicWaker::new()).collect(),
            claimed: AtomicU64::new(0),
        }
    }

    /// Wakes all that wait; to be called after what they wait for was stored.
    pub(crate) fn wake_all(&self) {
        stored();
        self.wake_claimed();
    }

    /// The same, to be called after [`stored`].
    #[inline]
    pub(crate) fn wake_claimed(&self) {
        let mut claimed = self.claimed.load(Ordering::Relaxed);
        while claimed != 0 {
            if let Some(waker) = self.wakers.get(claimed.trailing_zeros() as usize) {
                waker.wake();
            }
            claimed &= claimed - 1;
        }
    }

    /// Waits until `ready` gives a value.
    pub(crate) async fn until<T>(&self, mut ready: impl FnMut() -> Option<T>) -> T {
        let mut place = Place {
            waiters: self,
            index: None,
        };
        poll_fn(|cx| {
            if let Some(value) = ready() {
                return Poll::Ready(value);
            }
            place.register(cx);
            ready().map_or(Poll::Pending, Poll::Ready)
        })
        .await
    }

    fn claim(&self) -> Option<usize> {
        let before = self
            .claimed
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, |claimed| {
                let free = claimed.trailing_ones();
                ((free as usize) < self.wakers.len()).then(|| claimed | (1 << free))
            })
            .ok()?;
        Some(before.trailing_ones() as usize)
    }
}

/// To be called once between what was stored for others to wait for, whatever it was, and the waking of all of them.
#[inline]
pub(crate) fn stored() {
    // Pairs with the fence in `register`: either a place is seen claimed from here on, or its future sees what was stored.
    fence(Ordering::SeqCst);
}

struct Place<'a> {
    waiters: &'a Waiters,
    index: Option<usize>,
}

impl Place<'_> {
    fn register(&mut self, cx: &Context<'_>) {
        if self.index.is_none() {
            self.index = self.waiters.claim();
        }
        match self.index.and_then(|index| self.waiters.wakers.get(index)) {
            Some(waker) => waker.register(cx.waker()),
            None => cx.waker().wake_by_ref(),
        }
        fence(Ordering::SeqCst);
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        let Some(index) = self.index else { return };
        if let Some(waker) = self.waiters.wakers.get(index) {
            waker.take();
        }
        self.waiters
            .claimed
            .fetch_and(!(1 << index), Ordering::AcqRel);
    }
}

#[cfg(test)]
mod tests {
    use std::{
        sync::{
            Arc,
            atomic::{AtomicU32, Ordering},
        },
        thread,
    };

    use super::*;

    #[test]
    fn more_futures_than_places_are_all_woken() {
        let waiters = Arc::new(Waiters::new(2));
        let value = Arc::new(AtomicU32::new(0));
        let threads: Vec<_> = (0..5)
            .map(|_| {
                let (waiters, value) = (Arc::clone(&waiters), Arc::clone(&value));
                thread::spawn(move || {
                    for wanted in 1..=50 {
                        smol::block_on(
                            waiters
                                .until(|| (value.load(Ordering::Acquire) >= wanted).then_some(())),
                        );
                    }
                })
            })
            .collect();
        for n in 1..=50 {
            value.store(n, Ordering::Release);
            waiters.wake_all();
            thread::yield_now();
        }
        for thread in threads {
            thread.join().unwrap();
        }
        assert_eq!(
            waiters.claimed.load(Ordering::Relaxed),
            0,
            "every place was given back"
        );
    }
}

//! Where futures of the program wait for the bus thread.
//!
//! The bus thread says that something has come ([`Waiters::ring`]): it stores one bit, and touches neither a waker nor a lock. Another
//! thread wakes the futures, or the turn itself in virtual time: see [`Wakes`](super::Wakes).

use core::{
    future::poll_fn,
    task::{Context, Poll, Waker},
};
use std::sync::PoisonError;

use crate::sync::{Arc, AtomicBool, AtomicU64, Mutex, MutexGuard, Ordering, fence};

/// What all waiters of a network share with those who wake.
#[derive(Debug)]
pub(super) struct WakeSignal {
    /// Somebody has rung since it was looked at last.
    pub change: AtomicBool,
    /// Nobody looks any more: the thread that rings wakes as well.
    pub over: AtomicBool,
}

/// Futures that wait, as many as there are, each on one of 64 channels.
#[derive(Debug)]
pub(crate) struct Waiters {
    pub(super) signal: Arc<WakeSignal>,
    /// The channels on which somebody waits, one bit each.
    awaited: AtomicU64,
    /// The channels that were rung since their futures were woken last.
    rung: AtomicU64,
    /// Never locked by a thread that rings, and never while code of the program runs.
    places: Mutex<WaiterSlots>,
}

#[derive(Debug, Default)]
struct WaiterSlots {
    all: Vec<WaiterSlot>,
    free: Vec<usize>,
}

#[derive(Debug)]
struct WaiterSlot {
    channels: u64,
    waker: Option<Waker>,
}

impl WakeSignal {
    /// From now on the thread that rings wakes as well. Call this before the last look.
    pub fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
        fence(Ordering::SeqCst);
    }
}

impl Waiters {
    pub(super) fn new(signal: Arc<WakeSignal>) -> Self {
        Self {
            signal,
            awaited: AtomicU64::new(0),
            rung: AtomicU64::new(0),
            places: Mutex::new(WaiterSlots::default()),
        }
    }

    /// Rings where somebody waits on this channel; to be called after what they wait for was stored.
    #[inline]
    pub fn announce(&self, channel: u32) {
        stored();
        self.ring(channel);
    }

    /// The same, to be called after [`stored`].
    #[inline]
    pub fn ring(&self, channel: u32) {
        if self.awaited.load(Ordering::Relaxed) & bit(channel) != 0 {
            self.ring_all(bit(channel));
        }
    }

    /// Rings on all of these channels, whether anybody waits or not.
    pub fn ring_all(&self, channels: u64) {
        self.rung.fetch_or(channels, Ordering::Release);
        self.signal.change.store(true, Ordering::Release);
        // Pairs with the fence in `WakeSignal::end`: who looks for the last time sees what was rung, or it is seen here that nobody looks.
        fence(Ordering::SeqCst);
        if self.signal.over.load(Ordering::Relaxed) {
            let mut wakers = Vec::new();
            self.take_rung(&mut wakers);
            wakers.into_iter().for_each(Waker::wake);
        }
    }

    /// Takes the wakers of those who wait on a channel that was rung.
    pub(super) fn take_rung(&self, wakers: &mut Vec<Waker>) {
        if self.rung.load(Ordering::Relaxed) == 0 {
            return;
        }
        let rung = self.rung.swap(0, Ordering::AcqRel);
        let mut places = lock(&self.places);
        for place in &mut places.all {
            if place.channels & rung != 0 {
                wakers.extend(place.waker.take());
            }
        }
        self.awaited.fetch_and(!rung, Ordering::Relaxed);
    }

    /// Waits until `ready` gives a value: it is asked again whenever this channel was rung.
    pub async fn until<T>(&self, channel: u32, mut ready: impl FnMut() -> Option<T>) -> T {
        let mut seat = Seat::new(self, channel);
        poll_fn(|context| {
            if let Some(value) = ready() {
                return Poll::Ready(value);
            }
            seat.register(context);
            ready().map_or(Poll::Pending, Poll::Ready)
        })
        .await
    }
}

/// To be called once between what was stored for others to wait for, whatever it was, and the ringing for all of it.
#[inline]
pub(crate) fn stored() {
    // Pairs with the fence in `register`: either a channel is seen awaited from here on, or its future sees what was stored.
    fence(Ordering::SeqCst);
}

pub(super) fn bit(channel: u32) -> u64 {
    1 << (channel % u64::BITS)
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The place of one future.
pub(super) struct Seat<'a> {
    waiters: &'a Waiters,
    channels: u64,
    index: Option<usize>,
}

impl<'a> Seat<'a> {
    pub fn new(waiters: &'a Waiters, channel: u32) -> Self {
        Self {
            waiters,
            channels: bit(channel),
            index: None,
        }
    }

    /// Has this task woken when its channel is rung from now on.
    pub fn register(&mut self, context: &Context<'_>) {
        // A waker is the program's code: it is cloned and dropped outside of the lock.
        let waker = context.waker().clone();
        let before = {
            let mut places = lock(&self.waiters.places);
            let index = *self.index.get_or_insert_with(|| places.take());
            let before = places.all.get_mut(index).and_then(|place| {
                place.channels = self.channels;
                place.waker.replace(waker)
            });
            self.waiters
                .awaited
                .fetch_or(self.channels, Ordering::Relaxed);
            before
        };
        drop(before);
        fence(Ordering::SeqCst);
    }
}

impl WaiterSlots {
    /// A place that is nobody's.
    fn take(&mut self) -> usize {
        self.free.pop().unwrap_or_else(|| {
            self.all.push(WaiterSlot {
                channels: 0,
                waker: None,
            });
            self.all.len() - 1
        })
    }
}

impl Drop for Seat<'_> {
    fn drop(&mut self) {
        let Some(index) = self.index else { return };
        let waker = {
            let mut places = lock(&self.waiters.places);
            places.free.push(index);
            let place = places.all.get_mut(index);
            place.and_then(|place| place.waker.take())
        };
        drop(waker);
    }
}

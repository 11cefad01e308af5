//! Who wakes the program's futures: a thread of the library, `servocrab-wake`, and never the bus thread.
//!
//! A waker is code of the program. It may block, panic, or call whatever it likes of this library; on the bus thread it would stop the
//! cycles, and the drives by their watchdog. So the bus thread only rings ([`Waiters::ring`]), and hands over once a cycle what was rung
//! ([`Wakes::hand_over`]). In virtual time, which stands still meanwhile, the turn itself wakes.

#[cfg(test)]
mod tests;

mod waiters;

use core::future::{Future, poll_fn};
use core::mem;
use core::panic::AssertUnwindSafe;
use core::pin::pin;
use core::task::{Context, Waker};
use core::time::Duration;
use std::cell::Cell;
use std::panic::catch_unwind;
use std::sync::OnceLock;
use std::task::Wake;
use std::thread::Thread;
use std::time::Instant;
use std::{io, thread};

use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy_param,
};

use crate::sync::{Arc, AtomicBool, AtomicU64, Mutex, Ordering, fence};
use waiters::{Seat, WakeSignal, bit, lock};
pub(crate) use waiters::{Waiters, stored};

/// Futures that are woken at once as a rule.
const ROOM: usize = 256;
/// A waker that takes longer than this delays the others, which is reported.
const SLOW: Duration = Duration::from_millis(10);

/// Wakes the futures of a network, or of a program's own loop. Clones are the same.
#[derive(Debug, Clone)]
pub(crate) struct Wakes(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    signal: Arc<WakeSignal>,
    /// All that may be rung.
    waiters: Mutex<Vec<Arc<Waiters>>>,
    /// Room for those who are to be woken, so that a turn in virtual time allocates none.
    room: Mutex<Vec<Waker>>,
    /// None where the turns wake.
    thread: OnceLock<Thread>,
    began: Instant,
    /// Since when the waker is running that is running, in nanoseconds from `began`, and 1; 0 if none is.
    running_since: AtomicU64,
    slow: AtomicU64,
    longest_ns: AtomicU64,
    panicked: AtomicU64,
}

/// How the wakers of the program's futures behave. They run on a thread of their own: one that blocks delays the others, and nothing
/// else.
///
/// ```
/// use servocrab::bus::WakeStatistics;
/// let nothing_yet = WakeStatistics::default();
/// assert_eq!(nothing_yet.slow, 0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct WakeStatistics {
    /// Wakers that took longer than 10 ms, in which no other future was woken. One that is still running counts.
    pub slow: u64,
    /// The longest that a waker took. One that is still running counts.
    pub longest: Duration,
    /// Wakers that panicked: their futures may never be polled again, others are woken as usual.
    pub panicked: u64,
}

/// Held by the loop and dropped last: with it those who wait are woken for the last time.
#[derive(Debug)]
pub(crate) struct End(Wakes);

impl Wakes {
    fn new() -> Self {
        let signal = WakeSignal {
            change: AtomicBool::new(false),
            over: AtomicBool::new(false),
        };
        Self(Arc::new(Inner {
            signal: Arc::new(signal),
            waiters: Mutex::default(),
            room: Mutex::new(Vec::with_capacity(ROOM)),
            thread: OnceLock::new(),
            began: Instant::now(),
            running_since: AtomicU64::new(0),
            slow: AtomicU64::new(0),
            longest_ns: AtomicU64::new(0),
            panicked: AtomicU64::new(0),
        }))
    }

    /// For virtual time: [`hand_over`](Self::hand_over) wakes on its own thread.
    pub fn in_turn() -> (Self, End) {
        let wakes = Self::new();
        (wakes.clone(), End(wakes))
    }

    /// On a thread of its own, below the real-time priority that the bus thread is given; to be called before it has that.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(bus_priority: Option<u8>) -> io::Result<(Self, End)> {
        let wakes = Self::new();
        let served = wakes.clone();
        let thread = thread::Builder::new()
            .name("servocrab-wake".into())
            .spawn(move || {
                stay_below(bus_priority);
                served.serve();
            })?;
        // It was made here and holds nothing.
        let _ = wakes.0.thread.set(thread.thread().clone());
        Ok((wakes.clone(), End(wakes)))
    }

    /// Somewhere to wait.
    pub fn waiters(&self) -> Arc<Waiters> {
        let waiters = Arc::new(Waiters::new(Arc::clone(&self.0.signal)));
        lock(&self.0.waiters).push(Arc::clone(&waiters));
        waiters
    }

    /// Has those woken for whom was rung. To be called once in each turn; it costs a look where nobody was.
    #[inline]
    pub fn hand_over(&self) {
        if self.0.signal.change.load(Ordering::Relaxed) {
            self.wake();
        }
    }

    #[inline(never)]
    fn wake(&self) {
        // Taken before what was rung is looked at.
        self.0.signal.change.swap(false, Ordering::AcqRel);
        match self.0.thread.get() {
            Some(thread) => thread.unpark(),
            None => self.wake_rung(),
        }
    }

    /// On the thread that wakes.
    fn serve(&self) {
        loop {
            let over = self.0.signal.over.load(Ordering::Acquire);
            fence(Ordering::SeqCst);
            self.wake_rung();
            if over {
                return;
            }
            thread::park();
        }
    }

    fn wake_rung(&self) {
        let mut wakers = mem::take(&mut *lock(&self.0.room));
        let mut gone = Vec::new();
        {
            let mut all = lock(&self.0.waiters);
            let mut at = 0;
            while let Some(waiters) = all.get(at) {
                waiters.take_rung(&mut wakers);
                if Arc::strong_count(waiters) == 1 {
                    gone.push(all.swap_remove(at));
                } else {
                    at += 1;
                }
            }
        }
        if !gone.is_empty() {
            // With what futures that were never dropped have left behind.
            self.run(|| drop(gone));
        }
        for waker in wakers.drain(..) {
            self.run(|| waker.wake());
        }
        *lock(&self.0.room) = wakers;
    }

    /// Runs code of the program.
    fn run(&self, code: impl FnOnce()) {
        let inner = &*self.0;
        let since = inner.began.elapsed();
        let ns = nanoseconds(since);
        inner
            .running_since
            .store(ns.saturating_add(1), Ordering::Relaxed);
        if let Err(panic) = catch_unwind(AssertUnwindSafe(code)) {
            inner.panicked.fetch_add(1, Ordering::Relaxed);
            // It may panic as well.
            let _ = catch_unwind(AssertUnwindSafe(|| drop(panic))).map_err(mem::forget);
        }
        let took = inner.began.elapsed().saturating_sub(since);
        inner.running_since.store(0, Ordering::Relaxed);
        inner
            .longest_ns
            .fetch_max(nanoseconds(took), Ordering::Relaxed);
        if took > SLOW {
            inner.slow.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// What has become of the wakers so far.
    pub fn statistics(&self) -> WakeStatistics {
        let inner = &*self.0;
        let since = inner.running_since.load(Ordering::Relaxed);
        let running = match since.checked_sub(1) {
            Some(since) => nanoseconds(inner.began.elapsed()).saturating_sub(since),
            None => 0,
        };
        let running = Duration::from_nanos(running);
        let longest = Duration::from_nanos(inner.longest_ns.load(Ordering::Relaxed));
        WakeStatistics {
            slow: inner.slow.load(Ordering::Relaxed) + u64::from(running > SLOW),
            longest: longest.max(running),
            panicked: inner.panicked.load(Ordering::Relaxed),
        }
    }
}

impl Waiters {
    /// Those of a loop that has no bus thread: the thread that rings wakes.
    pub fn direct() -> Arc<Self> {
        let signal = WakeSignal {
            change: AtomicBool::new(false),
            over: AtomicBool::new(true),
        };
        Arc::new(Self::new(Arc::new(signal)))
    }
}

impl Drop for End {
    fn drop(&mut self) {
        self.0.0.signal.end();
        self.0.wake();
    }
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// A program that starts its network on a thread of a real-time class may mean what is woken as well, but never above the cycles. A
/// waker that computes would keep the bus thread from its processor.
fn stay_below(bus_priority: Option<u8>) {
    if let Ok((ThreadSchedulePolicy::Realtime(_), of)) =
        thread_schedule_policy_param(thread_native_id())
        && bus_priority.is_none_or(|bus| of.sched_priority >= i32::from(bus))
    {
        // Nobody is refused a lower class.
        let _ = set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Min,
            ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other),
        );
    }
}

// Futures that wait for messages of the bus thread, by waiters in between.

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
    pub async fn relay<T>(self: &Arc<Self>, future: impl Future<Output = T>) -> T {
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

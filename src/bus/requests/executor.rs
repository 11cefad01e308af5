//! The futures on the bus thread. Unlike a general executor, scheduling one allocates nothing: a task is queued at most
//! once, and the queue has a place for each.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    future::{Future, poll_fn},
    pin::pin,
    rc::Rc,
    sync::Arc,
    task::{Context, Poll, Waker},
    time::Duration,
};

use async_task::{Runnable, Task};
use crossbeam_queue::{ArrayQueue, SegQueue};

use crate::wakes::on_bus;

/// More tasks than a line has: one for the network, two for each drive.
const PLACES: usize = 1024;

/// Polls futures on one thread; they are woken from any.
pub(in crate::bus) struct Tasks {
    ready: Arc<Ready>,
    /// Of the tasks that are not over, by their numbers. A waker keeps the memory of its task.
    wakers: Rc<RefCell<BTreeMap<u64, Waker>>>,
    begun: Cell<u64>,
}

/// Held by a task's future: with that its waker goes.
struct Begun {
    number: u64,
    wakers: Rc<RefCell<BTreeMap<u64, Waker>>>,
}

impl Drop for Begun {
    fn drop(&mut self) {
        let waker = self.wakers.borrow_mut().remove(&self.number);
        drop(waker);
    }
}

struct Ready {
    queue: ArrayQueue<Runnable>,
    /// Allocates, but loses nothing.
    overflow: SegQueue<Runnable>,
}

impl Tasks {
    pub fn new() -> Self {
        Self {
            ready: Arc::new(Ready {
                queue: ArrayQueue::new(PLACES),
                overflow: SegQueue::new(),
            }),
            wakers: Rc::default(),
            begun: Cell::default(),
        }
    }

    /// Begins a task.
    pub fn spawn<T: 'static>(&self, future: impl Future<Output = T> + 'static) -> Task<T> {
        let ready = Arc::clone(&self.ready);
        let schedule = move |runnable| {
            if let Err(runnable) = ready.queue.push(runnable) {
                ready.overflow.push(runnable);
            }
        };
        let number = self.begun.get();
        self.begun.set(number.wrapping_add(1));
        let begun = Begun {
            number,
            wakers: Rc::clone(&self.wakers),
        };
        let future = async move {
            let _begun = begun;
            future.await
        };
        let (runnable, task) = async_task::spawn_local(future, schedule);
        self.wakers.borrow_mut().insert(number, runnable.waker());
        runnable.schedule();
        task
    }

    /// Polls one task that is ready; false if there is none.
    pub fn poll_one(&self) -> bool {
        let Some(runnable) = self.ready.next() else {
            return false;
        };
        on_bus(|| runnable.run());
        true
    }
}

impl Ready {
    fn next(&self) -> Option<Runnable> {
        // To take from an empty queue costs a fence of the processor.
        if self.queue.is_empty() && self.overflow.is_empty() {
            return None;
        }
        self.queue.pop().or_else(|| self.overflow.pop())
    }
}

impl Drop for Tasks {
    /// Drops all futures, on their own thread.
    fn drop(&mut self) {
        for waker in self.wakers.take().into_values() {
            waker.wake();
        }
        while let Some(runnable) = self.ready.next() {
            drop(runnable);
        }
    }
}

// The time that acyclic futures live in: what the link's clock said at the start of the loop's turn.

/// Room for sleepers, so that none allocates: more than the tasks of a long line.
const SLEEPERS: usize = 1024;

/// The loop's time and the futures that sleep until a moment of it.
pub(in crate::bus) struct Time {
    now: Cell<Duration>,
    next_sleeper: Cell<u64>,
    /// When the next sleeper may be woken, or one that is gone might have been;
    due: Cell<Option<Duration>>,
    /// and when the next one is to be.
    next: Cell<Option<Duration>>,
    sleepers: RefCell<Vec<Sleeper>>,
}

struct Sleeper {
    number: u64,
    until: Duration,
    /// It is woken with a turn that there is for other reasons.
    patient: bool,
    waker: Waker,
}

impl Default for Time {
    fn default() -> Self {
        Self {
            now: Cell::default(),
            next_sleeper: Cell::default(),
            due: Cell::default(),
            next: Cell::default(),
            sleepers: RefCell::new(Vec::with_capacity(SLEEPERS)),
        }
    }
}

impl Time {
    pub fn now(&self) -> Duration {
        self.now.get()
    }

    /// Moves on to `now` and wakes whose time has come.
    pub fn advance(&self, now: Duration) {
        self.now.set(now);
        if self.due.get().is_none_or(|due| now < due) {
            return;
        }
        self.due.set(None);
        self.next.set(None);
        self.sleepers.borrow_mut().retain(|sleeper| {
            let asleep = sleeper.until > now;
            if asleep {
                self.count(sleeper.until, sleeper.patient);
            } else {
                sleeper.waker.wake_by_ref();
            }
            asleep
        });
    }

    /// Takes in until when somebody sleeps.
    fn count(&self, until: Duration, patient: bool) {
        let sooner = |than: Option<Duration>| Some(than.map_or(until, |than| than.min(until)));
        self.due.set(sooner(self.due.get()));
        if !patient {
            self.next.set(sooner(self.next.get()));
        }
    }

    /// When [`advance`](Self::advance) is to be called at the latest.
    pub fn next(&self) -> Option<Duration> {
        self.next.get()
    }

    pub fn sleep(self: &Rc<Self>, duration: Duration) -> Sleep {
        self.sleep_for(duration, false)
    }

    /// The same until the first turn of the loop that comes then: a millisecond or a cycle later at the most. It costs no timer and
    /// wakes no thread.
    pub fn rest(self: &Rc<Self>, duration: Duration) -> Sleep {
        self.sleep_for(duration, true)
    }

    fn sleep_for(self: &Rc<Self>, duration: Duration, patient: bool) -> Sleep {
        let number = self.next_sleeper.get();
        self.next_sleeper.set(number.wrapping_add(1));
        Sleep {
            time: Rc::clone(self),
            number,
            until: self.now().saturating_add(duration),
            patient,
        }
    }

    /// Polls `future` until it is ready or `limit` is over; then it is dropped, within the poll.
    pub async fn within<T>(
        self: &Rc<Self>,
        limit: Duration,
        future: impl Future<Output = T>,
    ) -> Option<T> {
        let mut sleep = self.sleep(limit);
        let mut future = pin!(future);
        poll_fn(|context| {
            if let Poll::Ready(value) = future.as_mut().poll(context) {
                return Poll::Ready(Some(value));
            }
            sleep.poll_until(context).map(|()| None)
        })
        .await
    }
}

/// Ready when its time has come.
pub(in crate::bus) struct Sleep {
    time: Rc<Time>,
    number: u64,
    until: Duration,
    patient: bool,
}

impl Sleep {
    fn poll_until(&mut self, context: &Context<'_>) -> Poll<()> {
        if self.time.now() >= self.until {
            return Poll::Ready(());
        }
        let mut sleepers = self.time.sleepers.borrow_mut();
        match sleepers.iter_mut().find(|s| s.number == self.number) {
            Some(sleeper) => sleeper.waker.clone_from(context.waker()),
            None => {
                sleepers.push(Sleeper {
                    number: self.number,
                    until: self.until,
                    patient: self.patient,
                    waker: context.waker().clone(),
                });
                self.time.count(self.until, self.patient);
            }
        }
        Poll::Pending
    }
}

impl Future for Sleep {
    type Output = ();

    fn poll(mut self: std::pin::Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        self.poll_until(context)
    }
}

impl Drop for Sleep {
    fn drop(&mut self) {
        self.time
            .sleepers
            .borrow_mut()
            .retain(|s| s.number != self.number);
    }
}

#[cfg(test)]
mod tests {
    use std::{
        cell::Cell,
        future::{pending, poll_fn},
        rc::Rc,
        task::Poll,
    };

    use super::Tasks;

    #[test]
    fn each_task_is_polled_when_it_was_woken_and_not_otherwise() {
        let tasks = Tasks::new();
        let polls = Rc::new(Cell::new(0));
        let seen = Rc::clone(&polls);
        let waiting = tasks.spawn(poll_fn(move |_| {
            seen.set(seen.get() + 1);
            Poll::<()>::Pending
        }));
        assert!(tasks.poll_one());
        assert!(!tasks.poll_one());
        let other = tasks.spawn(async { 7 });
        while tasks.poll_one() {}
        assert!(other.is_finished() && !waiting.is_finished());
        assert_eq!(polls.get(), 1);
    }

    #[test]
    fn nothing_is_kept_of_a_task_that_is_over_or_was_given_up() {
        let tasks = Tasks::new();
        let waiting = tasks.spawn(pending::<()>());
        for _ in 0..100 {
            tasks.spawn(async {}).detach();
            drop(tasks.spawn(pending::<()>()));
            while tasks.poll_one() {}
        }
        assert_eq!(tasks.wakers.borrow().len(), 1);
        drop(waiting);
        while tasks.poll_one() {}
        assert_eq!(tasks.wakers.borrow().len(), 0);
    }

    #[test]
    fn with_the_tasks_all_their_futures_are_dropped() {
        let held = Rc::new(());
        let tasks = Rc::new(Tasks::new());
        let (inner, weak) = (Rc::clone(&held), Rc::downgrade(&tasks));
        tasks
            .spawn(async move {
                let _inner = inner;
                let _weak = weak;
                pending::<()>().await;
            })
            .detach();
        while tasks.poll_one() {}
        assert_eq!(Rc::strong_count(&held), 2);
        drop(tasks);
        assert_eq!(Rc::strong_count(&held), 1);
    }
}

#[cfg(test)]
mod time_tests {
    use std::{future::pending, rc::Rc, time::Duration};

    use smol::LocalExecutor;

    use super::Time;

    #[test]
    fn a_future_that_is_never_ready_ends_at_its_limit_and_not_before() {
        let time = Rc::new(Time::default());
        let executor = LocalExecutor::new();
        let task = executor.spawn({
            let time = Rc::clone(&time);
            async move { time.within(Duration::from_millis(5), pending::<()>()).await }
        });
        for ms in 0..5 {
            time.advance(Duration::from_millis(ms));
            while executor.try_tick() {}
            assert!(!task.is_finished());
        }
        assert_eq!(time.next(), Some(Duration::from_millis(5)));
        time.advance(Duration::from_millis(5));
        while executor.try_tick() {}
        assert!(task.is_finished());
        assert_eq!(time.next(), None);
    }

    #[test]
    fn who_rests_asks_for_no_turn_and_is_woken_with_the_first_one_that_comes() {
        let time = Rc::new(Time::default());
        let executor = LocalExecutor::new();
        let ms = Duration::from_millis;
        let resting = executor.spawn({
            let time = Rc::clone(&time);
            async move { time.rest(ms(5)).await }
        });
        let sleeping = executor.spawn({
            let time = Rc::clone(&time);
            async move { time.sleep(ms(7)).await }
        });
        while executor.try_tick() {}
        assert_eq!(time.next(), Some(ms(7)));
        time.advance(ms(4));
        while executor.try_tick() {}
        assert!(!resting.is_finished());
        time.advance(ms(6));
        while executor.try_tick() {}
        assert!(resting.is_finished() && !sleeping.is_finished());
        assert_eq!(time.next(), Some(ms(7)));
        time.advance(ms(7));
        while executor.try_tick() {}
        assert!(sleeping.is_finished());
        assert_eq!(time.next(), None);
    }
}

//! The time that acyclic futures live in: what the link's clock said at the start of the loop's turn.

use std::{
    cell::{Cell, RefCell},
    future::{Future, poll_fn},
    pin::pin,
    rc::Rc,
    task::{Context, Poll, Waker},
    time::Duration,
};

/// Room for sleepers, so that none allocates: more than the tasks of a long line.
const SLEEPERS: usize = 1024;

/// The loop's time and the futures that sleep until a moment of it.
pub(super) struct Time {
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
    pub(super) fn now(&self) -> Duration {
        self.now.get()
    }

    /// Moves on to `now` and wakes whose time has come.
    pub(super) fn advance(&self, now: Duration) {
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
    pub(super) fn next(&self) -> Option<Duration> {
        self.next.get()
    }

    pub(super) fn sleep(self: &Rc<Self>, duration: Duration) -> Sleep {
        self.sleep_for(duration, false)
    }

    /// The same until the first turn of the loop that comes then: a millisecond or a cycle later at the most. It costs no timer and
    /// wakes no thread.
    pub(super) fn rest(self: &Rc<Self>, duration: Duration) -> Sleep {
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
    pub(super) async fn within<T>(
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
pub(super) struct Sleep {
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

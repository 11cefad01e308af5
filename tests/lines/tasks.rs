//! Futures that are polled when they were woken, and the virtual time that they sleep in.

use std::{
    cell::{Cell, RefCell},
    future::{Future, poll_fn},
    pin::Pin,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, Wake, Waker},
    time::Duration,
};

/// The time of the bus loop.
#[derive(Clone, Default)]
pub struct Clock(Rc<Inner>);

#[derive(Default)]
struct Inner {
    now: Cell<Duration>,
    sleepers: RefCell<Vec<(Duration, Waker)>>,
}

impl Clock {
    pub fn now(&self) -> Duration {
        self.0.now.get()
    }

    pub fn set(&self, now: Duration) {
        self.0.now.set(now);
        self.0.sleepers.borrow_mut().retain(|(until, waker)| {
            let waits = *until > now;
            if !waits {
                waker.wake_by_ref();
            }
            waits
        });
    }

    pub async fn sleep(&self, time: Duration) {
        let until = self.now() + time;
        poll_fn(|context| {
            if self.now() >= until {
                return Poll::Ready(());
            }
            let mut sleepers = self.0.sleepers.borrow_mut();
            sleepers.push((until, context.waker().clone()));
            Poll::Pending
        })
        .await;
    }

    /// The outcome, unless it takes longer: then the future is dropped.
    pub async fn within<T>(&self, time: Duration, future: impl Future<Output = T>) -> Option<T> {
        let late = async {
            self.sleep(time).await;
            None
        };
        smol::future::or(async { Some(future.await) }, late).await
    }
}

struct Flag(AtomicBool);

impl Wake for Flag {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Release);
    }
}

struct Task<'a> {
    name: String,
    future: Pin<Box<dyn Future<Output = ()> + 'a>>,
    woken: Arc<Flag>,
}

/// What the programs of a scenario do at the same time.
#[derive(Default)]
pub struct Tasks<'a>(Vec<Task<'a>>);

impl<'a> Tasks<'a> {
    pub fn spawn(&mut self, name: impl Into<String>, future: impl Future<Output = ()> + 'a) {
        self.0.push(Task {
            name: name.into(),
            future: Box::pin(future),
            woken: Arc::new(Flag(AtomicBool::new(true))),
        });
    }

    /// Polls all that were woken.
    pub fn poll(&mut self) {
        self.0.retain_mut(|task| {
            if !task.woken.0.swap(false, Ordering::AcqRel) {
                return true;
            }
            let waker = Waker::from(Arc::clone(&task.woken));
            let mut context = Context::from_waker(&waker);
            task.future.as_mut().poll(&mut context).is_pending()
        });
    }

    /// Those that are not over.
    pub fn names(&self) -> Vec<&str> {
        self.0.iter().map(|task| task.name.as_str()).collect()
    }

    pub fn are_over(&self) -> bool {
        self.0.is_empty()
    }
}

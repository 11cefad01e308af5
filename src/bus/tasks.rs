//! The futures on the bus thread. Unlike a general executor, scheduling one allocates nothing: a task is queued at most
//! once, and the queue has a place for each.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    future::Future,
    rc::Rc,
    sync::Arc,
    task::Waker,
};

use async_task::{Runnable, Task};
use crossbeam_queue::{ArrayQueue, SegQueue};

use crate::wakes::on_bus;

/// More tasks than a line has: one for the network, two for each drive.
const PLACES: usize = 1024;

/// Polls futures on one thread; they are woken from any.
pub(super) struct Tasks {
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
    pub(super) fn new() -> Self {
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
    pub(super) fn spawn<T: 'static>(&self, future: impl Future<Output = T> + 'static) -> Task<T> {
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
    pub(super) fn poll_one(&self) -> bool {
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

//! The thread that makes events of notes.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::Ordering, mpsc},
    thread,
    time::Duration,
};

use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};
use tracing::{Dispatch, dispatcher, subscriber::NoSubscriber};

use super::{Log, Queue, ROOM};
use crate::bus::NetworkError;

/// How often it looks without being woken: on a bus that is too busy for gaps nobody wakes it.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How long the end of a network waits for the last lines.
const LAST_LINES: Duration = Duration::from_secs(1);

/// The other end of a [`Log`]: a thread of the network's own. It ends with the network, once all is written.
pub(in crate::bus) struct Writer {
    queue: Arc<Queue>,
    /// Fails once the thread is gone.
    gone: mpsc::Receiver<()>,
}

impl Writer {
    /// To be called where the program starts the network, before the bus thread takes a real-time class, which a thread would inherit.
    /// The events go to the subscriber that is the default here.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] if the system gives no thread.
    pub(in crate::bus) fn start() -> Result<(Log, Self), NetworkError> {
        let queue = Arc::new(Queue::new(ROOM));
        let (alive, gone) = mpsc::channel();
        let subscriber = Subscriber::current();
        let notes = Arc::clone(&queue);
        let thread = thread::Builder::new()
            .name("servocrab-log".into())
            .spawn(move || {
                leave_real_time();
                subscriber.of(|| write_all(&notes));
                drop(alive);
            })
            .map_err(|error| NetworkError::Thread(error.to_string()))?;
        // It was made here and holds nothing.
        let _ = queue.thread.set(thread.thread().clone());
        Ok((Log(Some(Arc::clone(&queue))), Self { queue, gone }))
    }

    /// Waits until all is written, but not for a subscriber that blocks: the thread is left to itself then, writes the rest when it
    /// can, and ends.
    pub(in crate::bus) fn end(self) {
        self.close();
        let _ = self.gone.recv_timeout(LAST_LINES);
    }

    fn close(&self) {
        self.queue.over.store(true, Ordering::Release);
        self.queue.wake();
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.close();
    }
}

fn write_all(queue: &Queue) {
    loop {
        let over = queue.over.load(Ordering::Acquire);
        // A subscriber that panics has cost the line that it was given, and no other one.
        while catch_unwind(AssertUnwindSafe(|| queue.write())).is_err() {}
        if over {
            return;
        }
        thread::park_timeout(LOOK_EVERY);
    }
}

/// A program that starts a network on a thread of a real-time class does not mean its log: at the bus thread's priority it would keep
/// that from its cycles.
fn leave_real_time() {
    if let Ok(ThreadSchedulePolicy::Realtime(_)) = thread_schedule_policy() {
        // Nobody is refused a lower class.
        let _ = set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Min,
            ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other),
        );
    }
}

/// To whom the events of a network's threads go.
#[derive(Clone)]
pub(in crate::bus) struct Subscriber(Dispatch);

impl Subscriber {
    /// The default of this thread.
    pub(in crate::bus) fn current() -> Self {
        Self(dispatcher::get_default(Clone::clone))
    }

    /// Does something with it as the default. A program that has none yet may set one for all threads later.
    pub(in crate::bus) fn of<T>(&self, what: impl FnOnce() -> T) -> T {
        if self.0.is::<NoSubscriber>() {
            return what();
        }
        dispatcher::with_default(&self.0, what)
    }
}

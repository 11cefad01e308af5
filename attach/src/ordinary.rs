//! The scheduling class of the server's thread. Threads inherit that of their maker, which may be a real-time one.

use std::{
    io,
    sync::{
        Mutex, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, channel, sync_channel},
    },
    thread::{self, JoinHandle},
    time::Instant,
};

use rustix::process::{getpriority_process, setpriority_process};
use thread_priority::{
    Error, NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};

use crate::AttachError;

/// The nice value 0, on the scale of `thread-priority`.
const NICE_0: u8 = 48;

/// A thread that runs in no real-time class, whoever has started it.
#[derive(Debug)]
pub(crate) struct OrdinaryThread {
    thread: JoinHandle<()>,
    /// Fails once its work is over. Behind a lock, which nobody waits for, so that tasks can share what has this.
    over: Mutex<Receiver<()>>,
}

impl OrdinaryThread {
    /// # Errors
    /// What is made of that of the operating system, where it gives no thread; [`AttachError::Scheduling`] where the thread cannot leave
    /// its class.
    pub fn start(
        name: &str,
        failed: impl FnOnce(io::Error) -> AttachError,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<Self, AttachError> {
        let (alive, over) = channel();
        let (ordinary, is_ordinary) = sync_channel(1);
        let thread = thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                // Dropped last, also where the work panics.
                let _alive = alive;
                let work = work;
                let scheduled = schedule();
                let goes_on = scheduled.is_ok();
                // Who has started it waits for it.
                let _ = ordinary.send(scheduled);
                if goes_on {
                    work();
                }
            })
            .map_err(failed)?;
        match is_ordinary.recv() {
            Ok(Err(error)) => Err(AttachError::Scheduling(error)),
            _ => Ok(Self {
                thread,
                over: Mutex::new(over),
            }),
        }
    }

    /// Waits until its work is over, but no longer than until then: the thread is left to itself after that.
    pub fn end(self, until: Instant) -> ThreadEnd {
        let left = until.saturating_duration_since(Instant::now());
        let over = self
            .over
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner);
        match over.recv_timeout(left) {
            Err(RecvTimeoutError::Timeout) => ThreadEnd::StillAtWork,
            _ => match self.thread.join() {
                Ok(()) => ThreadEnd::Over,
                Err(_) => ThreadEnd::Panicked,
            },
        }
    }
}

/// How a thread was found at its end.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum ThreadEnd {
    Over,
    Panicked,
    StillAtWork,
}

/// Takes the calling thread out of a real-time class; any other thread stays as it is.
fn schedule() -> io::Result<()> {
    if !is_real_time()? {
        return Ok(());
    }
    let nice = getpriority_process(None)?;
    let ordinary = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
    let priority = NICE_0.try_into().map_err(io::Error::other)?;
    let priority = ThreadPriority::Crossplatform(priority);
    let done = set_thread_priority_and_policy(thread_native_id(), priority, ordinary);
    // That call sets a nice value too; a thread that was better served than others may lose that.
    let _ = setpriority_process(None, nice);
    // What counts is the class, whatever became of the nice value.
    match (is_real_time()?, done) {
        (false, _) => Ok(()),
        (true, Err(error)) => Err(said(error)),
        (true, Ok(())) => Err(io::Error::other("the class has stayed")),
    }
}

fn is_real_time() -> io::Result<bool> {
    let policy = thread_schedule_policy().map_err(said)?;
    Ok(matches!(policy, ThreadSchedulePolicy::Realtime(_)))
}

fn said(error: Error) -> io::Error {
    match error {
        Error::OS(number) => io::Error::from_raw_os_error(number),
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn the_end_of_a_thread_is_waited_for_no_longer_than_is_said() {
        let start = |work: Box<dyn FnOnce() + Send>| {
            OrdinaryThread::start("test", AttachError::Scheduling, work).unwrap()
        };
        let generous = || Instant::now() + Duration::from_secs(60);
        let (go_on, waits) = channel::<()>();
        let blocked = start(Box::new(move || {
            let _ = waits.recv();
        }));
        assert_eq!(blocked.end(Instant::now()), ThreadEnd::StillAtWork);
        drop(go_on);
        assert_eq!(start(Box::new(|| {})).end(generous()), ThreadEnd::Over);
        let panics = start(Box::new(|| {
            std::panic::resume_unwind(Box::new("as it is meant to"))
        }));
        assert_eq!(panics.end(generous()), ThreadEnd::Panicked);
    }

    #[test]
    fn an_ordinary_thread_stays_as_it_is_and_the_scale_has_nice_0_where_it_is_expected() {
        let before = getpriority_process(None).unwrap();
        schedule().unwrap();
        assert_eq!(getpriority_process(None).unwrap(), before);
        let priority = ThreadPriority::Crossplatform(NICE_0.try_into().unwrap());
        let ordinary = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
        assert_eq!(priority.to_posix(ordinary).unwrap(), 0);
    }
}

//! The scheduling class of the server's thread. Threads inherit that of their maker, which may be a real-time one.

use std::io;

use rustix::process::{getpriority_process, setpriority_process};
use thread_priority::{
    Error, NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};

/// The nice value 0, on the scale of `thread-priority`.
const NICE_0: u8 = 48;

/// Takes the calling thread out of a real-time class; any other thread stays as it is.
pub(crate) fn schedule() -> io::Result<()> {
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
    use super::*;

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

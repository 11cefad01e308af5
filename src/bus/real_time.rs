//! What a bus thread gets of the operating system so that its cycles come on time: all of it opt-in.

use std::{fmt, io, thread};

use rustix::{
    mm::{MlockAllFlags, mlockall},
    process::{Resource, Rlimit, getrlimit, setrlimit},
    thread::{CapabilitySet, CpuSet, capabilities, sched_getaffinity, sched_setaffinity},
};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// Real time for the bus thread: scheduling class and priority, processors, locked memory. Nothing unless asked for.
///
/// Whatever the system refuses is an error that says why and what to change; nothing is left out in silence. The command
/// `servocrab doctor` looks at a machine beforehand.
///
/// ```no_run
/// use servocrab::{Network, bus::{RealTime, Scheduling}};
/// let builder = Network::builder().interface("eth0").real_time(
///     RealTime::new()
///         .scheduling(Scheduling::Fifo(80))
///         .processors([3])
///         .lock_memory(),
/// );
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RealTime {
    scheduling: Option<Scheduling>,
    processors: Vec<usize>,
    lock_memory: bool,
}

/// A real-time scheduling class of Linux with its priority, 1 to 99: higher ones run first (sched(7)).
///
/// Interrupt threads of a kernel with `PREEMPT_RT` have 50: a bus thread above them waits for no other driver's, and has to
/// sleep now and then, or the network card's own never runs.
///
/// ```
/// use servocrab::bus::{RealTime, Scheduling};
/// let below_the_interrupts = RealTime::new().scheduling(Scheduling::Fifo(49));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Scheduling {
    /// `SCHED_FIFO`: runs until it sleeps or a thread of a higher priority wants to.
    Fifo(u8),
    /// `SCHED_RR`: as `Fifo`, but takes turns with other threads of its priority.
    RoundRobin(u8),
}

impl Scheduling {
    const fn priority(self) -> u8 {
        match self {
            Self::Fifo(priority) | Self::RoundRobin(priority) => priority,
        }
    }

    const fn policy(self) -> ThreadSchedulePolicy {
        ThreadSchedulePolicy::Realtime(match self {
            Self::Fifo(_) => RealtimeThreadSchedulePolicy::Fifo,
            Self::RoundRobin(_) => RealtimeThreadSchedulePolicy::RoundRobin,
        })
    }
}

impl fmt::Display for Scheduling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fifo(priority) => write!(f, "SCHED_FIFO {priority}"),
            Self::RoundRobin(priority) => write!(f, "SCHED_RR {priority}"),
        }
    }
}

/// Why a thread could not have what was asked for it, and what to change.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RealTimeError {
    /// The priority is none of a real-time class.
    #[error("{0}: real-time priorities are 1 to 99")]
    Priority(Scheduling),
    /// The system refuses the scheduling class.
    #[error("the bus thread cannot run as {scheduling}: {source}; {remedy}")]
    Scheduling {
        /// What was asked for.
        scheduling: Scheduling,
        /// What the operating system says.
        source: io::Error,
        /// What to change.
        remedy: String,
    },
    /// The thread may not run on this processor, or there is none of this number.
    #[error(
        "the bus thread cannot run on processor {asked}: this process may use {allowed:?} (isolated processors are given to it by \
         `taskset`, `AllowedCPUs=` or a cpuset)"
    )]
    NoProcessor {
        /// The number asked for, from 0.
        asked: usize,
        /// The numbers of those that it may use.
        allowed: Vec<usize>,
    },
    /// The system refuses the processors.
    #[error("the bus thread cannot be bound to the processors {asked:?}: {source}")]
    Processors {
        /// The numbers asked for, from 0.
        asked: Vec<usize>,
        /// What the operating system says.
        source: io::Error,
    },
    /// The process may not lock as much memory as it will need.
    #[error(
        "this process may lock only {limit} bytes of memory (RLIMIT_MEMLOCK), and would fail when it needs more: run it as root, \
         give it the capability (`setcap cap_net_raw,cap_sys_nice,cap_ipc_lock+ep <program>` with what else it needs: those that are not named are taken away), or allow all (`memlock unlimited` in \
         /etc/security/limits.conf, `LimitMEMLOCK=infinity` of its systemd unit)"
    )]
    MemoryLimit {
        /// The limit in bytes.
        limit: u64,
    },
    /// The system refuses to lock the memory.
    #[error(
        "the memory of the process cannot be locked: {0}; is there as much of it as the process uses?"
    )]
    Memory(io::Error),
}

impl RealTime {
    /// Nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            scheduling: None,
            processors: Vec::new(),
            lock_memory: false,
        }
    }

    /// A scheduling class and priority for the bus thread (needs `CAP_SYS_NICE`, or a limit of real-time priorities as high).
    #[must_use]
    pub const fn scheduling(mut self, scheduling: Scheduling) -> Self {
        self.scheduling = Some(scheduling);
        self
    }

    /// The processors on which the bus thread runs, from 0: best one alone, that nothing else uses.
    #[must_use]
    pub fn processors(mut self, processors: impl IntoIterator<Item = usize>) -> Self {
        self.processors = processors.into_iter().collect();
        self
    }

    /// Keeps all memory of the process, present and future, in RAM (needs `CAP_IPC_LOCK`, or no limit of locked memory).
    #[must_use]
    pub const fn lock_memory(mut self) -> Self {
        self.lock_memory = true;
        self
    }

    /// The priority of its real-time class, if it is to have one.
    pub(in crate::bus) fn priority(&self) -> Option<u8> {
        self.scheduling.map(Scheduling::priority)
    }

    /// Gives it to the calling thread; for programs that run the loop on a thread of their own.
    ///
    /// # Errors
    /// What the system refuses: see [`RealTimeError`]. What stands before it in [`RealTime`] is set then.
    pub fn apply(&self) -> Result<(), RealTimeError> {
        self.bind()?;
        self.schedule()?;
        if self.lock_memory {
            lock_memory()?;
        }
        if *self != Self::new() {
            let thread = thread::current();
            tracing::info!(target: crate::log_target::BUS, thread = thread.name(), settings = ?self, "real time");
        }
        Ok(())
    }

    fn bind(&self) -> Result<(), RealTimeError> {
        if self.processors.is_empty() {
            return Ok(());
        }
        let refused = |error: rustix::io::Errno| RealTimeError::Processors {
            asked: self.processors.clone(),
            source: error.into(),
        };
        let before = sched_getaffinity(None).map_err(refused)?;
        // Of all processors the kernel leaves those that the process may use, isolated ones among them.
        sched_setaffinity(None, &every_processor()).map_err(refused)?;
        let allowed = sched_getaffinity(None).map_err(refused)?;
        let is_allowed = |number: usize| number < CpuSet::MAX_CPU && allowed.is_set(number);
        if let Some(&asked) = self.processors.iter().find(|asked| !is_allowed(**asked)) {
            sched_setaffinity(None, &before).map_err(refused)?;
            let allowed = (0..CpuSet::MAX_CPU).filter(|number| is_allowed(*number));
            return Err(RealTimeError::NoProcessor {
                asked,
                allowed: allowed.collect(),
            });
        }
        let mut chosen = CpuSet::new();
        for number in &self.processors {
            chosen.set(*number);
        }
        sched_setaffinity(None, &chosen).map_err(refused)
    }

    fn schedule(&self) -> Result<(), RealTimeError> {
        let Some(scheduling) = self.scheduling else {
            return Ok(());
        };
        let priority = scheduling.priority();
        let (1..=99, Ok(value)) = (priority, priority.try_into()) else {
            return Err(RealTimeError::Priority(scheduling));
        };
        let set = set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Crossplatform(value),
            scheduling.policy(),
        );
        set.map_err(|error| RealTimeError::Scheduling {
            scheduling,
            source: match error {
                thread_priority::Error::OS(number) => io::Error::from_raw_os_error(number),
                other => io::Error::other(other),
            },
            remedy: scheduling_remedy(priority),
        })
    }
}

fn every_processor() -> CpuSet {
    let mut every = CpuSet::new();
    for number in 0..CpuSet::MAX_CPU {
        every.set(number);
    }
    every
}

/// Why a scheduling class may have been refused.
fn scheduling_remedy(priority: u8) -> String {
    if has(CapabilitySet::SYS_NICE) {
        return "the process has CAP_SYS_NICE: is it inside a container or user namespace, where that does not count, or in a control \
                group without real-time runtime (`cpu.rt_runtime_us`)?"
            .into();
    }
    let limit = getrlimit(Resource::Rtprio)
        .current
        .map_or("unlimited".into(), |limit| limit.to_string());
    format!(
        "the limit of its real-time priorities (RLIMIT_RTPRIO) is {limit}: run the program as root, give it the capability \
         (`setcap cap_net_raw,cap_sys_nice,cap_ipc_lock+ep <program>` with what else it needs: those that are not named are taken away), or raise the limit (`rtprio {priority}` in /etc/security/limits.conf, \
         `LimitRTPRIO={priority}` of its systemd unit)"
    )
}

fn lock_memory() -> Result<(), RealTimeError> {
    // Below a limit the call succeeds, and the first allocation beyond it fails.
    if let Some(limit) = getrlimit(Resource::Memlock).current {
        let none = Rlimit {
            current: None,
            maximum: None,
        };
        let lifted = setrlimit(Resource::Memlock, none).is_ok();
        // Who has CAP_SYS_RESOURCE and cannot lift it is inside a user namespace, where CAP_IPC_LOCK does not count either.
        let exempt = has(CapabilitySet::IPC_LOCK) && !has(CapabilitySet::SYS_RESOURCE);
        if !lifted && !exempt {
            return Err(RealTimeError::MemoryLimit { limit });
        }
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
        .map_err(|error| RealTimeError::Memory(error.into()))
}

/// Whether this thread may do what the capability stands for.
fn has(capability: CapabilitySet) -> bool {
    capabilities(None).is_ok_and(|sets| sets.effective.contains(capability))
}

#[cfg(test)]
mod tests {
    use super::{CpuSet, RealTime, RealTimeError, Scheduling, sched_getaffinity};

    #[test]
    fn a_thread_runs_on_the_processor_that_was_asked_for_and_on_none_that_is_not_there() {
        let before = sched_getaffinity(None).unwrap();
        let first = (0..CpuSet::MAX_CPU).find(|at| before.is_set(*at)).unwrap();
        let beyond = RealTime::new().processors([first, CpuSet::MAX_CPU]).apply();
        let Err(RealTimeError::NoProcessor { asked, allowed }) = beyond else {
            panic!("{beyond:?}");
        };
        assert_eq!(asked, CpuSet::MAX_CPU);
        assert!(allowed.contains(&first), "{allowed:?}");
        assert_eq!(sched_getaffinity(None).unwrap(), before, "left as it was");
        RealTime::new().processors([first]).apply().unwrap();
        let bound = sched_getaffinity(None).unwrap();
        assert!(bound.count() == 1 && bound.is_set(first), "{bound:?}");
    }

    #[test]
    fn a_priority_that_is_none_is_refused_before_the_system_is_asked() {
        for priority in [0, 100, 255] {
            let error = RealTime::new()
                .scheduling(Scheduling::Fifo(priority))
                .apply()
                .unwrap_err();
            assert_eq!(
                error.to_string(),
                format!("SCHED_FIFO {priority}: real-time priorities are 1 to 99")
            );
        }
    }

    #[test]
    fn nothing_that_was_not_asked_for_is_touched() {
        let before = sched_getaffinity(None).unwrap();
        RealTime::new().apply().unwrap();
        assert_eq!(sched_getaffinity(None).unwrap(), before);
    }
}

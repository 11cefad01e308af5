//! Sleeping until a frame has come, a waker was used or a time has come: one epoll on a socket, an eventfd and a timerfd.

use std::{
    io,
    os::fd::{AsFd, OwnedFd},
    sync::Arc,
    task::{Wake, Waker},
    time::Duration,
};

use rustix::{
    event::{
        EventfdFlags,
        epoll::{self, CreateFlags, EventData, EventFlags},
        eventfd,
    },
    net::sockopt::socket_error,
    time::{
        ClockId, Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec,
        clock_gettime, timerfd_create, timerfd_settime,
    },
};

const SOCKET: u64 = 0;
const EVENT: u64 = 1;
const TIMER: u64 = 2;

/// The time of the clock that sleeping goes by.
pub(super) fn now() -> Duration {
    Duration::try_from(clock_gettime(ClockId::Monotonic)).unwrap_or_default()
}

/// Going to sleep for less than this would take longer.
const SHORTEST_SLEEP: Duration = Duration::from_micros(5);

/// What a thread sleeps with. Its timer is exact: the slack of the thread's other timers (prctl(2), `PR_SET_TIMERSLACK`) is not its.
pub(super) struct Sleeper {
    epoll: OwnedFd,
    timer: OwnedFd,
    /// When the timer rings; none once it was seen to have rung.
    rings: Option<Duration>,
    event: Arc<Event>,
}

impl Sleeper {
    pub(super) fn new(socket: &OwnedFd) -> io::Result<Self> {
        let epoll = epoll::create(CreateFlags::CLOEXEC)?;
        let timer = timerfd_create(
            TimerfdClockId::Monotonic,
            TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC,
        )?;
        let event = Arc::new(Event(eventfd(
            0,
            EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC,
        )?));
        for (descriptor, data, edge) in [
            // Else the kernel looks at the socket once more with each sleep.
            (socket.as_fd(), SOCKET, EventFlags::ET),
            (event.0.as_fd(), EVENT, EventFlags::empty()),
            (timer.as_fd(), TIMER, EventFlags::empty()),
        ] {
            let flags = EventFlags::IN | edge;
            epoll::add(&epoll, descriptor, EventData::new_u64(data), flags)?;
        }
        Ok(Self {
            epoll,
            timer,
            rings: None,
            event,
        })
    }

    /// Sleeps until more has come on `socket`, the waker was used or `until` has come; or until a time that was named before.
    pub(super) fn wait(&mut self, socket: &OwnedFd, until: Duration) {
        // Setting a timer anew costs more than to wake for nothing now and then: one that rings sooner is left as it is.
        if self.rings.is_none_or(|rings| until < rings) {
            self.set_timer(until);
        }
        let mut events = [epoll::Event {
            flags: EventFlags::empty(),
            data: EventData::new_u64(TIMER),
        }; 3];
        // An error (a signal came) is the same as waking early.
        let count = epoll::wait(&self.epoll, &mut events, None).unwrap_or(0);
        for epoll::Event { flags, data } in events.into_iter().take(count) {
            match data.u64() {
                EVENT => self.event.clear(),
                // The interface is down. Reading the error clears it; else the next frame that is sent would be refused for it, when
                // the interface is up again.
                SOCKET if flags.contains(EventFlags::ERR) => {
                    let _ = socket_error(socket);
                }
                // To set it anew is what clears it. Cycles that follow a clock begin a little later than it was set for.
                TIMER => {
                    self.rings = None;
                    if until.saturating_sub(now()) < SHORTEST_SLEEP {
                        while now() < until {
                            std::hint::spin_loop();
                        }
                    }
                }
                _ => {}
            }
        }
    }

    pub(super) fn waker(&self) -> Waker {
        Waker::from(Arc::clone(&self.event))
    }

    fn set_timer(&mut self, at: Duration) {
        // All zeros would be no time at all.
        let at = at.max(Duration::from_nanos(1));
        let Ok(it_value) = Timespec::try_from(at) else {
            return;
        };
        let it_interval = Timespec::default();
        let once = Itimerspec {
            it_interval,
            it_value,
        };
        // It cannot fail with a time and flags that are right.
        if timerfd_settime(&self.timer, TimerfdTimerFlags::ABSTIME, &once).is_ok() {
            self.rings = Some(at);
        }
    }
}

/// Ends a sleep from any thread.
struct Event(OwnedFd);

impl Event {
    fn clear(&self) {
        // Failing (there was nothing to read) is of no consequence: the descriptor does not block.
        let _ = rustix::io::read(&self.0, &mut [0; 8]);
    }
}

impl Wake for Event {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        // It can only fail when the counter is at its end, and then the descriptor is readable already.
        let _ = rustix::io::write(&self.0, &1u64.to_ne_bytes());
    }
}

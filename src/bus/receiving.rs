//! Whether the bus thread sleeps or spins while it waits.

use std::{num::NonZero, thread, time::Duration};

use rustix::thread::set_current_timer_slack;

/// How long before a cycle, and for its frames, the thread spins where the machine is suited to it.
const SPIN: Duration = Duration::from_micros(50);
/// Cycles that are longer gain nothing that counts.
const LONGEST_PERIOD_TO_SPIN: Duration = Duration::from_micros(500);
/// With fewer cores spinning takes the time from the program, or from the kernel's own work for the interface.
const FEWEST_CORES_TO_SPIN: usize = 4;

/// How the bus thread waits for the frames of a cycle and for the start of the next one. While the line is brought up it sleeps.
///
/// A thread that sleeps is woken some 10 to 50 µs after its time or its frame; one that spins sees both within a microsecond, and
/// takes a processor core for itself meanwhile. Without a [real-time class](super::RealTime) the kernel lets another thread on that
/// core when it has spun for a while, and then the cycle is late by milliseconds: [`Spin`](Self::Spin) wants a core that nobody else
/// uses.
///
/// ```
/// use servocrab::bus::{Network, Receiving};
/// use std::time::Duration;
/// let builder = Network::builder()
///     .cycle(Duration::from_micros(250))
///     .receiving(Receiving::SpinThenBlock { spin: Duration::from_micros(30) });
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Receiving {
    /// Sleeps whenever there is nothing to do.
    Block,
    /// Never sleeps.
    Spin,
    /// Sleeps until `spin` before a cycle, and spins for `spin` after its frames were sent: what takes longer is slept for.
    SpinThenBlock {
        /// How long it spins, each time.
        spin: Duration,
    },
}

impl Receiving {
    /// What is taken where the program says nothing: [`SpinThenBlock`](Self::SpinThenBlock) with 50 µs, but not more than an eighth
    /// of the cycle, where cycles are at most 500 µs long and the process may use four cores or more; else [`Block`](Self::Block).
    ///
    /// ```
    /// use servocrab::bus::Receiving;
    /// use std::time::Duration;
    /// assert_eq!(Receiving::suited_to(Duration::from_millis(1), 8), Receiving::Block);
    /// ```
    #[must_use]
    pub fn suited_to(period: Duration, cores: usize) -> Self {
        if period > LONGEST_PERIOD_TO_SPIN || cores < FEWEST_CORES_TO_SPIN {
            return Self::Block;
        }
        Self::SpinThenBlock {
            spin: SPIN.min(period / 8),
        }
    }

    /// The same for this machine.
    pub(super) fn suited_here(period: Duration) -> Self {
        let cores = thread::available_parallelism().map_or(1, NonZero::get);
        Self::suited_to(period, cores)
    }

    /// Until when the thread may sleep now, where nothing is to be done before `until`; none where it is to spin.
    pub(super) fn sleep(
        self,
        now: Duration,
        until: Duration,
        awaited: Awaited,
    ) -> Option<Duration> {
        let until = match (self, awaited) {
            (Self::Block, _) | (_, Awaited::Nothing) => until,
            (Self::Spin, _) => return None,
            (Self::SpinThenBlock { spin }, Awaited::Frames { sent }) => {
                if now < sent.saturating_add(spin) {
                    return None;
                }
                until
            }
            (Self::SpinThenBlock { spin }, Awaited::Cycle { start }) => {
                until.min(start.saturating_sub(spin))
            }
        };
        (now < until).then_some(until)
    }
}

/// Has the kernel wake this thread when its time has come, and not up to 50 µs later together with others (prctl(2),
/// `PR_SET_TIMERSLACK`).
pub(super) fn wake_on_time() {
    // Where that is refused it sleeps as others do.
    let _ = set_current_timer_slack(Some(NonZero::<u64>::MIN));
}

/// What the thread waits for.
#[derive(Debug, Clone, Copy)]
pub(super) enum Awaited {
    /// There are no cycles.
    Nothing,
    /// The frames of a cycle, which were sent at this time.
    Frames { sent: Duration },
    /// The next cycle, which starts at this time.
    Cycle { start: Duration },
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Awaited, Receiving};

    const fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn short_cycles_on_many_cores_spin_for_a_part_of_the_cycle_and_all_others_sleep() {
        assert_eq!(Receiving::suited_to(us(1000), 64), Receiving::Block);
        assert_eq!(Receiving::suited_to(us(250), 2), Receiving::Block);
        let spins = |spin| Receiving::SpinThenBlock { spin: us(spin) };
        assert_eq!(Receiving::suited_to(us(500), 4), spins(50));
        assert_eq!(Receiving::suited_to(us(200), 4), spins(25));
    }

    #[test]
    fn a_thread_spins_before_a_cycle_and_after_its_frames_and_sleeps_between() {
        let receiving = Receiving::SpinThenBlock { spin: us(30) };
        let frames = Awaited::Frames { sent: us(100) };
        assert_eq!(receiving.sleep(us(129), us(829), frames), None);
        assert_eq!(receiving.sleep(us(130), us(830), frames), Some(us(830)));
        let cycle = Awaited::Cycle { start: us(1000) };
        assert_eq!(receiving.sleep(us(400), us(1000), cycle), Some(us(970)));
        let timer = receiving.sleep(us(400), us(490), cycle);
        assert_eq!(timer, Some(us(490)));
        assert_eq!(receiving.sleep(us(970), us(1000), cycle), None);
    }

    #[test]
    fn nobody_spins_while_there_are_no_cycles() {
        let sleep = Receiving::Spin.sleep(us(5), us(705), Awaited::Nothing);
        assert_eq!(sleep, Some(us(705)));
    }
}

//! What stops an axis from anywhere.

use core::{
    sync::atomic::{AtomicU8, AtomicU64, Ordering},
    time::Duration,
};
use std::sync::Arc;

use crate::{StopRequest, units::AxisUnit};

use super::{Axis, shared::Shared};

impl<U: AxisUnit> Axis<U> {
    /// What stops this axis from anywhere: `Drop`, a signal, a panic hook.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let stop = net.axis("x")?.stop_handle();
    /// // From any thread, or a signal handler:
    /// std::thread::spawn(move || stop.quick_stop());
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn stop_handle(&self) -> StopHandle {
        StopHandle {
            shared: Arc::clone(&self.handles.shared),
        }
    }
}

/// Stops one axis: at once, from any thread, without waiting and without failing. What it asks for is in the next
/// process-data frame, whatever else is queued, and it wins over everything that is asked for in the same cycle. It does
/// not count as a handle of the axis.
///
/// Only atomics are touched: it may be called from a signal handler. It is no safety function.
#[derive(Debug, Clone)]
pub struct StopHandle {
    shared: Arc<Shared>,
}

impl StopHandle {
    /// Pauses by bit 8, keeping the set-point. On a drive that ignores bit 8 it goes on to the quick stop as soon as that is known. Where
    /// 605Dh is 0 it is a quick stop, and the set-point is gone.
    pub fn halt(&self) {
        self.shared.request_stop(StopRequest::HALT);
    }

    /// Halts, then abandons the set-point by quick stop.
    pub fn stop(&self) {
        self.shared.request_stop(StopRequest::STOP);
    }

    /// Quick stop (bit 2).
    pub fn quick_stop(&self) {
        self.shared.request_stop(StopRequest::QUICK_STOP);
    }
}

// Whether the program is alive: it feeds a [`Liveness`], and the bus thread halts every axis when that stops.

/// Fed by the program. When it is not fed for its time, or the last clone is dropped without [`end`](Self::end), it has expired.
/// Then every axis halts. Until it is fed or ended none is enabled, resumed, or starts anything.
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::Liveness;
/// let (live, mut watch) = Liveness::new(Duration::from_millis(200));
/// assert!(!watch.expired(Duration::from_secs(1)), "the time counts from the first look");
/// live.feed();
/// assert!(!watch.expired(Duration::from_millis(1150)));
/// assert!(watch.expired(Duration::from_millis(1351)));
/// live.end();
/// assert!(!watch.expired(Duration::from_millis(1600)), "nobody watches any more");
/// ```
#[must_use = "dropped without `end` it halts every axis"]
#[derive(Debug, Clone)]
pub struct Liveness {
    held: Arc<Held>,
}

/// All clones.
#[derive(Debug)]
struct Held {
    fed: Arc<Fed>,
}

#[derive(Debug, Default)]
struct Fed {
    times: AtomicU64,
    end: AtomicU8,
}

/// It was ended by the program.
const ENDED: u8 = 1;
/// The last clone was dropped.
const DROPPED: u8 = 2;

impl Liveness {
    /// A pair: one end for the program, one for the owner of the cycle.
    pub fn new(timeout: Duration) -> (Self, LivenessWatch) {
        let fed = Arc::new(Fed::default());
        let watch = LivenessWatch {
            fed: Arc::clone(&fed),
            timeout,
            seen: None,
        };
        let held = Arc::new(Held { fed });
        (Self { held }, watch)
    }

    /// Says that the program is alive.
    pub fn feed(&self) {
        self.held.fed.times.fetch_add(1, Ordering::Relaxed);
    }

    /// Nobody watches any more, whichever clones there are. Axes that have halted stay halted until they are resumed.
    pub fn end(self) {
        self.held.fed.end.store(ENDED, Ordering::Release);
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let end = &self.fed.end;
        let _ = end.compare_exchange(0, DROPPED, Ordering::AcqRel, Ordering::Acquire);
    }
}

/// The end that is looked at once a cycle. What it says goes to [`AxisPort::obey`](super::AxisPort::obey) of every axis.
#[derive(Debug)]
pub struct LivenessWatch {
    fed: Arc<Fed>,
    timeout: Duration,
    /// How often it was fed, and when that was first seen.
    seen: Option<(u64, Duration)>,
}

impl LivenessWatch {
    /// Whether the program has not fed it for longer than the timeout, or has dropped it: then every axis is to be halted.
    /// It stays true until it is fed again, or ended; what was halted stays halted until it is resumed.
    pub fn expired(&mut self, now: Duration) -> bool {
        match self.fed.end.load(Ordering::Acquire) {
            0 => {}
            end => return end == DROPPED,
        }
        let fed = self.fed.times.load(Ordering::Relaxed);
        match self.seen {
            Some((seen, since)) if seen == fed => now.saturating_sub(since) > self.timeout,
            _ => {
                self.seen = Some((fed, now));
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_stops_feeding_is_noticed_once_its_time_is_over_and_not_before() {
        let (live, mut watch) = Liveness::new(Duration::from_millis(5));
        let expired: Vec<bool> = (0..20)
            .map(|ms| {
                if ms < 4 || ms == 15 {
                    live.feed();
                }
                watch.expired(Duration::from_millis(ms))
            })
            .collect();
        let noticed: Vec<usize> = (0..20).filter(|ms| expired[*ms]).collect();
        assert_eq!(
            noticed,
            [9, 10, 11, 12, 13, 14],
            "last fed at 3 ms, and again at 15 ms"
        );
    }

    #[test]
    fn dropped_it_has_expired_and_ended_it_has_not() {
        let timeout = Duration::from_millis(5);
        let (live, mut watch) = Liveness::new(timeout);
        let clone = live.clone();
        drop(live);
        assert!(!watch.expired(timeout));
        drop(clone);
        assert!(watch.expired(timeout) && watch.expired(Duration::MAX));
        let (live, mut watch) = Liveness::new(timeout);
        let clone = live.clone();
        live.end();
        drop(clone);
        assert!(!watch.expired(timeout) && !watch.expired(Duration::MAX));
    }
}

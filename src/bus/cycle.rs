//! When cycles begin and end, and who is called around them.

use std::time::Duration;

use super::{
    ReferenceClock,
    dc::Phase,
    drive_data::Drives,
    exchange::{Events, Exchange, receive_deadline},
    frame::Tag,
    gap::{Gap, RoundTrip},
    statistics::Counters,
};
use crate::link::Link;

/// Who works with the process data, on the bus thread.
pub(super) trait Stepper {
    /// Last thing before the outputs are sent.
    fn before_send(&mut self, now: Duration, drives: &mut Drives);
    /// After the inputs came in, or did not.
    fn after_receive(&mut self, now: Duration, drives: &mut Drives);
}

/// One, then the other.
impl<A: Stepper, B: Stepper> Stepper for (A, B) {
    fn before_send(&mut self, now: Duration, drives: &mut Drives) {
        self.0.before_send(now, drives);
        self.1.before_send(now, drives);
    }

    fn after_receive(&mut self, now: Duration, drives: &mut Drives) {
        self.0.after_receive(now, drives);
        self.1.after_receive(now, drives);
    }
}

/// The exchange in time.
pub(super) struct Cycle {
    pub(super) exchange: Exchange,
    stepper: Box<dyn Stepper>,
    /// Keeps the cycles in step with a reference clock.
    clock: Option<Phase>,
    period: Duration,
    /// Parts of it: divisions are dear.
    deadline: Duration,
    eighth: Duration,
    next_start: Duration,
    receive_until: Duration,
    /// When the frames of the last cycle were sent, and when the last of them came back, if all did.
    sent_at: Duration,
    back_at: Option<Duration>,
    /// How long they were away, where that is still to be counted.
    took: Option<Duration>,
    round_trip: RoundTrip,
    /// Whether the frames of the last cycle were all back before its deadline.
    calm: bool,
    /// Consecutive cycles in which everything was right.
    pub(super) good: u32,
    /// What the last cycle showed.
    pub(super) last: Events,
    /// Whether a drive was lost or came back since somebody looked.
    pub(super) membership_changed: bool,
}

impl Cycle {
    pub(super) fn new(
        exchange: Exchange,
        stepper: Box<dyn Stepper>,
        period: Duration,
        first: Duration,
        clock: Option<Phase>,
    ) -> Self {
        Self {
            exchange,
            stepper,
            clock,
            period,
            deadline: receive_deadline(period),
            eighth: period / 8,
            next_start: first,
            receive_until: first,
            sent_at: first,
            back_at: None,
            took: None,
            round_trip: RoundTrip::default(),
            calm: false,
            good: 0,
            last: Events::default(),
            membership_changed: false,
        }
    }

    pub(super) const fn in_flight(&self) -> bool {
        self.exchange.in_flight()
    }

    /// When the last cycle was sent.
    pub(super) const fn sent(&self) -> Duration {
        self.sent_at
    }

    /// Whether a cycle is to be sent now, and nothing else before.
    pub(super) fn is_due(&self, now: Duration) -> bool {
        !self.in_flight() && now >= self.next_start
    }

    /// The time for acyclic frames until the next cycle starts.
    pub(super) fn gap(&self) -> Gap {
        Gap {
            end: self.next_start,
            round_trip: self.round_trip.reckoned(self.eighth),
            longest_alone: self.eighth,
        }
    }

    /// When [`turn`](Self::turn) is to be called at the latest. For a frame that is lost when all was well before that is the next
    /// start: the time that the thread is woken at in any case, so that it sets its timer once a cycle and not twice.
    pub(super) const fn next(&self) -> Duration {
        if self.in_flight() && !self.calm {
            self.receive_until
        } else {
            self.next_start
        }
    }

    /// Takes a frame of process data in a turn that began at `now`. True once all of the cycle are there: it ends with the turn that
    /// received the last one.
    // This and `turn` are kept whole: `benches/step` counts what is done in them, by their names.
    #[inline(never)]
    pub(super) fn accept(
        &mut self,
        tag: Tag,
        frame: &[u8],
        now: Duration,
        counters: &Counters,
    ) -> bool {
        let complete = self.exchange.accept(tag, frame, counters);
        if complete {
            self.back_at = Some(now);
            self.receive_until = Duration::ZERO;
        }
        complete
    }

    /// Ends a cycle and begins the next, each when it is time.
    #[inline(never)]
    pub(super) fn turn(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        if self.in_flight() && now >= self.receive_until {
            self.end(now, counters);
        }
        if self.is_due(now) {
            self.begin(now, link, counters);
        }
    }

    fn begin(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        let late = now.saturating_sub(self.next_start);
        // Cycles that were slept through are not made up for, and the phase stays.
        let periods = if late < self.period {
            1
        } else {
            let slept_through = late.as_nanos() / self.period.as_nanos().max(1);
            u32::try_from(slept_through + 1).unwrap_or(u32::MAX)
        };
        if let Some(clock) = &mut self.clock {
            let (passes, sooner) = clock.begin(late, periods);
            self.exchange.set_reference_time(passes as u32);
            self.next_start = earlier(self.next_start, sooner);
        }
        self.stepper.before_send(now, &mut self.exchange.drives);
        self.exchange.send(link, counters);
        self.sent_at = now;
        self.receive_until = now.saturating_add(self.deadline);
        let later = self.period.saturating_mul(periods);
        self.next_start = self.next_start.saturating_add(later);
        // The books are kept while nothing waits for it.
        self.exchange.record(now);
        counters.lateness.record(late);
        if late > self.period / 2 {
            counters.late_cycles.add();
        }
        if periods > 1 {
            counters.overruns.add_many(u64::from(periods - 1));
        }
        if let Some(took) = self.took.take() {
            counters.round_trip.record(took);
        }
    }

    /// The reference clock's time, and when it was that, where cycles are in step with one.
    pub(super) fn reference_time(&self) -> Option<(u64, Duration)> {
        let clock = self.clock.as_ref()?;
        Some((clock.time(), self.sent_at))
    }

    fn end(&mut self, now: Duration, counters: &Counters) {
        let events = self.exchange.judge(counters);
        self.calm = false;
        if let Some(back) = self.back_at.take() {
            let took = back.saturating_sub(self.sent_at);
            self.calm = took <= self.deadline;
            self.round_trip.observe(took);
            self.took = Some(took);
        }
        let complete = !events.wrong && events.al_status.is_some();
        self.good = if complete {
            self.good.saturating_add(1)
        } else {
            0
        };
        self.membership_changed |= events.membership;
        self.last = events;
        if let Some(clock) = &mut self.clock {
            let (sooner, measured) = clock.end(events.reference_time);
            self.next_start = earlier(self.next_start, sooner);
            match measured {
                Some(measured) => counters.clock.record(&measured),
                None => counters.clock.hold(clock.is_locked(), clock.reference()),
            }
            if clock.reference() == ReferenceClock::Jumped {
                self.exchange.lead_clocks();
            }
        }
        self.stepper.after_receive(now, &mut self.exchange.drives);
    }
}

/// So many nanoseconds before, or after with a negative number.
fn earlier(time: Duration, sooner: i64) -> Duration {
    let by = Duration::from_nanos(sooner.unsigned_abs());
    if sooner < 0 {
        time.saturating_add(by)
    } else {
        time.saturating_sub(by)
    }
}

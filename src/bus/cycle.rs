//! When cycles begin and end, and who is called around them.

use std::time::Duration;

use super::{
    exchange::{DriveData, Events, Exchange, receive_deadline},
    frame::Tag,
    statistics::Counters,
};
use crate::link::Link;

/// Who works with the process data, on the bus thread.
pub(super) trait Stepper {
    /// Last thing before the outputs are sent.
    fn before_send(&mut self, now: Duration, drives: &mut [DriveData]);
    /// After the inputs came in, or did not.
    fn after_receive(&mut self, now: Duration, drives: &mut [DriveData]);
}

/// The exchange in time.
pub(super) struct Cycle {
    pub(super) exchange: Exchange,
    stepper: Box<dyn Stepper>,
    period: Duration,
    next_start: Duration,
    receive_until: Duration,
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
    ) -> Self {
        Self {
            exchange,
            stepper,
            period,
            next_start: first,
            receive_until: first,
            good: 0,
            last: Events::default(),
            membership_changed: false,
        }
    }

    pub(super) const fn in_flight(&self) -> bool {
        self.exchange.in_flight()
    }

    /// When [`turn`](Self::turn) is to be called at the latest.
    pub(super) const fn next(&self) -> Duration {
        if self.in_flight() {
            self.receive_until
        } else {
            self.next_start
        }
    }

    /// Takes a frame of process data.
    pub(super) fn accept(&mut self, tag: Tag, frame: &[u8], counters: &Counters) {
        if self.exchange.accept(tag, frame, counters) {
            // All are there: the cycle ends with the turn that received the last one.
            self.receive_until = Duration::ZERO;
        }
    }

    pub(super) fn turn(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        if self.in_flight() && now >= self.receive_until {
            self.end(now, counters);
        }
        if !self.in_flight() && now >= self.next_start {
            self.begin(now, link, counters);
        }
    }

    fn begin(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        let late = now.saturating_sub(self.next_start);
        if late > self.period / 2 {
            counters.late_cycles.add();
        }
        self.stepper.before_send(now, &mut self.exchange.drives);
        self.exchange.send(link, counters);
        self.receive_until = now + receive_deadline(self.period);
        self.next_start += self.period;
        if self.next_start <= now {
            // Cycles that were slept through are not made up for.
            self.next_start = now + self.period;
        }
    }

    fn end(&mut self, now: Duration, counters: &Counters) {
        let events = self.exchange.judge(counters);
        let complete = !events.wrong && events.al_status.is_some();
        self.good = if complete {
            self.good.saturating_add(1)
        } else {
            0
        };
        self.membership_changed |= events.membership;
        self.last = events;
        self.stepper.after_receive(now, &mut self.exchange.drives);
    }
}
